"""Calibration: the complete experiment on an instrument, from its first voltage to a verified model."""

from dehyst.calibration.experiment import RESULTS, STAGE_RESULTS, Calibration, calibrate
from dehyst.calibration.plan import Plan, WantedVoltage, entries, read_voltage, steps
from dehyst.calibration.session import FORMAT
from dehyst.calibration.tracking import TrackedPath

__all__ = ["Calibration", "Plan", "TrackedPath", "calibrate"]
