"""Waveforms: voltages that excite an actuator, and scans for it to follow."""

from dehyst.waveforms import standard
from dehyst.waveforms.excitation import Excitation, Leg, Sampling, positive, refuse_long, volts
from dehyst.waveforms.one_axis import Steps, Triangle
from dehyst.waveforms.scan import Bridge, MotionLimits, PathPoint, Scan, ScanPath, whole
from dehyst.waveforms.standard import (
    RATIO,
    TURNS,
    descending_tops,
    homing,
    minor_loop,
    raised_cosine,
    reversal_curves,
    stage_excitation,
    staircase,
    wanted_path,
)
from dehyst.waveforms.two_axes import Lissajous, Raster, Spiral

__all__ = [
    "Excitation",
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
