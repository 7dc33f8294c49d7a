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

# Of the stroke: as near as the first steady cycle comes to the later ones.
_TOLERANCE = 1e-4
_HOMING_FREQUENCY = 1.0
# A homing of more samples is written in longer steps: so many a leg, and so many a period of a resonance.
_EVEN_SAMPLES, _LEG_SAMPLES, _SWING_SAMPLES = 100_000, 200, 10
# And where that leaves too many, samples of a hold are left out: each is so many times later than the one before.
_SPARSER = 1.02
HOMING, START_UP, CYCLE = 0, 1, 2


class Played(NamedTuple):
    """Homing, start-up and cycles in a row (n,): time [s], phase (0, 1, 2), voltage [V], wanted and expected [m].

    While homing nothing is wanted, and both displacements are those of a model that begins relaxed. A long homing has
    rows farther apart than the rest; between rows the voltage is straight.
    """

    time: Array
    phase: Array
    voltage: Array
    displacement: Array
    expected: Array


@dataclass(frozen=True, eq=False)
class WaveTable:
    """What to play for a periodic scan of one axis: homing, then start-up, then the cycle as often as one likes.

    Attributes
    ----------
    homing : Excitation or None
        Makes the state known; None if it was given, or is known whatever was before. A long one has a sample rate of
        its own: the scan's over a whole number.
    start_up : StartUp
        From the present displacement at rest to the cycle's first sample, then cycles whose voltages still change. The
        sample after its last is the cycle's first.
    cycle : StartUp
        One period in its steady cycle.
    cycles : int
        Cycles in the start-up, after which the steady table may be played.
    error : float
        How far the first cycle of the steady table comes off the later ones [m], by the model.
    tolerance : float
        How far it was allowed to come off [m].
    unknown : float
        How far the displacement may be from what is expected after the homing [m]; 0 if the state was given.
    certified : bool
        Whether the state before the start-up is known: it was given, or the homing is certified.
    state : State
        At the first sample of the steady cycle.
    start : State
        Where the start-up begins.
    actuator : Actuator
        That it was made for.
    clamped : int
        Samples of start-up and cycle whose voltage was changed to keep the limits.
    warnings : tuple of str
        What is not as asked for, in sentences.
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
        """Samples of the homing (k,) that `played` has: all, or of many in a hold ever fewer; not the last."""
        if self.homing is None:
            return np.zeros(0, dtype=np.int64)
        # It ends at the sample with which the start-up begins.
        rows = np.arange(len(self.homing) - 1)
        return rows if rows.size <= _EVEN_SAMPLES else rows[_telling(self.homing.voltage[:-1])]

    def rows(self, cycles: int = 1) -> int:
        """How many `played` has."""
        return self.homing_rows.size + len(self.start_up) + cycles * len(self.cycle)

    def played(self, cycles: int = 1) -> Played:
        """All in a row, with so many cycles of the steady table.

        Raises
        ------
        RecordError
            If `cycles` is no number of cycles, or there are more than 5e7 samples.
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
            v, y = self.homing.voltage[rows], self._while_homing()[rows]
            voltage, wanted, expected = [v, *voltage], [y, *wanted], [y, *expected]
            phase = [np.full(rows.size, HOMING), *phase]
            time = np.concatenate([rows / self.homing.sample_rate, self.homing.duration + time])
        return Played(time, *map(np.concatenate, (phase, voltage, wanted, expected)))

    def _while_homing(self) -> Array:
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
    """Find what to play for a periodic scan.

    Without time the second cycle repeats itself, for what the scan can wipe out is wiped out by the first. Creep and
    smooth elements settle slowly: their steady cycle is found directly (`steady_state`), and the start-up follows the
    path with its own voltages until the steady ones may take over.

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
        Where the actuator is, at rest; by default it is not known and the shortest homing comes first.
    present : float, optional
        With homing: voltage now [V]; by default 0 V or the limit next to it.
    drive : Sampling, optional
        Pace and shape of the homing; by default 1 Hz or the scan's frequency if that is lower, and with creep as slow
        as `shortest_homing` has it. Its samples are the scan's; those of more than 1e5 are 200 a leg at least.
    approach : float, optional
        Seconds to the first sample; by default as short as the speed and acceleration of the scan and the limits allow.
    cycles : int, optional
        Cycles in the start-up; by default as many as the tolerance needs, 1000 and 5e6 samples at most; while
        voltages are clipped, 47 and 1e5 samples at most. The axes of one scan should be given the same `approach` and
        `cycles`, those of the slower one.
    tolerance : float, optional
        How far the first steady cycle may come off [m]; by default 1e-4 of the stroke.

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
    if words := compensator.strays(path.displacement):
        raise ModelError(words)
    stroke = path.range[1] - path.range[0]
    least = _TOLERANCE * stroke if tolerance is None else positive(tolerance, "tolerance")
    wanted = None if cycles is None else start_up_cycles(cycles, path)
    said, homing, unknown, sure, start = list(scan.warnings), None, 0.0, True, state
    if start is None:
        homing, way_to, remarks = _homing(compensator, scan, present, drive)
        unknown, sure, start = way_to.error, way_to.certified, way_to.state
        said += remarks
    reach = MotionLimits(getattr(scan, "speed", None), getattr(scan, "acceleration", None))
    way = approach_to(path, compensator, start, reach, approach)
    found = settle(compensator, path, way, start, least, wanted)
    return WaveTable(
        homing,
        found.start_up,
        found.cycle,
        found.cycles,
        found.error,
        least,
        unknown,
        sure,
        found.state,
        start,
        actuator,
        found.clamped,
        (*said, *found.warnings),
    )


def _homing(
    compensator: Compensator, scan: Scan, present: float | None, drive: Sampling | None
) -> tuple[Excitation | None, Homing, tuple[str, ...]]:
    """The homing in the scan's samples, what it is worth, and what is to be said."""
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
    drive = replace(
        drive,
        sample_rate=_longer_steps(actuator, drive, scan.rate),
        base=now,
        present=now,
        limits=limits,
        slew_rate=compensator.slew_rate,
    )
    way = shortest_homing(actuator, limits=limits, present=now, stiff_only=True, drive=drive)
    if way.played is None or way.played.duration * scan.rate <= _EVEN_SAMPLES:
        drive = replace(drive, sample_rate=scan.rate)
        way = shortest_homing(actuator, limits=limits, present=now, stiff_only=True, drive=drive)
    said = () if way.certified and way.played is None else way.remarks
    if len(way.turns) < 2:
        return None, way, said
    played = way.played or homing_through(turns=way.turns, drive=drive)
    return played, way, (*said, *played.warnings)


def _telling(voltage: Array) -> NDArray[np.bool_]:
    """Samples (n,) that tell enough: those that move, and in a hold some whose distance grows as it goes on."""
    held = np.zeros(voltage.size, dtype=np.int64)
    held[1:] = voltage[1:] == voltage[:-1]
    moved = np.flatnonzero(held == 0)
    since = np.arange(voltage.size) - np.repeat(moved, np.diff(moved, append=voltage.size))
    steps = np.unique(np.round(_SPARSER ** np.arange(int(log(voltage.size) / log(_SPARSER)) + 2)))
    found: NDArray[np.bool_] = (since == 0) | np.isin(since, steps)
    found[:-1] |= since[1:] == 0
    return found


def _longer_steps(actuator: Actuator, drive: Sampling, rate: float) -> float:
    """Samples a second [Hz] of a long homing: the scan's `rate` over a whole number."""
    needed = 2 * _LEG_SAMPLES * drive.frequency
    if actuator.dynamics is not None:
        needed = max(needed, _SWING_SAMPLES * actuator.dynamics.frequency / (2 * pi))
    return rate / max(1, int(rate / needed))
