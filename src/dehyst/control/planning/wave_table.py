"""The wave table of a periodic scan: homing, lead-in, start-up, and the steady cycle in which all memory repeats."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil, inf, log, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import ModelError, RecordError
from dehyst._native import EMPTY
from dehyst._text import counted
from dehyst._types import Array
from dehyst._views.lines import span_of
from dehyst.control.compensator import Compensator
from dehyst.control.following import Followed, follow
from dehyst.control.limits import outside_identified
from dehyst.control.planning.homing import FASTEST_LEG, played_homing, rows_of
from dehyst.control.planning.plan import shortfall
from dehyst.model import Actuator, DisplacementCreep, PathData, State, creep_times, evaluator_of, standing
from dehyst.waveforms import (
    Bridge,
    Excitation,
    MotionLimits,
    PathPoint,
    Sampling,
    Scan,
    ScanPath,
    positive,
    refuse_long,
    whole,
)

# Enough for a contracting, piecewise smooth map; the linear one of Dahl's elements needs one.
_ROUNDS = 100
_EPS = float(np.finfo(np.float64).eps)
# Most difference of two steady cycles, as a share of the voltage range.
_REPEATS = 1e-9
# Of the range of the limits: a larger change of the voltage is no rounding.
_ROUNDING = 1e-12
MOST_CYCLES, MOST_SAMPLES = 1000, 5_000_000
# With clamped voltages: numbers of cycles to try, and most samples, as clamping is slow.
_CLAMPED, _MOST_CLAMPED = (3, 6, 12, 24, 48), 100_000
# Share of the stroke: deviation of the first steady cycle from the later ones.
_TOLERANCE = 1e-4
HOMING, START_UP, CYCLE = 0, 1, 2
# Least and most samples of a lead-in, and the factor by which it is lengthened.
_LEAST, _MOST = 4, 2_000_000
_LONGER = 2**0.25
# Quintic of least jerk: largest speed over height per time, largest acceleration over height per time squared.
_FASTEST, _HARDEST = 1.875, 10 / sqrt(3)


def timed(path: ScanPath) -> dict[str, Any]:
    """Return time and derivatives of a path, as arguments of `compensate` and `follow`."""
    return {"time": path.time, "velocity": path.velocity, "acceleration": path.acceleration}


def steady_state(actuator: Actuator, path: ScanPath, state: State) -> State:
    """Return the state at the first sample of a periodic path after infinitely many cycles.

    Creep and smooth elements are driven only by w, which follows from the path. So they are independent of each other
    and of the carts. A creep branch is linear: if a cycle from zero strain ends at D, its steady strain is ``d =
    exp(-T/tau) d + D``. The elongation of a smooth element after a cycle rises with the elongation before it, with
    slope below 1. Its only fixed point lies between the two extremes and is found by the Illinois method of false
    position. Raise `ModelError` if the state does not fit the actuator.

    `path`: one period. `state`: state at the path's first sample after at least two cycles, which erase the history of
    the carts.
    """
    cycle = path.repeated(1)
    if actuator.displacement_creep is not None:
        return _steady_behind(actuator, actuator.displacement_creep, cycle, state)
    if actuator.creep is not None:
        w = cycle.displacement + evaluator_of(actuator).lead(cycle.displacement, PathData(**timed(cycle)))
        gained = actuator.creep.strains(cycle.time, w)[-1]
        state = replace(state, creep=gained / -np.expm1(-float(cycle.time[-1]) / actuator.creep.time_constants))
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


@dataclass(frozen=True, eq=False)
class StartUp:
    """A voltage to play (n,) [V], with the wanted and the expected displacement (n,) [m]."""

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


@dataclass(frozen=True, eq=False)
class SteadyCycle:
    """Search for the steady cycle of a periodic path, and for the start-up that leads into it.

    It returns the fields of a `dehyst.control.WaveTable` that it determines.

    Attributes
    ----------
    compensator : Compensator
    path, way : ScanPath, ScanPath or None
        One period, and the lead-in to its first sample.
    start : State
        State before the lead-in.
    tolerance : float
        Largest allowed deviation of the first steady cycle from the later ones [m].
    present : float, optional
        Voltage before the first sample [V]; by default the voltage that holds the start.
    """

    compensator: Compensator
    path: ScanPath
    way: ScanPath | None
    start: State
    tolerance: float
    present: float | None = None

    def settled(self, cycles: int | None) -> dict[str, Any]:
        """Return the settled scan after `cycles` of start-up, by default as many as the tolerance requires."""
        return self._steady(cycles) or self._clamped(cycles)

    def _steady(self, cycles: int | None) -> dict[str, Any] | None:
        """Settle by computing the steady state; return None if the limits clamp the steady cycle."""
        size, actuator = len(self.path), self.compensator.actuator
        state = steady_state(actuator, self.path, self._begun(2).state)
        # In a cycle that repeats itself nothing limits the slew rate before the first sample.
        first = actuator.compensate(self.path.displacement, **timed(self.path), state=state, extrapolate=True)
        present = self.compensator._bounds.nearest(float(first.voltage[0]))
        three = self._follow(self.path.repeated(3), state, present)
        if three.clamped.any():
            return None
        # The middle cycle: at its ends the slope of the voltage is known from both sides, which a lag needs.
        voltage = three.voltage[size : 2 * size]
        repeats = float(np.abs(three.voltage[2 * size : 3 * size] - voltage).max())
        expected = self._cycle(voltage, state)
        count, error = self._needed(voltage, expected, cycles)
        command = self._begun(count)
        begun = self._towards(command.voltage[:-1], float(voltage[0]))
        held = self.compensator._held(self.start) if self.present is None else self.present
        change = np.abs(np.diff(np.concatenate([[held], begun, voltage[:1]])))
        if change.max() > self._step + _ROUNDING * float(np.ptp(self.compensator.limits)):
            # The start-up is too short to lead to the cycle.
            return None
        warnings = [*self._remarks(command, count), *self._not_settled(count, error)]
        if repeats > _REPEATS * float(np.ptp(voltage)):
            warnings.append(f"the steady cycle repeats itself to {repeats:.3g} V only")
        return {
            "start_up": self._start_up(count, begun, command.displacement[:-1]),
            "cycle": StartUp(voltage, self.path.displacement, expected[:-1], self.path.sample_rate),
            "cycles": count,
            "error": error,
            "state": state,
            "clamped": int(command.clamped[:-1].sum()),
            "warnings": tuple(warnings),
        }

    def _clamped(self, cycles: int | None) -> dict[str, Any]:
        """Settle by following the path until the clamped voltages repeat."""
        size, path = len(self.path), self.path
        tries = [count for count in _CLAMPED if count == _CLAMPED[0] or count * size <= _MOST_CLAMPED]
        for count in tries if cycles is None else (cycles + 1,):
            command = self._begun(count)
            end = command.voltage.size - 1
            last, before = command.voltage[end - size : end], command.voltage[end - 2 * size : end - size]
            if count > 1 and np.abs(last - before).max() <= _REPEATS * np.ptp(last):
                break
        voltage = self._towards(last, float(last[0]))
        twice = self._moved(np.concatenate([command.voltage[: end - size], voltage, voltage]), self.start)
        same = np.array_equal(voltage, last)
        expected = command.displacement[end - size : end] if same else twice[-2 * size : -size]
        error = float(np.abs(twice[-size:] - expected).max())
        miss = float(np.abs(expected - path.displacement).max())
        warnings = [
            f"CLAMPED: the steady cycle cannot be reached within the limits; each cycle misses the path by up to "
            f"{miss * 1e6:.4g} um",
            *self._remarks(command, count),
        ]
        if error > self.tolerance:
            warnings.append(
                f"{self._deviation(count - 1, error)}; with clamped voltages the required number is not known, and by "
                f"default {_CLAMPED[-1] - 1} cycles and {_MOST_CLAMPED:g} samples are tried at most; try {2 * count} "
                "cycles"
            )
        begun = slice(0, end - size)
        return {
            "start_up": self._start_up(count, command.voltage[begun], command.displacement[begun]),
            "cycle": StartUp(voltage, path.displacement, expected, path.sample_rate),
            "cycles": count - 1,
            "error": error,
            "state": command.state,
            "clamped": int(command.clamped[:-1].sum()),
            "warnings": tuple(warnings),
        }

    def _follow(self, path: ScanPath, state: State, present: float | None) -> Followed:
        return follow(self.compensator, path.displacement, **timed(path), state=state, present=present)

    def _remarks(self, found: Followed, cycles: int) -> tuple[str, ...]:
        """Return remarks on the clamped voltages of a start-up, and on those outside of the identified range."""
        missed, actuator = (
            float(np.abs(found.displacement - self._wanted(cycles).displacement).max()),
            self.compensator.actuator,
        )
        remarks = shortfall(found.voltage, found.clamped, self.compensator._bounds, missed, self.tolerance)
        return remarks + outside_identified(actuator, found.voltage, refuse=False).warnings

    def _wanted(self, cycles: int) -> ScanPath:
        """Return the lead-in, the cycles, and the sample that closes the last cycle."""
        path = self.path.repeated(cycles)
        return path if self.way is None else self.way.then(path)

    def _begun(self, cycles: int) -> Followed:
        return self._follow(self._wanted(cycles), self.start, self.present)

    def _start_up(self, cycles: int, voltage: Array, expected: Array) -> StartUp:
        wanted = self._wanted(cycles).displacement[: voltage.size]
        return StartUp(voltage, wanted, expected, self.path.sample_rate)

    def _needed(self, voltage: Array, expected: Array, cycles: int | None) -> tuple[int, float]:
        """Return the number of start-up cycles, and the deviation [m] of the first steady cycle."""
        most = max(1, min(MOST_CYCLES, MOST_SAMPLES // len(self.path))) if cycles is None else cycles
        before, state, sent, count = None, self.start, None, 0
        if self.way is not None:
            command = self._follow(self.way, self.start, self.present)
            before, state, sent = self.way.last, command.state, float(command.voltage[-1])
        while True:
            if cycles is None or count == cycles:
                error = float(np.abs(self._cycle(voltage, state, sent) - expected).max())
                if error <= self.tolerance or count >= most:
                    return count, error
            cycle = self.path if before is None else before.then(self.path)
            command = self._follow(cycle, state, sent)
            before, state, sent, count = self.path.last, command.state, float(command.voltage[-1]), count + 1

    @property
    def _step(self) -> float:
        """The largest change [V] in a sample."""
        slew = self.compensator.slew_rate
        return inf if slew is None else slew / self.path.sample_rate

    def _towards(self, voltage: Array, end: float) -> Array:
        """Return a voltage (n,) [V] with its last samples changed so that `end` [V] follows within the slew rate."""
        if self._step == inf:
            return voltage
        far = self._step * np.arange(voltage.size, 0, -1)
        # What keeps the slew rate keeps it between these two lines too.
        return np.clip(voltage, end - far, end + far)

    def _cycle(self, voltage: Array, state: State, sent: float | None = None) -> Array:
        """Return the displacement (n + 1,) [m] along a cycle, from its first sample or from the voltage before it."""
        closed = np.append(voltage, voltage[0])
        return self._moved(closed if sent is None else np.append(sent, closed), state)[-closed.size :]

    def _moved(self, voltage: Array, state: State) -> Array:
        """Return the displacement (n,) [m] that follows a state."""
        actuator = self.compensator.actuator
        time = np.arange(voltage.size) / self.path.sample_rate
        return actuator.simulate(voltage, time=time, state=state, extrapolate=True).displacement

    def _not_settled(self, count: int, error: float) -> tuple[str, ...]:
        """Return the warning if the steady cycle begins too early."""
        if error <= self.tolerance:
            return ()
        warning, times = self._deviation(count, error), creep_times(self.compensator.actuator)
        if not times.size:
            return (f"{warning}; give a start-up of more cycles",)
        period = len(self.path) / self.path.sample_rate
        more = ceil(float(times.max()) / period * log(error / self.tolerance))
        warning += f": creep takes {counted(more, 'cycle')} more, {more * period:.3g} s"
        most = MOST_SAMPLES // len(self.path)
        if count + more <= most:
            return (f"{warning}; give a start-up of {counted(count + more, 'cycle')}, or wait",)
        return (f"{warning}, but a start-up has {counted(most, 'cycle')} at most; play the table for that time first",)

    def _deviation(self, count: int, error: float) -> str:
        return (
            f"NOT SETTLED: after {counted(count, 'cycle')} of start-up the first steady cycle deviates by up to "
            f"{error * 1e6:.3g} um, need {self.tolerance * 1e6:.3g} um"
        )


class Played(NamedTuple):
    """Homing, start-up and cycles in sequence (n,): time [s], phase (0, 1, 2), voltage [V], wanted and expected [m].

    During the homing there is no wanted displacement, and the true one is unknown: both displacements are of a model
    that begins after slow loops through its range. Rows of a long homing are farther apart than the others; between
    rows the voltage is linear.
    """

    time: Array
    phase: Array
    voltage: Array
    displacement: Array
    expected: Array


@dataclass(frozen=True, eq=False, repr=False)
class WaveTable:
    """The voltages of a periodic scan of one axis: homing, then start-up, then the cycle any number of times.

    Attributes
    ----------
    homing : Excitation or None
        Leads to a known state; None if the state was given, or is known after any history. The sample rate of a long
        homing is the scan's divided by a whole number.
    start_up : StartUp
        From the present displacement at rest to the cycle's first sample, then cycles whose voltages still change. Its
        last sample is followed by the first sample of the cycle.
    cycle : StartUp
        One period in its steady cycle.
    cycles : int
        Cycles in the start-up, after which the steady table may be played.
    error : float
        Deviation of the first cycle of the steady table from the later ones [m], by the model.
    tolerance : float
        Largest allowed deviation [m].
    unknown : float
        Error bar of the displacement after the homing [m]; 0 if the state was given.
    certified : bool
        Whether the state before the start-up is known: it was given, or the homing is certified.
    state : State
        State at the first sample of the steady cycle.
    start : State
        State at the beginning of the start-up.
    actuator : Actuator
        The actuator of the table.
    clamped : int
        Samples of start-up and cycle whose voltage was changed to keep the limits.
    warnings : tuple of str
        Deviations from the request, in sentences.
    """

    homing: Excitation | None
    start_up: StartUp
    cycle: StartUp
    cycles: int
    error: float
    tolerance: float
    unknown: float
    certified: bool
    state: State
    start: State
    actuator: Actuator
    clamped: int
    warnings: tuple[str, ...]

    def __repr__(self) -> str:
        before = f"{self.homing_rows.size} of homing and {len(self.start_up)} of start-up"
        error = "settled" if self.settled else "not settled"
        cycle = f"{counted(len(self.cycle), 'sample')} a cycle, {span_of(self.cycle.voltage, 'V')}"
        return f"<WaveTable: {cycle}, after {before}, {error}, {self.clamped} clamped>"

    @property
    def settled(self) -> bool:
        """Whether the error is within the tolerance."""
        return self.error <= self.tolerance

    @property
    def sample_rate(self) -> float:
        """Sample rate [Hz] of start-up and cycle, and of a homing that is not long."""
        return self.cycle.sample_rate

    @cached_property
    def homing_rows(self) -> NDArray[np.int64]:
        """Samples of the homing (k,) in `played`, without the last: all, or increasingly sparse ones in a long hold."""
        if self.homing is None:
            return np.zeros(0, dtype=np.int64)
        # The last sample is the first of the start-up.
        return rows_of(self.homing.voltage[:-1])

    def rows(self, cycles: int = 1) -> int:
        """Return the number of rows of `played` with `cycles` cycles."""
        return self.homing_rows.size + len(self.start_up) + cycles * len(self.cycle)

    def played(self, cycles: int = 1) -> Played:
        """Return all parts in sequence, with `cycles` cycles of the steady table.

        Raise `RecordError` if `cycles` is not a valid number of cycles, or there are more than 5e7 samples.
        """
        times = whole(cycles, "cycles", 0)
        refuse_long(self.rows(times), self.sample_rate)
        parts = [self.start_up] + [self.cycle] * times
        voltage, wanted, expected = (
            [getattr(part, name) for part in parts] for name in ("voltage", "displacement", "expected")
        )
        phase = [np.full(len(part), START_UP if k == 0 else CYCLE) for k, part in enumerate(parts)]
        time = np.arange(sum(map(len, parts))) / self.sample_rate
        if self.homing is not None:
            rows = self.homing_rows
            v, actuator = self.homing.voltage, self.actuator
            begin = standing(actuator, float(v[0]), actuator.voltage_range)
            y = actuator.simulate(v, time=self.homing.time, state=begin, extrapolate=True).displacement[rows]
            voltage, wanted, expected = [v[rows], *voltage], [y, *wanted], [y, *expected]
            phase = [np.full(rows.size, HOMING), *phase]
            time = np.concatenate([rows / self.homing.sample_rate, self.homing.duration + time])
        return Played(time, *map(np.concatenate, (phase, voltage, wanted, expected)))


def wave_table(
    actuator: Actuator,
    scan: Scan,
    *,
    axis: str = "x",
    limits: tuple[float, float] | None = None,
    slew_rate: float | None = None,
    state: State | None = None,
    present: float | None = None,
    drive: Sampling | None = None,
    approach: float | None = None,
    cycles: int | None = None,
    tolerance: float | None = None,
) -> WaveTable:
    """Compute the wave table of a periodic scan.

    Without creep and smooth elements, all cycles from the second on are equal, because the first one wipes out all
    memory that the scan can wipe out. Creep and smooth elements settle slowly: their steady cycle is computed directly
    (`steady_state`), and the start-up follows the path with voltages of its own until the steady voltages may be
    played.

    Parameters
    ----------
    actuator : Actuator
    scan : Scan
        Periodic.
    axis : str
        Axis of the scan; each axis has its own actuator.
    limits, slew_rate
        Limits and slew rate of the voltage, as in `Compensator`.
    state : State, optional
        State of the actuator, at rest; by default it is unknown and the shortest homing comes first.
    present : float, optional
        Present voltage [V], with a homing; by default 0 V or the nearest limit.
    drive : Sampling, optional
        Speed and shape of the homing; by default 1 Hz or the scan's frequency, whichever is lower, and with creep as
        slow as the default of `shortest_homing`. The homing has the scan's sample rate. If it has more than 1e5
        samples, it has a lower rate with at least 200 samples for each leg.
    approach : float, optional
        Time to the first sample [s]; by default as short as the scan's speed and acceleration and the limits allow.
    cycles : int, optional
        Cycles in the start-up; by default as many as the tolerance requires, at most 1000 and 5e6 samples; with clamped
        voltages, at most 47 and 1e5 samples. Give all axes of a scan the same `approach` and `cycles`: the values of
        the slower axis.
    tolerance : float, optional
        Largest deviation of the first steady cycle [m]; by default 1e-4 of the stroke.

    Raises
    ------
    RecordError
        If the scan has no such axis, or a number is impossible.
    ModelError
        If there are no limits, the state does not fit the actuator, or the scan lies more than one stroke outside of
        its reach.
    """
    path, compensator = scan.path(axis), Compensator(actuator, limits, slew_rate, period=1 / scan.rate)
    if sentence := compensator._strays(path.displacement):
        raise ModelError(sentence)
    least = _TOLERANCE * (path.range[1] - path.range[0]) if tolerance is None else positive(tolerance, "tolerance")
    count, most = None if cycles is None else whole(cycles, "cycles", 0), MOST_SAMPLES // len(path)
    if count is not None and count > most:
        raise RecordError(
            argument="cycles",
            got=f"{count}, {count * len(path):.4g} samples of start-up",
            need=f"{most} at most ({MOST_SAMPLES:g} samples)",
            hint="try fewer, or a lower sample rate",
        )
    start, homed, warnings = state, None, tuple(scan.warnings)
    begin: dict[str, Any] = {"homing": None, "unknown": 0.0, "certified": True}
    if start is None:
        # By default no faster than the scan.
        leg = max(FASTEST_LEG, 0.5 * scan.period)
        homed, homing, remarks = played_homing(compensator, scan.rate, leg, present=present, drive=drive)
        start, warnings = homing.state, (*warnings, *remarks)
        begin = {"homing": homed, "unknown": homing.spread, "certified": homing.certified}
    motion = MotionLimits(getattr(scan, "speed", None), getattr(scan, "acceleration", None))
    way = approach_to(path, compensator, start, motion, approach)
    # The last row of the homing: without a certificate its voltage need not be the one that holds the state.
    now = None if homed is None else float(homed.voltage[-2])
    found = SteadyCycle(compensator, path, way, start, least, now).settled(count)
    found["warnings"] = (*warnings, *found["warnings"])
    return WaveTable(actuator=actuator, start=start, tolerance=least, **begin, **found)


def approach_to(
    path: ScanPath, compensator: Compensator, state: State, limits: MotionLimits, seconds: float | None = None
) -> ScanPath | None:
    """Return the way from a state at rest to the first sample (excluded) of a path; None if the state is already there.

    `compensator`: its slew rate limits the way. `limits`: largest speed [m/s] and acceleration [m/s^2]; by default the
    path's own extremes. `seconds`: duration [s], rounded up to a sample; by default as short as the limits of speed and
    acceleration allow, and as the slew rate allows if any duration keeps it. Raise `RecordError` if the duration is not
    positive, or too long.
    """
    now = (
        PathPoint(*map(float, state.motion))
        if state.motion.size
        else PathPoint(compensator.actuator.displacement(state))
    )
    first, rate, ends = path.first, path.sample_rate, _ends(path)
    if seconds is not None:
        duration = positive(seconds, "approach")
        refuse_long(int(min(duration * rate, 1e15)), rate)
        return _sampled(now, ends[0], max(_LEAST, ceil(duration * rate * (1 - 1e-12))), path)
    stroke = path.range[1] - path.range[0]
    if not any(now[1:]) and not ends[0].velocity and abs(now.displacement - first.displacement) <= 1e-12 * stroke:
        return None
    motion = MotionLimits(limits.speed or _extreme(path.velocity), limits.acceleration or _extreme(path.acceleration))
    height = abs(first.displacement - now.displacement)
    least = max(_FASTEST * height / (motion.speed or 1), sqrt(_HARDEST * height / (motion.acceleration or 1)))
    slew = inf if compensator.slew_rate is None else compensator.slew_rate
    count, shortest = max(_LEAST, ceil(least * rate * (1 - 1e-9))), None
    while count <= _MOST:
        for end in ends:
            if not motion.allow(Bridge(now, end, count / rate).peaks):
                continue
            way = _sampled(now, end, count, path)
            shortest = shortest or way
            whole_way = way.then(path.repeated(0))
            played = compensator.actuator.compensate(
                whole_way.displacement, **timed(whole_way), state=state, extrapolate=True
            )
            if np.abs(np.diff(played.voltage)).max(initial=0.0) <= slew / rate:
                return way
        count = ceil(count * _LONGER)
    refuse_long(count, rate)
    return shortest or _sampled(now, ends[-1], count, path)


def _extreme(row: Array) -> float:
    return float(np.abs(row).max())


def _ends(path: ScanPath) -> tuple[PathPoint, ...]:
    """Return the ends to try: the beginning of the scan, and the same without acceleration, to avoid a detour."""
    y, v, _ = path.first
    # From rest, an acceleration at the end would make the way overshoot and come back.
    if abs(v) <= 1e-9 * _extreme(path.velocity):
        return (PathPoint(y),)
    return path.first, PathPoint(y, v)


def _sampled(now: PathPoint, end: PathPoint, count: int, path: ScanPath) -> ScanPath:
    travel = Bridge(now, end, count / path.sample_rate).at(np.arange(count) / path.sample_rate)
    return ScanPath(*travel, path.sample_rate, periodic=False)
