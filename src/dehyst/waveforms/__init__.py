"""Waveforms: voltages that excite an actuator, and scans that it follows."""

from dehyst.waveforms import standard
from dehyst.waveforms.excitation import STEEPEST, Branch, Excitation, Sampling, positive, volts
from dehyst.waveforms.scan import Scan, ScanPath
from dehyst.waveforms.scans import Raster, Steps, Triangle
from dehyst.waveforms.standard import (
    FASTER,
    RATIO,
    TURNS,
    descending_tops,
    homing,
    raised_cosine,
    recommended,
    stage_excitation,
    staircase,
    wanted_path,
)

__all__ = [
    "Excitation",
    "Raster",
    "Sampling",
    "Steps",
    "Triangle",
    "descending_tops",
    "homing",
    "raised_cosine",
    "recommended",
    "stage_excitation",
    "staircase",
]
