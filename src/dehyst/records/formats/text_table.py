"""Text tables: rows of numbers below any number of header lines; separator and decimal sign follow from the file."""

from __future__ import annotations

import codecs
import io
import re
import warnings
from array import array
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from dehyst._errors import FileFormatError
from dehyst.records.formats.columns import Column, shortened, without_groups
from dehyst.records.formats.file_content import Allowance
from dehyst.records.formats.table_layout import Layout, cells_of, layout_of, number_in
from dehyst.records.formats.timestamps import elapsed, is_moment, moment

# Longest line [bytes] and most columns of a measurement.
_LONGEST, _WIDEST = 1_000_000, 10_000
_CHUNK = 1 << 20


class Text(NamedTuple):
    """A text file: bytes with uniform line ends, encoding, byte and line at which the rows start, header line."""

    data: bytes
    encoding: str
    start: int
    first: int
    header: str


def read_text(data: bytes, allowance: Allowance) -> list[Column]:
    """Read the columns of a text file; those with words have a fault, those without a name say so.

    Raises
    ------
    FileFormatError
        No text, no rows, rows that differ in length from the header, or more than allowed.
    """
    text = text_of(data, allowance)
    layout = layout_of(text.data, len(codecs.BOM_UTF8) * text.data.startswith(codecs.BOM_UTF8), text.encoding)
    if layout is None:
        return columns_below(text, _layout_of_first_line(text, allowance), allowance)
    columns = columns_below(text, layout, allowance)
    if layout.names and not any(layout.names[:3]):
        return [column for column in columns if column.name]
    return with_clock_of_counts(columns, layout)


def columns_below(text: Text, layout: Layout, allowance: Allowance) -> list[Column]:
    """Read the columns of a table whose place is known."""
    text, names, unnamed = text._replace(start=layout.start, first=layout.first), list(layout.names), ""
    if not names:
        names, unnamed = [str(k + 1) for k in range(len(cells_of(layout.row, layout.delimiter)))], _unnamed(layout)
    if len(names) > 1 and not names[-1]:
        names.pop()
    _refuse_wide(names, allowance)
    text = _with_points(text, layout.delimiter)
    allowance.take((text.data.count(b"\n", text.start) + 1) * len(names), "the number of its lines")
    columns = _at_once(text, names, layout.delimiter) or _by_rows(text, names, layout.delimiter, allowance)
    units = [*layout.units, *[""] * len(names)]
    return [
        without_groups(replace(column, unit=column.unit or unit, unnamed=unnamed))
        for column, unit in zip(columns, units, strict=False)
    ]


def _unnamed(layout: Layout) -> str:
    return (
        f"line {layout.first + 1} is '{layout.row[:60]}', but a header line with names and units is needed first, "
        "not behind a # or %; try time_s,voltage_V,displacement_um"
    )


def with_clock_of_counts(columns: list[Column], layout: Layout) -> list[Column]:
    """Return columns with the time that a header gives as a start and an increment, instead of counts.

    Oscilloscopes of Rigol write them below the names Start and Increment, into the row of units.
    """
    place = {name.lower(): k for k, name in enumerate(layout.names)}
    if not {"start", "increment"} <= place.keys() or len(layout.units) != len(layout.names) or not columns:
        return columns
    try:
        start, increment = (number_in(layout.units[place[name]]) for name in ("start", "increment"))
    except ValueError:
        return columns
    with np.errstate(all="ignore"):
        clock = Column("time", start + increment * columns[0].data, "s")
    return [
        clock,
        *(column for k, column in enumerate(columns[1:], 1) if k not in (place["start"], place["increment"])),
    ]


def _layout_of_first_line(text: Text, allowance: Allowance) -> Layout:
    """Return the layout of a table whose header is the first line."""
    delimiter = next((d for d in ";\t," if d in re.sub(r'"[^"]*"', "", text.header)), None)
    names = _names(text, delimiter, allowance)
    if all(_is_number(name.replace(",", ".") if delimiter != "," else name) for name in names):
        row = text.header.strip()
        raise FileFormatError(f"{allowance.path}: {_unnamed(Layout(0, text.first - 1, delimiter, (), (), row))}")
    return Layout(text.start, text.first, delimiter, tuple(names), (), "")


def text_of(data: bytes, allowance: Allowance) -> Text:
    """Find the header; refuse a file that is no text, or has longer lines than a table."""
    path = allowance.path
    if b"\0" in data:
        raise FileFormatError(
            f"{path}: not a text file (it holds NUL bytes); save it as UTF-8 text or correct its suffix"
        )
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    encoding, start = _encoding(data), len(codecs.BOM_UTF8) if data.startswith(codecs.BOM_UTF8) else 0
    _refuse_long_lines(data, allowance)
    number = 0
    while start < len(data):
        end = data.find(b"\n", start)
        end, begin, number = (len(data) if end < 0 else end), start, number + 1
        start, line = end + 1, data[begin:end].decode(encoding)
        if line.strip() and line.lstrip()[0] not in "#%":
            return Text(data, encoding, start, number, line)
    raise FileFormatError(f"{path}: nothing but blank and comment lines; a header line and rows are needed")


