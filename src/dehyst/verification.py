"""Whether the actuator follows: a path, the voltages for it with and without a model, and what was reached."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dehyst._native import Array
from dehyst.actuator import Actuator
from dehyst.compensator import Compensator
from dehyst.excitation import Excitation
from dehyst.metrics import largest, percent, rms
from dehyst.record import Record
from dehyst.trajectory import Command, Limits
from dehyst.trials import simulated

# Turning points of the path to follow, as fractions of the stroke: nine of them, no two alike.
TURNS = (0.02, 0.95, 0.2, 0.7, 0.35, 0.85, 0.1, 0.6, 0.45, 0.9, 0.3)


def wanted_path(stroke: float, turns: tuple[float, ...] = TURNS, *, leg: int = 200) -> Array:
    """Path [m] through turning points given as shares of the stroke, cosines of `leg` samples between them."""
    rise = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, leg + 1) / leg)
    legs = [start + (end - start) * rise for start, end in pairwise(turns)]
    return stroke * np.concatenate([[turns[0]], *legs])


@dataclass(frozen=True, eq=False)
class Course:
    """A path to follow after a homing, and the voltages for it.

    Attributes
    ----------
    wanted : (n,) array
        Displacement [m] for each sample of the excitations.
    begin : int
        The first sample of the path: before it are homing and the way to the path.
    nominal, compensated : Excitation
        By a constant ratio of voltage to displacement, and by the model.
    command : Command
        What the compensator says of its part.
    stroke : float
        Of the major loop [m].
    """

    wanted: Array
    begin: int
    nominal: Excitation
    compensated: Excitation
    command: Command
    stroke: float


def course(
    actuator: Actuator, homing: Excitation, ends: tuple[float, float], limits: Limits, *, leg: int = 200
) -> Course:
    """Plan a path through most of the stroke, and its voltages.

    Parameters
    ----------
    actuator : Actuator
    homing : Excitation
        Two major cycles, from and to the lowest voltage: after them the state is known. It gives the sample rate, too.
    ends : (float, float)
        Measured displacement [m] at the lowest and highest voltage of the homing.
    limits : Limits
        Voltages allowed [V], and their slew rate.
    leg : int
        Samples from one turning point to the next.
    """
    homed = simulated(actuator, homing.voltage, homing.time)
    low, stroke = ends[0], ends[1] - ends[0]
    path = low + wanted_path(stroke, leg=leg)
    way = wanted_path(1.0, (float(homed.displacement[-1]), float(path[0])), leg=leg)
    wanted = np.concatenate([way[1:], path[1:]])
    time = np.arange(wanted.size) / homing.sample_rate
    ahead = np.interp(time + actuator.delay, time, wanted)
    command = Compensator(actuator, (limits.low, limits.high), limits.slew_rate).trajectory(
        ahead, time=time, state=homed.state
    )
    v_low, v_high = homing.voltage_range
    ratio = np.clip(v_low + (wanted - low) * (v_high - v_low) / stroke, limits.low, limits.high)
    return Course(
        np.concatenate([np.full(len(homing), np.nan), wanted]), len(homing) + leg - 1,
        _after(homing, ratio, "nominal"), _after(homing, command.voltage, "compensated"), command, stroke,
    )  # fmt: skip


def _after(homing: Excitation, voltage: Array, name: str) -> Excitation:
    return Excitation(name, np.concatenate([homing.voltage, voltage]), homing.sample_rate)


@dataclass(frozen=True, eq=False)
class Followed:
    """What was measured along a path: time (n,) [s], wanted and reached displacement (n,) [m], and the stroke [m]."""

    time: Array
    wanted: Array
    reached: Array
    stroke: float

    @classmethod
    def of(cls, played: Course, record: Record, rows: NDArray[np.intp]) -> Followed:
        """Compare a record of one of the excitations with the path; `rows` says which sample is which."""
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
        """JSON values."""
        return {"largest_percent": self.largest_percent, "rms_percent": self.rms_percent,
                "mean_percent": percent(float(self.error.mean()), self.stroke),
                "largest_m": largest(self.error)}  # fmt: skip
