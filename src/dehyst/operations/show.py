"""`show`: how a file is understood."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
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
    run.known["file_columns"] = file_columns = [
        {"name": column.name, "unit": column.parts[1], "range": [] if column.fault else _span(column.data)}
        for column in table.columns
    ]
    for line in _column_lines(table):
        run.say(line)
    record = record_of(table, columns, file.stem)
    own = columns.of_axes() if columns.axes else {"": columns}
    axes = {axis: _AxisView(record.axis(axis), own[axis], axis) for axis in record.axes or ("",)}
    if output is not None:
        write_record(output, record)
    if save is not None:
        columns.save(save)
    fields = {axis: {**view.fields(), "file_columns": file_columns} for axis, view in axes.items()}
    lines = [line for view in axes.values() for line in view.lines()]
    return Result({"axes": fields} if record.axes else fields[""], [*lines, *files(Record=output, Columns=save)])


def _span(values: Array) -> list[float]:
    """Return the lowest and the highest of the finite values; empty if there is none."""
    finite = values[np.isfinite(values)]
    return [float(finite.min()), float(finite.max())] if finite.size else []


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


@dataclass(frozen=True)
class _AxisView:
    """How an axis of a record is understood."""

    record: Record
    columns: Columns
    name: str

    def understood(self) -> list[tuple[str, str, str]]:
        """Return each quantity, its column and its range, in words."""
        record = self.record
        used = {**{channel.name: channel.column for channel in record.others}, **record.meta.get("columns", {})}

        def origin(quantity: str) -> str:
            key = f"{quantity} of {self.name}" if self.name else quantity
            scale = record.meta.get("scales", {}).get(key)
            mark = " (guessed, verify)" if {quantity, key} & {*record.meta.get("guesses", ())} else ""
            column = used.get(quantity) or getattr(self.columns, quantity) or quantity
            return f"'{column}'{f', {scale}' if scale else ''}{mark}"

        noise = "" if record.measured is not None else f", noise {digits(record.noise * 1e9)} nm"
        moved = record.displacement[np.isfinite(record.displacement)]
        ranges = {
            "time": f"{ends(record.time[0], record.time[-1], 's')}, {1 / record.sample_time:.6g} Hz",
            "voltage": f"{span_of(record.voltage, 'V')}, {counted(len(record.cycles()), 'cycle')}",
            "displacement": f"{span_of(moved, 'um', 1e6)}{noise}",
        }
        for channel in record.others:
            ranges[channel.name] = span_of(channel.values, channel.unit)
        return [(quantity, origin(quantity), words) for quantity, words in ranges.items()]

    def lines(self) -> Iterator[str]:
        """Yield how the columns are understood, and suspicious properties."""
        rows = self.understood()
        width = max(len(column) for _, column, _ in rows)
        yield ""
        if self.name:
            yield f"Axis {self.name}"
        for quantity, column, words in rows:
            yield f"{quantity + ':':<14}{column:<{width}}  {words}"
        problems = [*self.unusable, *self.record.problems()]
        yield ""
        yield "Notes:" if problems else "No problems found."
        yield from (f"  - {sentence}" for sentence in problems)

    @cached_property
    def unusable(self) -> list[str]:
        """Why no loop can be identified from the record; empty if one can."""
        try:
            self.record.check_usable()
        except RecordError as error:
            return [f"Not usable for an identification: {error}."]
        return []

    def fields(self) -> dict[str, Any]:
        """Return JSON values."""
        record = self.record
        return {
            "name": record.name,
            **{name: record.meta.get(name, {}) for name in ("columns", "scales", "guesses")},
            "samples": len(record),
            "sample_rate_Hz": 1 / record.sample_time,
            "duration_s": float(record.time[-1] - record.time[0]),
            "voltage_V": list(record.voltage_range),
            "displacement_um": _span(record.displacement * 1e6),
            "others": {channel.column: _span(channel.values) for channel in record.others},
            "noise_nm": 1e9 * record.noise,
            "cycles": len(record.cycles()),
            "usable": not self.unusable,
            "problems": [*self.unusable, *self.record.problems()],
        }
