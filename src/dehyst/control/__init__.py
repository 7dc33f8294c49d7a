"""Control: from a wanted displacement to the voltage that produces it."""

from dehyst.control.axis import Axis
from dehyst.control.bank import Bank
from dehyst.control.compensator import Compensator, only_axis
from dehyst.control.feedback import Feedback
from dehyst.control.limits import Clamps, ClampWarning, SensorFault, SensorWarning, VoltageLimits, outside_identified
from dehyst.control.planning.homing import Homing, shortest_homing
from dehyst.control.planning.path import plan_path, plan_voltage
from dehyst.control.planning.plan import PathPlan
from dehyst.control.planning.start import PossibleStart, StartError, model_error
from dehyst.control.planning.wave_table import WaveTable, wave_table
from dehyst.control.repetition import Repetition

__all__ = [
    "Bank",
    "ClampWarning",
    "Compensator",
    "Feedback",
    "PathPlan",
    "PossibleStart",
    "Repetition",
    "SensorWarning",
    "VoltageLimits",
    "plan_path",
    "shortest_homing",
    "wave_table",
]
