"""Waveforms: voltages that excite an actuator, and scans that it is to follow."""

from dehyst.waveforms.excitation import Excitation, Leg, Sampling
from dehyst.waveforms.one_axis import Steps, Triangle
from dehyst.waveforms.scan import MotionLimits, Scan, ScanPath
from dehyst.waveforms.standard import (
    descending_tops,
    homing,
    minor_loop,
    raised_cosine,
    reversal_curves,
    stage_excitation,
    staircase,
)
from dehyst.waveforms.two_axes import Lissajous, Raster, Spiral

__all__ = [
    "Excitation",
    "Leg",
    "Lissajous",
    "MotionLimits",
    "Raster",
    "Sampling",
    "Scan",
    "ScanPath",
    "Spiral",
    "Steps",
    "Triangle",
    "descending_tops",
    "homing",
    "minor_loop",
    "raised_cosine",
    "reversal_curves",
    "stage_excitation",
    "staircase",
]
