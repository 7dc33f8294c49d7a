"""The wave table of a periodic scan: the plan of its start-up, and the steady cycle in which all memory repeats.

Without creep and smooth elements, all cycles from the second on are equal, because the first one wipes out all memory
that the scan can wipe out. Creep and smooth elements settle slowly: their steady cycle is computed directly, and the
start-up follows the path with voltages of its own until the steady voltages may be played.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import ceil, inf, log
from typing import Any, NamedTuple

import numpy as np

from dehyst._errors import RecordError
from dehyst._native import EMPTY
from dehyst._text import counted
from dehyst._types import Array, Mask
from dehyst._views.lines import span_of
from dehyst.control.axis import Axis
from dehyst.control.compensator import Compensator
from dehyst.control.following import Followed, follow
from dehyst.control.planning.path import Task
from dehyst.control.planning.plan import PathPlan
from dehyst.control.planning.start import PossibleStart
from dehyst.control.planning.ways import MOST_ROWS, Way
from dehyst.model import Actuator, DisplacementCreep, State, creep_times
from dehyst.waveforms import ScanPath, positive, refuse_long, whole

# Enough for a contracting, piecewise smooth map; the linear one of Dahl's elements needs one.
_ROUNDS = 100
_EPS = float(np.finfo(np.float64).eps)
# Most difference of two steady cycles, as a share of the voltage range, and of a step from the slew rate.
_REPEATS = 1e-9
_MOST_CYCLES, _FALLS = 1000, 0.5
# With clamped voltages: cycles before two are compared, most samples of these, and most cycles of a start-up.
_CLAMPED, _MOST_CLAMPED, _MOST_CLAMPED_CYCLES = (0, 3, 6, 12, 24), 100_000, 47
# Share of the stroke: deviation of the first steady cycle from the later ones.
_TOLERANCE = 1e-4
# Share of the tolerance: the last sample before the cycle adds to the deviation.
_SAFE = 0.99
START_UP, CYCLE = 1, 2


def timed(path: ScanPath) -> dict[str, Any]:
    """Return time and derivatives of a path, as arguments of `compensate` and `follow`."""
    return {"time": path.time, "velocity": path.velocity, "acceleration": path.acceleration}


def steady_state(actuator: Actuator, path: ScanPath, state: State) -> State:
    """Return the state at the first sample of a periodic path after infinitely many cycles.

    Smooth elements are driven only by w, which follows from the path. The elongation of a smooth element after a cycle
    rises with the elongation before it, with slope below 1. Its only fixed point lies between the two extremes and is
    found by the Illinois method of false position. Raise `ModelError` if the state does not fit the actuator.

    `path`: one period. `state`: state at the path's first sample after at least two cycles, which erase the history of
    the carts.
    """
    cycle = path.repeated(1)
    if actuator.displacement_creep is not None:
        return _steady_behind(actuator, actuator.displacement_creep, cycle, state)
    return state if actuator.smooth is None else replace(state, smooth=_elongations(actuator, cycle, state))


def _steady_behind(actuator: Actuator, creep: DisplacementCreep, cycle: ScanPath, state: State) -> State:
    """Return the state at the first sample of a periodic path, with creep in displacement: that of its steady cycle.

    While creep settles, the path before it drifts. If it drifts one way, the carts keep its extremes as after a jump.
    """
    before, begun = creep.steady(cycle.time, cycle.displacement)
    strains = creep.strains(cycle.time, before, begun)
    slow = strains / creep.time_constants
    velocity = cycle.velocity - slow @ creep.gains
    acceleration = cycle.acceleration - (velocity[:, None] - slow) @ (creep.gains / creep.time_constants)
    closed = ScanPath(before, velocity, acceleration, cycle.sample_rate)
    plain, inner = actuator._before_creep, replace(state, displacement_creep=EMPTY)
    for _ in range(2):
        inner = plain.compensate(before, **timed(closed), state=inner, extrapolate=True).state
    once = ScanPath(before[:-1], velocity[:-1], acceleration[:-1], cycle.sample_rate)
    return replace(steady_state(plain, once, inner), displacement_creep=begun)


def _elongations(actuator: Actuator, cycle: ScanPath, state: State) -> Array:
    """Return the steady elongations q_l (L,) [m] of a cycle."""
    length = np.zeros(0) if actuator.smooth is None else actuator.smooth.length

    def gained(elongation: Array) -> Array:
        begin = replace(state, smooth=elongation)
        motion = actuator.compensate(cycle.displacement, **timed(cycle), state=begin, extrapolate=True)
        return np.asarray(motion.state.smooth - elongation)

    low, high = -length, length.copy()
    left, right = gained(low), gained(high)
    middle, side = 0.5 * (low + high), np.zeros(length.size)
    for _ in range(_ROUNDS):
        with np.errstate(invalid="ignore", divide="ignore"):
            middle = np.where(left == right, 0.5 * (low + high), (low * right - high * left) / (right - left))
        middle = np.clip(middle, low, high)
        gain = gained(middle)
        if np.all(np.abs(gain) <= 4 * _EPS * length) or np.all(high - low <= 4 * _EPS * length):
            break
        up = gain > 0
        right = np.where(up & (side > 0), 0.5 * right, np.where(up, right, gain))
        left = np.where(~up & (side < 0), 0.5 * left, np.where(up, gain, left))
        low, high, side = np.where(up, middle, low), np.where(up, high, middle), np.where(up, 1.0, -1.0)
    return middle


class _Steady(NamedTuple):
    """A cycle that repeats itself (n + 1,), with its first sample at the end too: voltage [V] and displacement [m].

    `clamped` (n + 1,): samples whose voltage was changed. `state`: at the first sample.

    `repeats` [V]: by how much the cycle after it differs.
    """

    voltage: Array
    reached: Array
    clamped: Mask
    state: State
    repeats: float


def _steady_cycle(axis: Axis, path: ScanPath, state: State, sent: float) -> _Steady:
    """Return the steady cycle of a path from a `state` at its first sample, with the voltage `sent` [V] before.

    It is computed; where voltages are clamped, cycles follow until their voltages repeat.
    """
    size, actuator = len(path), axis.actuator
    begun = _followed(axis, path.repeated(2), state, sent)
    state = steady_state(actuator, path, begun.state)
    # In a cycle that repeats itself nothing limits the slew rate before the first sample.
    first = actuator.compensate(path.displacement, **timed(path), state=state, extrapolate=True)
    present = axis.bounds.nearest(float(first.voltage[0]))
    for count in _CLAMPED:
        if count * size > _MOST_CLAMPED:
            break
        if count:
            followed = _followed(axis, path.repeated(count), state, present)
            state, present = followed.state, float(followed.voltage[-1])
        three = _followed(axis, path.repeated(3), state, present)
        # At the ends of the middle cycle the slope of the voltage is known from both sides, which a lag needs.
        voltage = three.voltage[size : 2 * size]
        repeats = float(np.abs(three.voltage[2 * size : 3 * size] - voltage).max())
        if repeats <= _REPEATS * float(np.ptp(voltage)) or not three.clamped.any():
            break
    voltage = _towards(voltage, float(voltage[0]), axis)
    closed, middle = np.append(voltage, voltage[0]), slice(size, 2 * size + 1)
    return _Steady(closed, three.displacement[middle], three.clamped[middle], state, repeats)


def _followed(axis: Axis, path: ScanPath, state: State, sent: float) -> Followed:
    """Return the voltages of a path from a `state`, with the voltage `sent` [V] before."""
    return follow(axis, path.displacement, **timed(path), state=state, present=sent)


def _towards(voltage: Array, end: float, axis: Axis) -> Array:
    """Return a voltage (n,) [V] with its last samples changed so that `end` [V] follows within the slew rate."""
    step = axis.bounds.largest_step(axis.period or inf)
    if step == inf:
        return voltage
    far = step * np.arange(voltage.size, 0, -1)
    # A voltage within the slew rate keeps it between these two lines too.
    return np.clip(voltage, end - far, end + far)


@dataclass(frozen=True, eq=False)
class Cycle:
    """A cycle to play (n,): voltage [V], wanted and expected displacement [m]."""

    voltage: Array
    displacement: Array
    expected: Array
    sample_rate: float

    def __len__(self) -> int:
        return self.voltage.size

    @property
    def time(self) -> Array:
        """Time of each sample (n,) [s], from 0."""
        return np.arange(len(self)) / self.sample_rate


class Played(NamedTuple):
    """Plan and cycles in sequence (n,): time [s], phase (0, 1, 2), voltage [V], wanted and expected displacement [m].

    Rows of a long homing are farther apart than the others; between rows the voltage is linear.
    """

    time: Array
    phase: Array
    voltage: Array
    displacement: Array
    expected: Array


@dataclass(frozen=True, eq=False, repr=False)
class WaveTable:
    """The voltages of a periodic scan of one axis: a start-up, then the cycle any number of times.

    Attributes
    ----------
    cycle : Cycle
        One period in its steady cycle.
    plan : PathPlan or None
        Homing, way, cycles of start-up whose voltages still change, and the cycle once, closed; None if only the cycle
        is known. Its promise and warnings are those of the table.
    cycles : int
        Cycles in the start-up, after which the cycle may be played.
    error : float
        Deviation of the first steady cycle from the later ones [m], by the model.
    tolerance : float
        Largest allowed deviation [m].
    state : State or None
        State at the first sample of the steady cycle.
    warnings : tuple of str
        Deviations from the request, in sentences: those of the plan, and on cycles that do not repeat.
    """

    cycle: Cycle
    plan: PathPlan | None = None
    cycles: int = 0
    error: float = 0.0
    tolerance: float = 0.0
    state: State | None = None
    warnings: tuple[str, ...] = ()

    def __repr__(self) -> str:
        settled = "settled" if self.settled else "not settled"
        cycle = f"{counted(len(self.cycle), 'sample')} a cycle, {span_of(self.cycle.voltage, 'V')}"
        return f"<WaveTable: {cycle}, after {self.rows(0)} of start-up, {settled}>"

    @property
    def settled(self) -> bool:
        """Whether the error is within the tolerance."""
        return self.error <= self.tolerance

    @property
    def sample_rate(self) -> float:
        """Sample rate [Hz] of start-up and cycle, and of a homing that is not long."""
        return self.cycle.sample_rate

    def rows(self, cycles: int = 1) -> int:
        """Return the number of rows of `played` with `cycles` cycles."""
        before = 0 if self.plan is None else self.plan.voltage.size - len(self.cycle) - 1
        return before + cycles * len(self.cycle)

    def played(self, cycles: int = 1) -> Played:
        """Return the plan and then the cycle, `cycles` times.

        Its phase is 0 in the homing, 1 in the start-up, 2 in the cycles. Raise `RecordError` if `cycles` is not a valid
        number of cycles, or there are more than 5e7 samples.
        """
        times, first, cycle = whole(cycles, "cycles", 0), self.rows(0), self.cycle
        refuse_long(self.rows(times), self.sample_rate)
        time = np.arange(times * len(cycle)) / self.sample_rate
        phase = np.full(time.size, CYCLE)
        rows = [np.tile(getattr(cycle, name), times) for name in ("voltage", "displacement", "expected")]
        plan = self.plan
        if plan is None or plan.time is None:
            return Played(time, phase, *rows)
        before = (plan.voltage, plan.displacement, plan.expected)
        joined = [np.concatenate([column[:first], row]) for column, row in zip(before, rows, strict=True)]
        phase = np.concatenate([np.minimum(plan.phase[:first], START_UP), phase])
        return Played(np.concatenate([plan.time[:first], plan.time[first] + time]), phase, *joined)


def wave_table(
    actuator: Actuator,
    path: ScanPath,
    *,
    limits: tuple[float, float] | None = None,
    slew_rate: float | None = None,
    start: State | PossibleStart | None = None,
    home: bool | None = None,
    home_within: float | None = None,
    present: float | None = None,
    cycles: int | None = None,
    tolerance: float | None = None,
) -> WaveTable:
    """Compute the wave table of a periodic path of one axis.

    Parameters
    ----------
    actuator : Actuator
    path : ScanPath
        One period, such as ``Triangle(2e-6, 12e-6, 10).path()``.
    limits, slew_rate
        Limits and slew rate of the voltage, as in `Compensator`.
    start, home_within, present
        As in `plan_path`.
    home : bool, optional
        Whether the shortest homing comes first; default: unless there is a `start`.
    cycles : int, optional
        Cycles in the start-up; by default as many as the tolerance requires. If these are more than 5e6 samples, or
        voltages are clamped, at most 1000; with clamped voltages at most 47. Give all axes of a scan the same: the
        value of the slowest axis.
    tolerance : float, optional
        Largest deviation of the first steady cycle [m]; by default 1e-4 of the stroke.

    Raises
    ------
    RecordError
        If the path is not periodic, a number is impossible, or within the slew rate more cycles of start-up are
        necessary.
    ModelError
        If there are no limits, the start does not fit the actuator, or the path lies more than one stroke outside of
        its reach.
    """
    compensator = Compensator(actuator, limits, slew_rate, period=1 / path.sample_rate)
    least = _TOLERANCE * (path.range[1] - path.range[0]) if tolerance is None else positive(tolerance, "tolerance")
    count = 1 if cycles is None else _counted(cycles, path)
    first, axis = _task(compensator, path.repeated(count), home_within), compensator._axes[0]
    first.give(start, present)
    if home or (home is None and start is None):
        first.home(again=True)
    else:
        first.begin()
    way, begun = first.parts[0].way, first.parts[0].found
    steady = _steady_cycle(axis, path, begun.state, float(begun.voltage[-1]))
    if cycles is None:
        count = _start_up(axis, path, begun, steady, least)
    plan, error = _closed(_task(compensator, path.repeated(count + 1), home_within), way, steady)
    voltage = plan.voltage[plan.voltage.size - (count + 1) * len(path) - 1 :]
    _refuse_steps(axis, voltage if way.last is None else np.append(way.last, voltage), count)
    cycle = Cycle(steady.voltage[:-1], path.displacement, steady.reached[:-1], path.sample_rate)
    warnings = (*plan.warnings, *_unsettled(actuator, path, steady, count, error, least))
    return WaveTable(cycle, plan, count, error, least, steady.state, warnings)


def _counted(cycles: int, path: ScanPath) -> int:
    """Return the given number of cycles in the start-up; raise `RecordError` if there are too many."""
    count, most = whole(cycles, "cycles", 0), MOST_ROWS // len(path)
    if count > most:
        raise RecordError(
            argument="cycles",
            got=f"{count}, {count * len(path):g} samples of start-up",
            need=f"{most} at most ({MOST_ROWS:g} samples)",
            hint="try fewer, or a lower sample rate",
        )
    return count


def _closed(task: Task, way: Way, steady: _Steady) -> tuple[PathPlan, float]:
    """Return the plan of a start-up that ends in the steady cycle, and the deviation [m] of this cycle there."""
    (part,), size = task.parts, len(steady.voltage)
    part.way = way
    task.follow()
    start_up = _towards(part.found.voltage[:-size], float(steady.voltage[0]), part.loop)
    voltage = np.append(start_up, steady.voltage)
    moved = task.motion(voltage[:, None])[0][-voltage.size :, 0]
    clamped = np.append(part.found.clamped[:-size], steady.clamped)
    part.found = Followed(voltage, moved, clamped, steady.state)
    return task.plan(), float(np.abs(moved[-size:] - steady.reached).max())


def _start_up(axis: Axis, path: ScanPath, begun: Followed, steady: _Steady, least: float) -> int:
    """Return the cycles of start-up after which the steady cycle deviates by `least` [m], or the most that may be.

    `begun`: the first cycle.
    """
    actuator, clamps, time = axis.actuator, bool(steady.clamped.any()), path.repeated(1).time
    most, count, last = MOST_ROWS // len(path), 1, inf
    if clamps:
        most = min(most, _MOST_CLAMPED_CYCLES)
    while True:
        played = actuator.simulate(steady.voltage, time=time, state=begun.state, extrapolate=True)
        deviation = float(np.abs(played.displacement - steady.reached).max())
        ahead = 0 if deviation <= _SAFE * least else 1
        if ahead and count >= min(most, _MOST_CYCLES):
            ahead = 0 if clamps else _cycles_more(actuator, path, deviation / least)
            # A deviation that does not fall is not creep.
            if count + ahead > most or deviation > _FALLS * last:
                return count
            last = deviation
        if not ahead:
            return count
        begun = _followed(axis, path.repeated(ahead), begun.state, float(begun.voltage[-1]))
        count += ahead


def _task(compensator: Compensator, path: ScanPath, home_within: float | None) -> Task:
    """Return the task of planning a path that need not be on time."""
    rates = {"velocity": path.velocity, "acceleration": path.acceleration}
    task = Task(compensator, path.displacement, "displacement", path.time, None, rates)
    task.prepare(False, home_within)
    return task


def _refuse_steps(axis: Axis, voltage: Array, cycles: int) -> None:
    """Raise RecordError if a start-up is too short to lead to the steady cycle within the slew rate."""
    largest = float(np.abs(np.diff(voltage)).max())
    if largest > axis.bounds.largest_step(axis.period or inf) * (1 + _REPEATS):
        need = "more: within the slew rate they do not lead to the steady cycle"
        raise RecordError(argument="cycles", got=f"{cycles}", need=need)


def _unsettled(
    actuator: Actuator, path: ScanPath, steady: _Steady, count: int, error: float, least: float
) -> Iterator[str]:
    """Yield remarks if the steady cycle begins too early, or does not repeat itself."""
    if steady.repeats > _REPEATS * float(np.ptp(steady.voltage)):
        yield f"the steady cycle repeats itself to {steady.repeats:.3g} V only"
    if error <= least:
        return
    words = (
        f"NOT SETTLED: after {counted(count, 'cycle')} of start-up the first steady cycle deviates by up to "
        f"{error * 1e6:.3g} um, need {least * 1e6:.3g} um"
    )
    more, most = _cycles_more(actuator, path, error / least), MOST_ROWS // len(path)
    if not more or steady.clamped.any():
        yield f"{words}; give a start-up of more cycles"
    elif count + more <= most:
        yield f"{words}; give a start-up of {counted(count + more, 'cycle')}"
    else:
        seconds = more * len(path) / path.sample_rate
        yield f"{words}, and no start-up is long enough; play the table for {seconds:.3g} s first"


def _cycles_more(actuator: Actuator, path: ScanPath, ratio: float) -> int:
    """Return the cycles in which creep falls to its share `1 / ratio`; 0 without creep."""
    longest = float(creep_times(actuator).max(initial=0.0))
    return ceil(longest * path.sample_rate / len(path) * log(ratio))
