"""Requests of the page as words of a command: only options that are known here, each with a value of its kind."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from math import inf, isfinite
from pathlib import Path
from typing import Any

import numpy as np

from dehyst._errors import DehystError
from dehyst.records import write_columns
from dehyst.workbench import folder as places
from dehyst.workbench.entries import ModelEntry
from dehyst.workbench.folder import Folder

_TEXTS = ("columns", "time", "voltage", "displacement", "voltage_scale", "displacement_scale")
_KINDS: dict[str, type | tuple[str, ...]] = {
    **dict.fromkeys(_TEXTS, str),
    "sample_rate": float,
    "structure": ("auto", "paper"),
    "norm": ("l1", "l2", "linf"),
    "goal": float,
    "time_limit": float,
}
_READ = (*_TEXTS, "sample_rate")
_IDENTIFY = ("structure", "norm", "goal", "time_limit")
# Options of named scans: numbers, whole numbers and names.
_SCANS = ("triangle", "raster", "spiral", "lissajous", "steps")
_SCAN_NUMBERS = (
    *("low", "high", "y_low", "y_high", "frequency", "turns", "speed", "acceleration", "rising", "phase", "dwell"),
    *("edge", "sample_rate", "lines", "back", "revolutions", "cycles"),
)
_SCAN_NAMES = {
    "rounding": ("parabola", "cosine"),
    "slow": ("staircase", "ramp"),
    "constant": ("linear", "angular"),
    "shape": ("minimum-jerk", "trapezoid"),
    "axis": ("x", "y"),
}
_LONGEST = 1000
# Samples of a path that is drawn.
_MOST_SAMPLES = 10_000_000


class RequestError(DehystError, ValueError):
    """A request that is not understood: what was got, what is needed."""


def read_words(source: str, file: str, options: Mapping[str, Any]) -> list[str]:
    """Return the command that reads an uploaded file and writes the record in SI units."""
    # A record is a measurement, which is not replaced without --force: here by the same file, read otherwise.
    return ["show", source, "-o", file, "--force", "--json", *_options(options, _READ)]


def identify_words(entry: ModelEntry, train: list[str], validate: list[str], report: str) -> list[str]:
    """Return the command that identifies a model."""
    held_out = ["--validate", *validate] if validate else []
    outputs = ["-o", entry.file, "--traces", entry.traces, "--report", report, "--json"]
    return ["identify", *train, *outputs, *_options(entry.options, _IDENTIFY), *held_out]


def path_words(model: str, file: str, request: Mapping[str, Any], path: str | None) -> list[str]:
    """Return the command that computes the voltage for a `path`, or for the request's scan."""
    words = ["compensate", model]
    if path is not None:
        words.append(path)
    else:
        words += scan_words(request.get("scan"), request.get("rate"))
    words += ["-o", file, "--json"]
    if (limits := request.get("limits")) is not None:
        words += ["--limits", *map(repr, limits_of(limits))]
    if (slew := request.get("slew")) is not None:
        words += ["--slew", repr(number_of(slew, "slew"))]
    return words


def export_words(folder: Folder, model: ModelEntry, kind: str, request: Mapping[str, Any]) -> list[str]:
    """Return the command that exports a model."""
    name = Path(model.file).stem
    if kind == "c":
        return ["export", model.file, folder.new(places.EXPORTS, f"{name}-c"), "--json"]
    if kind == "fmu":
        return ["export", model.file, folder.new(places.EXPORTS, name, ".fmu"), "--fmu", "--json"]
    if kind == "wasm":
        return ["export", model.file, folder.new(places.EXPORTS, name, ".wasm"), "--json"]
    if kind == "wave_table":
        table = folder.new(places.EXPORTS, f"{name}-cycle", ".csv")
        file = folder.new(places.VOLTAGES, f"{name}-cycle", ".csv")
        return [*path_words(model.file, file, request, None), "--cycle", table]
    raise RequestError(f"kind: got {kind!r}, need c, fmu, wasm or wave_table")


