"""The decimal sign of a text table, decided once for the whole file, and its numbers in the notation of Python.

A sign between digits is a decimal sign or groups thousands. `0,5` and `50,1234` have a decimal comma for certain, and
`1,234,567` and `1,234.5` have commas that group; `12,011` can be both. What is certain decides for the others; where
nothing is certain, two readings are possible, and the file is refused.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

from dehyst._errors import DecimalSignError, FileFormatError
from dehyst._units import symbol_of
from dehyst.records.formats.timestamps import is_moment

SIGNS = (".", ",")
# A number with groups or with a decimal comma, which Python does not read.
WRITTEN = re.compile(r"[-+]?(?:\d+(?:[.,]\d{3})+(?:[.,]\d*)?|\d+,\d*|,\d+)(?:[eE][-+]?\d+)?")
_OTHER = {".": ",", ",": "."}
_NAMES = {".": "point", ",": "comma"}
# Bytes of a cell that a message shows.
_SHOWN = 40


class Notation(NamedTuple):
    """The decimal sign of a table, whether the other sign groups digits, and whether a cell or the user shows that."""

    decimal: str = "."
    grouped: bool = False
    shown: bool = True


class Cells:
    """The cells of a table's rows: bytes, the place at which they start, their separator.

    `where`: function of a place that returns its line and column, in words. `path`: name of the file in messages.
    """

    def __init__(self, data: bytes, start: int, delimiter: str | None, where: Callable[[int], str], path: str) -> None:
        self.data, self.start, self.delimiter, self.where, self.path = data, start, delimiter, where, path
        # The last line of a file may be cut off in the middle of a number.
        self._end = data.rfind(b"\n") + 1
        if self._end <= start:
            self._end = len(data)
        # Between commas, a cell with a comma is in quotes.
        self._used = {"."} if data.find(b".", start) >= 0 else set()
        self._used |= {","} if data.find(b'"' if delimiter == "," else b",", start) >= 0 else set()

    def find(self, kind: str, sign: str) -> str:
        """Return the first cell of a kind with a sign and its place, in words; empty if there is none."""
        if sign not in self._used or (kind == "mixed" and len(self._used) < 2):
            return ""
        match = _pattern(kind, sign, self.delimiter).search(self.data, self.start, self._end)
        if match is None:
            return ""
        return f"{self.where(match.start('number'))} holds '{match['number'][:_SHOWN].decode()}'"


def notation_of(cells: Cells, given: str | None) -> Notation:
    """Return the notation of a table's numbers; `given`: the decimal sign that the user states.

    Raises
    ------
    DecimalSignError
        If the cells allow both signs.
    FileFormatError
        If there are two decimal signs, or another than the given one.
    """
    certain = {sign: cells.find("decimal", sign) or cells.find("mixed", sign) for sign in SIGNS}
    if given is not None:
        return _as_given(cells, certain, given)
    if certain["."] and certain[","]:
        raise FileFormatError(
            f"{cells.path}: {certain['.']} and {certain[',']}, need one decimal sign in a file; save it with points"
        )
    found = next((sign for sign in SIGNS if certain[sign]), None)
    if found is not None:
        other = _OTHER[found]
        grouped = bool(cells.find("mixed", found) or cells.find("groups", other))
        if not grouped and (doubtful := cells.find("doubtful", other)):
            raise FileFormatError(
                f"{cells.path}: {doubtful}, while {certain[found]} with a decimal {_NAMES[found]}",
                hint=f'if the {_NAMES[other]} groups digits there, give the decimal sign "{found}"; else save the file '
                "with one sign",
                change=("decimal",),
            )
        return Notation(found, grouped)
    return _of_groups(cells)


def _of_groups(cells: Cells) -> Notation:
    """Return the notation of a table in which no sign is a decimal sign for certain."""
    groups = {sign: cells.find("groups", sign) for sign in SIGNS}
    if groups["."] and groups[","]:
        raise FileFormatError(
            f"{cells.path}: {groups['.']} and {groups[',']}, need one sign that groups digits; save it without groups"
        )
    for sign in SIGNS:
        if groups[sign]:
            return Notation(_OTHER[sign], grouped=True)
    doubtful = {sign: cells.find("doubtful", sign) for sign in SIGNS}
    # Numbers between commas or blanks have no other decimal sign by habit.
    if not doubtful[","] and (cells.delimiter in (",", None) or not doubtful["."]):
        return Notation(shown=False)
    sign = "," if doubtful[","] else "."
    raise DecimalSignError(
        f"{cells.path}: {doubtful[sign]}, which is a number with three decimals or a thousand times as large: no cell "
        f"shows whether the {_NAMES[sign]} is the decimal sign or groups digits",
        hint=f'give "{sign}" if it is the decimal sign, "{_OTHER[sign]}" if it groups digits',
        change=("decimal",),
    )


def _as_given(cells: Cells, certain: dict[str, str], given: str) -> Notation:
    other = _OTHER[given]
    if contrary := certain[other] or cells.find("groups", given):
        raise FileFormatError(
            f'{cells.path}: got the decimal sign "{given}", but {contrary}',
            hint="leave it out, or save it with one sign",
            change=("decimal",),
        )
    return Notation(
        given, bool(cells.find("groups", other) or cells.find("mixed", given) or cells.find("doubtful", other))
    )


def pointed(cells: Cells, notation: Notation, numbers_only: bool = False) -> bytes:
    """Return the bytes from the start on, with decimal points and without groups.

    `numbers_only`: whether commas in cells that are no numbers stay.
    """
    body, other = cells.data[cells.start :], _OTHER[notation.decimal]
    if notation.grouped:
        sign = other.encode()
        body = _pattern("grouped", other, cells.delimiter).sub(
            lambda match: match["before"] + match["number"].replace(sign, b""), body
        )
    if notation.decimal == ".":
        return body
    if cells.delimiter == "," or numbers_only:
        return _pattern("any", ",", cells.delimiter).sub(
            lambda match: match["before"] + match["number"].replace(b",", b"."), body
        )
    return body.replace(b",", b".")


@cache
def _pattern(kind: str, sign: str, delimiter: str | None) -> re.Pattern[bytes]:
    """Return the pattern of a whole cell that holds a number of a kind.

    "decimal": `sign` is its only sign, and a decimal sign. "mixed": the same behind groups. "groups": `sign` occurs
    twice, so that it groups. "doubtful": once, before three digits. "grouped": it groups, with or without decimals.
    """
    s, o, power = re.escape(sign), re.escape(_OTHER[sign]), r"(?:[eE][-+]?\d+)?"
    number = {
        "decimal": (
            rf"(?:(?:(?:0\d*|\d{{4,}}){s}\d*|{s}\d+|\d+{s}(?:\d{{1,2}}|\d{{4,}})?){power}"
            rf"|\d+{s}\d{{3}}[eE][-+]?\d+)"
        ),
        "mixed": rf"[1-9]\d{{0,2}}(?:{o}\d{{3}})+{s}\d*{power}",
        "groups": rf"[1-9]\d{{0,2}}(?:{s}\d{{3}}){{2,}}",
        "doubtful": rf"[1-9]\d{{0,2}}{s}\d{{3}}",
        "grouped": rf"[1-9]\d{{0,2}}(?:{s}\d{{3}})+(?:{o}\d*{power})?",
        "any": rf"\d*{s}\d*{power}",
    }[kind]
    # Between commas, a cell with a comma is in quotes.
    quoted = delimiter == "," and (sign == "," or kind == "mixed")
    if delimiter is None:
        before, after = r'(?<![^ \t\n])"?', r'(?="?(?:[ \t]|$))'
    elif quoted:
        before, after = r'(?:^|,) *" *', r'(?= *" *(?:,|$))'
    else:
        before, after = rf'(?:^|{delimiter})[ "]*', rf'(?=[ "]*(?:{delimiter}|$))'
    return re.compile(rf"(?m)(?P<before>{before})(?P<number>[-+]?{number}){after}".encode())


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
    names: tuple[str, ...]
    units: tuple[str, ...]
    row: str


class _Line(NamedTuple):
    number: int
    begin: int
    text: str


def layout_of(data: bytes, start: int, encoding: str) -> Layout | None:
    """Find the table of a text file, whose text begins at the byte `start`; None if the first line is its header.

    The table is what the later lines of the file's head look like: the same number of cells, numbers in the same
    columns. It begins with the first such line.
    """
    lines, comments = _head(data, start, encoding)
    if len(lines) < 2:
        return None
    later = lines[len(lines) // 2 :]
    delimiter = delimiter_of([line.text for line in later])
    if delimiter == "," and _commas_are_decimal(lines, later):
        delimiter = None
    rows = [cells_of(line.text, delimiter) for line in lines]
    width, numeric = _shape(rows[len(lines) // 2 :])
    place = next((i for i, row in enumerate(rows) if _fits(row, width, numeric)), None)
    if not numeric or place is None:
        return None
    above = rows[:place]
    if not above:
        signs = [cells_of(line.text.lstrip("#% \t"), delimiter) for line in comments if line.begin < lines[0].begin]
        above = [row for row in signs if len(row) == width]
    elif place == 1 and 1 < len(above[0]) != width and not any(_is_number(cell) for cell in above[0]):
        return None
    names, units = _beside(rows) or _heading(above, rows[place:], numeric)
    if place and not names and _heading(above[:1], rows[place:], numeric)[0]:
        return None
    if any(_is_row(row, width, numeric) for row in rows[: max(place - bool(names) - bool(units), 0)]):
        return None
    line = _first_row(lines[:place], lines[place], comments, (width, numeric, delimiter))
    return Layout(line.begin, line.number - 1, delimiter, names, units, line.text.strip())


def delimiter_of(lines: list[str]) -> str | None:
    """Return the separator that most of the lines contain, outside of quotes; None for blanks."""
    bare = [re.sub(r'"[^"]*"', "", line) for line in lines]
    return next((sign for sign in ";\t," if 2 * sum(sign in line for line in bare) > len(bare)), None)


def _commas_are_decimal(lines: list[_Line], later: list[_Line]) -> bool:
    """Return whether blanks separate the numbers of a table, and commas are in them: "0,010 50,12"."""
    rows = [line.text.split() for line in later]
    if not all(_COMMA.fullmatch(cell) or (_is_number(cell) and "," not in cell) for row in rows for cell in row):
        return False
    # Two whole numbers between commas look the same as one with a decimal comma; the names above them do not.
    above = next((line.text for line in lines if not _COMMA.fullmatch(line.text.strip())), ",")
    return min(map(len, rows)) > 1 or ("," not in above and len(UNIT_BEHIND.sub("", above).split()) == 1)


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


def _shape(rows: list[list[str]]) -> tuple[int, list[int]]:
    """Return the usual number of cells, and the columns that usually are numbers."""
    widths = Counter(map(len, rows))
    width = widths.most_common(1)[0][0]
    alike = [row for row in rows if len(row) == width]
    counts = [sum(_is_value(row[k]) and bool(row[k]) for row in alike) for k in range(width)]
    return width, [k for k in range(width) if 2 * counts[k] > len(alike)]


def _fits(row: list[str], width: int, numeric: list[int]) -> bool:
    return (
        len(row) == width
        and all(_is_value(row[k]) for k in numeric)
        and any(_is_value(row[k]) and row[k] for k in numeric)
    )


def _first_row(
    above: list[_Line], first: _Line, comments: list[_Line], shape: tuple[int, list[int], str | None]
) -> _Line:
    """Return the first row, or the line between the header and it that looks like a comment but is a row: #N/A,1,2."""
    width, numeric, delimiter = shape
    for line in comments:
        row = cells_of(line.text, delimiter)
        between = (above[-1].begin if above else -1) < line.begin < first.begin
        faulty = ERROR.fullmatch(row[0]) or (above and _is_row(row, width, numeric))
        if between and len(row) == width and faulty:
            return line
    return first


