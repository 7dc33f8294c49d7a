"""The wave table of a periodic scan: homing, a start-up from the present state, and the steady cycle."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import log, pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import ModelError, RecordError
from dehyst._types import Array
from dehyst._validation import interval
from dehyst.control.compensator import Compensator
from dehyst.control.homing import Homing, shortest_homing
from dehyst.control.homing_in_time import leg_seconds
from dehyst.control.lead_in import approach_to
from dehyst.control.start_up import StartUp, settle, start_up_cycles
from dehyst.model import Actuator, State
from dehyst.waveforms import Excitation, MotionLimits, Sampling, Scan
from dehyst.waveforms import homing as homing_through
from dehyst.waveforms.excitation import positive, refuse_long, volts
from dehyst.waveforms.scan import whole

# Share of the stroke: deviation of the first steady cycle from the later ones.
_TOLERANCE = 1e-4
_HOMING_FREQUENCY = 1.0
# A homing of more samples has longer steps: this many a leg, and a period of a resonance.
_EVEN_SAMPLES, _LEG_SAMPLES, _RESONANCE_SAMPLES = 100_000, 200, 10
# If these are still too many, most samples of a hold are left out: their times grow by this factor.
_SPARSER = 1.02
HOMING, START_UP, CYCLE = 0, 1, 2


class Played(NamedTuple):
    """Homing, start-up and cycles in a row (n,): time [s], phase (0, 1, 2), voltage [V], wanted and expected [m].

    During the homing nothing is wanted, and both displacements are those of a model that begins relaxed. A long homing
    has rows farther apart than the rest; between rows the voltage is linear.
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
        Leads to a known state; None if the state was given, or is known after any history. A long one has a sample
        rate of its own: the scan's over a whole number.
    start_up : StartUp
        From the present displacement at rest to the cycle's first sample, then cycles whose voltages still change. The
        sample after its last is the cycle's first.
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
        At the first sample of the steady cycle.
    start : State
        Where the start-up begins.
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
        """Whether the tolerance is kept."""
        return self.error <= self.tolerance

    @property
    def sample_rate(self) -> float:
        """Samples a second [Hz] of start-up and cycle, and of a homing that is not long."""
        return self.cycle.sample_rate

    @cached_property
    def homing_rows(self) -> NDArray[np.int64]:
        """Samples of the homing (k,) in `played`: all, or ever fewer of a long hold; not the last."""
        if self.homing is None:
            return np.zeros(0, dtype=np.int64)
        # The last sample is the first of the start-up.
        rows = np.arange(len(self.homing) - 1)
        return rows if rows.size <= _EVEN_SAMPLES else rows[_thinned(self.homing.voltage[:-1])]

    def rows(self, cycles: int = 1) -> int:
        """Return the number of rows of `played` with `cycles` cycles."""
        return self.homing_rows.size + len(self.start_up) + cycles * len(self.cycle)

    def played(self, cycles: int = 1) -> Played:
        """Return all parts in a row, with `cycles` cycles of the steady table.

        Raise `RecordError` if `cycles` is not a number of cycles, or there are more than 5e7 samples.
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
            v, y = self.homing.voltage[rows], self._homing_displacement()[rows]
            voltage, wanted, expected = [v, *voltage], [y, *wanted], [y, *expected]
            phase = [np.full(rows.size, HOMING), *phase]
            time = np.concatenate([rows / self.homing.sample_rate, self.homing.duration + time])
        return Played(time, *map(np.concatenate, (phase, voltage, wanted, expected)))

    def _homing_displacement(self) -> Array:
        if self.homing is None:
            return np.zeros(0)
        v = self.homing.voltage
        relaxed = self.actuator.relaxed(float(v[0]), extrapolate=True)
        time = self.homing.time if self.actuator.needs_time else None
        return self.actuator.simulate(v, time=time, state=relaxed, extrapolate=True).displacement


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

    Without creep and smooth elements the second cycle repeats, because the first wipes out all that the scan can wipe
    out. Creep and smooth elements settle slowly: their steady cycle is computed directly (`steady_state`), and the
    start-up follows the path with its own voltages until the steady ones may be played.

    Parameters
    ----------
    actuator : Actuator
    scan : Scan
        Periodic.
    axis : str
        Of the scan; each axis has an actuator of its own.
    limits, slew_rate
        Of the voltage, as in `Compensator`.
    state : State, optional
        State of the actuator, at rest; by default it is unknown and the shortest homing comes first.
    present : float, optional
        With homing: present voltage [V]; by default 0 V or the nearest limit.
    drive : Sampling, optional
        Speed and shape of the homing; by default 1 Hz or the scan's frequency if that is lower, and with creep as slow
        as the default of `shortest_homing`. It has the scan's sample rate; above 1e5 samples 200 a leg at least.
    approach : float, optional
        Seconds to the first sample; by default as short as the speed and acceleration of the scan and the limits allow.
    cycles : int, optional
        Cycles in the start-up; by default as many as the tolerance requires, 1000 and 5e6 samples at most; with
        clamped voltages, 47 and 1e5 samples at most. Give the axes of one scan the same `approach` and `cycles`, those
        of the slower one.
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
        raise RecordError("scan: got one that ends elsewhere than it begins, need a periodic one; try closed=True")
    path, compensator = scan.path(axis), Compensator(actuator, limits, slew_rate)
    if sentence := compensator.strays(path.displacement):
        raise ModelError(sentence)
    stroke = path.range[1] - path.range[0]
    least = _TOLERANCE * stroke if tolerance is None else positive(tolerance, "tolerance")
    count = None if cycles is None else start_up_cycles(cycles, path)
    warnings, excitation, unknown, certified, start = list(scan.warnings), None, 0.0, True, state
    if start is None:
        excitation, homing, remarks = _homing(compensator, scan, present, drive)
        unknown, certified, start = homing.error, homing.certified, homing.state
        warnings += remarks
    motion = MotionLimits(getattr(scan, "speed", None), getattr(scan, "acceleration", None))
    way = approach_to(path, compensator, start, motion, approach)
    settled = settle(compensator, path, way, start, least, count)
    table = {**vars(settled), "warnings": (*warnings, *settled.warnings), "tolerance": least, "unknown": unknown}
    return WaveTable(homing=excitation, certified=certified, start=start, actuator=actuator, **table)


def _homing(
    compensator: Compensator, scan: Scan, present: float | None, drive: Sampling | None
) -> tuple[Excitation | None, Homing, tuple[str, ...]]:
    """Return the homing as an excitation at the scan's sample rate, the homing itself, and remarks on it."""
    actuator, limits = compensator.actuator, interval(compensator.limits or ())
    now = min(max(0.0, limits[0]), limits[1]) if present is None else volts(present, "present")
    if not limits[0] <= now <= limits[1]:
        raise RecordError(
            f"present: got {now:.9g} V, but the limits are {limits[0]:g} to {limits[1]:g} V; ramp there first, or "
            "widen the limits if actuator and amplifier allow it"
        )
    if drive is None:
        slowly = max(0.5 / _HOMING_FREQUENCY, 0.5 * scan.period)
        drive = Sampling(frequency=0.5 / leg_seconds(actuator, slowly), sample_rate=scan.rate)
    rate = _longer_steps(actuator, drive, scan.rate)
    drive = replace(drive, sample_rate=rate, base=now, present=now, limits=limits, slew_rate=compensator.slew_rate)
    homing = shortest_homing(actuator, limits=limits, present=now, stiff_only=True, drive=drive)
    if homing.played is None or homing.played.duration * scan.rate <= _EVEN_SAMPLES:
        drive = replace(drive, sample_rate=scan.rate)
        homing = shortest_homing(actuator, limits=limits, present=now, stiff_only=True, drive=drive)
    remarks = () if homing.certified and homing.played is None else homing.remarks
    if len(homing.turns) < 2:
        return None, homing, remarks
    played = homing.played or homing_through(turns=homing.turns, drive=drive)
    return played, homing, (*remarks, *played.warnings)


def _thinned(voltage: Array) -> NDArray[np.bool_]:
    """Return which samples (n,) to keep: those that move, and in a hold ever fewer."""
    held = np.zeros(voltage.size, dtype=np.int64)
    held[1:] = voltage[1:] == voltage[:-1]
    moving = np.flatnonzero(held == 0)
    since = np.arange(voltage.size) - np.repeat(moving, np.diff(moving, append=voltage.size))
    steps = np.unique(np.round(_SPARSER ** np.arange(int(log(voltage.size) / log(_SPARSER)) + 2)))
    kept: NDArray[np.bool_] = (since == 0) | np.isin(since, steps)
    kept[:-1] |= since[1:] == 0
    return kept


def _longer_steps(actuator: Actuator, drive: Sampling, rate: float) -> float:
    """Return the sample rate [Hz] of a long homing: the scan's `rate` over a whole number."""
    needed = 2 * _LEG_SAMPLES * drive.frequency
    if actuator.dynamics is not None:
        needed = max(needed, _RESONANCE_SAMPLES * actuator.dynamics.frequency / (2 * pi))
    return rate / max(1, int(rate / needed))