def written_path(file: Path, points: Any, rate: Any) -> None:
    """Write a path through points (time [s], displacement [um]), with straight lines between them, as CSV.

    Raises
    ------
    RequestError
        The points are not two at least with rising times, or the rate [Hz] asks for too many samples.
    """
    hertz = number_of(rate, "rate")
    try:
        corners = np.array(points, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise RequestError("points: need pairs of a time (s) and a displacement (um)") from error
    if corners.ndim != 2 or corners.shape[0] < 2 or corners.shape[1] != 2 or not np.isfinite(corners).all():
        raise RequestError("points: need two at least, each a time (s) and a displacement (um)")
    time = corners[:, 0]
    if not (np.diff(time) > 0).all():
        raise RequestError("points: their times do not rise; move the points apart")
    samples = (time[-1] - time[0]) * hertz
    if not 1 <= samples <= _MOST_SAMPLES:
        raise RequestError(
            f"rate: {hertz:g} Hz gives {samples:.4g} samples, need 1 to {_MOST_SAMPLES:g}; give another rate"
        )
    sampled = time[0] + np.arange(round(samples) + 1) / hertz
    write_columns(file, {"time_s": sampled, "displacement_um": np.interp(sampled, time, corners[:, 1])}, digits=12)


def limits_of(value: Any) -> tuple[float, float]:
    """Return voltage limits [V] from a request."""
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise RequestError("limits: need the lowest and the highest voltage (V)")
    low, high = (number_of(one, "limits") for one in value)
    if not low < high:
        raise RequestError(f"limits: got {low:g} to {high:g} V, need the lower one first")
    return low, high


def number_of(value: Any, name: str) -> float:
    """Return a finite number from a request."""
    try:
        number = float(value) if isinstance(value, int | float) and not isinstance(value, bool) else inf
    except OverflowError:
        number = inf
    if not isfinite(number):
        raise RequestError(f"{name}: got {str(value)[:40]!r}, need a number")
    return number


def _options(given: Mapping[str, Any], known: Iterable[str]) -> list[str]:
    """Return options as words: each with its value in one word, so that no value is taken for an option."""
    if unknown := set(given) - set(known):
        raise RequestError(f"options: got {sorted(unknown)[0]!r}, need some of {', '.join(known)}")
    words = []
    for name, value in given.items():
        if value is not None and value != "":
            words.append(f"--{name.replace('_', '-')}={_text(name, value, _KINDS[name])}")
    return words


def _text(name: str, value: Any, kind: type | tuple[str, ...]) -> str:
    if kind is float:
        return repr(number_of(value, name))
    if isinstance(kind, tuple):
        if value not in kind:
            raise RequestError(f"{name}: got {str(value)[:40]!r}, need {' or '.join(kind)}")
        return str(value)
    if not isinstance(value, str) or len(value) > _LONGEST or "\0" in value:
        raise RequestError(f"{name}: need a text of at most {_LONGEST} letters")
    return value


def scan_words(scan: Any, rate: Any) -> list[str]:
    """Return a scan as options of `dehyst compensate`."""
    if not isinstance(scan, Mapping) or scan.get("kind") not in _SCANS:
        raise RequestError(f"scan: need one of {', '.join(_SCANS)}, or points")
    words = ["--scan", scan["kind"]]
    given = {"sample_rate": rate, **{name: value for name, value in scan.items() if name != "kind"}}
    for name, value in given.items():
        if value is None or value == "":
            continue
        flag = f"--{name.replace('_', '-')}"
        if name in _SCAN_NUMBERS:
            words.append(f"{flag}={number_of(value, name):.12g}")
        elif name in _SCAN_NAMES:
            words.append(f"{flag}={_text(name, value, _SCAN_NAMES[name])}")
        elif name == "levels" and isinstance(value, list):
            words.append(f"{flag}={','.join(f'{number_of(one, name):.12g}' for one in value)}")
        elif name == "ratio" and isinstance(value, list) and len(value) == 2:
            words += [flag, *(f"{number_of(one, name):.12g}" for one in value)]
        else:
            raise RequestError(f"scan: got {str(name)[:40]!r}, which is not an option of a scan, or not of that kind")
    return words
