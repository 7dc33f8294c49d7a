"""A whole path to voltages that may leave the program: within limits and slew rate, clamped loudly."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dehyst._native import CoreState
from dehyst._types import Array, Mask
from dehyst._validation import vector
from dehyst.control.limits import TIME_NEEDED, VoltageLimits
from dehyst.model import Actuator, Motion, State
from dehyst.model.evaluator import PathData

_CHUNK = 64
_ANY = float(np.finfo(np.float64).max)
# What `Loop.trace` calls an offer that was not clamped.
_WISHED = 1
_ROUNDING = 1e-12
# Of the spring's knots: a miss that is worth a sentence.
_WORTH = 1e-3
# Runs of equal steps, each of which is set up anew.
_FEW = 64


@dataclass(frozen=True, eq=False)
class Command:
    """A voltage to send.

    Attributes
    ----------
    voltage : (n,) array
        [V], within limits and slew rate.
    displacement : (n,) array
        What the model does with it [m]: the wanted path, but where the voltage was clamped; with dynamics or a lag,
        simulated.
    clamped : (n,) bool array
        Samples whose voltage was changed.
    state : State
        The state that the clamped voltage leads to.
    warnings : tuple of str
        What was clamped, and whether the path is missed for another reason, in sentences; empty if all is well.
    missed : float
        Largest distance [m] of `displacement` from the wanted path.
    followed : bool
        Whether nothing was clamped, and the path is missed by no more than a thousandth of the range of the spring.
    """

    voltage: Array
    displacement: Array
    clamped: Mask
    state: State
    warnings: tuple[str, ...]
    missed: float
    followed: bool


def follow(
    actuator: Actuator,
    limits: VoltageLimits,
    displacement: ArrayLike,
    *,
    time: ArrayLike | None,
    period: float | None,
    load: ArrayLike | None,
    velocity: ArrayLike | None,
    acceleration: ArrayLike | None,
    start: State,
) -> Command:
    """Voltages for a path, each clamped with the state kept true; see `Compensator.trajectory`."""
    wanted = vector(displacement, "displacement")
    if time is None and period is not None:
        time = period * np.arange(wanted.size)
    steps = limits.steps(wanted.size, time)
    path, state = _Path(actuator, wanted, time, load, velocity, acceleration), start
    _ = path.clock  # which refuses a time that is missing or does not fit
    voltage, reached = np.empty_like(wanted), np.empty_like(wanted)
    clamped = np.zeros(wanted.size, dtype=bool)
    i, chunk = 0, _CHUNK
    while i < wanted.size:
        stop = min(i + chunk, wanted.size)
        wish, after = path.followed(i, stop, state)
        before = voltage[i - 1] if i else wish[0]
        allowed = limits.allowed(wish, before, steps[i:stop])
        # What rounding leaves of a wish that lies on a limit is no clamp.
        bad = np.flatnonzero(np.abs(allowed - wish) > _ROUNDING * (limits.high - limits.low))
        good = int(bad[0]) if bad.size else stop - i
        voltage[i : i + good], reached[i : i + good] = allowed[:good], wanted[i : i + good]
        if not bad.size:
            i, state, chunk = stop, after, 2 * chunk
            continue
        if good:
            state = path.followed(i, i + good, state)[1]
        i += good
        voltage[i], clamped[i] = allowed[good], True
        reached[i], state = path.sent(voltage, i, state)
        i, chunk = i + 1, _CHUNK
        if path.steps_on:
            # What is clamped once is soon clamped again: one by one, then, to the end.
            voltage[i:], reached[i:], clamped[i:], state = path.stepped(i, voltage[i - 1], state, limits)
            break
    if path.moves_on:
        motion = path.played(voltage, start)
        reached, state = motion.displacement, motion.state
    missed = float(np.abs(wanted - reached).max(initial=0.0))
    said = _clamps(limits, voltage, missed, clamped)
    followed = not clamped.any() and missed <= _WORTH * float(np.ptp(actuator.spring.displacement))
    if not followed and not clamped.any():
        said = (*said, _lagged(missed))
    return Command(voltage, reached, clamped, state, (*said, *_extrapolates(actuator, voltage)), missed, followed)


def _lagged(missed: float) -> str:
    """Where nothing was clamped only a mass or an amplifier can be left behind."""
    return (
        f"the path is missed by up to {missed * 1e6:.4g} um, though nothing was clamped: it does not begin where the "
        "actuator stands, or moves faster than its samples tell"
    )


def _extrapolates(actuator: Actuator, voltage: Array) -> tuple[str, ...]:
    if actuator.limits is None:
        return ()
    low, high = actuator.limits
    count = int(np.count_nonzero((voltage < low) | (voltage > high)))
    if not count:
        return ()
    return (f"{count} voltages lie outside the identified range {low:.6g} to {high:.6g} V: extrapolated",)


def _clamps(limits: VoltageLimits, voltage: Array, missed: float, clamped: Mask) -> tuple[str, ...]:
    count = int(np.count_nonzero(clamped))
    if not count:
        return ()
    at_limit = int(np.count_nonzero(clamped & ((voltage <= limits.low) | (voltage >= limits.high))))
    first = int(np.flatnonzero(clamped)[0])
    why = f"{at_limit} at the limits {limits.words}, {count - at_limit} by the slew rate"
    return (
        f"CLAMPED: {count} of {voltage.size} voltages ({why}), the first at sample {first}; the path is missed by "
        f"up to {missed * 1e6:.4g} um",
    )


@dataclass(frozen=True, eq=False)
class _Path:
    """A wanted path, followed in pieces. In time a piece begins with the sample at which the last one ended."""

    actuator: Actuator
    wanted: Array
    time: ArrayLike | None
    load: ArrayLike | None
    velocity: ArrayLike | None
    acceleration: ArrayLike | None

    @property
    def moves_on(self) -> bool:
        """Whether a mass or an amplifier still answers what was clamped before."""
        return self.actuator.model.moves_on

    @property
    def steps_on(self) -> bool:
        """Whether nothing moves on, and all but a few steps are of equal time."""
        return not self.moves_on and self.clock[1].size <= _FEW

    @cached_property
    def clock(self) -> tuple[NDArray[np.int64], Array]:
        """Runs of equal steps, see `Evaluator.clock`."""
        return self.actuator.model.clock(self.time, self.wanted.size, TIME_NEEDED)

    @cached_property
    def course(self) -> dict[str, Array | None]:
        """What goes with the path, a value a sample."""
        found = {"time": self.time, "load": self.load}
        if self.actuator.dynamics is not None:
            along = PathData(self.time, self.load, self.velocity, self.acceleration)
            found["velocity"], found["acceleration"] = self.actuator.model.derivatives(self.wanted, along)
        return {name: None if values is None else vector(values, name) for name, values in found.items()}

    @cached_property
    def lead(self) -> Array:
        """W less the path [m]."""
        return self.actuator.model.lead(self.wanted, PathData(**self.course))

    def followed(self, i: int, stop: int, start: State) -> tuple[Array, State]:
        """Voltages of samples i to stop - 1, from the state at sample i - 1, and the state at the last."""
        if not self.actuator.wide:
            motion = self.actuator.compensate(self.wanted[i:stop], load=self.load, state=start, extrapolate=True)
            return motion.voltage, motion.state
        motion = self._piece(i, stop, start)
        voltage = motion.voltage
        if self.actuator.lag and stop < self.wanted.size:
            # A lag asks for the slope of the voltage, which a piece's last sample knows from one side only.
            voltage = self._piece(i, stop + 1, start).voltage[:-1]
        return voltage[min(i, 1) :], motion.state

    def sent(self, voltage: Array, i: int, start: State) -> tuple[float, State]:
        """Where the voltage of sample i leads."""
        first = i if not self.actuator.wide else max(i - 1, 0)
        cut = self._cut(first, i + 1)
        motion = self.actuator.simulate(voltage[first : i + 1], **cut, state=start, extrapolate=True)
        return float(motion.displacement[-1]), motion.state

    def stepped(
        self, first: int, before: float, start: State, limits: VoltageLimits
    ) -> tuple[Array, Array, Mask, State]:
        """The samples from `first` on, each within limits: voltages, displacements, what was clamped, and the end."""
        model, n, state = self.actuator.model, self.wanted.size, start
        bounds, durations = self.clock
        voltage, place, offers = np.empty(n), np.empty(n), np.empty(n)
        w = self.wanted + self.lead
        for r, seconds in enumerate(durations):
            run = slice(max(int(bounds[r]), first), int(bounds[r + 1]))
            if run.start >= run.stop:
                continue
            change = _ANY if limits.slew_rate is None else limits.slew_rate * seconds
            numbers = np.array([limits.low, limits.high, change, 0.0, 0.0, 0.0, 1.0])
            pace = model.step_coefficients(np.array([0, 1]), np.array([seconds]))
            loop = model.core.loop(pace, np.ones(1), numbers, lambda *_: None, model.core_state(state))
            loop.go_on(np.array([before, before, before, before, 0.0, 0.0, w[run.start - 1]]), 0, 0, 0)
            voltage[run], place[run], offers[run] = loop.trace(w[run])
            before, state = float(voltage[run.stop - 1]), model.state_of(CoreState(*loop.state()))
        clamped = offers[first:] != _WISHED
        clamped &= np.abs(place - w)[first:] > _ROUNDING * float(np.ptp(model.spring.displacement))
        reached = np.where(clamped, place[first:] - self.lead[first:], self.wanted[first:])
        return voltage[first:], reached, clamped, state

    def played(self, voltage: Array, start: State) -> Motion:
        """What the whole command does."""
        return self.actuator.simulate(voltage, time=self.time, load=self.load, state=start, extrapolate=True)

    def _piece(self, i: int, stop: int, start: State) -> Motion:
        first = max(i - 1, 0)
        path = self.wanted[first:stop].copy()
        if i:
            path[0] = start.displacement - self.lead[first]
        along: dict[str, Any] = {
            name: None if values is None else values[first:stop] for name, values in self.course.items()
        }
        return self.actuator.compensate(path, **along, state=start, extrapolate=True)

    def _cut(self, first: int, stop: int) -> dict[str, Any]:
        if not self.actuator.wide:
            return {}
        return {name: values[first:stop] for name in ("time", "load") if (values := self.course[name]) is not None}
