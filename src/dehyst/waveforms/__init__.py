"""Scans: paths that a microscopist wants, one for each axis, within limits of speed and acceleration."""

from __future__ import annotations

from dehyst.waveforms.lissajous import Lissajous
from dehyst.waveforms.raster import Raster
from dehyst.waveforms.scan import Scan, ScanPath
from dehyst.waveforms.spiral import Spiral
from dehyst.waveforms.steps import Steps
from dehyst.waveforms.triangle import Triangle

__all__ = ["Lissajous", "Raster", "Scan", "ScanPath", "Spiral", "Steps", "Triangle"]
