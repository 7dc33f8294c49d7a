"""Control: from a wanted displacement to the voltage that produces it."""

from dehyst.control.clamping import ClampWarning
from dehyst.control.compensator import Compensator
from dehyst.control.homing import Homing, shortest_homing
from dehyst.control.limits import VoltageLimits
from dehyst.control.snapshot import Snapshot
from dehyst.control.state_bounds import StateBounds
from dehyst.control.tracking import PathPlanner, TrackedPath
from dehyst.control.trajectory import Command
from dehyst.control.wave_table import WaveTable, wave_table

__all__ = [
    "ClampWarning",
    "Command",
    "Compensator",
    "Homing",
    "PathPlanner",
    "Snapshot",
    "StateBounds",
    "TrackedPath",
    "VoltageLimits",
    "WaveTable",
    "shortest_homing",
    "wave_table",
]
