"""The wave table of a periodic scan: homing, a start-up from the present state, and the steady cycle."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import ModelError, RecordError
from dehyst._types import Array
from dehyst.control.compensator import Compensator
from dehyst.control.homing_played import FASTEST_LEG, played_homing, rows_of
from dehyst.control.lead_in import approach_to
from dehyst.control.start_up import StartUp, settle, start_up_cycles
from dehyst.model import Actuator, State
from dehyst.waveforms import Excitation, MotionLimits, Sampling, Scan
from dehyst.waveforms.excitation import positive, refuse_long
from dehyst.waveforms.scan import whole

# Share of the stroke: deviation of the first steady cycle from the later ones.
_TOLERANCE = 1e-4
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
        return rows_of(self.homing.voltage[:-1])

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


class _Begin(NamedTuple):
    """The state before the start-up, and the homing that leads to it; as in `WaveTable`."""

    start: State
    homing: Excitation | None = None
    unknown: float = 0.0
    certified: bool = True
    warnings: tuple[str, ...] = ()


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
    begin = _homed(compensator, scan, present, drive) if state is None else _Begin(state)
    motion = MotionLimits(getattr(scan, "speed", None), getattr(scan, "acceleration", None))
    way = approach_to(path, compensator, begin.start, motion, approach)
    settled = settle(compensator, path, way, begin.start, least, count)
    warnings = (*scan.warnings, *begin.warnings, *settled.warnings)
    table = {**vars(settled), **begin._asdict(), "warnings": warnings, "tolerance": least}
    return WaveTable(actuator=actuator, **table)


def _homed(compensator: Compensator, scan: Scan, present: float | None, drive: Sampling | None) -> _Begin:
    """Return the state after the shortest homing, by default no faster than the scan."""
    leg = max(FASTEST_LEG, 0.5 * scan.period)
    excitation, homing, remarks = played_homing(compensator, scan.rate, leg, present=present, drive=drive)
    return _Begin(homing.state, excitation, homing.error, homing.certified, remarks)
