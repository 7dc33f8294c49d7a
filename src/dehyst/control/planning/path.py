"""Planning of a path from its possible starts: with a homing if the start matters, and the way to the path."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError, RecordError
from dehyst._types import Array
from dehyst._validation import for_each, untimely, vector
from dehyst.control.axis import Axis
from dehyst.control.compensator import Compensator
from dehyst.control.coupling import targets_and_clamped
from dehyst.control.following import Followed, follow_axes
from dehyst.control.limits import outside_identified, unit_hint
from dehyst.control.planning.homing import HOME_WITHIN
from dehyst.control.planning.plan import PATH, WAY, PathPlan, shortfall
from dehyst.control.planning.start import PossibleStart, StartError
from dehyst.control.planning.ways import TOLERANCE, Begin, Way, begin_of, pace, simultaneous, usual_step, way_to
from dehyst.model import (
    Actuator,
    Stage,
    State,
    apply,
    evaluator_of,
    major_loop,
    promised,
    standing,
    state_at,
    temperature_columns,
    tested_temperatures,
    untested,
)
from dehyst.records import impossible

# Relative difference of times, and of voltage steps, that is rounding.
_ROUNDING = 1e-9
# A homing is long if it takes this many times the path that follows.
_LONG = 2.0


def plan_path(
    model: Actuator | Stage | Compensator,
    path: ArrayLike,
    *,
    time: ArrayLike | None = None,
    limits: Any = None,
    slew_rate: Any = None,
    temperature: ArrayLike | None = None,
    start: Any = None,
    home: bool | None = None,
    home_within: float | None = None,
    present: Any = None,
    on_time: bool | None = None,
) -> PathPlan:
    """Plan the voltages of a path that is known ahead, with a homing before it if the start matters.

    The path is followed at its own speed within limits and slew rate. Jumps to its first sample, homings and the ways
    to the path are no faster than the records of the model. Several axes are homed simultaneously: an axis with a
    shorter homing waits before it, at its present voltage.

    Parameters
    ----------
    model : Actuator, Stage or Compensator
        A compensator gives limits, slew rates, units and `scale`; its state has no effect.
    path : (n,) or (n, axes) array_like
        Wanted displacement [m, or `units` of the compensator], as its sensor shows it.
    time : (n,) array_like, optional
        [s], strictly increasing; needed with a slew rate, and by an actuator with creep, dynamics or a lag. Default: a
        sample every `period`, if the compensator has one.
    limits, slew_rate : optional
        As in `Compensator`; only for an actuator or a stage.
    temperature : float, (n,) or (n, axes) array_like, optional
        [degC] of the path; default: not known, and computed with the compensator's `scale`. Without the part
        `thermal` it is only compared with that of the model's records.
    start : PossibleStart or State, or one an axis, optional
        The state before the path; default: unknown, at rest near the first sample.
    home : bool, optional
        True: a way to the first sample comes before the path, from a known start directly, otherwise with a homing.
        False: no homing. Default: a homing if the error that an unknown start leaves along the path exceeds the
        model's error. With False and by default, a way leads from a given start or present voltage to a path that one
        step does not reach.
    home_within : float, optional
        Longest duration of the homing and of the way to the path [s]; a shorter homing leaves a larger error of the
        start. Default: as long as necessary; a remark says so if it takes more than twice as long as the path.
    present : float, or one an axis, optional
        Present voltage [V] of an unknown start: from there the homing begins, or without one the way to the first
        sample. Default 0 V or the nearest limit; without a homing: if none is given, at the first sample.
    on_time : bool, optional
        True: the voltage leads the path by the actuator's delay, so that the path is on time. False: the path comes
        late by the delay. Default: True if the actuator lags by the identification (`lag_of`).

    Returns
    -------
    PathPlan

    Raises
    ------
    ModelError
        If the arrays do not fit, a time is missing, the path lies more than one stroke outside of the reach, or the
        present voltage lies outside of the limits.
    RecordError
        If the path is empty, there is no homing that is short enough, or there would be more than 5e6 rows.

    Examples
    --------
    >>> import dehyst, numpy as np
    >>> actuator = dehyst.Actuator(dehyst.MaxwellSlip([1e-6], [5e6]), dehyst.Spring([0, 1e-5], [0, 90]))
    >>> plan = dehyst.plan_path(actuator, np.linspace(3e-6, 6e-6, 50), limits=(0, 100), home=True)
    >>> plan.voltage[plan.first :].shape
    (50,)
    """
    task = Task(_compensator_of(model, limits, slew_rate), path, "displacement", time, temperature)
    task.shift(on_time)
    task.home_within = HOME_WITHIN(home_within, "home_within")
    return task.planned(start, present, home)


def plan_voltage(
    model: Actuator | Stage | Compensator,
    voltage: ArrayLike,
    *,
    time: ArrayLike | None = None,
    temperature: ArrayLike | None = None,
    start: Any = None,
) -> PathPlan:
    """Return the displacement that a voltage (n,) or (n, axes) [V] causes; limits of a compensator do not count.

    Default of `start`: unknown, at rest at the first voltage. Others, and errors, as in `plan_path`.
    """
    task = Task(_compensator_of(model, None, None), voltage, "voltage", time, temperature)
    starts = [
        known or PossibleStart.unknown(loop.actuator, volts, loop.limits)
        for known, loop, volts in zip(task.given(start)[0], task.loops, task.firsts, strict=True)
    ]
    ways = [Way(known, known.state) for known in starts]
    moved, states = task.motion(ways, task.rows)
    still, pairs = np.zeros(len(task.rows), dtype=bool), zip(task.rows.T, moved.T, states, strict=True)
    found = [Followed(volts, y, still, state) for volts, y, state in pairs]
    return task.result(task.plans(ways, moved[:0], found, wanted=moved))


class Task:
    """A path [m] or a voltage [V] of one axis or several, as `rows` (n, axes) at `time` (n,) [s] or None.

    `moved` (n, axes): voltage [V], or displacement [m] without coupling. `firsts`: the voltage or displacement of each
    model at the first sample, without gain and offset. `temperature` (n, axes) [degC]: of the actuators; `warmth`:
    those that have an effect. `delays` [s]: by which the voltage of each axis leads. `ahead`: rows added for that.
    """

    def __init__(
        self,
        compensator: Compensator,
        rows: ArrayLike,
        what: str,
        time: ArrayLike | None,
        temperature: ArrayLike | None,
        rates: dict[str, Array] | None = None,
    ) -> None:
        self.compensator, self.loops, self.voltage = compensator, compensator._axes, what == "voltage"
        self.single, self.stage = compensator._single, compensator.stage
        self.rows = compensator._rows(rows, what)
        if not self.voltage:
            self.rows = self.rows / compensator._per_metre
        size, period = len(self.rows), compensator.period
        if not size:
            raise RecordError(argument="path", got="no samples", need="one at least")
        actuators = self.stage.actuators
        self.temperature: Array | None = None
        self.warmth: list[Array | None] = [None] * len(actuators)
        if temperature is not None:
            self.temperature = temperature_columns(temperature, size, len(actuators))
            if any(actuator.thermal for actuator in actuators) or not any(map(tested_temperatures, actuators)):
                self.warmth = self.stage.temperatures(self.temperature, size)
        self.moved, self.firsts = self.rows, self.rows[0].tolist()
        self.time = None if period is None else period * np.arange(size, dtype=np.float64)
        if time is not None:
            self.time = vector(time, "time")
            if self.time.size != size or np.any(np.diff(self.time) <= 0):
                raise ModelError(untimely(self.time, size))
            if size > 1 and (words := impossible("time", float(np.median(np.diff(self.time))))):
                raise ModelError(words, argument="time")
        # Velocity [m/s] and acceleration [m/s^2] of the path of a single axis; by default those of its cubic spline.
        self.rates = rates or {}
        self.home_within: float | None = None
        self.delays, self.ahead = [0.0] * len(actuators), 0
        self.remarks: list[tuple[str, ...]] = [()] * len(actuators)
        if not self.voltage:
            self._decouple()

    def _decouple(self) -> None:
        """Find the displacements without coupling, and the first ones of the models."""
        self.moved = self.through(self.stage.decoupling, self.rows)
        scales = [loop.scaling(warm, len(self.rows)) for loop, warm in zip(self.loops, self.warmth, strict=True)]
        for j, (gain, offset) in enumerate(scales):
            if words := self.compensator._straying(j, (self.moved[:, j] - offset) / gain):
                raise ModelError(words if self.single else f"axis {self.stage.axes[j]}: {words}")
        gains, offsets = ([float(np.ravel(values)[0]) for values in column] for column in zip(*scales, strict=True))

        def nearest(j: int, target: float) -> float | None:
            loop = self.loops[j]
            low, high = (offsets[j] + gains[j] * end for end in major_loop(loop.actuator, loop.limits))
            return None if low <= target <= high else min(max(target, low), high)

        # Axes within reach are corrected by what the others miss, as in each step.
        targets, _ = targets_and_clamped(self.stage.decoupling.tolist(), self.rows[0].tolist(), nearest)
        self.firsts = [(y - offset) / gain for y, gain, offset in zip(targets, gains, offsets, strict=True)]

    def through(self, matrix: Array, columns: Array) -> Array:
        """Return columns (n, axes) times a matrix of the stage; a single axis is the same array."""
        return columns if self.single else apply(matrix, columns)

    def shift(self, on_time: bool | None) -> None:
        """Let the voltages lead the path by the delays of the actuators, where these lag; else say that it is late."""
        by = [loop.actuator.identification for loop in self.loops]
        lags = ["" if known is None else known.lag_of for known in by]
        for j, (loop, lag_of) in enumerate(zip(self.loops, lags, strict=True)):
            delay = loop.actuator.delay
            leads = lag_of == "actuator" if on_time is None else on_time
            if not delay or (lag_of == "sensor" and not on_time):
                continue
            if leads and self.time is not None:
                self.delays[j] = delay
                words = "the voltage leads the path by the delay of the actuator, {:.4g} ms: the path is on time"
            elif lag_of == "actuator" or self.time is None:
                words = "the displacement lags by {:.4g} ms: expect the path that much later"
            else:
                words = "the records lag by {:.4g} ms: expect the path that much later, unless their sensor lagged"
            self.remarks[j] = (words.format(1e3 * delay),)
        if self.time is None or not any(self.delays):
            return
        step = usual_step(self.time)
        self.ahead = math.ceil(max(self.delays) / step - _ROUNDING)
        time = np.concatenate([self.time[0] - step * np.arange(self.ahead, 0, -1), self.time])
        columns = zip(self.delays, self.moved.T, strict=True)
        self.moved = np.column_stack([np.interp(time + delay, self.time, column) for delay, column in columns])
        # Before it begins and after it ends, the path rests.
        rates, rests = self.rates.items(), {"left": 0.0, "right": 0.0}
        self.rates = {name: np.interp(time + self.delays[0], self.time, rate, **rests) for name, rate in rates}
        self.rows = np.concatenate([np.repeat(self.rows[:1], self.ahead, axis=0), self.rows])
        self.warmth = [self.degrees(warm, self.ahead, warm.size) if warm is not None else None for warm in self.warmth]
        if self.temperature is not None:
            first = np.repeat(self.temperature[:1], self.ahead, axis=0)
            self.temperature = np.concatenate([first, self.temperature])
        self.time = time

    def given(self, starts: Any, present: Any = None) -> tuple[list[Any], list[Any]]:
        """Return the start and the present voltage [V] of each axis, None if none was given."""
        found: list[Any] = []
        for start in for_each(starts, len(self.loops), "start"):
            if start is not None and not isinstance(start, State | PossibleStart):
                hint = 'PossibleStart.named(actuator, "top") makes one'
                raise ModelError(argument="start", got=repr(start), need="a State or a PossibleStart", hint=hint)
            found.append(PossibleStart("given", (start,)) if isinstance(start, State) else start)
        return found, for_each(present, len(self.loops), "present")

    def planned(self, start: Any, present: Any, home: bool | None) -> PathPlan:
        """Return the plan of the path, with a homing where `home` or the error of an unknown start asks for it."""
        given, now = self.given(start, present)
        if not home:
            ways, before, found = self.begun(self.begins(given, now, near=all(volts is None for volts in now)))
            errors = self.errors(ways, found)
            if home is not None or all(given) or not any(error.matters for error in errors):
                return self.result(self.plans(ways, before, found, errors=errors))
        begins = self.begins(given, now, home=bool(home))
        return self.result(self.plans(*self.after(self.ways(begins, True), begins)))

    def begins(
        self, given: Sequence[Any], present: Sequence[Any], *, near: bool = False, home: bool = False
    ) -> list[Begin]:
        """Return how each actuator stands: as given, or unknown at a voltage [V], or `near` the first sample.

        A homing makes a given start useless that is not known: with `home` it counts as unknown.
        """
        if home:
            given = [start if start and start.known else None for start in given]
        columns = zip(self.loops, given, present, self.firsts, strict=True)
        return [begin_of(loop, known, now, first, near=near) for loop, known, now, first in columns]

    def begun(self, begins: list[Begin]) -> tuple[list[Way], Array, list[Followed]]:
        """Return what `after` does, with a way before the path only if its first step is a jump."""
        ways = [Way(begin.start, begin.state, last=begin.volts, step=self.compensator.period) for begin in begins]
        begun = self.after(ways, begins)
        pairs = zip(self.loops, begins, begun[2], strict=True)
        if any(self.jumps(loop, begin.volts, each) for loop, begin, each in pairs):
            return self.after(self.ways(begins, False), begins)
        return begun

    def jumps(self, loop: Axis, volts: float | None, found: Followed) -> bool:
        """Return whether a path begins with a step that its slew rate does not allow, or a fast one unlike its own."""
        if volts is None or self.time is None:
            return False
        if loop.slew_rate and found.clamped[0]:
            return True
        step = float(np.abs(np.diff(found.voltage)).max(initial=0.0))
        usual = max((pace(loop) or math.inf) * usual_step(self.time), step)
        return abs(float(found.voltage[0]) - volts) > usual * (1 + _ROUNDING)

    def after(self, ways: list[Way], begins: list[Begin]) -> tuple[list[Way], Array, list[Followed]]:
        """Return the ways to the path, the displacement (k, axes) [m] along them, and the voltages of the path."""
        # An actuator stands at the first sample, or is brought there; a mass moves with the path from there on.
        states = [
            state_at(loop.actuator, way.state, y)
            if way.last is None or evaluator_of(loop.actuator).has_dynamics
            else way.state
            for loop, way, y in zip(self.loops, ways, self.firsts, strict=True)
        ]
        options: dict[str, Any] = {"time": self.time, "period": ways[0].step, "temperature": self.warmth, **self.rates}
        present = [way.last for way in ways]
        found = follow_axes(self.stage, self.loops, self.moved, states=states, present=present, **options)
        before = self.lead(ways)
        # The way leads from one state of several possible ones.
        ways = [way if way.homing else way._replace(start=begin.start) for way, begin in zip(ways, begins, strict=True)]
        return ways, before, found

    def ways(self, begins: Sequence[Begin], home: bool) -> list[Way]:
        """Return the ways to the first sample, which begin and end simultaneously: an axis with a shorter way waits.

        It waits at its present voltage, so that its homing, which makes the state known, ends with the way to the path.
        """
        options: dict[str, Any] = {"within": self.home_within, "rows": len(self.rows)}
        ways = [
            way_to(loop, begin, first, self.time, home=home and not begin.start.known, **options)
            for loop, begin, first in zip(self.loops, begins, self.firsts, strict=True)
        ]
        merged = ways if self.single else simultaneous(ways)
        if merged is ways:
            return ways
        states = self.motion(merged)[1]
        return [way._replace(state=state) for way, state in zip(merged, states, strict=True)]

    def time_of(self, way: Way, size: int) -> Array | None:
        """Return the time [s] of the rows of a way and of `size` samples after it; None if the path has no time."""
        if self.time is None:
            return None
        return np.concatenate([way.time, way.seconds + (self.time - self.time[0])[:size]])

    def degrees(self, temperature: Array | None, before: int, size: int) -> Array | None:
        """Return a temperature (n,) [degC] for `before` rows and `size` samples after them; before, it is the first."""
        return None if temperature is None else np.concatenate([np.full(before, temperature[0]), temperature[:size]])

    def motion(self, ways: Sequence[Way], rows: Array | None = None) -> tuple[Array, list[State]]:
        """Return the displacement (k, axes) [m] along ways and then voltages (n, axes) [V], and the last states."""
        after = np.zeros((0, len(ways))) if rows is None else rows
        time = self.time_of(ways[0], len(after))
        moved, states = [], []
        for loop, way, volts, warmth in zip(self.loops, ways, after.T, self.warmth, strict=True):
            voltage = np.concatenate([way.voltage, volts])
            motion = loop.actuator.simulate(voltage, time=time, state=way.start.state, extrapolate=True)
            gain, offset = loop.scaling(self.degrees(warmth, way.voltage.size, volts.size), voltage.size)
            moved.append(offset + gain * motion.displacement)
            states.append(motion.state)
        return self.through(self.stage.coupling, np.column_stack(moved)), states

    def lead(self, ways: Sequence[Way]) -> Array:
        """Return the displacement (k, axes) [m] along ways, from a state within the limits if the start is unknown."""
        begun = []
        for loop, way in zip(self.loops, ways, strict=True):
            start = way.start
            if not start.known and way.voltage.size:
                start = replace(start, states=(standing(loop.actuator, float(way.voltage[0]), loop.limits),))
            begun.append(way._replace(start=start))
        return self.motion(begun)[0]

    def misses(self, found: Sequence[Followed]) -> Array:
        """Return how far the model misses the path (n, axes) [m], when the displacement shows it."""
        if all(np.array_equal(each.displacement, column) for each, column in zip(found, self.moved.T, strict=True)):
            return np.broadcast_to(0.0, self.rows.shape)
        miss = np.column_stack([each.displacement for each in found]) - self.moved
        if self.time is not None:
            pairs = zip(self.delays, miss.T, strict=True)
            miss = np.column_stack(
                [np.interp(self.time - delay, self.time, column) if delay else column for delay, column in pairs]
            )
        return self.through(self.stage.coupling, miss)

    def errors(self, ways: Sequence[Way], found: Sequence[Followed]) -> list[StartError]:
        """Return the error of each axis along its path due to its start."""
        size, first = len(self.rows), ways[0].voltage.size
        time, errors = self.time_of(ways[0], size), []
        for loop, way, each, warmth in zip(self.loops, ways, found, self.warmth, strict=True):
            voltage = np.concatenate([way.voltage, each.voltage]) if first else each.voltage
            error = way.start.error_along(loop.actuator, voltage, loop.limits, time=time, first=first + self.ahead)
            gain, offset = loop.scaling(None if warmth is None else warmth[self.ahead :], size - self.ahead)
            errors.append(error.scaled(gain, offset))
        return errors

    def plans(
        self,
        ways: Sequence[Way],
        before: Array,
        found: Sequence[Followed],
        *,
        wanted: Array | None = None,
        errors: Sequence[StartError] | None = None,
    ) -> list[PathPlan]:
        """Return the plan of each axis: its way, with displacements `before` (k, axes) [m], then what was found.

        `wanted` (n, axes) [m]: what a given voltage causes; by default the path. `errors`: of `errors`, if known.
        """
        size, first, after = len(self.rows), ways[0].voltage.size, self.ahead
        phase = np.concatenate([ways[0].phase, np.repeat(np.array([WAY, PATH], dtype=np.int8), [after, size - after])])
        path, miss = (self.rows, self.misses(found)) if wanted is None else (wanted, np.broadcast_to(0.0, wanted.shape))
        known, time, plans = errors or self.errors(ways, found), self.time_of(ways[0], size), []
        for j, (loop, way, each, error) in enumerate(zip(self.loops, ways, found, known, strict=True)):
            temperature, off = None if self.temperature is None else self.temperature[:, j], miss[:, j]
            degrees = None if temperature is None else temperature[after:]
            promise = promised(
                loop.actuator,
                each.voltage[after:],
                None if self.time is None else self.time[after:],
                temperature=degrees,
                waits=way.waits,
                begins=way.start.name if way.homing is None else "homed",
                opened=() if way.homing is None and way.start.known else error.left_of(each.displacement[after:]),
                missed=off[after:] if each.clamped.any() else (),
            )
            missed = float(max(off.max(), -off.min()))
            tolerated = TOLERANCE * float(np.ptp(loop.actuator.spring.displacement))
            if promise is not None:
                tolerated = max(tolerated, promise.largest - promise.parts.get("clamped", 0.0))
            remarks = way.remarks + self.patience(way)
            if wanted is None:
                remarks += shortfall(each.voltage, each.clamped, loop.bounds, missed, tolerated)
                remarks += outside_identified(loop.actuator, each.voltage, refuse=False).warnings
                remarks += self.remarks[j] + self.speeds(j, each)
            plan = PathPlan(
                time,
                phase,
                np.concatenate([way.voltage, each.voltage]),
                displacement=np.concatenate([before[:, j], path[:, j]]),
                expected=np.concatenate([before[:, j], path[:, j] + off]),
                clamped=np.concatenate([np.zeros(first, dtype=bool), each.clamped]),
                state=each.state,
                start=way.start,
                homing=way.homing,
                error=error,
                promise=promise,
                followed=missed <= tolerated,
                warnings=(*remarks, *untested(loop.actuator, promise, degrees)),
                temperature=self.degrees(temperature, first, size),
            )
            plans.append(plan)
        return plans

    def patience(self, way: Way) -> tuple[str, ...]:
        """Return a remark on a homing that takes long for the path, unless its time was given."""
        if way.homing is None or self.time is None or self.home_within is not None or len(way.homing.turns) < 2:
            return ()
        if way.homing.played.duration <= _LONG * float(np.ptp(self.time)):
            return ()
        seconds = way.seconds + float(self.time[self.ahead] - self.time[0])
        words = "home within a shorter time to begin earlier, with more of the start left open"
        return (f"the path begins after {seconds:.4g} s; {words}",)

    def speeds(self, j: int, found: Followed) -> tuple[str, ...]:
        """Return a remark if the path of an axis needs more than its slew rate."""
        loop = self.loops[j]
        if self.time is None or self.time.size < 2 or loop.slew_rate is None or not found.clamped.any():
            return ()
        gain, offset = loop.scaling(self.warmth[j], len(self.rows))
        rates = {name: values / gain for name, values in self.rates.items()}
        target = (self.moved[:, j] - offset) / gain
        state = state_at(loop.actuator, loop.actuator.state, float(target[0]))
        given: dict[str, Any] = {"time": self.time, "state": state, "extrapolate": True, **rates}
        voltage = np.clip(loop.actuator.compensate(target, **given).voltage, *loop.limits)
        needed = float(np.abs(np.diff(voltage) / np.diff(self.time)).max())
        slewed = f"the path needs up to {needed:.4g} V/s, the slew rate allows {loop.slew_rate:.4g} V/s"
        return (slewed,) if needed > loop.slew_rate else ()

    def result(self, plans: list[PathPlan]) -> PathPlan:
        """Return the plan of several axes, or that of the only axis, in the units of the compensator."""
        units, counts, made = self.compensator.units, self.compensator._per_metre, []
        for plan, loop, column in zip(plans, self.loops, self.rows.T, strict=True):
            hint = unit_hint(units, (counts * loop.reach[0], counts * loop.reach[1]), counts * column)
            made.append(replace(plan, warnings=(*plan.warnings, *hint)).in_units(units))
        return made[0] if self.single else PathPlan.of_axes(self.stage.axes, made)


def _compensator_of(model: Actuator | Stage | Compensator, limits: Any, slew_rate: Any) -> Compensator:
    """Return the compensator of a model, or the given one; raise `ModelError` for limits beside a compensator."""
    if not isinstance(model, Compensator):
        return Compensator(model, limits, slew_rate)
    for name, value in {"limits": limits, "slew_rate": slew_rate}.items():
        if value is not None:
            raise ModelError(argument=name, got="some beside a compensator, which has its own", hint="leave them out")
    return model