def _encoding(data: bytes) -> str:
    """Return UTF-8 if the bytes are valid; else Latin-1, in which instruments write the micro sign."""
    decoder = codecs.getincrementaldecoder("utf-8")()
    try:
        for start in range(0, len(data), _CHUNK):
            decoder.decode(data[start : start + _CHUNK], final=start + _CHUNK >= len(data))
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8"


def _refuse_long_lines(data: bytes, allowance: Allowance) -> None:
    """Search each stretch of the greatest length backwards for a line end, which takes few steps."""
    start = 0
    while len(data) - start > _LONGEST:
        end = data.rfind(b"\n", start, start + _LONGEST + 1)
        if end < 0:
            number = data.count(b"\n", 0, start) + 1
            raise FileFormatError(
                f"{allowance.path}: line {number} is longer than {_LONGEST} bytes, longer than any row of a "
                "measurement; check that this is a table with a line for each sample"
            )
        start = end + 1


def _names(text: Text, delimiter: str | None, allowance: Allowance) -> list[str]:
    header = text.header
    names = cells_of(re.sub(r"(?<!\s)\s+(?=[\[(])", "", header) if delimiter is None else header, delimiter)
    if len(names) > 1 and not names[-1]:
        names.pop()
    _refuse_wide(names, allowance)
    return names


def _refuse_wide(names: list[str], allowance: Allowance) -> None:
    if len(names) > _WIDEST:
        raise FileFormatError(
            f"{allowance.path}: the header has {len(names)} columns, at most {_WIDEST} are read; check the separator, "
            "or keep time, voltage and displacement only"
        )


def _with_points(text: Text, delimiter: str | None) -> Text:
    """Replace decimal commas by points, and % by # as the sign of a comment; in the rows only."""
    comma = delimiter in (";", "\t") and text.data.find(b",", text.start) >= 0
    percent = text.data.find(b"%", text.start) >= 0
    if not comma and not percent:
        return text
    body = text.data[text.start :]
    if comma:
        body = body.replace(b",", b".")
    return text._replace(data=re.sub(rb"(?m)^[ \t\v\f]*%", b"#", body) if percent else body, start=0)


def _at_once(text: Text, names: list[str], delimiter: str | None) -> list[Column]:
    """Read all columns at once if all cells of all rows are numbers; else return none."""
    first = next((cells for _, cells in _rows(text, delimiter)), [])
    if len(first) != len(names):
        return []
    stream = io.BytesIO(text.data)
    stream.seek(text.start)
    try:
        with warnings.catch_warnings(action="ignore"), np.errstate(all="ignore"):
            lines = io.TextIOWrapper(stream, encoding=text.encoding, newline="\n")
            data = np.loadtxt(lines, delimiter=delimiter, ndmin=2)
    except ValueError:
        return []
    if data.shape[1] != len(names) or not len(data):
        return []
    return [Column(name, column.copy()) for name, column in zip(names, data.T, strict=True)]


def _rows(text: Text, delimiter: str | None) -> Iterator[tuple[int, list[str]]]:
    """Yield line number and cells of each row, without blank lines and comments."""
    start, number, data = text.start, text.first, text.data
    while start < len(data):
        end = data.find(b"\n", start)
        end = len(data) if end < 0 else end
        line, start, number = data[start:end].decode(text.encoding), end + 1, number + 1
        if line.strip(f"{delimiter or ''} \t") and line.lstrip()[:1] not in ("#", "%"):
            yield number, cells_of(line, delimiter)


def _is_number(cell: str) -> bool:
    try:
        number_in(cell)
    except ValueError:
        return False
    return True


def _by_rows(text: Text, names: list[str], delimiter: str | None, allowance: Allowance) -> list[Column]:
    """Read row by row: slow, but it finds the line of an error and allows text columns and timestamps."""
    columns = [array("d") for _ in names]
    clocks: dict[int, list[tuple[int, float]]] = {}
    faults: dict[int, str] = {}
    empty = True
    for number, cells in _rows(text, delimiter):
        if len(cells) == len(names) + 1 and not cells[-1]:
            cells.pop()
        if len(cells) != len(names):
            raise FileFormatError(
                f"{allowance.path}: line {number} has {len(cells)} cells where the header has {len(names)}: "
                f"'{(delimiter or ' ').join(cells)[:60]}'; correct or remove that line"
            )
        if empty:
            clocks = {place: [] for place, cell in enumerate(cells) if is_moment(cell)}
        empty = False
        for place, cell in enumerate(cells):
            if place not in faults:
                try:
                    if place in clocks:
                        clocks[place].append(moment(cell))
                    else:
                        columns[place].append(number_in(cell))
                except ValueError:
                    kind = "timestamp" if place in clocks else "number"
                    faults[place] = f"line {number} holds '{shortened(cell)}', which is no {kind}"
                    columns[place] = array("d")
    if empty:
        raise FileFormatError(f"{allowance.path}: a header but no rows; export the measurement again")
    advice = "; correct or remove that row"
    return [
        Column(name, np.empty(0), fault=faults[place] + advice)
        if place in faults
        else Column(name, elapsed(clocks[place]), "s")
        if place in clocks
        else Column(name, np.array(columns[place]))
        for place, name in enumerate(names)
    ]
