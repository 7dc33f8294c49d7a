"""Control: from a wanted displacement to the voltage that produces it."""

from dehyst.control.clamping import ClampWarning
from dehyst.control.compensator import Compensator
from dehyst.control.homed_path import HomedPath, home_before, home_before_voltage, start_at
from dehyst.control.homing import Homing, shortest_homing
from dehyst.control.limits import VoltageLimits
from dehyst.control.possible_start import PossibleStart
from dehyst.control.snapshot import Snapshot
from dehyst.control.start_error import StartError
from dehyst.control.state_bounds import StateBounds
from dehyst.control.tracking import PathPlanner, TrackedPath
from dehyst.control.trajectory import Command
from dehyst.control.wave_table import WaveTable, wave_table

__all__ = [
    "ClampWarning",
    "Command",
    "Compensator",
    "HomedPath",
    "Homing",
    "PathPlanner",
    "PossibleStart",
    "Snapshot",
    "StartError",
    "StateBounds",
    "TrackedPath",
    "VoltageLimits",
    "WaveTable",
    "home_before",
    "home_before_voltage",
    "shortest_homing",
    "start_at",
    "wave_table",
]
