"""Scans by name, from options in micrometres: one declaration for the command line, the workbench and its page."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import radians
from typing import Any, NamedTuple, get_args

from dehyst._errors import RecordError
from dehyst.waveforms.one_axis import Shape, Steps, Triangle
from dehyst.waveforms.scan import Rounding, Scan, between
from dehyst.waveforms.two_axes import Constant, Lissajous, Raster, Slow, Spiral

_MICRO = 1e-6
_MOST_DEGREES = 36_000


class ScanOption(NamedTuple):
    """An option of named scans.

    `kind`: float, int, the words to choose from, or a list: "numbers" or "pair". `unit`: "" for a pure number; lengths
    are in um. `help`: what it is. `default`: what it is if it is not given, in words; the first word of a choice.
    """

    kind: type | tuple[str, ...] | str
    unit: str
    help: str
    default: str = ""


OPTIONS: dict[str, ScanOption] = {
    "low": ScanOption(float, "um", "Lowest displacement, along x"),
    "high": ScanOption(float, "um", "Highest displacement, along x"),
    "y_low": ScanOption(float, "um", "Lowest displacement along y; the first line of a raster", "as along x"),
    "y_high": ScanOption(float, "um", "Highest displacement along y; the last line of a raster", "as along x"),
    "frequency": ScanOption(float, "Hz", "Cycles, lines or whole figures a second"),
    "turns": ScanOption(
        float, "share", "Share of the time spent turning", "0.1, or as short as the acceleration allows"
    ),
    "speed": ScanOption(float, "um/s", "Largest speed of an axis"),
    "acceleration": ScanOption(float, "um/s2", "Largest acceleration of an axis"),
    "rising": ScanOption(float, "share", "Share of the time spent rising", "0.5"),
    "rounding": ScanOption(
        get_args(Rounding), "", "Shape of turns: parabola has constant acceleration, cosine has no jumps of it"
    ),
    "lines": ScanOption(int, "", "Lines of a raster"),
    "slow": ScanOption(get_args(Slow), "", "Motion of a raster along y"),
    "back": ScanOption(int, "", "Lines that y of a raster takes back", "fewest"),
    "revolutions": ScanOption(int, "", "Revolutions of a spiral outwards; 1/4 is added"),
    "constant": ScanOption(get_args(Constant), "", "Constant speed of a spiral"),
    "ratio": ScanOption("pair", "", "Cycles of x and y of a Lissajous figure", "1 1"),
    "phase": ScanOption(float, "degrees", "Phase of y of a Lissajous figure", "widest figure"),
    "levels": ScanOption("numbers", "um", "Levels of steps"),
    "dwell": ScanOption(float, "s", "Time on each level"),
    "edge": ScanOption(float, "s", "Time between levels", "as the limits allow"),
    "shape": ScanOption(get_args(Shape), "", "Shape of a change of level"),
}


class ScanKind(NamedTuple):
    """A named scan: the function that makes it, the options that it needs, and those that it may have."""

    make: Callable[[dict[str, Any], float | None], Scan]
    needs: tuple[str, ...]
    may: tuple[str, ...]

    @property
    def takes(self) -> tuple[str, ...]:
        """All of its options, in the order of `OPTIONS`."""
        return tuple(name for name in OPTIONS if name in {*self.needs, *self.may})


def scan_of(
    kind: str, options: Mapping[str, Any], sample_rate: float | None, *, written: Callable[[str], str] = str
) -> Scan:
    """Return the scan that options define.

    Parameters
    ----------
    kind : str
        A name of `SCANS`.
    options : mapping
        Values by name, as `OPTIONS` declares them: lengths in micrometres, the phase in degrees, levels as numbers.
    sample_rate : float, optional
        [Hz].
    written : function
        Writes the name of an option in messages.

    Raises
    ------
    RecordError
        An option is missing, does not belong to the scan, or is impossible.
    """
    scan = SCANS[kind]
    if missing := [name for name in scan.needs if name not in options]:
        needs = ", ".join(map(written, scan.needs))
        raise RecordError(f"{written('scan')} {kind}: got no {' and no '.join(map(written, missing))}, need {needs}")
    if foreign := [name for name in options if name not in scan.takes]:
        takes = ", ".join(map(written, scan.takes))
        raise RecordError(
            f"{written(foreign[0])}: got {options[foreign[0]]!r} with {written('scan')} {kind}, which takes {takes}"
        )
    given = {name: _in_metres(value, OPTIONS[name].unit) for name, value in options.items()}
    return scan.make(given, sample_rate)


def _in_metres(value: Any, unit: str) -> Any:
    if not unit.startswith("um"):
        return value
    return tuple(level * _MICRO for level in value) if isinstance(value, list | tuple) else value * _MICRO


def _spiral(given: dict[str, Any], rate: float | None) -> Scan:
    (x, radius), (y, y_radius) = _middles(given)
    if abs(radius - y_radius) > 1e-9 * radius:
        raise RecordError(
            f"got a range of {2e6 * y_radius:.6g} um, but x has {2e6 * radius:.6g} um, and a spiral is round",
            argument="y_low, y_high",
            hint="give equal ranges",
        )
    return Spiral(radius, centre=(x, y), **given, sample_rate=rate)


def _lissajous(given: dict[str, Any], rate: float | None) -> Scan:
    (x, a), (y, b) = _middles(given)
    if "phase" in given:
        if not abs(given["phase"]) <= _MOST_DEGREES:
            raise RecordError(
                argument="phase",
                got=f"{given['phase']:g}",
                need=f"an angle in degrees, {-_MOST_DEGREES} to {_MOST_DEGREES}",
            )
        given["phase"] = radians(given["phase"])
    return Lissajous((a, b), centre=(x, y), **given, sample_rate=rate)


def _steps(given: dict[str, Any], rate: float | None) -> Scan:
    levels = given.pop("levels")
    if len(levels) < 2:
        raise RecordError(
            argument="levels", got=f"{levels[0] / _MICRO:g} um alone", need="at least two, such as 0,10,20"
        )
    return Steps(levels, seconds=given.pop("edge", None), **given, sample_rate=rate)


def _middles(given: dict[str, Any]) -> list[tuple[float, float]]:
    """Return the middle and half of the range along x and y [m]."""
    x = between(given.pop("low"), given.pop("high"))
    y = between(given.pop("y_low", x[0]), given.pop("y_high", x[1]), ("y_low", "y_high"))
    return [(0.5 * (low + high), 0.5 * (high - low)) for low, high in (x, y)]


_RANGE = ("low", "high", "frequency")
_LIMITS = ("speed", "acceleration")
_TURNING = ("turns", *_LIMITS, "rounding")
_PLANE = ("y_low", "y_high")
SCANS: dict[str, ScanKind] = {
    "triangle": ScanKind(lambda given, rate: Triangle(**given, sample_rate=rate), _RANGE, (*_TURNING, "rising")),
    "raster": ScanKind(
        lambda given, rate: Raster(**given, sample_rate=rate),
        (*_RANGE, "lines"),
        (*_PLANE, "slow", "back", "rising", *_TURNING),
    ),
    "spiral": ScanKind(_spiral, (*_RANGE, "revolutions"), (*_PLANE, "constant", *_TURNING)),
    "lissajous": ScanKind(_lissajous, _RANGE, (*_PLANE, "ratio", "phase", *_LIMITS)),
    "steps": ScanKind(_steps, ("levels", "dwell"), ("edge", "shape", *_LIMITS)),
}
