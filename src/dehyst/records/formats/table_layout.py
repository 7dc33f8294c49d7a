"""Where the table of a text file begins, its separator, and the names and units above it."""

from __future__ import annotations

import csv
import re
from collections import Counter
from typing import NamedTuple

from dehyst._units import symbol_of
from dehyst.records.formats.notation import WRITTEN
from dehyst.records.formats.timestamps import is_moment

# Lines, and bytes, that are looked at: an oscilloscope writes some 30 lines above its table.
_HEAD, _HEAD_BYTES = 400, 400_000
# What instruments write in the row of units for a column of counts.
_COUNTS = ("sequence", "samples", "sample", "index", "#", "-")
# A number with a decimal comma, and the blanks before a unit in brackets.
_COMMA, UNIT_BEHIND = re.compile(r"[-+]?\d+,\d+(?:[eE][-+]?\d+)?"), re.compile(r"(?<!\s)\s+(?=[\[(])")
# A value that a spreadsheet could not compute: #N/A, #DIV/0!.
ERROR = re.compile(r"#[A-Z][A-Z0-9/]*[!?]?")


class Layout(NamedTuple):
    """The place of a table in a text file.

    `start`: byte at which its first row begins. `first`: number of the line before it. `delimiter`: separator of its
    cells, None for blanks. `names`, `units`: of its columns; no names if the file has none. `row`: its first row.
    """

    start: int
    first: int
    delimiter: str | None
    names: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    row: str = ""


class _Line(NamedTuple):
    number: int
    begin: int
    text: str


class _Shape(NamedTuple):
    """The usual number of cells of a row, the columns that usually are numbers, and the separator."""

    width: int
    numeric: list[int]
    delimiter: str | None

    def fits(self, row: list[str]) -> bool:
        """Whether a line may be the first row."""
        values = [row[k] for k in self.numeric] if len(row) == self.width else []
        return any(values) and all(not cell or is_number(cell) or is_moment(cell) for cell in values)

    def is_row(self, row: list[str]) -> bool:
        """Whether a line above the table may be a row of it with a fault, which must not be left out."""
        if len(row) == self.width and 2 * sum(is_number(row[k]) for k in self.numeric) > len(self.numeric):
            return True
        return is_number(row[0]) and 2 * sum(map(is_number, row)) >= len(row)


