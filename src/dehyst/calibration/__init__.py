"""Calibration: the complete experiment on an instrument, from its first voltage to a verified model."""

from dehyst.calibration.experiment import Calibration, calibrate
from dehyst.calibration.plan import Plan
from dehyst.calibration.tracking import TrackedPath

__all__ = ["Plan", "calibrate"]
