"""Control: from a wanted displacement to the voltage that produces it."""

from dehyst.control.bank import Bank, BankClamps, BankState
from dehyst.control.compensator import Compensator
from dehyst.control.limits import ClampWarning, VoltageLimits
from dehyst.control.loop import Snapshot
from dehyst.control.planning.bounds import StateBounds
from dehyst.control.planning.homing import Homing, shortest_homing
from dehyst.control.planning.path import HomedPath, plan_path, plan_voltage, start_at
from dehyst.control.planning.stage_path import home_stage_before, plan_stage_path, plan_stage_voltage
from dehyst.control.planning.start import PossibleStart, StartError
from dehyst.control.planning.wave_table import WaveTable, wave_table
from dehyst.control.stage_compensator import StageCompensator
from dehyst.control.trajectory import Command

__all__ = [
    "Bank",
    "BankClamps",
    "BankState",
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
    "home_stage_before",
    "plan_path",
    "plan_stage_path",
    "plan_stage_voltage",
    "plan_voltage",
    "shortest_homing",
    "start_at",
    "wave_table",
]
