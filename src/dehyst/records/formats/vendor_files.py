"""Text tables of other programs: GCS arrays of PI's recorders, LabVIEW measurements (.lvm), Excel sheets (.xlsx)."""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Iterable
from contextlib import closing
from dataclasses import replace
from datetime import date, datetime, time
from math import isfinite
from typing import Any

import numpy as np

from dehyst._errors import FileFormatError
from dehyst.records.formats.columns import Column, listed, shortened
from dehyst.records.formats.file_content import Allowance
from dehyst.records.formats.notation import SIGNS, WRITTEN, Cells, notation_of, pointed
from dehyst.records.formats.table_layout import Layout
from dehyst.records.formats.text_table import WIDEST, TextTable, read_text, text_of
from dehyst.records.formats.timestamps import clock_of, moment

GCS_END = "# END_HEADER"
# The separators of a GCS array by their number; None: blanks.
GCS_SEPARATORS = {"9": "\t", "32": None, "44": ",", "59": ";"}
_END = re.compile(rb"(?m)^#[ \t]*END_HEADER[ \t\r]*$")
_ENTRY = re.compile(r"#\s*([A-Z_]+\d*)\s*=\s*(.*)")
# The header of an array is shorter [bytes].
_HEAD = 50_000


def is_gcs(data: bytes) -> bool:
    """Return whether a text is a GCS array."""
    return _END.search(data, 0, _HEAD) is not None


def gcs_entries(lines: Iterable[str]) -> list[tuple[str, str]]:
    """Return keys and values of the header of a GCS array."""
    return [(match[1], match[2].strip()) for line in lines if (match := _ENTRY.fullmatch(line.strip()))]


def read_gcs(data: bytes, allowance: Allowance) -> list[Column]:
    """Read a GCS array: its columns by the names in the header, and their time by its sample time; it has no units.

    Raise `FileFormatError` if the separator is unknown, the sample time is not a positive number, or the rows are not a
    table.
    """
    text = text_of(data)
    end = _END.search(text.data)
    if end is None:
        raise FileFormatError(f"got no line {GCS_END}, need one before the rows; record again")
    lines = text.data[: end.start()].decode(text.encoding).split("\n")
    header = dict(gcs_entries(lines))
    separator = GCS_SEPARATORS.get(header.get("SEPARATOR", "32"), "")
    if separator == "":
        got = f"SEPARATOR = {shortened(header['SEPARATOR'])}"
        raise FileFormatError(f"got {got}, need 32 (space), 9, 44 or 59; record again")
    start = min(end.end() + 1, len(text.data))
    row = text.data[start : start + 10_000].lstrip().split(b"\n")[0].decode(text.encoding)
    names = tuple(header.get(f"NAME{k}") or f"column {k + 1}" for k in range(len(row.split(separator))))
    columns = TextTable.of(text, Layout(start, len(lines), separator, names, row=row)).columns(allowance)
    if "SAMPLE_TIME" not in header:
        return columns
    try:
        step = float(header["SAMPLE_TIME"])
    except ValueError:
        step = 0.0
    if not 0 < step < float("inf"):
        got = f"SAMPLE_TIME = {shortened(header['SAMPLE_TIME'])}"
        raise FileFormatError(f"got {got}, need a time above 0 s; record again")
    samples = len(columns[0].data)
    allowance.take(samples, "the time of its samples")
    return [Column("time", np.arange(float(samples)) * step, "s"), *columns]


# The name of a column of times, and the part of a sample by which the clocks of channels may differ.
_CLOCK, _SAME = "X_Value", 0.01
_MAGIC, _LABVIEW_END = b"LabVIEW Measurement", b"***End_of_Header***"


def is_labview(data: bytes) -> bool:
    """Return whether a text is a LabVIEW measurement file."""
    return data.lstrip(b"\xef\xbb\xbf").startswith(_MAGIC)


