"""One actuator within limits: its start, and its loop in the C core."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError, of_part
from dehyst._native import CoreError, CoreState, Loop
from dehyst._types import Array
from dehyst._validation import for_each, interval, keep, number
from dehyst.control.limits import Clamps, VoltageLimits, stray_sentence, warn_of_clamps
from dehyst.model import Actuator, State, demand_thermal, evaluator_of, major_loop, state_within_limits, stroke_of

# A delay this close to a whole number of steps is that number.
_WHOLE = 1e-9
# Largest number of steps in a delay, or in a radian of the resonance.
_FARTHEST = 1e6


@dataclass(frozen=True, eq=False)
class Axis:
    """An actuator within limits and its loop in C; lengths are in metres.

    `given`: the state at the construction or last reset; if `assumed`, the default state of the actuator. `start`: this
    state within the limits. `previews`, `warns`: as in `Compensator`. `per_metre`: units of steps and offers in a
    metre. `name`: if there are several axes.
    """

    actuator: Actuator
    bounds: VoltageLimits
    period: float | None
    given: State
    assumed: bool = False
    previews: bool = False
    warns: bool = False
    per_metre: float = 1.0
    name: str = ""
    start: State = field(init=False)

    def __post_init__(self) -> None:
        keep(self, start=state_within_limits(self.actuator, self.given, self.limits))

    @property
    def limits(self) -> tuple[float, float]:
        """Lowest and highest voltage [V]."""
        return self.bounds.low, self.bounds.high

    @property
    def slew_rate(self) -> float | None:
        """Largest slew rate [V/s]; None if it is not limited."""
        return self.bounds.slew_rate

    @cached_property
    def loop(self) -> Loop:
        """The loop in C, made when first needed, because a plan does not need it.

        Raise `ModelError` if a period is missing, too long for a resonance, or too short for the slew rate.
        """
        model, slew, seconds = evaluator_of(self.actuator), self.slew_rate, self.period or 0.0
        if self.period is None and (model.needs_time or slew is not None):
            words = "creep, inertia, a lag or a slew rate need the time between steps"
            raise ModelError(words, hint="give the period [s]", change=("period",))
        coefficients = model.step_coefficients(np.array([0, 1]), np.array([seconds]))
        most = float(np.finfo(np.float64).max)
        change = most if slew is None else min(slew * seconds, most)
        if change <= 0:
            words = f"{slew:g} V/s allow no change in {seconds:g} s"
            raise ModelError(words, argument="slew_rate", hint="give more, or a longer period")
        numbers = np.array([*self.limits, change, *model.amplifier(seconds)])
        actuator, bounds, name = self.actuator, self.bounds, self.name

        def warn(slewed: bool, displacement: float, voltage: float, before: float) -> None:
            reason = f"the slew rate allows no more from {before:.6g} V" if slewed else "that is a limit"
            words = f"CLAMPED: {displacement * 1e6:.6g} um wanted, {voltage:.6g} V to be sent: {reason}"
            warn_of_clamps(actuator, bounds, name, words, np.array([displacement]), before)

        call = warn if self.warns else lambda *_: None
        loop = model.core.loop(coefficients, self.preview[0], numbers, call, self.core_start)
        loop.per_metre = self.per_metre
        # A block gives the loop the checksums of its model, which snapshots need.
        loop.block(*self.core_start, seconds, self.preview[1])
        return loop

    @property
    def running(self) -> bool:
        """Whether the loop exists; before that, nothing was sent."""
        return "loop" in self.__dict__

    @property
    def core_start(self) -> CoreState:
        """The start as numbers of the C core."""
        return evaluator_of(self.actuator).core_state(self.start)

    @cached_property
    def preview(self) -> tuple[Array, int]:
        """Taps of the preview filter, and the number of samples that it looks ahead."""
        return preview_filter(self.actuator, self.period) if self.previews and self.period else (np.ones(1), 0)

    @property
    def voltage(self) -> float:
        """The last voltage sent [V]; before any, the voltage that holds the actuator in its start."""
        return self.loop.sent() if self.running else self.held(self.start)

    @property
    def state(self) -> State:
        """State after all voltages sent."""
        return evaluator_of(self.actuator).state_of(CoreState(*self.loop.state())) if self.running else self.start

    @property
    def clamps(self) -> Clamps:
        """Number of samples clamped so far, by kind."""
        return Clamps(*self.loop.counts()[:2]) if self.running else Clamps(0, 0)

    @property
    def reach(self) -> tuple[float, float]:
        """Displacements [m] at both limits of a slow major loop, with creep at rest, gain and offset."""
        (low, high), (gain, offset) = self._reach, self.scaling()
        return offset + gain * low, offset + gain * high

    @property
    def width(self) -> float:
        """Width of the reach [m], or the stroke if smaller: a reach far beyond the records is extrapolated."""
        return min(self.reach[1] - self.reach[0], stroke_of(self.actuator))

    @cached_property
    def _reach(self) -> tuple[float, float]:
        return major_loop(self.actuator, self.limits)

    def held(self, state: State) -> float:
        """Return the voltage [V] within the limits that holds the actuator in a `state`, or the nearest limit."""
        return self.bounds.nearest(self.actuator.voltage(state))

    def scaling(self, temperature: ArrayLike | None = None, samples: int = 1) -> tuple[Any, Any]:
        """Return gains and offsets [m] of `samples` at a `temperature` () or (n,) [degC]; None: those of the loop.

        Raise `ModelError` if the actuator does not depend on temperature.
        """
        if temperature is not None:
            return demand_thermal(self.actuator.thermal).scale(temperature, samples)
        gain, offset = self.loop.rest()[5:7].tolist() if self.running else (1.0, 0.0)
        return gain, offset

    def strays(self, displacement: Array) -> str:
        """Return why a `displacement` (n,) [m] of the model is implausible; "" if it is plausible."""
        return stray_sentence(self.actuator, self.bounds, displacement)

    def call(self, function: Callable[[float], float], displacement: float) -> float:
        """Return the voltage [V] for a displacement [m, or the loop's unit], by a `function` of the loop."""
        try:
            return function(displacement)
        except TypeError:
            return function(number(displacement, "displacement"))
        except CoreError as error:
            raise refusal(displacement) from error

    def run(self, wanted: Array) -> Array:
        """Return the voltages (n,) [V] of steps for displacements (n,) [m]; raise and warn as `Compensator.run`."""
        begin, before, (gain, offset) = self.voltage, self.loop.counts(), self.scaling()
        voltage = self.loop.run(wanted)
        limited, slewed, refused = (int(n) for n in np.subtract(self.loop.counts(), before))
        if refused:
            raise refusal(float(wanted[np.argmax(np.abs(wanted))]))
        if (limited or slewed) and self.warns:
            reason = f"{limited} at the limits {self.bounds.words}, {slewed} by the slew rate from {begin:.6g} V"
            words = f"{limited + slewed} of {wanted.size} voltages clamped: {reason}"
            warn_of_clamps(self.actuator, self.bounds, self.name, words, (wanted - offset) / gain, begin)
        return voltage

    def commit(self, voltage: float) -> None:
        """Commit a `voltage` [V] as sent; raise `ModelError` as `Compensator.commit`."""
        try:
            self.loop.commit(voltage)
        except CoreError as error:
            raise ModelError(
                f"got {voltage:g} V, too far outside the limits {self.bounds.words} to return in one step",
                argument="voltage",
                hint="give the voltage that was really sent, in volts; if it was that, ramp to the limits first",
            ) from error

    def scale(self, gain: float, offset: float) -> None:
        """Set gain and offset [m] of the displacement; raise `ModelError` as `Compensator.scale`."""
        try:
            self.loop.scale(gain, offset)
        except CoreError as error:
            raise ModelError(argument="gain", got=gain, need="a positive number, and not too large") from error

    def block(self) -> bytes:
        """Return actuator, limits, period and start as the block that `dehyst_model_load` reads in C."""
        return self.loop.block(*self.core_start, self.period or 0.0, self.preview[1])

    def ids(self) -> tuple[int, int]:
        """Return the checksums `id` and `shape` of the model in C; limits and start have no effect on them."""
        return self.loop.ids()

    def snapshot(self) -> bytes:
        """Return the whole memory of the loop."""
        return self.loop.save()

    def restore(self, snapshot: object) -> None:
        """Continue from a `snapshot`; an error may leave the memory changed, which `restore_all` undoes."""
        if not isinstance(snapshot, bytes):
            raise ModelError(argument="snapshot", got=type(snapshot).__name__, need="the bytes of snapshot()")
        try:
            self.loop.restore(snapshot)
        except CoreError as error:
            raise ModelError(f"got a snapshot that the core refuses: {error}", argument="snapshot") from error
        self.bounds.within(self.loop.sent(), "snapshot")


def restore_all(axes: Sequence[Axis], snapshots: Any) -> None:
    """Continue from `snapshots`, one per axis; raise `ModelError` as `Compensator.restore`: the memory is unchanged."""
    given = len(snapshots) if isinstance(snapshots, Sequence) else type(snapshots).__name__
    if given != len(axes):
        raise ModelError(argument="snapshot", got=str(given), need=f"{len(axes)}, one for each axis")
    with unchanged_by_errors(*axes):
        for axis, snapshot in zip(axes, snapshots, strict=True):
            axis.restore(snapshot)


def axes_of(
    actuators: Sequence[Actuator],
    names: Sequence[str],
    period: float | None,
    *,
    limits: Any = None,
    slew_rate: Any = None,
    state: Any = None,
    runs: bool = False,
    **options: Any,
) -> tuple[Axis, ...]:
    """Return an axis for each actuator; an error begins with the name of its axis.

    `limits`, `slew_rate`, `state`: one value, or one per actuator. `runs`: whether a missing period is an error.
    `options`: further fields of all axes.
    """
    given = {"limits": limits, "slew_rate": slew_rate, "state": state}
    columns = [for_each(values, len(actuators), name) for name, values in given.items()]
    if period is not None and number(period, "period") <= 0:
        raise ModelError(argument="period", got=period, need="a positive number of seconds")
    seconds, made = None if period is None else float(period), []
    for name, actuator, allowed, slew, own in zip(names, actuators, *columns, strict=True):
        try:
            bounds = VoltageLimits(*allowed_limits(actuator, allowed), slew)
            begin = actuator.state if own is None else own
            made.append(Axis(actuator, bounds, seconds, begin, own is None, name=name, **options))
            _ = runs and made[-1].loop
        except ModelError as error:
            raise of_part(error, name) from error.__cause__
    return tuple(made)


def allowed_limits(actuator: Actuator, limits: Sequence[float] | None) -> tuple[float, float]:
    """Return the given limits [V], or the actuator's; raise `ModelError` if there are none, or they are no interval."""
    if not isinstance(actuator, Actuator):
        raise ModelError(argument="actuator", got=type(actuator).__name__, need="an Actuator")
    chosen = actuator.limits if limits is None else limits
    if chosen is None:
        raise ModelError(
            "no voltage limits: the actuator has none and none were given",
            hint="give limits (low, high)",
            change=("limits",),
        )
    return interval(chosen)


@contextmanager
def unchanged_by_errors(*axes: Axis) -> Iterator[None]:
    """Restore the whole memory of all `axes` if an error occurs in the block."""
    before = [(CoreState(*axis.loop.state()), axis.loop.rest(), axis.loop.counts()) for axis in axes]
    try:
        yield
    except BaseException:
        for axis, (state, rest, counts) in zip(axes, before, strict=True):
            axis.loop.begin(*state)
            axis.loop.go_on(rest, *counts)
        raise


def refusal(displacement: float) -> ModelError:
    """Return the error of a displacement that cannot be followed."""
    return ModelError(argument="displacement", got=repr(displacement), need="a finite number that the model can follow")


def preview_filter(actuator: Actuator, period: float) -> tuple[Array, int]:
    """Return an FIR filter from the wanted displacement y to w, the displacement that the elements follow.

    ``w(t) = Y(t + delay)``, with inertia ``Y = y + 2 zeta/omega y' + y''/omega^2``; between samples, y is the
    polynomial through the nearest samples. Raise `ModelError` if the delay, or one radian of the resonance, takes more
    than a million steps of `period` [s].

    Returns
    -------
    taps : (M,) array
        w is the sum of taps[m] times the input displacement m samples ago.
    ahead : int
        Number of samples by which the input displacement is ahead.
    """
    delay, dynamics = actuator.delay / period, actuator.dynamics
    if delay > _FARTHEST or (dynamics is not None and dynamics.omega * period < 1 / _FARTHEST):
        raise ModelError(
            f"got {period:g} s, which is too short to look ahead by a delay of {actuator.delay:g} "
            "s or a period of the resonance",
            argument="period",
            hint="give a longer period, or no preview",
        )
    # Remove the rounding of a whole number of periods.
    delay = round(delay) if abs(delay - round(delay)) < _WHOLE else delay
    whole = math.floor(delay)
    if dynamics is None and delay == whole:
        return np.ones(1), whole
    # Samples symmetric about the delay make the error of a derivative one order smaller.
    near = (1 if dynamics is None else 2) + (delay != whole)
    offsets = np.arange(whole + (delay != whole) - near, whole + near + 1, dtype=np.float64)
    # Weights of the samples in the value and the derivatives of their polynomial at the delay.
    powers = np.vander(np.subtract(offsets, delay), increasing=True).T
    taps, first, second = (np.linalg.solve(powers, math.factorial(n) * np.eye(offsets.size)[n]) for n in range(3))
    if dynamics is not None:
        steps = dynamics.omega * period
        taps = taps + (2 * dynamics.damping * first + second / steps) / steps
    return np.ascontiguousarray(taps[::-1]), int(offsets[-1])
