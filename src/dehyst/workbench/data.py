"""Data for the page: columns of records, paths of points and scans, WebAssembly."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from dehyst._errors import DehystError, FileFormatError
from dehyst._types import Array
from dehyst.control import Compensator
from dehyst.exports import wasm_module
from dehyst.model import Actuator
from dehyst.operations.axes import AxesModel
from dehyst.operations.command import context_of, given_in
from dehyst.operations.files import AS_FOUND, Columns, clock_of
from dehyst.operations.run import Run
from dehyst.records import read, table_of, write_columns
from dehyst.records.tables import ColumnsError
from dehyst.waveforms.scans import SCANS, scan_of
from dehyst.workbench.jobs import words_of

_MICRO = 1e6
# Most samples of a path that is written, and of a path that the page draws.
_MOST_SAMPLES, _MOST_DRAWN = 10_000_000, 2_000_000


class RequestError(DehystError, ValueError):
    """A request that the server does not understand."""


def number_of(value: Any, name: str) -> float:
    """Return a finite number from a request."""
    if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300 and isfinite(value):
        return float(value)
    raise RequestError(argument=name, got=repr(str(value)[:40]), need="a number")


def written_path(file: Path, points: Any, rate: Any) -> None:
    """Write a path through points (time [s], displacement [um]), with straight lines between them, as CSV.

    With several axes, `points` holds the points of each axis by name.

    Raises
    ------
    RequestError
        If there are fewer than two points, times do not rise, or the rate [Hz] gives too many samples.
    """
    hertz = number_of(rate, "rate")
    each = {"displacement_um": points} if not isinstance(points, Mapping) else {f"{k}_um": v for k, v in points.items()}
    corners = {name: _corners(path) for name, path in each.items()}
    if not corners:
        raise RequestError(argument="points", need="the points of at least one axis")
    first = max(path[0, 0] for path in corners.values())
    seconds = max(path[-1, 0] for path in corners.values()) - first
    if not 1 <= seconds * hertz <= _MOST_SAMPLES:
        got = f"{hertz:g} Hz, {seconds * hertz:.4g} samples"
        raise RequestError(argument="rate", got=got, need=f"1 to {_MOST_SAMPLES:g} samples", hint="give another rate")
    sampled = first + np.arange(round(seconds * hertz) + 1) / hertz
    moved = {name: np.interp(sampled, *path.T) for name, path in corners.items()}
    write_columns(file, {"time_s": sampled, **moved}, digits=12)


def path_points(file: Path, model: Path) -> list[list[list[float]]]:
    """Return the points (time [s], displacement [um]) of a path in a file, for each axis of a model; times begin at 0.

    Raises
    ------
    RequestError
        If the file is not understood, or its times do not rise. A table without a header holds time and displacement.
    """
    known = AxesModel.read(Run(), model)
    try:
        moved, time = _path_columns(file, known)
    except FileFormatError as error:
        need = ",".join(["time_s", *(known.name("displacement", axis) for axis in known.axes)])
        unnamed = isinstance(error, ColumnsError) and not any(p.column and p.column.fault for p in error.problems)
        if unnamed or "columns" in error.change:
            raise RequestError(f"has no column with a known name and unit; need columns such as {need}") from error
        raise RequestError(str(error).replace(f"{file}: ", "").replace(f"{file.name}: ", "")) from error
    if time.size < 2 or not (np.diff(time) > 0).all():
        raise RequestError("its times do not rise; need at least two rising times, in a column such as time_s")
    return [np.column_stack([time - time[0], _MICRO * column]).tolist() for column in moved.T]


def _path_columns(file: Path, known: AxesModel) -> tuple[Array, Array]:
    """Return displacements (n, axes) [m] and times (n,) [s] of a path."""
    table = table_of(file, AS_FOUND)
    # Without a header, a time and a displacement.
    bare = len(table.names) == 2 and all(name.isdigit() for name in table.names)
    columns = Columns(time="1:s", displacement="2:um") if bare else AS_FOUND
    return known.values(table, "displacement", columns), clock_of(table, columns).get("time_s", np.empty(0))


def _corners(points: Any) -> Array:
    try:
        corners = np.array(points, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise RequestError(argument="points", need="pairs of a time (s) and a displacement (um)") from error
    if corners.ndim != 2 or corners.shape[0] < 2 or corners.shape[1] != 2 or not np.isfinite(corners).all():
        raise RequestError(argument="points", need="at least two, each with a time (s) and a displacement (um)")
    if not (np.diff(corners[:, 0]) > 0).all():
        raise RequestError("their times do not rise", argument="points", hint="move the points apart")
    return corners


def scan_words(scan: Mapping[str, Any], **more: Any) -> tuple[list[str], str]:
    """Return the command words of a requested scan, with `more` options, and the wanted axis.

    Raise `RequestError` or `OperationError` if the request is not a scan.
    """
    given = {name: ",".join(map(str, value)) if isinstance(value, list) else value for name, value in scan.items()}
    kind, axis = str(given.pop("kind", "")), str(given.pop("axis", None) or "x")
    if kind not in SCANS:
        raise RequestError(argument="kind", got=repr(kind), need=f"one of {', '.join(SCANS)}")
    known = (*SCANS[kind].takes, "cycles")
    if unknown := [name for name, value in given.items() if name not in known and value not in (None, "")]:
        raise RequestError(argument=unknown[0], got=f"it for a {kind}", need=f"some of {', '.join(known)}")
    return words_of(f"scan {kind}", **given, **more), axis


def scan_columns(scan: Mapping[str, Any], rate: Any) -> tuple[Array, Array]:
    """Return time [s] and displacement [um] of a requested scan, sampled at a rate [Hz].

    Raise `RequestError`, `OperationError` or `RecordError` if the scan is impossible, or has too many samples.
    """
    hertz, (words, axis) = number_of(rate, "rate"), scan_words(scan, output="path.csv")
    context = context_of(words)
    kind, cycles = str(context.info_name), context.params["cycles"]
    values = {name: value for name, value in given_in(context).items() if name not in ("output", "cycles")}
    path = scan_of(kind, values, hertz).path(axis)
    if len(path) * cycles > _MOST_DRAWN:
        got = f"{hertz:g} Hz, {len(path) * cycles} samples"
        raise RequestError(argument="rate", got=got, need=f"at most {_MOST_DRAWN} to draw them")
    whole = path.repeated(cycles) if path.periodic else path
    return np.arange(len(whole)) / hertz, whole.displacement * _MICRO


def wasm(file: Path, period: float | None) -> bytes:
    """Return a model as a WebAssembly module, with a `period` [s] if the model depends on time.

    A model that depends on temperature is taken at its reference temperature.
    """
    actuator = replace(Actuator.load(file), thermal=None)
    return wasm_module(Compensator(actuator, period=period))


def record_columns(file: Path, axis: str = "") -> tuple[Array, ...]:
    """Return time [s], voltage [V] and displacement [um] in a record's file, or of one `axis` in it."""
    record = read(file, Columns(voltage=f"v{axis}_V", displacement=f"{axis}_m") if axis else None)
    return record.time - record.time[0], record.voltage, record.displacement * _MICRO


def packed(columns: tuple[Array, ...]) -> bytes:
    """Return columns, one after the other, as little-endian 32-bit floats."""
    return b"".join(column.astype("<f4").tobytes() for column in columns)
