"""Where the table of a text file begins: its first row, its separator, and the lines of names and units above it."""

from __future__ import annotations

import csv
import re
from collections import Counter
from typing import NamedTuple

from dehyst.records.formats.timestamps import is_moment
from dehyst.records.formats.units import symbol_of

# Lines, and bytes, that are looked at: an oscilloscope writes some 30 lines above its table.
_HEAD, _HEAD_BYTES = 400, 400_000
# What instruments write in the row of units for a column of counts.
_COUNTS = ("sequence", "samples", "sample", "index", "#", "-")


class Layout(NamedTuple):
    """The place of a table in a text file.

    `start`: byte at which its first row begins. `first`: number of the line before it. `delimiter`: separator of its
    cells, None for blanks. `names`, `units`: of its columns; no names if the file has none. `row`: its first row.
    """

    start: int
    first: int
    delimiter: str | None
    names: tuple[str, ...]
    units: tuple[str, ...]
    row: str


class _Line(NamedTuple):
    number: int
    begin: int
    text: str


def layout_of(data: bytes, start: int, encoding: str) -> Layout | None:
    """Find the table of a text file, whose text begins at the byte `start`; None if the first line is its header.

    The table is what the later lines of the file's head look like: so many cells, numbers in the same columns. It
    begins with the first such line.
    """
    lines, comments = _head(data, start, encoding)
    if len(lines) < 2:
        return None
    later = lines[len(lines) // 2 :]
    delimiter = delimiter_of([line.text for line in later])
    rows = [cells_of(line.text, delimiter) for line in lines]
    width, numeric = _shape(rows[len(lines) // 2 :], delimiter)
    place = next((i for i, row in enumerate(rows) if _fits(row, width, numeric, delimiter)), None)
    if not numeric or place is None:
        return None
    above = rows[:place]
    if not above:
        signs = [cells_of(line.text.lstrip("#% \t"), delimiter) for line in comments if line.begin < lines[0].begin]
        above = [row for row in signs if len(row) == width]
    elif place == 1 and 1 < len(above[0]) != width and not any(_is_number(cell, delimiter) for cell in above[0]):
        return None
    names, units = _beside(rows) or _heading(above, rows[place:], numeric, delimiter)
    if place and not names and _heading(above[:1], rows[place:], numeric, delimiter)[0]:
        return None
    if any(_is_row(row, width, numeric, delimiter) for row in rows[: max(place - bool(names) - bool(units), 0)]):
        return None
    line = lines[place]
    return Layout(line.begin, line.number - 1, delimiter, names, units, line.text.strip())


def delimiter_of(lines: list[str]) -> str | None:
    """Return the separator that most of the lines contain, outside of quotes; None for blanks."""
    bare = [re.sub(r'"[^"]*"', "", line) for line in lines]
    return next((sign for sign in ";\t," if 2 * sum(sign in line for line in bare) > len(bare)), None)


def cells_of(line: str, delimiter: str | None) -> list[str]:
    """Return the cells of a line."""
    if '"' not in line:
        return [cell.strip() for cell in line.split(delimiter)]
    return [
        cell.strip() for cell in next(csv.reader([line.strip(" ")], delimiter=delimiter or " ", skipinitialspace=True))
    ]


def number_in(cell: str) -> float:
    """Return a cell's number, NaN if empty; raise ValueError for numbers of Python only: 1_000, other digits."""
    if "_" in cell or not cell.isascii():
        raise ValueError(cell)
    return float(cell or "nan")


def _head(data: bytes, start: int, encoding: str) -> tuple[list[_Line], list[_Line]]:
    """Return the first lines with content, and the comments among them; a line that is cut off is left out."""
    lines: list[_Line] = []
    comments: list[_Line] = []
    number, stop = 0, start + _HEAD_BYTES
    while start < min(len(data), stop) and len(lines) < _HEAD:
        end = data.find(b"\n", start)
        end = len(data) if end < 0 else end
        number, text = number + 1, data[start:end].decode(encoding)
        if text.strip("; \t,"):
            (comments if text.lstrip()[0] in "#%" else lines).append(_Line(number, start, text))
        start = end + 1
    return lines, comments


def _shape(rows: list[list[str]], delimiter: str | None) -> tuple[int, list[int]]:
    """Return the usual number of cells, and the columns that usually are numbers."""
    widths = Counter(map(len, rows))
    width = widths.most_common(1)[0][0]
    alike = [row for row in rows if len(row) == width]
    counts = [sum(_is_value(row[k], delimiter) and bool(row[k]) for row in alike) for k in range(width)]
    return width, [k for k in range(width) if 2 * counts[k] > len(alike)]


def _fits(row: list[str], width: int, numeric: list[int], delimiter: str | None) -> bool:
    return (
        len(row) == width
        and all(_is_value(row[k], delimiter) for k in numeric)
        and any(_is_value(row[k], delimiter) and row[k] for k in numeric)
    )


def _is_row(row: list[str], width: int, numeric: list[int], delimiter: str | None) -> bool:
    """Return whether a line above the table may be a row of it with a fault, which must not be left out."""
    if len(row) == width and 2 * sum(_is_number(row[k], delimiter) for k in numeric) > len(numeric):
        return True
    return _is_number(row[0], delimiter) and 2 * sum(_is_number(cell, delimiter) for cell in row) >= len(row)


def _heading(
    above: list[list[str]], rows: list[list[str]], numeric: list[int], delimiter: str | None
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return names and units from the lines above the table; nothing if these are no names."""
    width = len(rows[0])
    empty_end = width > 1 and not any(row[-1] for row in rows if len(row) == width)
    fitting = [_padded(row, width, empty_end) for row in above[-2:]]
    last = fitting[-1] if fitting else None
    if last is None:
        return (), ()
    before = fitting[0] if len(fitting) > 1 else None
    if before is not None and _are_units(last, numeric, delimiter) and all(before[k] for k in numeric):
        return tuple(before), tuple(cell.strip("[]() ") for cell in last)
    if any(not last[k] or _is_number(last[k], delimiter) for k in numeric):
        return (), ()
    return tuple(last), ()


def _beside(rows: list[list[str]]) -> tuple[tuple[str, ...], tuple[str, ...]] | None:
    """Return names and units if the header stands beside the rows: three cells of it, then time and value.

    Oscilloscopes of Tektronix's older series write one channel to a file in this way.
    """
    width = len(rows[0])
    if rows[0][0].lower() != "record length" or width < 5:
        return None
    header = {row[0].lower(): row[1] for row in rows if len(row) == width}
    names = ("", "", "", "TIME", header.get("source") or "CH", *[""] * (width - 5))
    return names, ("", "", "", header.get("horizontal units", ""), header.get("vertical units", ""), *names[5:])


def _padded(row: list[str], width: int, empty_end: bool) -> list[str] | None:
    """Return a line with the cells of a row, None if it has another number."""
    if len(row) == width + 1 and row[-1].lower() in ("", "comment"):
        return row[:-1]
    if len(row) == width - 1 and empty_end:
        return [*row, ""]
    return row if len(row) == width else None


def _are_units(row: list[str], numeric: list[int], delimiter: str | None) -> bool:
    """Return whether a line holds units; instruments write other numbers into it, in columns without numbers."""
    known = [k for k in numeric if symbol_of(row[k])]
    return bool(known) and all(
        not row[k]
        or k in known
        or row[k].lower() in _COUNTS
        or (row[k][0] in "[(" and not _is_number(row[k], delimiter))
        for k in numeric
    )


def _is_value(cell: str, delimiter: str | None) -> bool:
    return not cell or _is_number(cell, delimiter) or is_moment(cell)


def _is_number(cell: str, delimiter: str | None) -> bool:
    try:
        number_in(cell.replace(",", ".") if delimiter in (";", "\t") else cell)
    except ValueError:
        return False
    return bool(cell)
