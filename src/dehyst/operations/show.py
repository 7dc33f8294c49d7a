"""`show`: how a file is understood."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from dehyst._errors import RecordError
from dehyst._io import format_of
from dehyst._text import counted, digits
from dehyst._types import Array
from dehyst._views.lines import ends, span_of
from dehyst.operations.command import OUTPUT, Values, argument, command, option, output
from dehyst.operations.files import AS_COLUMNS, AS_FOUND, RECORD, Columns, is_model
from dehyst.operations.run import Result, Run, files
from dehyst.records import Record, Table, table_of, write_record
from dehyst.records.files import record_of


def _of_record(given: Values) -> str:
    return "with a model" if is_model(given["file"]) else ""


@command("show")
def show(
    run: Run,
    file: Path = argument(),
    output: Path | None = output("Write the record here, in s, V and um (.csv) or m (.npz).", OUTPUT, _of_record),
    columns: Columns = option(Columns.about, AS_COLUMNS, _of_record, default=AS_FOUND),
    save: Path | None = option("Write the columns here as text, for --columns @FILE.", OUTPUT, _of_record),
) -> Result:
    """Print how a FILE is understood: columns, units, sample rate, cycles and problems.

    The status is 2 if the file is not a record; the message then suggests columns. For a model, its parts are printed.
    """
    if is_model(file):
        from dehyst.model import Actuator, Stage

        model = (Stage if format_of(file) == "dehyst-stage" else Actuator).load(file)
        return Result(model.as_dict(), model.summary().split("\n"))
    columns.demand(RECORD, "here", axes=bool(columns.axes))
    table = table_of(file, columns)
    run.known["file_columns"] = [
        {"name": column.name, "unit": column.parts[1], "range": [] if column.fault else _span(column.data)}
        for column in table.columns
    ]
    for line in _column_lines(table):
        run.say(line)
    record = record_of(table, columns, file.stem)
    own = columns.of_axes() if columns.axes else {"": columns}
    axes = {axis: _fields(record.axis(axis), own[axis]) for axis in record.axes or ("",)}
    if output is not None:
        write_record(output, record)
    if save is not None:
        columns.save(save)
    lines = [line for axis, found in axes.items() for line in _lines(axis, found)]
    fields = {"axes": axes} if record.axes else axes[""]
    return Result({**run.known, **fields}, [*lines, *files(Record=output, Columns=save)])


def _span(values: Array) -> list[float]:
    """Return the lowest and the highest of the finite values; empty if there is none."""
    finite = values[np.isfinite(values)]
    return [float(finite.min()), float(finite.max())] if finite.size else []


def _ends(span: list[float], unit: str = "") -> str:
    return ends(span[0], span[1], unit) if span else "none"


def _column_lines(table: Table) -> Iterator[str]:
    """Yield the columns of a file with their original names and units."""
    samples = max((column.data.size for column in table.columns), default=0)
    yield f"{table.source}: {counted(samples, 'row')} of {counted(len(table.columns), 'column')}"
    width = max(6, *(min(len(column.name), 60) for column in table.columns))
    yield f"  {'column':<{width}}  {'unit':<8}range"
    for column in table.columns:
        known, size = column.data[np.isfinite(column.data)], column.data.size
        lost = f", {counted(size - known.size, 'value')} not finite" if size > known.size else ""
        words = column.fault or f"{span_of(known, '')}{lost}"
        yield f"  {column.name[:60]:<{width}}  {(column.parts[1] or '-')[:7]:<8}{words}"


def _fields(record: Record, columns: Columns) -> dict[str, Any]:
    """Return how an axis of a record is understood, as JSON values."""
    meta, unusable = record.meta, []
    try:
        record.check_usable()
    except RecordError as error:
        unusable = [f"Not usable for an identification: {error}."]
    given = {quantity: name for quantity in ("voltage", "displacement") if (name := getattr(columns, quantity))}
    return {
        "name": record.name,
        "columns": given | dict(meta.get("columns", {})),
        **{name: meta.get(name, {}) for name in ("scales", "guesses")},
        "samples": len(record),
        "sample_rate_Hz": 1 / record.sample_time,
        "duration_s": float(record.time[-1] - record.time[0]),
        "voltage_V": list(record.voltage_range),
        "displacement_um": _span(record.displacement * 1e6),
        "others": {channel.column: _span(channel.values) for channel in record.others},
        "noise_nm": 1e9 * record.noise,
        "cycles": len(record.cycles()),
        "usable": not unusable,
        "problems": [*unusable, *record.problems()],
    }


def _lines(axis: str, found: dict[str, Any]) -> Iterator[str]:
    """Yield how the columns of an axis are understood, and suspicious properties."""
    rows = {
        "time": f"{ends(0.0, found['duration_s'], 's')}, {found['sample_rate_Hz']:.6g} Hz",
        "voltage": f"{_ends(found['voltage_V'], 'V')}, {counted(found['cycles'], 'cycle')}",
        "displacement": f"{_ends(found['displacement_um'], 'um')}, noise {digits(found['noise_nm'])} nm",
    }
    origins = {}
    for quantity in rows:
        keys = {quantity, f"{quantity} of {axis}"}
        scale = "".join(f", {words}" for key, words in found["scales"].items() if key in keys)
        mark = " (guessed, verify)" if keys & {*found["guesses"]} else ""
        origins[quantity] = f"'{found['columns'].get(quantity, quantity)}'{scale}{mark}"
    rows |= {name: _ends(span) for name, span in found["others"].items()}
    width = max(map(len, origins.values()))
    yield from ("", f"Axis {axis}") if axis else ("",)
    yield from (f"{name + ':':<14}{origins.get(name, ''):<{width}}  {words}" for name, words in rows.items())
    yield from ("", "Notes:" if found["problems"] else "No problems found.")
    yield from (f"  - {sentence}" for sentence in found["problems"])
