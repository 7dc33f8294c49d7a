"""Tracking: a path, the voltages for it with and without a model, and the displacement that they reach."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array
from dehyst.control.compensator import Compensator
from dehyst.control.limits import VoltageLimits
from dehyst.model import Actuator, simulated
from dehyst.records import Record
from dehyst.records.metrics import largest, percent, rms
from dehyst.waveforms import Excitation

# Turning points of the path to follow, as fractions of the stroke: nine of them, no two alike.
TURNS = (0.02, 0.95, 0.2, 0.7, 0.35, 0.85, 0.1, 0.6, 0.45, 0.9, 0.3)


def wanted_path(stroke: float, turns: tuple[float, ...] = TURNS, *, leg: int = 200) -> Array:
    """Return a path [m] through turning points in shares of the stroke, joined by cosines of `leg` samples."""
    rise = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, leg + 1) / leg)
    legs = [start + (end - start) * rise for start, end in pairwise(turns)]
    return stroke * np.concatenate([[turns[0]], *legs])


@dataclass(frozen=True, eq=False)
class PlannedRun:
    """A path to follow after a homing, and a voltage for it.

    Attributes
    ----------
    wanted : (n,) array
        Wanted reading of the sensor [m] at each sample of the excitation; NaN during the homing.
    begin : int
        First sample of the path, after the homing and the way to the path.
    excitation : Excitation
    stroke : float
        Of the major loop [m].
    warnings : tuple of str
        Where the voltage could not follow.
    """

    wanted: Array
    begin: int
    excitation: Excitation
    stroke: float
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class PathPlanner:
    """A planner of a path through most of the stroke after a homing.

    Parameters
    ----------
    homing : Excitation
        Two major cycles, from and to the lowest voltage: after them the state is known. It sets the sample rate too.
    ends : (float, float)
        Measured displacement [m] at the lowest and highest voltage of the homing.
    limits : VoltageLimits
        Voltages allowed [V], and their slew rate.
    leg : int
        Samples from one turning point to the next.
    """

    homing: Excitation
    ends: tuple[float, float]
    limits: VoltageLimits
    leg: int = 200

    @property
    def stroke(self) -> float:
        """Of the major loop [m]."""
        return self.ends[1] - self.ends[0]

    def nominal(self) -> PlannedRun:
        """Plan the run with a constant ratio of voltage to displacement."""
        low, high = self.homing.voltage_range
        wanted = self._wanted(self.ends[0])
        voltage = low + (wanted - self.ends[0]) * (high - low) / self.stroke
        return self._run("nominal", wanted, np.clip(voltage, self.limits.low, self.limits.high))

    def compensated(self, actuator: Actuator, before: Sequence[Record]) -> PlannedRun:
        """Plan the run with a model `actuator`; its state follows from all earlier records, its zero from the last.

        `before`: all records until now, in order; the last is that of the nominal run. Its path corrects for what
        happened before the records, and for the drift of the sensor.
        """
        history = _joined(before)
        played = simulated(actuator, history.voltage, history.time)
        late = slice(-(len(TURNS) - 1) * self.leg, None)
        datum = float(np.mean((history.displacement - played.displacement)[late]))
        homing = self.homing
        homed = actuator.simulate(homing.voltage, time=homing.time, state=played.state, extrapolate=True)
        wanted = self._wanted(float(homed.displacement[-1]) + datum)
        time = np.arange(wanted.size) / homing.sample_rate
        ahead = np.interp(time + actuator.delay, time, wanted) - datum
        compensator = Compensator(actuator, (self.limits.low, self.limits.high), self.limits.slew_rate)
        command = compensator.trajectory(ahead, time=time, state=homed.state)
        return self._run("compensated", wanted, command.voltage, command.warnings)

    def _wanted(self, start: float) -> Array:
        """Return the way from the end of the homing to the path, and the path [m]."""
        path = self.ends[0] + wanted_path(self.stroke, leg=self.leg)
        way = wanted_path(1.0, (start, float(path[0])), leg=self.leg)
        return np.concatenate([way[1:], path[1:]])

    def _run(self, name: str, wanted: Array, voltage: Array, warnings: tuple[str, ...] = ()) -> PlannedRun:
        home = self.homing
        excitation = Excitation(name, np.concatenate([home.voltage, voltage]), home.sample_rate)
        shown = np.concatenate([np.full(len(home), np.nan), wanted])
        return PlannedRun(shown, len(home) + self.leg - 1, excitation, self.stroke, warnings)


def _joined(records: Sequence[Record]) -> Record:
    """Return the records joined into one, as far back as their times increase from one to the next."""
    kept = [records[-1]]
    for record in records[-2::-1]:
        if record.time[-1] >= kept[0].time[0]:
            break
        kept.insert(0, record)
    time, voltage, displacement = (
        np.concatenate([getattr(record, column) for record in kept]) for column in ("time", "voltage", "displacement")
    )
    return Record(time, voltage, displacement, "history")


@dataclass(frozen=True, eq=False)
class TrackedPath:
    """A measured path: `time` (n,) [s], `wanted` and `reached` displacement (n,) [m], and the `stroke` [m]."""

    time: Array
    wanted: Array
    reached: Array
    stroke: float

    @classmethod
    def of(cls, played: PlannedRun, record: Record, rows: NDArray[np.intp]) -> TrackedPath:
        """Compare the `record` of a run `played` with its path; `rows` maps its samples to those of the excitation."""
        along = rows >= played.begin
        wanted = played.wanted[rows[along]]
        return cls(record.time[along] - record.time[along][0], wanted, record.displacement[along], played.stroke)

    @property
    def error(self) -> Array:
        """Reached minus wanted displacement (n,) [m]."""
        return self.reached - self.wanted

    @property
    def largest_percent(self) -> float:
        """Largest error in % of the stroke."""
        return percent(largest(self.error), self.stroke)

    @property
    def rms_percent(self) -> float:
        """RMS error in % of the stroke."""
        return percent(rms(self.error), self.stroke)

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {
            "largest_percent": self.largest_percent,
            "rms_percent": self.rms_percent,
            "mean_percent": percent(float(self.error.mean()), self.stroke),
            "largest_m": largest(self.error),
        }
