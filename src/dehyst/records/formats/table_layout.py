"""Where the table of a text file begins, its separator, and the names, the units and the time step above it."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dehyst._errors import FileFormatError
from dehyst._units import FACTORS, symbol_of
from dehyst.records.formats.columns import Column, shortened
from dehyst.records.formats.notation import is_moment

# Lines that are looked at: an oscilloscope writes some 30 lines above its table.
_HEAD = 400
# The most rows of a table that belongs to the header of another one.
_FEW = 4
# With these begins a comment.
_MARKS = ("#", "%")
# What instruments write in the row of units for a column of counts.
_COUNTS = ("sequence", "samples", "sample", "index", "#", "-")
# Names above the time of the first sample and the step, in the row of units.
_CLOCK = ("start", "increment")
# The blanks before a unit in brackets.
_UNIT_BEHIND = re.compile(r"(?<!\s)\s+(?=[\[(])")
# A number in a notation that Python does not read.
_NUMBER = re.compile(r"[-+]?\d[\d.,]*(?:[eE][-+]?\d+)?")
# A value that a spreadsheet could not compute: #N/A, #DIV/0!.
_ERROR = re.compile(r"#(?:N/A|NV|[A-Z0/]+[!?])")


class Layout(NamedTuple):
    """The place of a table in a text file.

    `first`: number of lines before its first row. `delimiter`: separator of its cells, None for blanks. `names`,
    `units`: of its columns; no names if the file has none. `row`: its first row. `above`: the lines above it, of which
    `header` has the names, and the units below them.
    """

    first: int
    delimiter: str | None
    names: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    row: str = ""
    above: tuple[str, ...] = ()
    header: tuple[str, ...] = ()

    @property
    def unnamed(self) -> str:
        """Why the columns of a table have no names, and what to try."""
        return (
            f"line {self.first + 1} is '{self.row[:60]}', but a header line with names and units is needed first, "
            "not behind a # or %; try time_s,voltage_V,displacement_um"
        )


class _Line(NamedTuple):
    """A line with content, the number of lines before it, and its cells."""

    number: int
    text: str
    cells: list[str]


class _Shape(NamedTuple):
    """The usual number of cells of a row, the columns that usually are numbers, and whether the last one is empty."""

    width: int
    numeric: list[int]
    empty_end: bool

    @classmethod
    def of(cls, rows: list[list[str]]) -> _Shape:
        """Return what most of the rows look like."""
        width = Counter(map(len, rows)).most_common(1)[0][0]
        alike = [row for row in rows if len(row) == width]
        counts = [sum(not _is_word(row[k]) for row in alike) for k in range(width)]
        numeric = [k for k in range(width) if 2 * counts[k] > len(alike)]
        return cls(width, numeric, width > 1 and not any(row[-1] for row in alike))

    def fits(self, row: list[str]) -> bool:
        """Whether a line may be the first row."""
        values = [row[k] for k in self.numeric] if len(row) == self.width else []
        return any(values) and not any(cell and _is_word(cell) for cell in values)

    def names(self, row: list[str], *, words: bool = True) -> tuple[str, ...]:
        """Return the names that a line has for the columns, if it has any; `words`: no number is a name."""
        row = [*row, ""] if self.empty_end and len(row) == self.width - 1 else row
        beyond = all(cell.lower() in ("", "comment") for cell in row[self.width :])
        if len(row) < self.width or not beyond or (words and any(is_number(row[k]) for k in self.numeric)):
            return ()
        # Programs write no name above a count in the first column.
        needed = self.numeric[1:] or self.numeric
        return tuple(row[: self.width]) if all(row[k] for k in needed) else ()

    def is_row(self, row: list[str]) -> bool:
        """Whether a line above the table may be a row of it with a fault, which must not be left out."""
        if len(row) == self.width and 2 * sum(is_number(row[k]) for k in self.numeric) > len(self.numeric):
            return True
        # Also a row with another separator.
        return all(is_number(part) for cell in row for part in re.split(r"[;,\t ]+", cell) if part)


def layout_of(block: str, decimal: str | None = None) -> Layout:
    """Find the table in the first lines of a text file; `decimal`: the decimal sign that the user states.

    The table is what the later of these lines look like: the same number of cells, numbers in the same columns. It
    begins below the last line of names above the first such line: what is between is a row with a fault. Raise
    `FileFormatError` if the text has no lines with content, or if the line above the rows has fewer names than they
    have cells.
    """
    texts = [(k, text) for k, text in enumerate(block.split("\n")) if text.strip("; \t,")]
    plain = [text for _, text in texts if not text.lstrip().startswith(_MARKS)][:_HEAD]
    if not plain:
        raise FileFormatError("nothing but blank and comment lines; a header line and rows are needed")
    delimiter = _delimiter(plain, decimal)
    lines, comments = list[_Line](), list[_Line]()
    for k, text in texts:
        cells = cells_of(_UNIT_BEHIND.sub("", text) if delimiter is None else text, delimiter)
        (comments if text.lstrip().startswith(_MARKS) else lines).append(_Line(k, text, cells))
    lines = lines[:_HEAD]
    rows = [line.cells for line in lines]
    shape = _Shape.of(rows[len(rows) // 2 :])
    place = next((i for i, row in enumerate(rows) if shape.fits(row)), len(rows))
    if place == len(rows):
        # No line has numbers where others have them.
        return Layout(lines[0].number + 1, delimiter, tuple(rows[0]), header=(lines[0].text,))
    begin = 0
    for i in range(place + 2, min(place + _FEW + 2, len(rows))):
        # The rows before are metadata, as R, C and temperature with one value each.
        if shape.fits(rows[i]) and _are_names(rows[i - 1]) and rows[i - 1] not in rows[:place]:
            begin, place = place + 1, i
    named = lines[begin:place]
    if not any(shape.names(line.cells) for line in named):
        before = [line for line in comments if line.number < lines[place].number]
        named = [_commented(line, delimiter, shape.width) for line in before] or named
    heading = _beside(lines) or next(filter(None, (_heading(named[:i], shape) for i in range(len(named), 0, -1))), None)
    if heading is None:
        return _without_names(lines, place, delimiter, shape)
    over = [line for line in lines[begin:place] if line.number < heading.end and line.text not in heading.texts]
    if faulty := [line for line in over if shape.is_row(line.cells)]:
        raise FileFormatError(f"line {faulty[0].number + 1} holds numbers above the names; correct or remove it")
    rest = [line.number for line in lines if line.number >= heading.end]
    # A row that looks like a comment: #N/A,1,2.
    rest += [c.number for c in comments if c.number >= heading.end and not is_comment(c.cells, shape.width, delimiter)]
    first, written = min(rest), block.split("\n")
    above = (*written[:first], *heading.clock)
    return Layout(first, delimiter, heading.names, heading.units, written[first].strip(), above, heading.texts)


def _without_names(lines: list[_Line], place: int, delimiter: str | None, shape: _Shape) -> Layout:
    """Return the layout of a table without names; lines above it that may be rows with a fault belong to it.

    Raise `FileFormatError` if commas may be decimal signs: fewer names than cells, or a blank behind some commas only.
    """
    line, cells = lines[place], lines[place - 1].cells if place else []
    names = bool(cells) and all(map(_is_word, cells))
    mixed = ", " in line.text and re.search(r"\d,\d", line.text)
    doubtful = delimiter == "," and "." not in line.text and (mixed or (names and len(cells) < shape.width))
    if doubtful or (names and 1 < len(cells) != shape.width):
        raise FileFormatError(
            f"line {line.number + 1} is '{shortened(line.text.strip())}', {shape.width} cells, but the line above has "
            f"{len(cells)} names: commas may be decimal signs too",
            hint="state decimal=comma if they are, or correct the names",
            change=("decimal",),
        )
    while place and (len(lines[place - 1].cells) == shape.width or shape.is_row(lines[place - 1].cells)):
        place -= 1
    return Layout(lines[place].number, delimiter, row=lines[place].text.strip())


def _commented(line: _Line, delimiter: str | None, width: int) -> _Line:
    """Return a comment without its mark, unless this names a count."""
    plain = cells_of(line.text.lstrip("#% \t"), delimiter)
    signed = len(line.cells) == width != len(plain) and line.cells[0] in _MARKS
    return line if signed else line._replace(cells=plain)


def _delimiter(lines: list[str], decimal: str | None) -> str | None:
    """Return the separator that most of the later lines contain, outside of quotes; None for blanks.

    Where commas are decimal signs, as the user states, a comma with a blank separates.
    """
    later = [re.sub(r'"[^"]*"', "", text) for text in lines[len(lines) // 2 :]]
    signs = (";", "\t", ", " if decimal == "," else ",")
    found = next((sign for sign in signs if 2 * sum(sign in text for text in later) > len(later)), None)
    return "," if found is None and decimal == "," and any('","' in text for text in lines) else found


def cells_of(line: str, delimiter: str | None) -> list[str]:
    """Return the cells of a line."""
    cells = line.split(delimiter)
    if '"' in line:
        sign = delimiter[0] if delimiter else " "
        cells = next(csv.reader([line.strip(" ")], delimiter=sign, skipinitialspace=True))
    return [cell.strip() for cell in cells]


def number_in(cell: str, decimal: str = ".") -> float:
    """Return a cell's number, NaN if empty; raise ValueError for numbers of Python only: 1_000, other digits."""
    if "_" in cell or not cell.isascii() or (decimal == "," and "." in cell):
        raise ValueError(cell)
    return float(cell.replace(decimal, ".") or "nan")


