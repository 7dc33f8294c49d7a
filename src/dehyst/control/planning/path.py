"""Planning of a path from its possible starts: with a homing if the start matters, and the way to the path."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError, RecordError, of_part
from dehyst._types import Array
from dehyst._validation import for_each, untimely, vector
from dehyst.control.axis import Axis
from dehyst.control.compensator import Compensator
from dehyst.control.following import Followed, follow
from dehyst.control.limits import outside_identified, unit_hint
from dehyst.control.planning.homing import HOME_WITHIN
from dehyst.control.planning.plan import PATH, WAY, PathPlan, shortfall
from dehyst.control.planning.start import PossibleStart, StartError
from dehyst.control.planning.ways import TOLERANCE, Way, pace, past_of, simultaneous, stand, usual_step, way_to
from dehyst.model import (
    Actuator,
    Stage,
    State,
    apply,
    evaluator_of,
    standing,
    state_at,
    temperature_columns,
    untested,
)
from dehyst.records import impossible

# Relative differences of times, and of voltage steps, below this are rounding.
_ROUNDING = 1e-9


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

    The path keeps its own speed within limits and slew rate; jumps, homings and ways to it are no faster than the
    model's records. Several axes are homed simultaneously: an axis with a shorter homing waits at its present voltage.

    Parameters
    ----------
    model : Actuator, Stage or Compensator
        A compensator gives limits, slew rates, units and `scale`; its state has no effect.
    path : (n,) or (n, axes) array_like
        Wanted displacement [m, or `units` of the compensator], as the sensor reads it.
    time : (n,) array_like, optional
        [s], strictly increasing; needed with a slew rate, and by an actuator with creep, dynamics or a lag. Default: a
        sample every `period`, if the compensator has one.
    limits, slew_rate : optional
        As in `Compensator`; only for an actuator or a stage.
    temperature : float, (n,) or (n, axes) array_like, optional
        [degC]; default: not known, and the compensator's `scale` applies. Without `thermal` it is only compared with
        that of the records.
    start : PossibleStart or State, or one per axis, optional
        The state before the path; default: unknown, at rest near the first sample.
    home : bool, optional
        Whether a homing comes first, or for a known start only the way. Default: yes if an unknown start leaves a
        larger error along the path than the model has. Without a homing, a way leads from a given start or present
        voltage to the path, if one step does not reach it.
    home_within : float, optional
        Longest duration of homing and way [s]; a shorter homing leaves a larger error. Default: as necessary.
    present : float, or one per axis, optional
        Present voltage [V] of an unknown start, where the homing or the way begins. Default: 0 V or the nearest limit;
        without a homing, the voltage of the first sample.
    on_time : bool, optional
        Whether the voltage leads by the actuator's delay. Default: yes if the actuator lags by the identification.

    Raises
    ------
    ModelError
        If the arrays do not fit, a time is missing, the path lies more than one stroke outside of the reach, or the
        present voltage lies outside of the limits.
    RecordError
        If the path is empty, no homing is short enough, or the plan would have more than 5e6 rows.
    """
    task = Task(_compensator_of(model, limits, slew_rate), path, "displacement", time, temperature)
    task.prepare(on_time, home_within)
    task.give(start, present)
    return task.planned(home)


def plan_voltage(
    model: Actuator | Stage | Compensator,
    voltage: ArrayLike,
    *,
    time: ArrayLike | None = None,
    temperature: ArrayLike | None = None,
    start: Any = None,
) -> PathPlan:
    """Return the displacement that a voltage (n,) or (n, axes) [V] causes; limits of a compensator do not count.

    Default of `start`: unknown, at rest at the first voltage. Other parameters, and errors, are as in `plan_path`.
    """
    task = Task(_compensator_of(model, None, None), voltage, "voltage", time, temperature)
    task.give(start)
    for part in task.parts:
        known = part.start or PossibleStart.unknown(part.loop.actuator, part.first, part.loop.limits)
        part.way = Way(known, known.state, known.state)
    moved, states = task.motion(task.rows)
    still = np.zeros(len(task.rows), dtype=bool)
    for part, volts, y, state in zip(task.parts, task.rows.T, moved.T, states, strict=True):
        part.found = Followed(volts, y, still, state)
    return task.plan(moved)


