"""Calibration: the complete experiment on an instrument."""

from dehyst.instruments.calibration.experiment import Calibration, calibrate
from dehyst.instruments.calibration.plan import Plan
from dehyst.instruments.calibration.session import ProgressListener

__all__ = ["Calibration", "Plan", "ProgressListener", "calibrate"]