def is_number(cell: str) -> bool:
    """Return whether a cell is a number, also in a notation that Python does not read; an empty one is none."""
    try:
        number_in(cell)
    except ValueError:
        return _NUMBER.fullmatch(cell) is not None
    return bool(cell)


def is_comment(cells: list[str], width: int, delimiter: str | None) -> bool:
    """Return whether a line is a comment, and no row of that width which begins as one does: #N/A,1,2 or %,1,2."""
    first, whole = cells[0], len(cells) in (width, width + (not cells[-1]))
    if not first.startswith(_MARKS) or not whole or first[1:2].isspace() or (len(first) == 1 and delimiter is None):
        return first.startswith(_MARKS)
    # A spreadsheet fills up the line of a comment with separators.
    return width > 1 and len(first) > 1 and not any(cells[1:]) and not _ERROR.fullmatch(first)


def _is_word(cell: str) -> bool:
    """Return whether a cell is neither a number nor a timestamp."""
    return not is_number(cell) and not is_moment(cell)


def _are_names(row: list[str]) -> bool:
    """Return whether the cells of a line are different names, at least one of them with its unit."""
    ends = [re.split(r"[\s,/_(\[]", cell.rstrip("])"))[-1] for cell in row]
    return all(row) and all(map(_is_word, row)) and len(set(row)) == len(row) and any(map(symbol_of, ends))


