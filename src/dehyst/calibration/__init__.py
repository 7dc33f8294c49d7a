"""Calibration: the complete experiment on an instrument, from its first voltage to a verified model."""

from dehyst.calibration.experiment import Calibration, calibrate
from dehyst.calibration.plan import Plan
from dehyst.calibration.session import ProgressListener
from dehyst.calibration.tracking import PathPlanner, TrackedPath

__all__ = ["Calibration", "PathPlanner", "Plan", "ProgressListener", "TrackedPath", "calibrate"]
