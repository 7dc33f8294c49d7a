"""The loop of a compensator in the C core: its preview, how it is made, its snapshot, and how it is resumed."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from dehyst._errors import ModelError
from dehyst._io import PathLike, read_json, write_json
from dehyst._native import CoreState, Loop, StepCoefficients, checked
from dehyst._types import Array
from dehyst._validation import keep, vector
from dehyst.control.limits import VoltageLimits, warn_of_sample
from dehyst.model import Actuator, State, serialization

# Of the largest change: a smaller one is not clamped.
_NEARLY = 1 - 1e-9
FORMAT = "dehyst-loop"
VERSION = 1
# Range of the core's counts on every machine.
_MOST = 2**31
# Entries of a model file on which a loop does not depend.
_FREE = serialization.DESCRIPTION | {"limits", "state"}
# A delay this close to a whole number of steps is that number.
_WHOLE = 1e-9
# Most steps of a delay, or of a radian of the resonance.
_FARTHEST = 1e6


def step_numbers(
    actuator: Actuator, limits: VoltageLimits, period: float | None
) -> tuple[StepCoefficients, tuple[float, float, float, float, float, float, float]]:
    """Return the coefficients of a step, and the limits, the largest change [V] and the amplifier's numbers.

    Raise `ModelError` if a period is missing, too long for a resonance, or too short for the slew rate.
    """
    model, slew = actuator.model, limits.slew_rate
    if period is None and (model.needs_time or slew is not None):
        raise ModelError(
            "creep, inertia, a lag or a slew rate need the time between steps",
            hint="give the period [s]",
            change=("period",),
        )
    seconds = 0.0 if period is None else period
    pace = model.step_coefficients(np.array([0, 1]), np.array([seconds]))
    most = float(np.finfo(np.float64).max)
    change = most if slew is None else min(slew * seconds, most)
    if change <= 0:
        raise ModelError(
            f"{slew:g} V/s allow no change in {seconds:g} s", argument="slew_rate", hint="give more, or a longer period"
        )
    return pace, (limits.low, limits.high, change, *model.amplifier(seconds))


def make_loop(
    actuator: Actuator, limits: VoltageLimits, period: float | None, taps: Array, start: CoreState, warns: bool = True
) -> Loop:
    """Return a loop that starts in a state and may warn of clamped samples; raise `ModelError` as `step_numbers`."""
    pace, numbers = step_numbers(actuator, limits, period)
    warn = partial(warn_of_sample, actuator, limits) if warns else lambda *_: None
    return actuator.model.core.loop(pace, taps, np.array(numbers), warn, start)


def resume(loop: Loop, actuator: Actuator, limits: VoltageLimits, key: str, snapshot: Snapshot) -> None:
    """Set a loop to a snapshot; `key` identifies the loop. After an error the loop is as before.

    Raise `ModelError` if the snapshot is of another actuator, period or preview, or damaged.
    """
    if not isinstance(snapshot, Snapshot):
        raise ModelError(
            argument="snapshot",
            got=type(snapshot).__name__,
            need="a Snapshot",
            hint="Snapshot.load reads a file",
        )
    if snapshot.key != key:
        raise ModelError(
            "it is of another actuator, period or preview",
            argument="snapshot",
            hint="make the compensator as it was",
        )
    state = actuator.model.core_state(actuator.model.complete_state(snapshot.state))
    if snapshot.rest.size != loop.rest().size:
        raise ModelError(
            argument="snapshot", got=f"{snapshot.rest.size} numbers beside the state", need=str(loop.rest().size)
        )
    if not limits.low <= snapshot.rest[0] <= limits.high:
        raise ModelError(
            f"its voltage, {snapshot.rest[0]:g} V, lies outside the limits {limits.words}", argument="snapshot"
        )
    before = loop.state(), loop.rest(), loop.counts()
    checked(loop.begin, *state)
    try:
        checked(loop.go_on, snapshot.rest, *snapshot.counts)
    except ModelError:
        loop.begin(*before[0])
        loop.go_on(before[1], *before[2])
        raise


def reached_if_clamped(loop: Loop, limits: VoltageLimits, period: float | None, voltage: float) -> float | None:
    """Return the displacement w [m] that a `voltage` on offer leads to if it was clamped, else None.

    The loop has nothing on offer afterwards if the result is a number; it is as before otherwise.
    """
    change = float("inf") if limits.slew_rate is None or period is None else limits.slew_rate * period
    if limits.low < voltage < limits.high and abs(voltage - loop.sent()) < _NEARLY * change:
        return None
    before = loop.state(), loop.rest(), loop.counts()
    loop.commit(voltage)
    clamped, reached = loop.counts()[:2] != before[2][:2], float(loop.state()[0])
    loop.begin(*before[0])
    loop.go_on(before[1], *before[2])
    return reached if clamped else None


@dataclass(frozen=True, eq=False)
class Snapshot:
    """The memory of a loop between two steps.

    Attributes
    ----------
    key : str
        Digest of the actuator's numbers, the period and the preview: the snapshot fits no other loop.
    state : State
        State of the actuator.
    rest : (6 + M,) array
        The remaining memory: the last voltage, the output of the amplifier, its two inputs before, the push and the
        velocity of the mass, and the displacements fed, newest first.
    counts : (int, int, int)
        Numbers of samples limited, slewed and refused.
    """

    key: str
    state: State
    rest: Array
    counts: tuple[int, int, int]

    def __post_init__(self) -> None:
        if not isinstance(self.state, State):
            raise ModelError(argument="snapshot", got=f"a state of type {type(self.state).__name__}", need="a State")
        keep(self, rest=vector(self.rest, "snapshot: rest"))
        counts = self.counts
        whole = isinstance(counts, Sequence) and [type(n) for n in counts] == [int] * 3
        if not whole or not all(0 <= n < _MOST for n in counts):
            raise ModelError(argument="snapshot: counts", got=repr(counts), need=f"three whole numbers below {_MOST}")
        keep(self, counts=tuple(counts))

    def save(self, path: PathLike) -> None:
        """Write the snapshot to `path` as JSON, completely or not at all.

        Raise `FileFormatError` if it cannot be written.
        """
        head = {"format": FORMAT, "version": VERSION, "key": self.key}
        memory = {"rest": self.rest.tolist(), "counts": list(self.counts)}
        write_json(path, {**head, "state": serialization.state_dict(self.state), **memory})

    @classmethod
    def load(cls, path: PathLike) -> Snapshot:
        """Read a snapshot from `path`, strictly and without loss.

        Raises
        ------
        FileFormatError
            If the file cannot be read or is not JSON.
        ModelError
            If it is not a snapshot of this version.
        """
        data = read_json(path)
        if data.get("format") != FORMAT or type(data.get("version")) is not int or data["version"] != VERSION:
            raise ModelError(
                f"{path}: got format {data.get('format')!r} version {data.get('version')!r}, need {FORMAT!r} {VERSION}"
            )
        serialization.demand_keys(data, {"format", "version", "key", "state", "rest", "counts"}, "snapshot")
        try:
            rest = serialization.numbers(data["rest"], "rest")
            return cls(str(data["key"]), serialization.state(data), rest, data["counts"])
        except ModelError as error:
            raise ModelError(f"{path}: {error}") from error


def key_of(actuator: Actuator, period: float | None, preview: bool) -> str:
    """Return the digest that a snapshot of a loop has as its key."""
    numbers = {name: value for name, value in actuator.as_dict().items() if name not in _FREE}
    text = json.dumps([numbers, period, preview], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True, eq=False)
class Preview:
    """An FIR filter from the wanted displacement y to w, the displacement that the elements follow.

    ``w(t) = Y(t + delay)``, with inertia ``Y = y + 2 zeta/omega y' + y''/omega^2``; between samples y is the polynomial
    through the nearest samples.

    `taps` (M,): w is the sum of taps[m] times the displacement fed m samples ago. `ahead`: number of samples by which
    the fed displacement is ahead.
    """

    taps: Array
    ahead: int

    @classmethod
    def none(cls) -> Preview:
        """Return the filter that leaves the displacement unchanged."""
        return cls(np.ones(1), 0)

    @classmethod
    def of(cls, actuator: Actuator, period: float) -> Preview:
        """Return the filter for the delay and the dynamics of an actuator, with a step every `period` [s].

        Raise `ModelError` if the delay, or a radian of the resonance, takes more than a million steps.
        """
        delay, dynamics = actuator.delay / period, actuator.dynamics
        if delay > _FARTHEST or (dynamics is not None and dynamics.frequency * period < 1 / _FARTHEST):
            raise ModelError(
                f"got {period:g} s, which is too short to look ahead by a delay of {actuator.delay:g} "
                "s or a period of the resonance",
                argument="period",
                hint="give a longer one, or leave preview out",
            )
        # Remove the rounding of a whole number of periods.
        delay = round(delay) if abs(delay - round(delay)) < _WHOLE else delay
        whole = math.floor(delay)
        if dynamics is None and delay == whole:
            return cls(np.ones(1), whole)
        # Symmetric about the delay: the error of a derivative is then one order smaller.
        near = (1 if dynamics is None else 2) + (delay != whole)
        offsets = np.arange(whole + (delay != whole) - near, whole + near + 1, dtype=np.float64)
        weights = np.array([_weights(np.subtract(offsets, delay), order) for order in range(3)])
        taps = weights[0]
        if dynamics is not None:
            steps = dynamics.frequency * period
            taps = taps + (2 * dynamics.damping * weights[1] + weights[2] / steps) / steps
        return cls(np.ascontiguousarray(taps[::-1]), int(offsets[-1]))


def _weights(offsets: Array, order: int) -> Array:
    """Return the weights of values at offsets [samples] in a derivative at 0 of the polynomial through them."""
    powers = np.vander(offsets, increasing=True).T
    return np.linalg.solve(powers, math.factorial(order) * np.eye(offsets.size)[order])