class _Heading(NamedTuple):
    """Names and units of columns, the number of lines up to their end, their texts, and the time that they state."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    end: int
    texts: tuple[str, ...] = ()
    clock: tuple[str, ...] = ()


def _heading(lines: list[_Line], shape: _Shape) -> _Heading | None:
    """Return names and units from the last one or two of these lines; None if they are no names."""
    before, last, end = lines[-2].cells if len(lines) > 1 else [], lines[-1].cells, lines[-1].number + 1
    stated = {name.lower(): cell for name, cell in zip(before, last, strict=False) if is_number(cell)}
    clock = tuple(f"x{name}\t{stated[name]}\ts" for name in _CLOCK if name in stated)
    if clock:
        before, last = ["" if name.lower() in _CLOCK else name for name in before], last[: shape.width]
    names, units = shape.names(before, words=False), [*last, *[""] * (shape.width - len(last))]
    numeric = [units[k] for k in shape.numeric]
    known = [symbol_of(cell) != "" for cell in numeric]
    # Instruments write other numbers into the row of units, in columns without numbers.
    are_units = any(known) and all(
        not cell or unit or cell.lower() in _COUNTS or (cell[0] in "[(" and not is_number(cell))
        for cell, unit in zip(numeric, known, strict=True)
    )
    if are_units and names and all(names[k] for k in shape.numeric):
        stated_units = tuple(cell.strip("[]() ") for cell in units[: shape.width])
        return _Heading(names, stated_units, end, tuple(line.text for line in lines[-2:]), clock)
    names = shape.names(last)
    return _Heading(names, (), end, (lines[-1].text,)) if names else None


def _beside(lines: list[_Line]) -> _Heading | None:
    """Return names and units if the header stands beside the rows: three cells of it, then time and value.

    Oscilloscopes of Tektronix's older series write one channel to a file in this way.
    """
    width = len(lines[0].cells)
    if lines[0].cells[0].lower() != "record length" or width < 5:
        return None
    header = {line.cells[0].lower(): line.cells[1] for line in lines if len(line.cells) == width}
    rest = ("",) * (width - 5)
    units = "", "", "", header.get("horizontal units", ""), header.get("vertical units", ""), *rest
    return _Heading(("", "", "", "TIME", header.get("source") or "CH", *rest), units, lines[0].number)


# Letters of the words for the time from one sample to the next, for samples a second, and for the first sample's time.
_WORDS = {
    "step": "xinc xincr xincrement sampleinterval samplinginterval sampleperiod timestep deltat dt horizontalinterval "
    "abtastintervall abtastzeit",
    "rate": "samplerate samplingrate samplefrequency samplingfrequency abtastrate abtastfrequenz sampling",
    "start": "xorg xorigin xzero xstart starttime horizontaloffset",
}
_KINDS = {word: kind for kind, words in _WORDS.items() for word in words.split()}
_HERTZ = {"hz": 1.0, "khz": 1e3, "mhz": 1e6, "ghz": 1e9, "s/s": 1.0, "sa/s": 1.0, "ks/s": 1e3, "ms/s": 1e6}
# Key, unit in brackets, number, and unit of a line.
_STATED = re.compile(
    r"[#%;\s\"]*([A-Za-z][A-Za-z _]*)(?:[\[(]([^\[\]()]*)[\])])?[\s\":=;,]+"
    r"([-+]?[.,]?\d(?:[\d.,]*\d)?(?:[eE][-+]?\d+)?)[\s\";,]*([^\W\d]+(?:/[^\W\d]+)?)?(?![^\s\";,]).*"
)
# The longest line that is looked at, and the relative difference of steps that state the same.
_LONGEST_LINE, _SAME = 400, 1e-6


def with_clock(columns: list[Column], lines: Sequence[str], decimal: str) -> list[Column]:
    """Return columns with the time that the `lines` above a table state, in the place of one that counts samples.

    Nothing changes if they state no step with its unit, or if a column has a time with its unit. If steps contradict
    one another, or a number can be read in two ways, the time has a fault. `decimal`: the decimal sign of the table.
    """
    if not columns or any(column.parts[1] in FACTORS["time"] for column in columns):
        return columns
    place = next((k for k, column in enumerate(columns) if _counts(column)), None)
    named = place is None and any("time" in column.quantities for column in columns)
    stated = [
        _stated(match, decimal) for line in lines if len(line) <= _LONGEST_LINE and (match := _STATED.fullmatch(line))
    ]
    steps = [value for kind, value, _ in stated if kind == "step"]
    if named or not steps:
        return columns
    rest = [column for k, column in enumerate(columns) if k != place]
    if not max(steps) - min(steps) <= _SAME * max(steps):
        words = ", ".join(text for kind, _, text in stated if kind == "step")
        fault = f"the header states the time step by {words}, which is not one number; correct it, or give rate=HZ"
        return [Column("time", np.empty(0), "s", fault), *rest]
    start = next((value for kind, value, _ in stated if kind == "start"), 0.0)
    counts = np.arange(float(columns[0].data.size)) if place is None else columns[place].data
    with np.errstate(all="ignore"):
        return [Column("time", start + steps[0] * counts, "s"), *rest]


def _counts(column: Column) -> bool:
    """Return whether a column counts samples: whole numbers that rise by one, or by more where samples are left out."""
    steps = np.diff(column.data)
    if not steps.size or column.data[0] % 1 or np.any(steps % 1) or steps.min() != 1:
        return False
    return bool(steps.max() == 1) or not (column.quantities or symbol_of(column.parts[1]))


def _stated(match: re.Match[str], decimal: str) -> tuple[str, float, str]:
    """Return what a line as "XInc, 0.01, s", "# Sample interval [ms] = 2" or "dt 0,01 s" states: "step" or "start".

    The value [s] is NaN if the number can be read in two ways. An empty kind is nothing that is known.
    """
    key, unit = re.sub(r"[^a-z]", "", match[1].lower()), match[4] or match[2] or ""
    kind, hertz, seconds = _KINDS.get(key, ""), _HERTZ.get(unit.lower(), 0.0), FACTORS["time"].get(symbol_of(unit), 0.0)
    try:
        value = number_in(match[3], decimal) if not {*match[3]} & {",", "."} - {decimal} else np.nan
    except ValueError:
        value = np.nan
    known = value > 0 or kind == "start" or np.isnan(value)
    if kind == "rate" and hertz and known:
        return "step", 1 / (hertz * value), f"'{key}' of '{match[3]}'"
    return kind if seconds and kind != "rate" and known else "", seconds * value, f"'{key}' of '{match[3]}'"