def read_labview(data: bytes, allowance: Allowance) -> list[Column]:
    """Read the segment of a LabVIEW measurement file: its channels with their units, and their time.

    Raise `FileFormatError` for a header without its end, more than one segment, channels with clocks of their own, or
    fewer samples than the header states.
    """
    text = text_of(data)
    parts = text.data.split(_LABVIEW_END)
    if len(parts) != 3:
        count = max(len(parts) - 2, 0)
        raise FileFormatError(f"got {count} segments of a LabVIEW measurement, need 1; save each in a file of its own")
    comma = b"\nSeparator\tComma" in parts[0] or b"\nSeparator,Comma" in parts[0]
    sign = "," if comma else "\t"
    lines = [[line.split(sign) for line in part.decode(text.encoding).split("\n")] for part in parts[:2]]
    stated, header = ({cells[0].strip(): [cell.strip() for cell in cells[1:]] for cells in part} for part in lines)
    body = parts[2].partition(b"\n")[2]
    head, _, rows = body.partition(b"\n")
    names = [cell.strip() for cell in head.decode(text.encoding).split(sign)]
    names = names[: names.index("Comment")] if "Comment" in names else names
    cut = sign.encode()
    rows = b"\n".join(cut.join(line.split(cut)[: len(names)]) for line in rows.split(b"\n") if line.strip())
    first = text.data[: len(text.data) - len(body)].count(b"\n") + 1
    decimal = next((mark for mark in stated.get("Decimal_Separator", [])[:1] if mark in SIGNS), None)
    table = TextTable.of(text._replace(data=rows), Layout(0, first, sign, tuple(names)))
    columns = table.columns(allowance, decimal)
    return _with_header(columns, header, [name for name in names if name != _CLOCK])


def _with_header(columns: list[Column], header: dict[str, list[str]], names: list[str]) -> list[Column]:
    """Return the channels with their units, after their time: a column of it, else the step of the header.

    Raise FileFormatError if they have clocks of their own, or fewer samples than the header states.
    """

    def cells(key: str) -> list[str]:
        given = header.get(key, [])
        # With a column of time for each channel, the cells above these are empty.
        stated = [cell for cell in given if cell]
        return stated if len(stated) == len(names) else [*given, *[""] * len(names)][: len(names)]

    numbers = {key: [_number(cell) for cell in cells(key)] for key in ("X0", "Delta_X", "Samples")}
    offsets, steps, samples = ([one for one in values if one is not None] for values in numbers.values())
    channels = [column for column in columns if column.name != _CLOCK]
    clocks = [c.data for c in columns if c.name == _CLOCK and c.data.size and np.isfinite(c.data).all()]
    count = max((column.data.size for column in channels), default=0)
    if count < (most := max(samples, default=0.0)):
        raise FileFormatError(
            f"its header states {most:.0f} samples, it holds {count}: the file is cut short. Take a complete copy, or "
            "correct Samples in its header to read what is there"
        )
    slack = _SAME * abs(steps[0]) if steps else 0.0
    starts = {start for pair in zip(cells("Date"), cells("Time"), strict=True) if (start := " ".join(pair)).strip()}
    apart = {
        "X0": bool(offsets) and max(offsets) - min(offsets) > slack,
        "Delta_X": bool(steps) and (max(steps) - min(steps)) * max([1.0, *samples]) > slack,
        "Date and Time": len(starts) > 1 and not _simultaneous(starts, slack),
        "X_Value": any(not np.array_equal(clock, clocks[0]) for clock in clocks[1:]),
    }
    if any(apart.values()):
        differing = ", ".join(key for key, differs in apart.items() if differs)
        raise FileFormatError(
            f"the channels {listed(tuple(names))} have clocks of their own: {differing} differ",
            hint="save each in a file of its own, and join the second one",
            change=("join",),
        )
    channels = [replace(column, unit=unit) for column, unit in zip(channels, cells("Y_Unit_Label"), strict=False)]
    unit = "s" if header.get("X_Dimension", ["Time"])[:1] == ["Time"] else ""
    if clocks:
        return [Column("time", clocks[0], unit), *channels]
    offset, step = (next(iter(numbers[key]), None) for key in ("X0", "Delta_X"))
    if offset is None or step is None:
        return channels
    with np.errstate(all="ignore"):
        return [Column("time", offset + step * np.arange(float(count)), unit), *channels]


def _number(cell: str) -> float | None:
    try:
        number = float(cell.replace(",", "."))
    except ValueError:
        return None
    return number if isfinite(number) else None