def _is_row(row: list[str], width: int, numeric: list[int]) -> bool:
    """Return whether a line above the table may be a row of it with a fault, which must not be left out."""
    if len(row) == width and 2 * sum(_is_number(row[k]) for k in numeric) > len(numeric):
        return True
    return _is_number(row[0]) and 2 * sum(_is_number(cell) for cell in row) >= len(row)


def _heading(
    above: list[list[str]], rows: list[list[str]], numeric: list[int]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return names and units from the lines above the table; nothing if these are no names."""
    width = len(rows[0])
    empty_end = width > 1 and not any(row[-1] for row in rows if len(row) == width)
    fitting = [_padded(row, width, empty_end) for row in above[-2:]]
    last = fitting[-1] if fitting else None
    if last is None:
        return (), ()
    before = fitting[0] if len(fitting) > 1 else None
    if before is not None and _are_units(last, numeric) and all(before[k] for k in numeric):
        return tuple(before), tuple(cell.strip("[]() ") for cell in last)
    if any(not last[k] or _is_number(last[k]) for k in numeric):
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


def _are_units(row: list[str], numeric: list[int]) -> bool:
    """Return whether a line holds units; instruments write other numbers into it, in columns without numbers."""
    known = [k for k in numeric if symbol_of(row[k])]
    return bool(known) and all(
        not row[k] or k in known or row[k].lower() in _COUNTS or (row[k][0] in "[(" and not _is_number(row[k]))
        for k in numeric
    )


def _is_value(cell: str) -> bool:
    return not cell or _is_number(cell) or is_moment(cell)


def _is_number(cell: str) -> bool:
    try:
        number_in(cell)
    except ValueError:
        return WRITTEN.fullmatch(cell) is not None
    return bool(cell)