@dataclass(eq=False)
class Part:
    """One axis of a path: the wanted motion of its actuator, and the plan as far as it is known.

    `moved` (n,): voltage [V], or displacement [m] without coupling. `first`: its first value, for the model without
    gain and offset. `past`: range of the earlier voltages [V]. `temperature` (n,) [degC]: of the actuator; `warmth`:
    None without effect. `delay` [s]: by which the voltage leads; `late` [s]: by which the displacement lags. `start`,
    `present` [V]: as given. `way`: before the path. `found`: the voltages of the path. `error`: due to the start.
    """

    loop: Axis
    moved: Array
    first: float
    past: tuple[float, float]
    temperature: Array | None = None
    warmth: Array | None = None
    delay: float = 0.0
    late: float = 0.0
    remarks: tuple[str, ...] = ()
    start: PossibleStart | None = None
    present: Any = None
    way: Way = field(init=False)
    found: Followed = field(init=False)
    error: StartError | None = None

    def lead(self, on_time: bool | None, *, timed: bool) -> None:
        """Find the delay by which the voltage leads a path with times (`timed`), and a remark on it."""
        lag_of, delay = self.loop.actuator.identification.lag_of, self.loop.actuator.delay
        leads = lag_of == "actuator" if on_time is None else on_time
        if not delay or (lag_of == "sensor" and not on_time):
            return
        if leads and timed:
            self.delay = delay
            words = "the voltage leads the path by the delay of the actuator, {:.4g} ms: the path is on time"
        else:
            self.late, words = delay, "the displacement lags by {:.4g} ms: expect the path that much later"
            if lag_of != "actuator" and timed:
                words = "the records lag by {:.4g} ms: expect the path that much later, unless their sensor lagged"
        self.remarks = (words.format(1e3 * delay),)

    def jumps(self, time: Array | None) -> bool:
        """Return whether a path begins with a step that its slew rate does not allow, or an unusually fast step."""
        volts, found = self.way.last, self.found
        if volts is None or time is None:
            return False
        if self.loop.slew_rate and found.clamped[0]:
            return True
        step = float(np.abs(np.diff(found.voltage)).max(initial=0.0))
        usual = max((pace(self.loop) or math.inf) * usual_step(time), step)
        return abs(float(found.voltage[0]) - volts) > usual * (1 + _ROUNDING)

    def motion(self, time: Array | None, volts: Array, origin: State) -> tuple[Array, State]:
        """Return the displacement (k,) [m] along the way and then `volts` (n,) [V], and the last state."""
        voltage = np.concatenate([self.way.voltage, volts])
        motion = self.loop.actuator.simulate(voltage, time=time, state=origin, extrapolate=True)
        warmth = extended(self.warmth, self.way.voltage.size)
        gain, offset = self.loop.scaling(None if warmth is None else warmth[: voltage.size], voltage.size)
        return offset + gain * motion.displacement, motion.state

    @property
    def shown(self) -> State:
        """The state in which the shown displacement begins: for an unknown start, a state within the limits."""
        if self.way.homing is None or not self.way.voltage.size:
            return self.way.origin
        return standing(self.loop.actuator, float(self.way.voltage[0]), self.loop.limits)


