"""A path of all axes together: its voltages with and without the model of the stage, and what they reach."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle, islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array
from dehyst.control import VoltageLimits
from dehyst.control.tracking import TURNS, wanted_path
from dehyst.model.replay import beginning
from dehyst.records.metrics import largest, percent, rms
from dehyst.stages.compensator import StageCompensator
from dehyst.stages.decoupling import apply
from dehyst.stages.excitation import RATIO
from dehyst.stages.record import StageRecord
from dehyst.stages.stage import Stage
from dehyst.stages.stage_trace import StageTrace

# Share of the range of every actuator that a path uses.
_USED = 0.96
# Axis j begins this many turning points later than the axis before.
_LATER = 3


@dataclass(frozen=True, eq=False)
class StageRun:
    """A path to follow after a homing of all axes, and voltages for it.

    Attributes
    ----------
    name : str
    voltage : (n, axes) array
        [V], the homing first.
    wanted : (n, axes) array
        Wanted reading of each sensor [m]; NaN during the homing.
    begin : int
        First sample of the path, after the homing and the way to the path.
    strokes : (axes,) array
        Of the major loops [m].
    warnings : tuple of str
        Where a voltage could not follow.
    """

    name: str
    voltage: Array
    wanted: Array
    begin: int
    strokes: Array
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class StagePathPlanner:
    """A planner of paths of all axes of a stage, moving together with periods that do not repeat.

    Parameters
    ----------
    stage : Stage
        The identified model.
    homing : (m, axes) array
        Voltages [V] of two major cycles of all axes, from and to the lowest voltage of each.
    sample_rate : float
        [Hz].
    limits : sequence of VoltageLimits
        Of each axis, with its slew rate.
    leg : int
        Samples from one turning point to the next, of the first axis.
    """

    stage: Stage
    homing: Array
    sample_rate: float
    limits: Sequence[VoltageLimits]
    leg: int

    @staticmethod
    def samples(leg: int, axes: int) -> int:
        """Return the samples of a path of so many `axes`, with the way to it; `leg` as of the planner."""
        return leg + (len(TURNS) - 1) * max(_legs(leg, axes))

    def nominal(self, before: Sequence[StageRecord]) -> StageRun:
        """Plan the path with a constant ratio of voltage to displacement on each axis, as if there was no coupling.

        `before`: all records until now, in order.
        """
        homed, datum = self._homed(before)
        low, high = self._ends(homed)
        wanted, begin = self._wanted(homed, low, high, datum)
        bottom, top = (np.array([getattr(one, key) for one in self.limits]) for key in ("low", "high"))
        rest = apply(self.stage.coupling, low[None])[0] + datum
        voltage = bottom + (wanted - rest) * (top - bottom) / (high - low)
        return self._run("nominal", wanted, begin, np.clip(voltage, bottom, top), high - low)

    def compensated(self, before: Sequence[StageRecord]) -> StageRun:
        """Plan the path by the model; its states follow from all earlier records, its zeros from the last.

        `before`: all records until now, in order; the last is that of the nominal run.
        """
        homed, datum = self._homed(before)
        low, high = self._ends(homed)
        wanted, begin = self._wanted(homed, low, high, datum)
        time = np.arange(len(wanted)) / self.sample_rate
        ahead = np.column_stack(
            [
                np.interp(time + one.delay, time, column) - zero
                for one, column, zero in zip(self.stage.actuators, wanted.T, datum.tolist(), strict=True)
            ]
        )
        compensator = StageCompensator(
            self.stage,
            limits=[(one.low, one.high) for one in self.limits],
            slew_rate=[one.slew_rate for one in self.limits],
            states=homed.states,
        )
        command = compensator.trajectory(ahead, time=time)
        return self._run("compensated", wanted, begin, command.voltage, high - low, command.warnings)

    def _homed(self, before: Sequence[StageRecord]) -> tuple[StageTrace, Array]:
        """Return the motion of the next homing, and the zeros (axes,) [m] of the sensors by the last record."""
        time = np.concatenate([record.time for record in before])
        voltage = np.vstack([record.voltage for record in before])
        starts = [beginning(one, voltage[:, j]) for j, one in enumerate(self.stage.actuators)]
        played = self.stage.simulate(voltage, time=time, states=starts, extrapolate=True)
        late = len(before[-1]) // 2
        datum = np.mean(before[-1].displacement[-late:] - played.displacement[-late:], axis=0)
        seconds = np.arange(len(self.homing)) / self.sample_rate
        homed = self.stage.simulate(self.homing, time=seconds, states=played.states, extrapolate=True)
        return homed, np.asarray(datum)

    def _ends(self, homed: StageTrace) -> tuple[Array, Array]:
        """Return the displacements (axes,) [m] of each actuator alone at the ends of its major loop."""
        moved = apply(self.stage.decoupling, homed.displacement)[len(self.homing) // 2 :]
        return moved.min(axis=0), moved.max(axis=0)

    def _wanted(self, homed: StageTrace, low: Array, high: Array, datum: Array) -> tuple[Array, int]:
        """Return the way from the end of the homing to the path, and the path [m]; and where the path begins."""
        strokes = high - low
        # So large that whatever the other axes do no actuator leaves its range.
        share = _USED * float((strokes / (np.abs(self.stage.decoupling) @ strokes)).min())
        middle = apply(self.stage.coupling, (0.5 * (low + high))[None])[0] + datum
        legs = _legs(self.leg, len(strokes))
        # As many samples as the slowest axis needs for all its turning points.
        count = (len(TURNS) - 1) * max(legs) + 1
        path = np.column_stack(
            [
                middle[j] + share * strokes[j] * (wanted_path(1.0, _turns(j, count, leg), leg=leg)[:count] - 0.5)
                for j, leg in enumerate(legs)
            ]
        )
        start = homed.displacement[-1] + datum
        way = np.column_stack(
            [
                wanted_path(1.0, (begin, end), leg=self.leg)
                for begin, end in zip(start.tolist(), path[0].tolist(), strict=True)
            ]
        )
        return np.vstack([way[1:], path[1:]]), len(way) - 2

    def _run(
        self,
        name: str,
        wanted: Array,
        begin: int,
        voltage: Array,
        strokes: Array,
        warnings: tuple[str, ...] = (),
    ) -> StageRun:
        shown = np.vstack([np.full_like(self.homing, np.nan), wanted])
        return StageRun(name, np.vstack([self.homing, voltage]), shown, len(self.homing) + begin, strokes, warnings)


def _legs(leg: int, axes: int) -> list[int]:
    """Return the samples between two turning points of each axis."""
    return [round(leg * RATIO**j) for j in range(axes)]


def _turns(j: int, count: int, leg: int) -> tuple[float, ...]:
    """Return the turning points of axis `j` for `count` samples."""
    return tuple(islice(cycle(TURNS[1:]), _LATER * j, _LATER * j + count // leg + 2))


@dataclass(frozen=True, eq=False)
class TrackedStage:
    """A measured path of all axes: `time` (n,) [s], `wanted` and `reached` (n, axes) [m], `strokes` (axes,) [m]."""

    axes: tuple[str, ...]
    time: Array
    wanted: Array
    reached: Array
    strokes: Array

    @classmethod
    def of(cls, run: StageRun, record: StageRecord, rows: NDArray[np.intp]) -> TrackedStage:
        """Compare the `record` of a `run` with its path; `rows` maps its samples to those of the run."""
        along = rows >= run.begin
        return cls(
            record.axes,
            record.time[along] - record.time[along][0],
            run.wanted[rows[along]],
            record.displacement[along],
            run.strokes,
        )

    @property
    def largest_percent(self) -> tuple[float, ...]:
        """Largest error of each axis in % of its stroke."""
        error = self.reached - self.wanted
        return tuple(percent(largest(error[:, j]), stroke) for j, stroke in enumerate(self.strokes.tolist()))

    @property
    def rms_percent(self) -> tuple[float, ...]:
        """RMS error of each axis in % of its stroke."""
        error = self.reached - self.wanted
        return tuple(percent(rms(error[:, j]), stroke) for j, stroke in enumerate(self.strokes.tolist()))

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {
            axis: {"largest_percent": largest_error, "rms_percent": rms_error, "stroke_m": stroke}
            for axis, largest_error, rms_error, stroke in zip(
                self.axes, self.largest_percent, self.rms_percent, self.strokes.tolist(), strict=True
            )
        }
