"""Options of the command line that name a scan, in micrometres, and the scan that they mean."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from dehyst.waveforms import Scan

_WORD = {"metavar": "UM", "type": float}
_OPTIONS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("--low", {**_WORD, "help": "Lowest displacement, along x."}),
    ("--high", {**_WORD, "help": "Highest displacement, along x."}),
    ("--y-low", {**_WORD, "help": "Along y; the first line of a raster.  [default: --low]"}),
    ("--y-high", {**_WORD, "help": "Along y; the last line of a raster.  [default: --high]"}),
    ("--frequency", {"type": float, "metavar": "HZ", "help": "Cycles, lines or whole figures a second."}),
    (
        "--turns",
        {
            "type": float,
            "metavar": "SHARE",
            "help": "Of the time, spent turning.  [default: 0.1, or as short as --acceleration allows]",
        },
    ),
    ("--speed", {"type": float, "metavar": "UM/S", "help": "Largest speed of an axis."}),
    ("--acceleration", {"type": float, "metavar": "UM/S2", "help": "Largest acceleration of an axis."}),
    ("--rising", {"type": float, "metavar": "SHARE", "help": "Of the time, spent rising.  [default: 0.5]"}),
    (
        "--rounding",
        {
            "type": click.Choice(["parabola", "cosine"]),
            "help": "Of turns: constant acceleration, or without "
            "jumps of it, for a stage that resonates.  [default: parabola]",
        },
    ),
    ("--lines", {"type": int, "metavar": "N", "help": "Of a raster."}),
    ("--slow", {"type": click.Choice(["staircase", "ramp"]), "help": "Y of a raster.  [default: staircase]"}),
    ("--back", {"type": int, "metavar": "N", "help": "Lines that y of a raster takes back.  [default: fewest]"}),
    ("--revolutions", {"type": int, "metavar": "N", "help": "Of a spiral, out; 1/4 is added."}),
    ("--constant", {"type": click.Choice(["linear", "angular"]), "help": "Speed of a spiral.  [default: linear]"}),
    ("--ratio", {"type": (int, int), "metavar": "P Q", "help": "Lissajous: cycles of x and y.  [default: 1 1]"}),
    ("--phase", {"type": float, "metavar": "DEGREES", "help": "Lissajous: of y.  [default: widest figure]"}),
    ("--levels", {"metavar": "UM,UM,...", "help": "Steps: where to stand."}),
    ("--dwell", {"type": float, "metavar": "S", "help": "Steps: time on each level."}),
    ("--edge", {"type": float, "metavar": "S", "help": "Steps: time between levels.  [default: as the limits allow]"}),
    ("--shape", {"type": click.Choice(["minimum-jerk", "trapezoid"]), "help": "Steps.  [default: minimum-jerk]"}),
)
_LIMITS = ("speed", "acceleration")
_TURNING = ("low", "high", "frequency", "turns", *_LIMITS, "rounding")
_PLANE = ("y_low", "y_high")
_TAKES = {
    "triangle": (*_TURNING, "rising"),
    "raster": (*_TURNING, "rising", *_PLANE, "lines", "slow", "back"),
    "spiral": (*_TURNING, *_PLANE, "revolutions", "constant"),
    "lissajous": ("low", "high", "frequency", *_LIMITS, *_PLANE, "ratio", "phase"),
    "steps": (*_LIMITS, "levels", "dwell", "edge", "shape"),
}
_NEEDS = {
    "triangle": ("low", "high", "frequency"),
    "raster": ("low", "high", "frequency", "lines"),
    "spiral": ("low", "high", "frequency", "revolutions"),
    "lissajous": ("low", "high", "frequency"),
    "steps": ("levels", "dwell"),
}
NAMES = tuple(flag[2:].replace("-", "_") for flag, _ in _OPTIONS)
_MICRO = 1e-6
_MOST_DEGREES = 36_000


def scan_options(command: Callable[..., None]) -> Callable[..., None]:
    """Options of all named scans."""
    for flag, settings in reversed(_OPTIONS):
        command = click.option(flag, **settings)(command)
    return click.option("--scan", type=click.Choice(list(_TAKES)), help="A named path instead of a file.")(command)


def named_scan(kind: str, sample_rate: float | None, options: dict[str, Any]) -> Scan:
    """The scan that the options mean.

    Raises
    ------
    RecordError
        If one is missing, is none of this scan's, or is impossible.
    """
    from dehyst._errors import RecordError

    given = {name: value for name, value in options.items() if name in NAMES and value is not None}
    missing = [name for name in _NEEDS[kind] if name not in given]
    if missing:
        raise RecordError(f"--scan {kind}: got no {' and no '.join(map(_flag, missing))}, need {_needs(kind)}")
    other = [name for name in given if name not in _TAKES[kind]]
    if other:
        takes = ", ".join(map(_flag, _TAKES[kind]))
        raise RecordError(f"{_flag(other[0])}: got {given[other[0]]!r} with --scan {kind}, which takes {takes}")
    for name in ("low", "high", "y_low", "y_high", "speed", "acceleration"):
        if name in given:
            given[name] *= _MICRO
    return _MAKERS[kind](given, sample_rate)


def _flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _needs(kind: str) -> str:
    return ", ".join(map(_flag, _NEEDS[kind]))


def _triangle(given: dict[str, Any], rate: float | None) -> Scan:
    from dehyst.waveforms import Triangle

    return Triangle(**given, sample_rate=rate)


def _raster(given: dict[str, Any], rate: float | None) -> Scan:
    from dehyst.waveforms import Raster

    return Raster(**given, sample_rate=rate)


def _spiral(given: dict[str, Any], rate: float | None) -> Scan:
    from dehyst._errors import RecordError
    from dehyst.waveforms import Spiral

    (x, radius), (y, other) = _middles(given)
    if abs(radius - other) > 1e-9 * radius:
        raise RecordError(
            f"--y-low, --y-high: got {2e6 * other:.6g} um, but x has {2e6 * radius:.6g} um, and a spiral is round; "
            "give as much"
        )
    return Spiral(radius, centre=(x, y), **given, sample_rate=rate)


def _lissajous(given: dict[str, Any], rate: float | None) -> Scan:
    from math import radians

    from dehyst._errors import RecordError
    from dehyst.waveforms import Lissajous

    (x, a), (y, b) = _middles(given)
    if "phase" in given:
        if not abs(given["phase"]) <= _MOST_DEGREES:
            raise RecordError(
                f"--phase: got {given['phase']:g}, need an angle in degrees, {-_MOST_DEGREES} to {_MOST_DEGREES}"
            )
        given["phase"] = radians(given["phase"])
    return Lissajous((a, b), centre=(x, y), **given, sample_rate=rate)


def _steps(given: dict[str, Any], rate: float | None) -> Scan:
    from dehyst._errors import RecordError
    from dehyst.waveforms import Steps

    try:
        levels = tuple(float(level) * _MICRO for level in given.pop("levels").split(","))
    except ValueError as error:
        raise RecordError(f"--levels: {error}; need displacements in um with commas, such as 0,10,20") from error
    if len(levels) < 2:
        raise RecordError(f"--levels: got {levels[0] / _MICRO:g} um alone, need two at least, such as 0,10,20")
    return Steps(levels, seconds=given.pop("edge", None), **given, sample_rate=rate)


def _middles(given: dict[str, Any]) -> list[tuple[float, float]]:
    """Middle and half of the range along x and y [m]."""
    from dehyst.waveforms.scan import between

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
