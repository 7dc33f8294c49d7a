"""Named scans on the command line: their options, in micrometres, the scan that they define, and its messages."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from dehyst.waveforms import Scan

_CURVED = (
    "Shape of turns: parabola has constant acceleration; cosine has no jumps of it, for a stage that resonates.  "
    "[default: parabola]"
)
_TURNS = "Share of the time spent turning.  [default: 0.1, or as short as --acceleration allows]"
_SHAPE = "Steps: shape of a change of level.  [default: minimum-jerk]"


def _option(flag: str, kind: Any, metavar: str | None, text: str) -> tuple[str, Callable[..., Any]]:
    return flag[2:].replace("-", "_"), click.option(flag, type=kind, metavar=metavar, help=text)


_OPTIONS = (
    _option("--low", float, "UM", "Lowest displacement, along x."),
    _option("--high", float, "UM", "Highest displacement, along x."),
    _option("--y-low", float, "UM", "Along y; the first line of a raster.  [default: --low]"),
    _option("--y-high", float, "UM", "Along y; the last line of a raster.  [default: --high]"),
    _option("--frequency", float, "HZ", "Cycles, lines or whole figures a second."),
    _option("--turns", float, "SHARE", _TURNS),
    _option("--speed", float, "UM/S", "Largest speed of an axis."),
    _option("--acceleration", float, "UM/S2", "Largest acceleration of an axis."),
    _option("--rising", float, "SHARE", "Share of the time spent rising.  [default: 0.5]"),
    _option("--rounding", click.Choice(["parabola", "cosine"]), None, _CURVED),
    _option("--lines", int, "N", "Lines of a raster."),
    _option("--slow", click.Choice(["staircase", "ramp"]), None, "Y of a raster.  [default: staircase]"),
    _option("--back", int, "N", "Lines that y of a raster takes back.  [default: fewest]"),
    _option("--revolutions", int, "N", "Revolutions of a spiral outwards; 1/4 is added."),
    _option("--constant", click.Choice(["linear", "angular"]), None, "Speed of a spiral.  [default: linear]"),
    _option("--ratio", (int, int), "P Q", "Lissajous: cycles of x and y.  [default: 1 1]"),
    _option("--phase", float, "DEGREES", "Lissajous: phase of y.  [default: widest figure]"),
    _option("--levels", None, "UM,UM,...", "Steps: the levels."),
    _option("--dwell", float, "S", "Steps: time on each level."),
    _option("--edge", float, "S", "Steps: time between levels.  [default: as the limits allow]"),
    _option("--shape", click.Choice(["minimum-jerk", "trapezoid"]), None, _SHAPE),
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
NAMES = tuple(name for name, _ in _OPTIONS)


def scan_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options of all named scans."""
    for _, option in reversed(_OPTIONS):
        command = option(command)
    return click.option("--scan", type=click.Choice(list(_TAKES)), help="A named path instead of a file.")(command)


def named_scan(kind: str, sample_rate: float | None, options: dict[str, Any]) -> Scan:
    """Return the scan that the options define.

    Raise `RecordError` if an option is missing, does not belong to this scan, or is impossible.
    """
    from dehyst._errors import RecordError
    from dehyst.waveforms.named import scan_of

    given = {name: value for name, value in options.items() if name in NAMES and value is not None}
    missing = [name for name in _NEEDS[kind] if name not in given]
    if missing:
        raise RecordError(f"--scan {kind}: got no {' and no '.join(map(_flag, missing))}, need {_needs(kind)}")
    foreign = [name for name in given if name not in _TAKES[kind]]
    if foreign:
        takes = ", ".join(map(_flag, _TAKES[kind]))
        raise RecordError(f"{_flag(foreign[0])}: got {given[foreign[0]]!r} with --scan {kind}, which takes {takes}")
    return scan_of(kind, given, sample_rate)


def _flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _needs(kind: str) -> str:
    return ", ".join(map(_flag, _NEEDS[kind]))


# Arguments of scans with another name on the command line.
_RENAMED = {"cycles": "start-up", "seconds": "edge", "slew_rate": "slew", "base": "present"}
_OTHERS = ("sample_rate", "axis", "limits", "present", "approach", "tolerance")
_FLAGS = {name: f"--{name.replace('_', '-')}" for name in (*NAMES, *_OTHERS) if name != "edge"} | {
    name: f"--{flag}" for name, flag in _RENAMED.items()
}
_ARGUMENTS = "|".join(_FLAGS)
_NUMBER = r"-?\d[\d.]*(?:e[+-]?\d+)?"
_ENTRIES = (
    # The library gives both units where either may be meant.
    (re.compile(rf"{_NUMBER} m/s(?:\^2)? \(({_NUMBER} um/s(?:\^2)?)\)"), r"\1"),
    (re.compile("give metres, such as 5e-6"), "give micrometres, such as 5"),
    (re.compile(r"give more cycles="), "give a larger --start-up"),
    (re.compile(r"limits=\([^)]*\)"), "--limits LOW HIGH"),
    (re.compile(rf"\b({_ARGUMENTS})=(?=\S)"), lambda match: f"{_FLAGS[match[1]]} "),
)
_LENGTHS = re.compile(rf"({_NUMBER})(?: and ({_NUMBER}))? m\b(?!/)")
_HEAD = re.compile(rf"^(?:{_ARGUMENTS})(?:, (?:{_ARGUMENTS}))*(?=:)")


def in_options(sentence: str) -> str:
    """Write a sentence of a scan with options for arguments, and micrometres for metres."""
    sentence = _HEAD.sub(lambda match: ", ".join(_FLAGS[name] for name in match[0].split(", ")), sentence)
    for pattern, words in _ENTRIES:
        sentence = pattern.sub(words, sentence)
    return _LENGTHS.sub(_micro, sentence)


@contextmanager
def errors_in_options() -> Iterator[None]:
    """Re-raise errors in the words of the command line."""
    from dehyst._errors import ModelError, RecordError

    try:
        yield
    except (ModelError, RecordError) as error:
        raise type(error)(in_options(str(error))) from error


def _micro(match: re.Match[str]) -> str:
    return " and ".join(f"{float(length) * 1e6:.6g}" for length in match.groups() if length) + " um"
