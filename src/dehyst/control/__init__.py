"""Control: from a wanted displacement to the voltage that produces it."""

from dehyst.control.bank import Bank
from dehyst.control.compensator import Compensator
from dehyst.control.limits import Clamps, ClampWarning, VoltageLimits, outside_identified
from dehyst.control.loop import Snapshot
from dehyst.control.planning.homing import Homing, shortest_homing
from dehyst.control.planning.path import HomedPath, plan_path, plan_voltage
from dehyst.control.planning.start import PossibleStart, StartError, model_error
from dehyst.control.planning.states import StateBounds, first_known_by_displacement, least_width, time_dependence
from dehyst.control.planning.wave_table import WaveTable, wave_table
from dehyst.control.stage_compensator import StageCompensator
from dehyst.control.trajectory import Command

__all__ = [
    "Bank",
    "ClampWarning",
    "Command",
    "Compensator",
    "HomedPath",
    "Homing",
    "PossibleStart",
    "Snapshot",
    "StageCompensator",
    "StartError",
    "StateBounds",
    "VoltageLimits",
    "WaveTable",
    "plan_path",
    "plan_voltage",
    "shortest_homing",
    "wave_table",
]
