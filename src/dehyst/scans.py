"""Scans: paths that a microscopist wants, one for each axis, within limits of speed and acceleration."""

from __future__ import annotations

from dehyst.lissajous import Lissajous
from dehyst.raster import Raster
from dehyst.scan import Path, Scan
from dehyst.spiral import Spiral
from dehyst.steps import Steps
from dehyst.triangle import Triangle

__all__ = ["Lissajous", "Path", "Raster", "Scan", "Spiral", "Steps", "Triangle"]