def layout_of(data: bytes, start: int, encoding: str) -> Layout | None:
    """Find the table of a text file, whose text begins at the byte `start`; None if the first line is its header.

    The table is what the later lines of the file's head look like: the same number of cells, numbers in the same
    columns. It begins with the first such line.
    """
    lines, comments = _head(data, start, encoding)
    if len(lines) < 2:
        return None
    later = lines[len(lines) // 2 :]
    # The separator that most of the lines contain, outside of quotes; None for blanks.
    bare = [re.sub(r'"[^"]*"', "", line.text) for line in later]
    delimiter = next((sign for sign in ";\t," if 2 * sum(sign in line for line in bare) > len(bare)), None)
    if delimiter == "," and _commas_are_decimal(lines, later):
        delimiter = None
    rows = [cells_of(line.text, delimiter) for line in lines]
    width = Counter(len(row) for row in rows[len(lines) // 2 :]).most_common(1)[0][0]
    alike = [row for row in rows[len(lines) // 2 :] if len(row) == width]
    counts = [sum(is_number(row[k]) or is_moment(row[k]) for row in alike) for k in range(width)]
    shape = _Shape(width, [k for k in range(width) if 2 * counts[k] > len(alike)], delimiter)
    place = next((i for i, row in enumerate(rows) if shape.fits(row)), None)
    if place is None:
        return None
    above = rows[:place]
    if not above:
        signs = [cells_of(line.text.lstrip("#% \t"), delimiter) for line in comments if line.begin < lines[0].begin]
        above = [row for row in signs if len(row) == width]
    elif place == 1 and 1 < len(above[0]) != width and not any(map(is_number, above[0])):
        return None
    names, units = _beside(rows) or _heading(above, rows[place:], shape)
    if place and not names and _heading(above[:1], rows[place:], shape)[0]:
        return None
    if any(map(shape.is_row, rows[: max(place - bool(names) - bool(units), 0)])):
        return None
    line, header = lines[place], lines[place - 1].begin if place else -1
    for comment in comments:
        # A row that looks like a comment, between the header and the table: #N/A,1,2.
        row = cells_of(comment.text, delimiter)
        faulty = ERROR.fullmatch(row[0]) or (place and shape.is_row(row))
        if header < comment.begin < line.begin and len(row) == width and faulty:
            line = comment
            break
    return Layout(line.begin, line.number - 1, delimiter, names, units, line.text.strip())


def _commas_are_decimal(lines: list[_Line], later: list[_Line]) -> bool:
    """Return whether blanks separate the numbers of a table, and commas are in them: "0,010 50,12"."""
    rows = [line.text.split() for line in later]
    if not all(_COMMA.fullmatch(cell) or (is_number(cell) and "," not in cell) for row in rows for cell in row):
        return False
    # Two whole numbers between commas look the same as one with a decimal comma; the names above them do not.
    above = next((line.text for line in lines if not _COMMA.fullmatch(line.text.strip())), ",")
    return min(map(len, rows)) > 1 or ("," not in above and len(UNIT_BEHIND.sub("", above).split()) == 1)


def cells_of(line: str, delimiter: str | None) -> list[str]:
    """Return the cells of a line."""
    cells = line.split(delimiter)
    if '"' in line:
        cells = next(csv.reader([line.strip(" ")], delimiter=delimiter or " ", skipinitialspace=True))
    return [cell.strip() for cell in cells]


def number_in(cell: str) -> float:
    """Return a cell's number, NaN if empty; raise ValueError for numbers of Python only: 1_000, other digits."""
    if "_" in cell or not cell.isascii():
        raise ValueError(cell)
    return float(cell or "nan")


def is_number(cell: str) -> bool:
    """Return whether a cell is a number, also in a notation that Python does not read; an empty one is none."""
    try:
        number_in(cell)
    except ValueError:
        return WRITTEN.fullmatch(cell) is not None
    return bool(cell)


def _head(data: bytes, start: int, encoding: str) -> tuple[list[_Line], list[_Line]]:
    """Return the first lines with content, and the comments among them; a line that is cut off is left out."""
    lines: list[_Line] = []
    comments: list[_Line] = []
    number, stop = 0, min(len(data), start + _HEAD_BYTES)
    while start < stop and len(lines) < _HEAD:
        end = data.find(b"\n", start)
        end = len(data) if end < 0 else end
        number, text = number + 1, data[start:end].decode(encoding)
        if text.strip("; \t,"):
            (comments if text.lstrip()[0] in "#%" else lines).append(_Line(number, start, text))
        start = end + 1
    return lines, comments


def _heading(above: list[list[str]], rows: list[list[str]], shape: _Shape) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return names and units from the lines above the table; nothing if these are no names."""
    width = len(rows[0])
    empty_end = width > 1 and not any(row[-1] for row in rows if len(row) == width)

    def padded(row: list[str]) -> list[str] | None:
        if len(row) == width + 1 and row[-1].lower() in ("", "comment"):
            return row[:-1]
        if len(row) == width - 1 and empty_end:
            return [*row, ""]
        return row if len(row) == width else None

    before, last = [None, None, *map(padded, above[-2:])][-2:]
    if last is None:
        return (), ()
    cells = [last[k] for k in shape.numeric]
    known = [symbol_of(cell) != "" for cell in cells]
    # Instruments write other numbers into the row of units, in columns without numbers.
    are_units = any(known) and all(
        not cell or unit or cell.lower() in _COUNTS or (cell[0] in "[(" and not is_number(cell))
        for cell, unit in zip(cells, known, strict=True)
    )
    if before is not None and are_units and all(before[k] for k in shape.numeric):
        return tuple(before), tuple(cell.strip("[]() ") for cell in last)
    if any(not cell or is_number(cell) for cell in cells):
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