def _simultaneous(starts: set[str], slack: float) -> bool:
    """Return whether all channels start on one day, within `slack` [s]."""
    days, stamps = {start.split(" ")[0] for start in starts}, [start.split(" ")[-1] for start in starts]
    try:
        times = clock_of([moment(stamp) for stamp in stamps]).seconds
    except ValueError:
        return False
    return len(days) == 1 and bool(np.ptp(times) <= slack)


# Rows of a sheet in Excel, and the least memory of a cell while it is read [bytes].
_MOST_ROWS, _CELL = 1 << 20, 32


def read_xlsx(data: bytes, allowance: Allowance) -> list[Column]:
    """Read the tables of a workbook; the names of several sheets are put before those of their columns.

    Raise `FileFormatError` for no sheet with a table, or more than allowed.
    """
    import openpyxl

    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        for member in archive.infolist():
            allowance.check(member.file_size, f"sheet '{member.filename}'")
    with closing(openpyxl.load_workbook(io.BytesIO(data), read_only=True, data_only=True)) as workbook:
        sheets = {sheet.title: _text(sheet, allowance) for sheet in workbook.worksheets}
    sheets = {title: text for title, text in sheets.items() if sum(map(bool, map(bytes.strip, text.split(b"\n")))) > 1}
    if not sheets:
        raise FileFormatError("no sheet with rows found; save the measurement in a sheet")
    return [
        column if len(sheets) == 1 else replace(column, name=f"{title}/{column.name}")
        for title, text in sheets.items()
        for column in read_text(text, allowance, ".")
    ]


def _text(sheet: Any, allowance: Allowance) -> bytes:
    """Return the rows of a sheet as text with tabs and decimal points, up to its last cell with content.

    The range that a sheet declares is not believed: programs write a wrong one.

    Raise `FileFormatError` for more rows than Excel has, or more cells than allowed; empty cells before one with
    content count.
    """
    sheet.reset_dimensions()
    table: list[list[Any]] = []
    filled, width, cells = 0, 0, 0
    for number, given in enumerate(sheet.iter_rows(values_only=True), 1):
        if number > _MOST_ROWS or len(given) > WIDEST:
            what = f"{_MOST_ROWS} rows" if number > _MOST_ROWS else f"{WIDEST} columns"
            raise FileFormatError(
                f"sheet '{shortened(sheet.title)}' has more than {what}, which is no measurement; keep time, voltage "
                "and displacement only"
            )
        cells += len(given)
        allowance.check(_CELL * cells, f"the cells of sheet '{shortened(sheet.title)}'")
        row = list(given)
        while row and not _cell(row[-1]):
            row.pop()
        filled, width = (number if row else filled), max(width, len(row))
        table.append(row)
    allowance.check(filled * width, f"the cells of sheet '{shortened(sheet.title)}'")
    table = [row + [None] * (width - len(row)) for row in table[:filled]]
    if any(isinstance(cell, str) and WRITTEN.fullmatch(cell.strip()) for row in table for cell in row):
        _point(table, allowance)
    return "".join("\t".join(map(_cell, row)) + "\n" for row in table).encode()


def _point(table: list[list[Any]], allowance: Allowance) -> None:
    """Write the numbers among the texts of a sheet with decimal points; a cell that is a number has no sign."""
    texts = [[_cell(cell) if isinstance(cell, str) else "" for cell in row] for row in table]

    def where(place: int) -> str:
        before = data[:place]
        column = before.count(b"\t", before.rfind(b"\n") + 1) + 1
        return f"row {before.count(10) + 1}, column {column}"

    data = "".join("\t".join(row) + "\n" for row in texts).encode()
    cells = Cells(data, 0, "\t", where)
    lines = pointed(cells, notation_of(cells, allowance.decimal), numbers_only=True).decode().split("\n")
    for row, line in zip(table, lines, strict=False):
        row[:] = [text or cell for cell, text in zip(row, line.split("\t"), strict=False)]


def _cell(value: Any) -> str:
    if isinstance(value, datetime | date | time):
        return value.isoformat()
    return "" if value is None else " ".join(str(value).split())
