"""Where the table of a text file begins, its separator, and the names, the units and the time step above it."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Callable, Sequence
from math import isfinite
from typing import NamedTuple

import numpy as np

from dehyst._errors import DecimalSignError, FileFormatError
from dehyst._units import FACTORS, symbol_of
from dehyst.records.formats.columns import Column, shortened
from dehyst.records.formats.notation import Notation, is_moment, readings

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
# A number with a decimal comma, and the blanks before a unit in brackets.
_COMMA, _UNIT_BEHIND = re.compile(r"[-+]?\d+,\d+(?:[eE][-+]?\d+)?"), re.compile(r"(?<!\s)\s+(?=[\[(])")
# A value that a spreadsheet could not compute: #N/A, #DIV/0!.
_ERROR = re.compile(r"#(?:N/A|NV|[A-Z0/]+[!?])")


class Layout(NamedTuple):
    """The place of a table in a text file.

    `first`: number of lines before its first row. `delimiter`: separator of its cells, None for blanks. `names`,
    `units`: of its columns; no names if the file has none. `row`: its first row. `above`: the lines above it, of which
    `header` has the names, and the units below them. `cut`: what separates cells, if tabs are to replace it.
    """

    first: int
    delimiter: str | None
    names: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    row: str = ""
    above: tuple[str, ...] = ()
    header: tuple[str, ...] = ()
    cut: str = ""

    @property
    def unnamed(self) -> str:
        """Why the columns of a table have no names, and what to try."""
        return (
            f"line {self.first + 1} is '{self.row[:60]}', but a header line with names and units is needed first, "
            "not behind a # or %; try time_s,voltage_V,displacement_um"
        )


class _Heading(NamedTuple):
    """Names and units of columns, the number of their lines, and the times of samples in the words of other headers."""

    names: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    lines: int = 0
    clock: tuple[str, ...] = ()


class _Line(NamedTuple):
    """A line with content, and the number of lines before it."""

    number: int
    text: str


class _Shape(NamedTuple):
    """The usual number of cells of a row, and the columns that usually are numbers."""

    width: int
    numeric: list[int]

    @classmethod
    def of(cls, rows: list[list[str]]) -> _Shape:
        """Return what most of the rows look like."""
        width = Counter(map(len, rows)).most_common(1)[0][0]
        alike = [row for row in rows if len(row) == width]
        counts = [sum(not _is_word(row[k]) for row in alike) for k in range(width)]
        return cls(width, [k for k in range(width) if 2 * counts[k] > len(alike)])

    def fits(self, row: list[str]) -> bool:
        """Whether a line may be the first row."""
        values = [row[k] for k in self.numeric] if len(row) == self.width else []
        return any(values) and not any(cell and _is_word(cell) for cell in values)

    def is_row(self, row: list[str]) -> bool:
        """Whether a line above the table may be a row of it with a fault, which must not be left out."""
        if len(row) == self.width and 2 * sum(is_number(row[k]) for k in self.numeric) > len(self.numeric):
            return True
        # Also a row with another separator.
        parts = [part for cell in row for part in re.split(r"[;,\t ]+", cell) if part]
        return (is_number(row[0]) and 2 * sum(map(is_number, row)) >= len(row)) or all(map(is_number, parts))


def layout_of(block: str) -> Layout:
    """Find the table in the first lines of a text file.

    The table is what the later of these lines look like: the same number of cells, numbers in the same columns. It
    begins with the first such line. If the lines above it are no header, it begins below the first line of the file.
    Raise `FileFormatError` if the text has no lines with content, or if its rows can be read in two ways.
    """
    found = [_Line(k, text) for k, text in enumerate(block.split("\n")) if text.strip("; \t,")]
    comments = [line for line in found if line.text.lstrip().startswith(_MARKS)]
    lines = [line for line in found if not line.text.lstrip().startswith(_MARKS)][:_HEAD]
    if not lines:
        raise FileFormatError("nothing but blank and comment lines; a header line and rows are needed")
    delimiter = _delimiter(comments, lines)
    if delimiter == ", ":
        return layout_of(block.replace(delimiter, "\t"))._replace(cut=delimiter)
    rows = [cells_of(_UNIT_BEHIND.sub("", line.text) if delimiter is None else line.text, delimiter) for line in lines]
    shape = _Shape.of(rows[len(rows) // 2 :])
    place = next((i for i, row in enumerate(rows) if shape.fits(row)), None)
    if place is None or len(lines) < 2:
        return _below_first_line(lines[0], rows[0], delimiter)
    begin = 0
    for i in range(place + 2, min(place + _FEW + 2, len(rows))):
        # The rows before are metadata, as R, C and temperature with one value each.
        if shape.fits(rows[i]) and _are_names(rows[i - 1]) and rows[i - 1] not in rows[:place]:
            units = all(map(symbol_of, rows[i - 1])) and all(map(_is_word, rows[i - 2]))
            begin, place = i - 1 - units, i
    texts, above = [line.text for line in lines[begin:place]], rows[begin:place]
    if not any(len(row) == shape.width for row in above):
        # Names in comments.
        before = [line.text for line in comments if line.number < lines[place].number]
        named = [(text, cells) for text in before if (cells := _commented(text, delimiter, shape.width))]
        texts, above = [text for text, _ in named] or texts, [cells for _, cells in named] or above
    heading = _beside(rows) or _heading(above, rows[place:], shape)
    below = any(map(shape.is_row, rows[begin : max(place - heading.lines, 0)]))
    if place and not heading.names:
        width = len(above[-1])
        words = width > 1 and all(map(_is_word, above[-1]))
        points = any("." in cell for row in rows[place:] for cell in row)
        if words and delimiter == "," and width < shape.width <= 2 * width and not points:
            raise _two_readings(lines[place], width, shape.width)
        below |= (place == 1 and words and width != shape.width) or bool(_heading(above[:1], rows[place:], shape).names)
    if below:
        return _below_first_line(lines[0], rows[0], delimiter)
    line, header = lines[place], lines[place - 1].number if place else -1
    # A row that looks like a comment, between the header and the table: #N/A,1,2.
    between = [other for other in comments if header < other.number < line.number and other.text not in texts]
    faulty = (other for other in between if not is_comment(cells_of(other.text, delimiter), shape.width, delimiter))
    line = next(faulty, line)
    top = (*block.split("\n")[: line.number], *heading.clock)
    texts = texts[len(texts) - heading.lines :]
    return Layout(line.number, delimiter, heading.names, heading.units, line.text.strip(), top, tuple(texts))


def _commented(text: str, delimiter: str | None, width: int) -> list[str]:
    """Return the cells of a comment, as many as the columns, or none; a sign of its own may name a count."""
    signed, plain = cells_of(text, delimiter), cells_of(text.lstrip("#% \t"), delimiter)
    return plain if len(plain) == width else signed if len(signed) == width and signed[0] in _MARKS else []


def _below_first_line(line: _Line, names: list[str], delimiter: str | None) -> Layout:
    """Return the layout of a table whose header is the first line with content."""
    if all(not name or is_number(name) for name in names):
        raise FileFormatError(Layout(line.number, delimiter, row=line.text.strip()).unnamed)
    return Layout(line.number + 1, delimiter, tuple(names), header=(line.text,))


def _delimiter(comments: list[_Line], lines: list[_Line]) -> str | None:
    """Return the separator that most of the later lines contain, outside of quotes; None for blanks.

    Where commas are decimal signs too, the names above the rows show what separates their cells.
    """
    later = [re.sub(r'"[^"]*"', "", line.text) for line in lines[len(lines) // 2 :]]
    delimiter = next((sign for sign in ";\t," if 2 * sum(sign in text for text in later) > len(later)), None)
    if delimiter != ",":
        return delimiter
    heads = (line.text.lstrip("#% \t") for line in reversed([*comments, *lines[: len(lines) // 2]]))
    names = next((text for text in heads if all(map(_is_word, cells_of(text, ",")))), "")
    by_comma = _Shape.of([cells_of(text, ",") for text in later]).width
    for sign, blank in ((", ", False), (None, True)):
        rows = [cells_of(text, sign) for text in later]
        width = _Shape.of(rows).width
        others = [cell for row in rows for cell in row if not _COMMA.fullmatch(cell)]
        strange = [c for c in others if "," in c or (not is_number(c) if blank else is_number(c) and "." in c)]
        if len(others) == sum(map(len, rows)) or strange or (width == 1 and not blank):
            continue
        if (names and len(cells_of(names, ",")) == by_comma) or (width == 1 and "," in names):
            return ","
        if (blank and width > 1) or (names and len(cells_of(_UNIT_BEHIND.sub("", names), sign)) == width):
            return sign
        if not blank:
            raise _two_readings(lines[-1], len(cells_of(names, sign)) * bool(names), by_comma)
    return ","


def _two_readings(line: _Line, names: int, cells: int) -> FileFormatError:
    """Return the error for rows that have more cells between commas than the header has names."""
    return FileFormatError(
        f"line {line.number + 1} is '{shortened(line.text.strip())}': {cells} cells if each comma separates two, but "
        f"the header has {f'{names} names' if names else 'no names'}, so that commas may be decimal signs too",
        hint="save it with decimal points, or with semicolons between the cells",
    )


def cells_of(line: str, delimiter: str | None) -> list[str]:
    """Return the cells of a line."""
    cells = line.split(delimiter)
    if '"' in line:
        sign = delimiter[0] if delimiter else " "
        cells = next(csv.reader([line.strip(" ")], delimiter=sign, skipinitialspace=True))
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
        return bool(readings(cell))
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


def _heading(above: list[list[str]], rows: list[list[str]], shape: _Shape) -> _Heading:
    """Return names and units from the lines above the table; nothing if these are no names."""
    width = shape.width
    empty_end = width > 1 and not any(row[-1] for row in rows if len(row) == width)

    def padded(row: list[str]) -> tuple[str, ...]:
        row = [*row, ""] if empty_end and len(row) == width - 1 else row
        beyond = all(cell.lower() in ("", "comment") for cell in row[width:])
        return tuple(row[:width]) if beyond and len(row) >= width else ()

    before, last = [[], [], *above][-2:]
    stated = {name.lower(): cell for name, cell in zip(before, last, strict=False) if is_number(cell)}
    clock = tuple(f"x{name}\t{stated[name]}\ts" for name in _CLOCK if name in stated)
    if clock:
        before, last = ["" if name.lower() in _CLOCK else name for name in before], last[:width]
    names, cells = padded(before), padded(last)
    numeric = [cells[k] for k in shape.numeric] if cells else [""]
    known = [symbol_of(cell) != "" for cell in numeric]
    # Instruments write other numbers into the row of units, in columns without numbers.
    are_units = any(known) and all(
        not cell or unit or cell.lower() in _COUNTS or (cell[0] in "[(" and not is_number(cell))
        for cell, unit in zip(numeric, known, strict=True)
    )
    if names and are_units and all(names[k] for k in shape.numeric):
        return _Heading(names, tuple(cell.strip("[]() ") for cell in cells), 2, clock)
    # Programs write no name above a count in the first column.
    unnamed = any(not cell for cell in numeric[1:] or numeric) or any(map(is_number, numeric))
    return _Heading() if unnamed else _Heading(cells, (), 1)


def _beside(rows: list[list[str]]) -> _Heading | None:
    """Return names and units if the header stands beside the rows: three cells of it, then time and value.

    Oscilloscopes of Tektronix's older series write one channel to a file in this way.
    """
    width = len(rows[0])
    if rows[0][0].lower() != "record length" or width < 5:
        return None
    header = {row[0].lower(): row[1] for row in rows if len(row) == width}
    names = ("", "", "", "TIME", header.get("source") or "CH", *[""] * (width - 5))
    return _Heading(
        names, ("", "", "", header.get("horizontal units", ""), header.get("vertical units", ""), *names[5:])
    )


# Letters of the words for the time from one sample to the next, for samples a second, and for the first sample's time.
_WORDS = {
    "step": "xinc xincr xincrement sampleinterval samplinginterval sampleperiod timestep deltat dt horizontalinterval "
    "abtastintervall abtastzeit",
    "rate": "samplerate samplingrate samplefrequency samplingfrequency abtastrate abtastfrequenz sampling",
    "start": "xorg xorigin xzero xstart starttime horizontaloffset",
}
_KINDS = {word: kind for kind, words in _WORDS.items() for word in words.split()}
_HERTZ = {"hz": 1.0, "khz": 1e3, "mhz": 1e6, "ghz": 1e9, "s/s": 1.0, "sa/s": 1.0, "ks/s": 1e3, "ms/s": 1e6}
# Key, unit in brackets, and the rest of a line; a number in it, and its unit.
_LINE = re.compile(r"[#%;\s\"]*([A-Za-z][^\[\](){}:=;,\t\"\d]*)(?:[\[(]([^\[\]()]*)[\])])?[\s\":=;,]+(.*)")
_VALUE = re.compile(
    r"(?<![^\s\";,])([-+]?[.,]?\d(?:[\d.,]*\d)?(?:[eE][-+]?\d+)?)[\s\";,]*([^\W\d]+(?:/[^\W\d]+)?)?(?![^\s\";,])"
)
# The longest line that is looked at.
_LONGEST_LINE = 400
# Relative difference of steps that state the same.
_SAME = 1e-6


class _Stated(NamedTuple):
    """What a line of the header states: a kind of `_KINDS`, a number as it is written, its unit, and words."""

    kind: str
    number: str
    unit: str
    words: str


def with_clock(
    columns: list[Column], lines: Sequence[str], delimiter: str | None, notation: Callable[[], Notation]
) -> list[Column]:
    """Return columns with the time that the `lines` above a table state, in the place of one that counts samples.

    Nothing changes if the header states no step, or if a column has a time with its unit. If steps contradict one
    another, or their decimal sign is unknown, the time has a fault. A step without a unit is taken for seconds, as a
    guess. `notation`: function that returns that of the table, for numbers that can be read in two ways.
    """
    if not columns or any(column.parts[1] in FACTORS["time"] for column in columns):
        return columns
    place = next((k for k, column in enumerate(columns) if _counts(column)), None)
    stated = [one for line in lines if len(line) <= _LONGEST_LINE for one in _stated(line, delimiter)]
    named = place is None and any("time" in column.quantities for column in columns)
    if named or not any(one.kind in ("step", "rate") for one in stated):
        return columns
    rest = [column for k, column in enumerate(columns) if k != place]
    try:
        clock = _clock(stated, notation)
    except FileFormatError as error:
        return [Column("time", np.empty(0), "s", f"{error}; or give the sample rate in Hz"), *rest]
    if clock is None:
        return columns
    step, start, guessed = clock
    counts = np.arange(float(columns[0].data.size)) if place is None else columns[place].data
    with np.errstate(all="ignore"):
        return [Column("time", start + step * counts, "s", guessed=guessed), *rest]


def _counts(column: Column) -> bool:
    """Return whether a column counts samples: whole numbers that rise by one, or by more where samples are left out."""
    steps = np.diff(column.data)
    if not steps.size or column.data[0] % 1 or np.any(steps % 1) or steps.min() != 1:
        return False
    return bool(steps.max() == 1) or not (column.quantities or symbol_of(column.parts[1]))


def _stated(line: str, delimiter: str | None) -> list[_Stated]:
    """Return what a line as "XInc, 0.01, s", "# Sample interval [ms] = 2" or "dt 0,01" states."""
    match = _LINE.fullmatch(line)
    key = re.sub(r"[^a-z]", "", match[1].lower()) if match else ""
    if match is None or key not in _KINDS:
        return []
    # Between commas, one before a zero belongs to a number: 10,000.
    rest = match[3].replace(",", " ") if delimiter == "," and not re.search(r"\d,0\d", match[3]) else match[3]
    found = []
    for number, behind in _VALUE.findall(rest):
        unit = behind or match[2] or ""
        known = not unit or unit.lower() in _HERTZ or symbol_of(unit) in FACTORS["time"]
        # The word "sampling" alone can mean anything; 12.05.2024 is no number.
        if known and readings(number) and (unit or key != "sampling"):
            found.append(_Stated(_KINDS[key], number, unit, f"'{key}' of '{number}'"))
    return found


def _clock(stated: list[_Stated], notation: Callable[[], Notation]) -> tuple[float, float, str] | None:
    """Return the step of a header, the time of its first sample [s], and what is a guess; raise FileFormatError."""
    steps: list[tuple[bool, float, str]] = []
    start = 0.0
    for kind, text, unit, words in stated:
        known = readings(text)
        sign = next(iter(known)) if len(set(known.values())) == 1 else notation().decimal if notation().shown else ""
        if not sign:
            raise DecimalSignError(f"the header states {words}, which can be read in two ways; give the decimal sign")
        factor = FACTORS["time"].get(symbol_of(unit), 0.0 if unit else 1.0)
        if kind == "start":
            start = known[sign] * factor
        elif kind == "step":
            steps.append((not unit, known[sign] * factor, words))
        elif hertz := known[sign] * _HERTZ.get(unit.lower(), 0.0 if unit else 1.0):
            steps.append((not unit, 1 / hertz, words))
    steps = [one for one in steps if isfinite(one[1]) and one[1] > 0]
    sizes = [step for _, step, _ in steps]
    if not steps:
        return None
    if max(sizes) - min(sizes) > _SAME * max(sizes):
        raise FileFormatError(f"the header states different steps: {', '.join(c[2] for c in steps)}; correct it")
    guessed, step, words = min(steps, key=lambda one: one[0])
    return step, start, f"time step of {step:g} s, from {words} in the header without a unit" * guessed
