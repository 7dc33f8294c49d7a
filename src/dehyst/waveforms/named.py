"""Scans by name, from options in micrometres: as the command line and the workbench take them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import radians
from typing import Any

from dehyst._errors import RecordError
from dehyst.waveforms.lissajous import Lissajous
from dehyst.waveforms.raster import Raster
from dehyst.waveforms.scan import Scan, between
from dehyst.waveforms.spiral import Spiral
from dehyst.waveforms.steps import Steps
from dehyst.waveforms.triangle import Triangle

_MICRO = 1e-6
_LENGTHS = ("low", "high", "y_low", "y_high", "speed", "acceleration")
_MOST_DEGREES = 36_000


def scan_of(kind: str, options: Mapping[str, Any], sample_rate: float | None) -> Scan:
    """Return the scan that options define.

    Parameters
    ----------
    kind : {"triangle", "raster", "spiral", "lissajous", "steps"}
    options : mapping
        Arguments of that scan, with lengths in micrometres, `phase` in degrees, `levels` as numbers with commas between
        them, `edge` for `seconds`, and the range along x and y for radius, amplitude and centre.
    sample_rate : float, optional
        [Hz].

    Raises
    ------
    RecordError
        An option is impossible.
    TypeError
        An option is missing, or does not belong to the scan.
    """
    given = dict(options)
    for name in _LENGTHS:
        if name in given:
            given[name] *= _MICRO
    return _MAKERS[kind](given, sample_rate)


def _triangle(given: dict[str, Any], rate: float | None) -> Scan:
    return Triangle(**given, sample_rate=rate)


def _raster(given: dict[str, Any], rate: float | None) -> Scan:
    return Raster(**given, sample_rate=rate)


def _spiral(given: dict[str, Any], rate: float | None) -> Scan:
    (x, radius), (y, y_radius) = _middles(given)
    if abs(radius - y_radius) > 1e-9 * radius:
        raise RecordError(
            f"y_low, y_high: got a range of {2e6 * y_radius:.6g} um, but x has {2e6 * radius:.6g} um, and a spiral "
            "is round; give equal ranges"
        )
    return Spiral(radius, centre=(x, y), **given, sample_rate=rate)


def _lissajous(given: dict[str, Any], rate: float | None) -> Scan:
    (x, a), (y, b) = _middles(given)
    if "phase" in given:
        if not abs(given["phase"]) <= _MOST_DEGREES:
            raise RecordError(
                f"phase: got {given['phase']:g}, need an angle in degrees, {-_MOST_DEGREES} to {_MOST_DEGREES}"
            )
        given["phase"] = radians(given["phase"])
    return Lissajous((a, b), centre=(x, y), **given, sample_rate=rate)


def _steps(given: dict[str, Any], rate: float | None) -> Scan:
    try:
        levels = tuple(float(level) * _MICRO for level in given.pop("levels").split(","))
    except ValueError as error:
        raise RecordError(f"levels: {error}; need displacements in um with commas, such as 0,10,20") from error
    if len(levels) < 2:
        raise RecordError(f"levels: got {levels[0] / _MICRO:g} um alone, need at least two, such as 0,10,20")
    return Steps(levels, seconds=given.pop("edge", None), **given, sample_rate=rate)


def _middles(given: dict[str, Any]) -> list[tuple[float, float]]:
    """Return the middle and half of the range along x and y [m]."""
    x = between(given.pop("low"), given.pop("high"))
    y = between(given.pop("y_low", x[0]), given.pop("y_high", x[1]), ("y_low", "y_high"))
    return [(0.5 * (low + high), 0.5 * (high - low)) for low, high in (x, y)]


_MAKERS: dict[str, Callable[[dict[str, Any], float | None], Scan]] = {
    "triangle": _triangle,
    "raster": _raster,
    "spiral": _spiral,
    "lissajous": _lissajous,
    "steps": _steps,
}
