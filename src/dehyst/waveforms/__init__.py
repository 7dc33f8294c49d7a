"""Waveforms: voltages that excite an actuator, and scans that it is to follow."""

from dehyst.waveforms.excitation import Excitation
from dehyst.waveforms.lissajous import Lissajous
from dehyst.waveforms.playback import Leg, Sampling
from dehyst.waveforms.raster import Raster
from dehyst.waveforms.scan import MotionLimits, Scan, ScanPath
from dehyst.waveforms.spiral import Spiral
from dehyst.waveforms.standard import descending_tops, homing, minor_loop, raised_cosine, reversal_curves, staircase
from dehyst.waveforms.steps import Steps
from dehyst.waveforms.triangle import Triangle

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
    "staircase",
]
