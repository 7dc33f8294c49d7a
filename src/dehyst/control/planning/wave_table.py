"""The wave table of a periodic scan: homing, lead-in, start-up, and the steady cycle."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import ceil, inf, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import ModelError, RecordError
from dehyst._types import Array
from dehyst.control.compensator import Compensator
from dehyst.control.planning.homing import FASTEST_LEG, played_homing, rows_of
from dehyst.control.planning.steady_cycle import MOST_SAMPLES, StartUp, SteadyCycle, timed
from dehyst.model import Actuator, State, standing
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

# Share of the stroke: deviation of the first steady cycle from the later ones.
_TOLERANCE = 1e-4
HOMING, START_UP, CYCLE = 0, 1, 2
# Least and most samples of a lead-in, and the factor by which it is lengthened.
_LEAST, _MOST = 4, 2_000_000
_LONGER = 2**0.25
# Quintic of least jerk: largest speed over height per time, largest acceleration over height per time squared.
_FASTEST, _HARDEST = 1.875, 10 / sqrt(3)


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


@dataclass(frozen=True, eq=False)
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
            when = self.homing.time if actuator.needs_time else None
            begin = standing(actuator, float(v[0]), actuator.voltage_range)
            y = actuator.simulate(v, time=when, state=begin, extrapolate=True).displacement[rows]
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
        If the scan is not periodic or has no such axis, or a number is impossible.
    ModelError
        If there are no limits, the state does not fit the actuator, or the scan lies more than one stroke outside of
        its reach.
    """
    if not scan.periodic:
        raise RecordError(
            argument="scan", got="one that ends elsewhere than it begins", need="a periodic one", hint="close it"
        )
    path, compensator = scan.path(axis), Compensator(actuator, limits, slew_rate, period=1 / scan.rate)
    if sentence := compensator.strays(path.displacement):
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
        begin = {"homing": homed, "unknown": homing.error, "certified": homing.certified}
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
