"""The wave table of a periodic scan: the plan of its repeated path, whose last cycle is the table.

Without creep and smooth elements, all cycles from the second on are equal, because the first one wipes out all memory
that the scan can wipe out. Creep and smooth elements settle slowly: the table is taken when it no longer drifts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf
from typing import Any

import numpy as np

from dehyst._errors import RecordError
from dehyst._text import counted
from dehyst._types import Array
from dehyst._validation import count as whole
from dehyst._views.lines import length, span_of
from dehyst.control.compensator import Compensator
from dehyst.control.planning.path import Task
from dehyst.control.planning.start import PossibleStart
from dehyst.control.planning.ways import MOST_ROWS
from dehyst.model import Actuator, State
from dehyst.waveforms import ScanPath, positive

# A drift that more cycles do not reduce to this part does not settle; part of the tolerance that creep may use.
_SETTLING_RATIO, _CREEP_SHARE = 0.9, 0.95
# Largest drift of a repeated cycle, as a part of the stroke.
_TOLERANCE = 1e-4
# Number of cycle counts that are tried.
_COUNTS = 400


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


@dataclass(frozen=True, eq=False, repr=False)
class WaveTable:
    """The voltages of a periodic scan of one axis: a start-up, then the cycle any number of times.

    Attributes
    ----------
    cycle : Cycle
        One period in its steady cycle.
    plan : PathPlan or None
        The plan of homing, way, cycles of start-up and one closed cycle: play it without its last sample, and then the
        cycle. None if only the cycle is known. Its promise is that of the table.
    cycles : int
        Cycles in the start-up, after which the cycle may be played.
    error : float
        Drift [m] of the repeated cycles, by the model.
    tolerance : float
        Largest allowed drift [m].
    state : State or None
        State at the first sample of the cycle.
    warnings : tuple of str
        Deviations from the request, in sentences: those of the plan, and one on cycles that drift.
    """

    cycle: Cycle
    plan: Any = None
    cycles: int = 0
    error: float = 0.0
    tolerance: float = 0.0
    state: State | None = None
    warnings: tuple[str, ...] = ()

    def __repr__(self) -> str:
        settled = "settled" if self.settled else "not settled"
        cycle = f"{counted(len(self.cycle), 'sample')} a cycle, {span_of(self.cycle.voltage, 'V')}"
        return f"<WaveTable: {cycle}, after {counted(self.cycles, 'cycle')} of start-up, {settled}>"

    @property
    def settled(self) -> bool:
        """Whether the error is within the tolerance."""
        return self.error <= self.tolerance

    @property
    def sample_rate(self) -> float:
        """Sample rate [Hz] of start-up and cycle, and of a homing that is not long."""
        return self.cycle.sample_rate


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
        Whether the shortest homing comes first; default: yes, unless there is a `start`.
    cycles : int, optional
        Cycles in the start-up; by default as many as the tolerance requires, in at most 5e6 samples. Give all axes of a
        scan the same number, that of the slowest axis.
    tolerance : float, optional
        Largest drift of the repeated cycle [m]; by default 1e-4 of the stroke.

    Raises
    ------
    RecordError
        If the path is not periodic, or a number is impossible.
    ModelError
        If there are no limits, the start does not fit the actuator, or the path lies more than one stroke outside of
        its reach.
    """
    compensator = Compensator(actuator, limits, slew_rate, period=1 / path.sample_rate)
    least = _TOLERANCE * (path.range[1] - path.range[0]) if tolerance is None else positive(tolerance, "tolerance")
    most = MOST_ROWS // len(path)
    count, last = 1 if cycles is None else whole(cycles, "cycles", 0, most, error=RecordError), inf
    task = _task(compensator, path, count, home_within)
    task.give(start, present)
    if home or (home is None and start is None):
        task.home(again=True)
    else:
        task.begin()
    while True:
        table, more = _last_cycle(task, path, count, least)
        if cycles is not None or not more or table.error > _SETTLING_RATIO * last:
            plan = task.plan()
            return replace(table, plan=plan, warnings=(*plan.warnings, *table.warnings))
        count, last, way = count + more, table.error, task.parts[0].way
        task = _task(compensator, path, count, home_within)
        task.parts[0].way = way
        task.follow()


def _task(compensator: Compensator, path: ScanPath, cycles: int, home_within: float | None) -> Task:
    """Return the task of planning some `cycles` of start-up and one cycle, which need not be on time."""
    rows = path.repeated(cycles + 1)
    rates = {"velocity": rows.velocity, "acceleration": rows.acceleration}
    task = Task(compensator, rows.displacement, "displacement", rows.time, None, rates)
    task.prepare(False, home_within)
    return task


def _last_cycle(task: Task, path: ScanPath, count: int, least: float) -> tuple[WaveTable, int]:
    """Return the last cycle of a planned path as a table after `count` cycles, and the number of cycles that it lacks.

    The table may drift by `least` [m]. If it drifts by more and no start-up suffices, the number is 0.
    """
    (part,), size = task.parts, len(path)
    _close(task, size)
    closed, expected = part.found.voltage[-size - 1 :], part.found.displacement[-size - 1 : -1]
    # Three further cycles show the drift: each branch of creep moves by a share of its remaining way.
    actuator, state = part.loop.actuator, part.found.state
    played, states = [], [state]
    for _ in range(3):
        motion = actuator.simulate(closed, time=path.repeated(1).time, state=states[-1], extrapolate=True)
        played.append(motion.displacement[:-1] - expected)
        states.append(motion.state)
    creep, left, rates = actuator.displacement_creep, np.zeros(0), np.zeros(0)
    if creep is not None:
        rates = size / path.sample_rate / creep.time_constants
        left = creep.gains * (states[3].displacement_creep - states[2].displacement_creep) / np.expm1(-rates)
    error = max(float(np.abs(played).max()), float(np.abs(played[-1] + left.sum()).max()))
    counts = np.unique(np.geomspace(1, max(MOST_ROWS // size - count, 1), _COUNTS).astype(np.int64))
    enough = np.abs(np.exp(-np.outer(counts, rates)) @ left) <= _CREEP_SHARE * least
    more = int(counts[np.argmax(enough)]) if error > least and enough.any() else 0
    warnings: tuple[str, ...] = ()
    if error > least:
        remedy = f"give a start-up of {counted(count + more, 'cycle')}" if more else "no start-up is long enough"
        drifts = f"the cycles that follow drift by up to {length(error, least)}, need {length(least)}"
        warnings = (f"NOT SETTLED: after {counted(count, 'cycle')} of start-up {drifts}; {remedy}",)
    cycle = Cycle(closed[:-1], path.displacement, expected, path.sample_rate)
    return WaveTable(cycle, None, count, error, least, state, warnings), more


def _close(task: Task, size: int) -> None:
    """Let the last cycle of a planned path, of `size` samples, end where it begins, within the slew rate."""
    (part,) = task.parts
    voltage = part.found.voltage.copy()
    cycle, first = voltage[-size - 1 : -1], voltage[-size - 1]
    far = part.loop.bounds.largest_step(part.loop.period or inf) * np.arange(size, 0, -1)
    cycle[:], voltage[-1] = np.clip(cycle, first - far, first + far), first
    if not np.array_equal(voltage, part.found.voltage):
        moved, (state,) = task.motion(voltage[:, np.newaxis])
        part.found = part.found._replace(voltage=voltage, displacement=moved[-voltage.size :, 0], state=state)