class Task:
    """A path [m] or a voltage [V] of one axis or several, as `rows` (n, axes) at `time` (n,) [s] or None.

    `parts`: one per axis. `ahead`: number of rows before the path, because voltages lead it. `rates`: velocity [m/s]
    and acceleration [m/s^2] of the path of a single axis; by default those of its cubic spline.
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
        self.compensator, self.stage, self.single = compensator, compensator.stage, compensator._single
        self.rows, self.rates = compensator._rows(rows, what), rates or {}
        if what == "displacement" and compensator._per_metre != 1:
            self.rows = self.rows / compensator._per_metre
        size, period = len(self.rows), compensator.period
        if not size:
            raise RecordError(argument="path", got="no samples", need="one at least")
        columns = zip(compensator._axes, self.rows.T, strict=True)
        self.parts = [Part(loop, column, float(column[0]), loop.limits) for loop, column in columns]
        if temperature is not None:
            self._warm(temperature)
        self.time = None if period is None else period * np.arange(size, dtype=np.float64)
        if time is not None:
            self.time = vector(time, "time")
            if self.time.size != size or np.any(np.diff(self.time) <= 0):
                raise ModelError(untimely(self.time, size))
            if size > 1 and (words := impossible("time", float(np.median(np.diff(self.time))))):
                raise ModelError(words, argument="time")
        self.home_within: float | None = None
        self.ahead = 0
        if what == "displacement":
            self._decouple()

    def _warm(self, temperature: ArrayLike) -> None:
        """Set the temperatures [degC] of the axes."""
        actuators, size = self.stage.actuators, len(self.rows)
        table = temperature_columns(temperature, size, len(actuators))
        tested = [actuator.identification.validity for actuator in actuators]
        matters = any(own.thermal for own in actuators) or not any(own.temperatures for own in tested if own)
        warmths = self.stage.temperatures(table if matters else None, size)
        for part, column, warmth in zip(self.parts, table.T, warmths, strict=True):
            part.temperature, part.warmth = column, warmth

    def _decouple(self) -> None:
        """Find the displacements without coupling, and the first ones of the models."""
        moved = self.rows if self.single else apply(self.stage.decoupling, self.rows)
        for j, part in enumerate(self.parts):
            part.moved = moved[:, j]
            gain, offset = part.loop.scaling(part.warmth, len(self.rows))
            own = (part.moved - offset) / gain
            if words := self.compensator._straying(j, own):
                raise ModelError(words if self.single else f"axis {self.stage.axes[j]}: {words}")
            part.first, part.past = float(own[0]), past_of(part.loop, own)

    def prepare(self, on_time: bool | None, home_within: float | None) -> None:
        """Let the voltages lead the path by the delays of actuators that lag; else remark that the path is late.

        `home_within` [s]: the longest time of homing and way.
        """
        self.home_within = HOME_WITHIN(home_within, "home_within")
        for part in self.parts:
            part.lead(on_time, timed=self.time is not None)
        longest = max(part.delay for part in self.parts)
        if self.time is None or not longest:
            return
        step = usual_step(self.time)
        self.ahead = math.ceil(longest / step - _ROUNDING)
        time = np.concatenate([self.time[0] - step * np.arange(self.ahead, 0, -1), self.time])
        for part in self.parts:
            part.moved = np.interp(time + part.delay, self.time, part.moved)
            part.temperature, part.warmth = extended(part.temperature, self.ahead), extended(part.warmth, self.ahead)
        # Before it begins and after it ends, the path rests.
        rates, rests = self.rates.items(), {"left": 0.0, "right": 0.0}
        self.rates = {name: np.interp(time + longest, self.time, rate, **rests) for name, rate in rates}
        self.rows = np.concatenate([np.repeat(self.rows[:1], self.ahead, axis=0), self.rows])
        self.time = time

    def give(self, starts: Any, present: Any = None) -> None:
        """Set the start and the present voltage [V] of each axis; None if it is not known."""
        for part, start in zip(self.parts, for_each(starts, len(self.parts), "start"), strict=True):
            if start is not None and not isinstance(start, State | PossibleStart):
                hint = 'PossibleStart.named(actuator, "top") makes one'
                raise ModelError(argument="start", got=repr(start), need="a State or a PossibleStart", hint=hint)
            part.start = PossibleStart("given", (start,)) if isinstance(start, State) else start
        for part, volts in zip(self.parts, for_each(present, len(self.parts), "present"), strict=True):
            part.present = volts

    def planned(self, home: bool | None) -> PathPlan:
        """Return the plan of the path, with a homing where `home` or the error of an unknown start asks for it."""
        if not home:
            self.begin()
            known = all(part.start for part in self.parts)
            if home is not None or known or not any(error.matters for error in self.errors()):
                return self.plan()
        self.home(again=bool(home))
        return self.plan()

    def begin(self) -> None:
        """Follow the path, with a way before it only if its first step is a jump."""
        near = all(part.present is None for part in self.parts)
        for part in self.parts:
            way = stand(part.loop, part.past, part.start, part.present, part.first, near=near)
            part.way = way._replace(step=self.compensator.period)
        self.follow()
        if any(part.jumps(self.time) for part in self.parts):
            self.go(home=False)
            self.follow()

    def home(self, *, again: bool) -> None:
        """Follow the path after homings; `again`: home also if a start is given that is not a known state."""
        for part in self.parts:
            known = None if again and part.start and not part.start.known else part.start
            part.way = stand(part.loop, part.past, known, part.present, part.first, near=False)
        self.go(home=True)
        self.follow()

    def go(self, *, home: bool) -> None:
        """Find the ways to the first sample, which begin and end simultaneously: an axis with a shorter way waits.

        It waits at its present voltage, so that its homing, which makes the state known, ends with the way to the path.
        """
        options: dict[str, Any] = {"within": self.home_within, "rows": len(self.rows)}
        for part in self.parts:
            homes = home and not part.way.start.known
            part.way = way_to(part.loop, part.way, part.first, self.time, past=part.past, home=homes, **options)
        if self.single or not any(part.way.time.size for part in self.parts):
            return
        for part, way in zip(self.parts, simultaneous([part.way for part in self.parts]), strict=True):
            part.way = way
        for part, state in zip(self.parts, self.motion()[1], strict=True):
            part.way = part.way._replace(state=state)

    def follow(self) -> None:
        """Find the voltages of the path after the ways."""
        options: dict[str, Any] = {"time": self.time, "period": self.parts[0].way.step, **self.rates}
        for name, part in zip(self.stage.axes, self.parts, strict=True):
            way, actuator = part.way, part.loop.actuator
            # Without a way, the actuator begins at the first sample of the path. So does a mass.
            brought = way.last is None or evaluator_of(actuator).has_dynamics
            state = state_at(actuator, way.state, part.first) if brought else way.state
            given: dict[str, Any] = {"state": state, "present": way.last, "temperature": part.warmth}
            try:
                part.found, part.error = follow(part.loop, part.moved, **given, **options), None
            except ModelError as error:
                raise of_part(error, "" if self.single else f"axis {name}") from error.__cause__

    def time_of(self, size: int) -> Array | None:
        """Return the time [s] of the rows of the ways and of `size` samples after them; None without a time."""
        if self.time is None:
            return None
        way = self.parts[0].way
        return np.concatenate([way.time, way.seconds + (self.time - self.time[0])[:size]])

    def motion(self, rows: Array | None = None, *, shown: bool = False) -> tuple[Array, list[State]]:
        """Return the displacement (k, axes) [m] along ways and then voltages (n, axes) [V], and the last states.

        With `shown`, an unknown start is a state within the limits.
        """
        after = np.zeros((0, len(self.parts))) if rows is None else rows
        time, moved, states = self.time_of(len(after)), [], []
        for part, volts in zip(self.parts, after.T, strict=True):
            y, state = part.motion(time, volts, part.shown if shown else part.way.origin)
            moved.append(y)
            states.append(state)
        return apply(self.stage.coupling, np.column_stack(moved)), states

    def misses(self) -> Array:
        """Return the error of the model (n, axes) [m], at the times when the displacement shows the path."""
        if all(not part.delay and np.array_equal(part.found.displacement, part.moved) for part in self.parts):
            return np.broadcast_to(0.0, self.rows.shape)
        miss = []
        for part, late in zip(self.parts, apply(self.stage.decoupling, self.rows).T, strict=True):
            own = part.found.displacement
            if self.time is not None and part.delay:
                # Between two samples the displacement does not have the corners of the path.
                miss.append(np.interp(self.time - part.delay, self.time, own) - late)
            else:
                miss.append(own - part.moved)
        return apply(self.stage.coupling, np.column_stack(miss))

    def errors(self) -> list[StartError]:
        """Return the error of each axis along its path due to its start."""
        size, time, first = len(self.rows), self.time_of(len(self.rows)), self.parts[0].way.voltage.size
        found = []
        for part in self.parts:
            if part.error is None:
                loop, volts = part.loop, part.found.voltage
                voltage = np.concatenate([part.way.voltage, volts]) if first else volts
                begin = first + self.ahead
                error = part.way.start.error_along(loop.actuator, voltage, part.past, time=time, first=begin)
                warmth = None if part.warmth is None else part.warmth[self.ahead :]
                part.error = error.scaled(*loop.scaling(warmth, size - self.ahead))
            found.append(part.error)
        return found

    def plan(self, wanted: Array | None = None) -> PathPlan:
        """Return the plan of a single axis or of several, in the units of the compensator.

        `wanted` (n, axes) [m]: what a given voltage causes; by default the path.
        """
        errors, size, first, after = self.errors(), len(self.rows), self.parts[0].way.voltage.size, self.ahead
        phase = np.repeat(np.array([WAY, PATH], dtype=np.int8), [after, size - after])
        phase, time = np.concatenate([self.parts[0].way.phase, phase]), self.time_of(size)
        path, miss = (self.rows, self.misses()) if wanted is None else (wanted, np.broadcast_to(0.0, wanted.shape))
        columns = (self.motion(shown=True)[0].T, path.T, miss.T, self.rows.T)
        units, counts, plans = self.compensator.units, self.compensator._per_metre, []
        for part, error, before, y, off, row in zip(self.parts, errors, *columns, strict=True):
            loop, way, found = part.loop, part.way, part.found
            degrees = None if part.temperature is None else part.temperature[after:]
            volts, clamped, left = (column[after:] for column in (found.voltage, found.clamped, off))
            missed = float(np.abs(left).max())
            tolerated = TOLERANCE * float(np.ptp(loop.actuator.spring.displacement))
            promise = loop.actuator.promise(
                volts,
                None if self.time is None else self.time[after:],
                temperature=degrees,
                waits=way.waits,
                begins=way.start.name if way.homing is None else "homed",
                opened=() if way.homing is None and way.start.known else error.left_of(found.displacement[after:]),
                missed=left if clamped.any() or missed > tolerated else (),
            )
            if promise is not None:
                promise = replace(promise, delay=max(promise.delay, part.late))
                tolerated = max(tolerated, promise.largest - promise.parts.get("missed", 0.0))
            # A path that lies completely beyond a limit is not followed, for any promise.
            followed = missed <= tolerated and not (clamped & loop.bounds.reached(volts)).all()
            remarks = () if way.homing is None else way.remarks
            short = shortfall(volts, clamped, loop.bounds, missed, followed=followed)
            if wanted is None:
                remarks += (short,) if short else ()
                remarks += outside_identified(loop.actuator, found.voltage, refuse=False).warnings
                remarks += part.remarks
            hint = unit_hint(units, (counts * loop.reach[0], counts * loop.reach[1]), counts * row)
            plan = PathPlan(
                time,
                phase,
                np.concatenate([way.voltage, found.voltage]),
                displacement=(moved := np.concatenate([before, y])),
                expected=np.concatenate([before, y + off]) if off.any() else moved,
                clamped=np.concatenate([np.zeros(first, dtype=bool), found.clamped]),
                state=found.state,
                start=way.start,
                homing=way.homing,
                error=error,
                promise=promise,
                failure="" if followed else short,
                warnings=(*remarks, *untested(loop.actuator, promise, degrees), *hint),
                temperature=extended(part.temperature, first),
            )
            plans.append(plan if units == "m" else plan.in_units(units))
        return plans[0] if self.single else PathPlan.of_axes(self.stage.axes, plans)


def extended(temperature: Array | None, rows: int) -> Array | None:
    """Return a temperature (n,) [degC], preceded by `rows` of its first value."""
    return None if temperature is None else np.concatenate([np.full(rows, temperature[0]), temperature])


def _compensator_of(model: Actuator | Stage | Compensator, limits: Any, slew_rate: Any) -> Compensator:
    """Return the compensator of a model, or the given one; raise `ModelError` for limits beside a compensator."""
    if not isinstance(model, Compensator):
        return Compensator(model, limits, slew_rate)
    for name, value in {"limits": limits, "slew_rate": slew_rate}.items():
        if value is not None:
            raise ModelError(argument=name, got="a value beside that of the compensator", hint="leave it out")
    return model
