"""The wave table of a periodic scan: homing, a start-up from the present state, and the steady cycle."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from dehyst._errors import RecordError
from dehyst._native import Array
from dehyst.actuator import Actuator, interval
from dehyst.approach import approach_to
from dehyst.compensator import Compensator
from dehyst.drive import Drive
from dehyst.excitation import Excitation, positive, refuse_long, volts
from dehyst.excite import homing as homing_through
from dehyst.homing import Homing, shortest_homing
from dehyst.model import State
from dehyst.scan import Limits, Scan, whole
from dehyst.settling import Stretch, settle
from dehyst.timed_homing import leg_seconds

# Of the stroke: as near as the first steady cycle comes to the later ones.
_TOLERANCE = 1e-4
_HOMING_FREQUENCY = 1.0
HOMING, START_UP, CYCLE = 0, 1, 2


class Played(NamedTuple):
    """Homing, start-up and cycles in a row (n,): time [s], phase (0, 1, 2), voltage [V], wanted and expected [m].

    While homing nothing is wanted, and both displacements are those of a model that begins relaxed.
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
        Makes the state known; None if it was given, or is known whatever was before.
    start_up : Stretch
        From the present displacement at rest to the cycle's first sample, then cycles whose voltages still change. The
        sample after its last is the cycle's first.
    cycle : Stretch
        One period in its steady cycle.
    cycles : int
        Cycles in the start-up, after which the steady table may be played.
    error : float
        How far the first cycle of the steady table comes off the later ones [m], by the model.
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
    start_up: Stretch
    cycle: Stretch
    cycles: int
    error: float
    unknown: float
    certified: bool
    state: State
    start: State
    actuator: Actuator
    clamped: int
    warnings: tuple[str, ...]

    @property
    def sample_rate(self) -> float:
        """Samples a second [Hz], of all three."""
        return self.cycle.sample_rate

    def played(self, cycles: int = 1) -> Played:
        """All in a row, with so many cycles of the steady table.

        Raises
        ------
        RecordError
            If `cycles` is no number of cycles, or there are more than 5e7 samples.
        """
        times = whole(cycles, "cycles", 0)
        refuse_long(len(self.start_up) + times * len(self.cycle), self.sample_rate)
        parts = [self.start_up] + [self.cycle] * times
        voltage, wanted, expected = (
            [getattr(part, name) for part in parts] for name in ("voltage", "displacement", "expected")
        )
        phase = [np.full(len(part), START_UP if k == 0 else CYCLE) for k, part in enumerate(parts)]
        if self.homing is not None:
            # It ends at the sample with which the start-up begins.
            v, y = self.homing.voltage[:-1], self._while_homing()[:-1]
            voltage, wanted, expected = [v, *voltage], [y, *wanted], [y, *expected]
            phase = [np.full(v.size, HOMING), *phase]
        v = np.concatenate(voltage)
        return Played(np.arange(v.size) / self.sample_rate, np.concatenate(phase), v, np.concatenate(wanted),
                      np.concatenate(expected))  # fmt: skip

    def _while_homing(self) -> Array:
        if self.homing is None:
            return np.zeros(0)
        v, relaxed = self.homing.voltage, self.actuator.relaxed(float(self.homing.voltage[0]))
        time = self.homing.time if self.actuator.needs_time else None
        return self.actuator.simulate(v, time=time, state=relaxed).displacement


def wave_table(
    actuator: Actuator,
    scan: Scan,
    *,
    axis: str = "x",
    limits: tuple[float, float] | None = None,
    slew_rate: float | None = None,
    state: State | None = None,
    present: float | None = None,
    drive: Drive | None = None,
    approach: float | None = None,
    cycles: int | None = None,
    tolerance: float | None = None,
) -> WaveTable:
    """Find what to play for a periodic scan.

    Without time the second cycle repeats itself, for what the scan can wipe out is wiped out by the first. Creep and
    smooth elements settle slowly: their steady cycle is found directly (`dehyst.steady`), and the start-up follows the
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
    drive : Drive, optional
        Pace and shape of the homing, with the scan's sample rate; by default 1 Hz or the scan's frequency if that
        is lower, and with creep as slow as `shortest_homing` has it.
    approach : float, optional
        Seconds to the first sample; by default as short as the speed and acceleration of the scan and the limits allow.
    cycles : int, optional
        Cycles in the start-up; by default as many as the tolerance needs, 1000 at most. The axes of one scan should
        be given the same `approach` and `cycles`, those of the slower one.
    tolerance : float, optional
        How far the first steady cycle may come off [m]; by default 1e-4 of the stroke.

    Raises
    ------
    RecordError
        If the scan is not periodic or has no such axis, or a number is impossible.
    ModelError
        If there are no limits, or the state does not fit the actuator.
    """
    if not scan.periodic:
        raise RecordError("scan: got one that ends elsewhere than it begins, need a periodic one; try closed=True")
    path, compensator = scan.path(axis), Compensator(actuator, limits, slew_rate)
    stroke = path.range[1] - path.range[0]
    least = _TOLERANCE * stroke if tolerance is None else positive(tolerance, "tolerance")
    wanted = None if cycles is None else whole(cycles, "cycles", 0)
    said, homing, unknown, sure, start = list(scan.warnings), None, 0.0, True, state
    if start is None:
        homing, way_to, remarks = _homing(compensator, scan, present, drive)
        unknown, sure, start = way_to.error, way_to.certified, way_to.state
        said += remarks
    reach = Limits(getattr(scan, "speed", None), getattr(scan, "acceleration", None))
    way = approach_to(path, compensator, start, reach, approach)
    found = settle(compensator, path, way, start, least, wanted)
    return WaveTable(homing, found.start_up, found.cycle, found.cycles, found.error, unknown, sure, found.state, start,
                     actuator, found.clamped, (*said, *found.warnings))  # fmt: skip


def _homing(
    compensator: Compensator, scan: Scan, present: float | None, drive: Drive | None
) -> tuple[Excitation | None, Homing, tuple[str, ...]]:
    """The homing in the scan's samples, what it is worth, and what is to be said."""
    actuator, limits = compensator.actuator, interval(compensator.limits or ())
    now = min(max(0.0, limits[0]), limits[1]) if present is None else volts(present, "present")
    if drive is None:
        slowly = max(0.5 / _HOMING_FREQUENCY, 0.5 * scan.period)
        drive = Drive(frequency=0.5 / leg_seconds(actuator, slowly), sample_rate=scan.rate)
    drive = replace(drive, sample_rate=scan.rate, base=now, present=now, limits=limits,
                    slew_rate=compensator.slew_rate)  # fmt: skip
    way = shortest_homing(actuator, limits=limits, present=now, stiff_only=True, drive=drive)
    said = () if way.certified and way.played is None else way.remarks
    if len(way.turns) < 2:
        return None, way, said
    played = way.played or homing_through(turns=way.turns, drive=drive)
    return played, way, (*said, *played.warnings)
