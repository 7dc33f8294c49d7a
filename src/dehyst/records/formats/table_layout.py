"""Where the table of a text file begins, its separator, and the names and the units above it."""

from __future__ import annotations

import re
from collections import Counter
from typing import NamedTuple

import numpy as np

from dehyst._errors import FileFormatError
from dehyst._units import symbol_of
from dehyst.records.formats.column import Column, shortened
from dehyst.records.formats.notation import cells_of, is_moment, is_number

# Number of lines that are searched for a table: an oscilloscope writes some 30 lines above it.
_HEAD = 400
# The most rows of a table that belongs to the header of another one.
_FEW = 4
# A comment begins with one of these.
_MARKS = ("#", "%")
# Instruments write these words in the row of units for a column of counts.
_COUNTS = ("sequence", "samples", "sample", "index", "#", "-")
# Names above the time of the first sample and the step, in the row of units of Rigol's oscilloscopes.
_STEP, _CLOCK = "increment", ("start", "increment")
# The blanks before a unit in brackets.
_UNIT_BEHIND = re.compile(r"(?<!\s)\s+(?=[\[(])")
# A value that a spreadsheet could not compute: #N/A, #DIV/0!.
_ERROR = re.compile(r"#(?:N/A|NV|[A-Z0/]+[!?])")


class Layout(NamedTuple):
    """The place of a table in a text file.

    `first`: number of lines before its first row. `delimiter`: separator of its cells, None for blanks. `names`,
    `units`: of its columns; names are numbers if it is `unnamed`. `header`: the lines with the names and the units.
    `above`: the lines above the table, and what a row of units states of the times of samples.
    """

    first: int
    delimiter: str | None
    names: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    unnamed: bool = False
    header: tuple[str, ...] = ()
    above: tuple[str, ...] = ()


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
        return tuple(row[: self.width]) if all(row[k] for k in self.numeric[1:] or self.numeric) else ()

    def is_row(self, row: list[str]) -> bool:
        """Whether a line above the table may be a row of it with a fault, which must not be left out."""
        if len(row) == self.width and 2 * sum(is_number(row[k]) for k in self.numeric) > len(self.numeric):
            return True
        # A row with another separator counts too.
        return all(is_number(part) for cell in row for part in re.split(r"[;,\t ]+", cell) if part)


def layout_of(written: list[str], decimal: str | None = None) -> Layout:
    """Find the table in the first lines of a text file: its rows look like the later ones of these lines.

    It begins below the last line of names above the first such row: a line between them is a row with a fault. Raise
    `FileFormatError` if no line has content, or the line above the rows has fewer names than they have cells.
    """
    texts = [(k, text) for k, text in enumerate(written) if text.strip("; \t,")]
    plain = [text for _, text in texts if not text.lstrip().startswith(_MARKS)][:_HEAD]
    if not plain:
        raise FileFormatError("nothing but blank rows and comments; a header row and rows of numbers are needed")
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
        # No line has numbers in all columns in which most lines have numbers.
        return Layout(lines[0].number + 1, delimiter, tuple(rows[0]), header=(lines[0].text,))
    begin = 0
    for i in range(place + 2, min(place + _FEW + 2, len(rows))):
        # The rows before are metadata, as R, C and temperature with one value each.
        row = rows[i - 1]
        united = any(symbol_of(Column(cell, np.empty(0)).parts[1]) for cell in row)
        different = all(row) and all(map(_is_word, row)) and len(set(row)) == len(row)
        if shape.fits(rows[i]) and united and different and row not in rows[:place]:
            begin, place = place + 1, i
    named = lines[begin:place]
    if not any(shape.names(line.cells) for line in named):
        before = [line for line in comments if line.number < lines[place].number]
        named = [_commented(line, delimiter, shape.width) for line in before] or named
    heading = next(filter(None, (_heading(named[:i], shape) for i in range(len(named), 0, -1))), None)
    if heading is None:
        return _without_names(lines, place, delimiter, shape)
    over = [line for line in lines[begin:place] if line.number < heading.first and line.text not in heading.header]
    if faulty := [line for line in over if shape.is_row(line.cells)]:
        raise FileFormatError(f"row {faulty[0].number + 1} holds numbers above the names; correct or remove it")
    # A row may look like a comment: #N/A,1,2.
    filled = [line.number for line in [*lines, *comments] if not is_comment(line.cells, shape.width, delimiter)]
    first = min((number for number in filled if number >= heading.first), default=heading.first)
    above = (*written[:first], *heading.above)
    # Only the line of names ends with a separator.
    empty = not heading.names[-1] and len(heading.names) > len(cells_of(written[first].strip(), delimiter))
    names = heading.names[:-1] if empty else heading.names
    return heading._replace(first=first, delimiter=delimiter, names=names, above=above)


def _without_names(lines: list[_Line], place: int, delimiter: str | None, shape: _Shape) -> Layout:
    """Return the layout of a table without names; raise `FileFormatError` if commas may be decimal signs."""
    line, cells = lines[place], lines[place - 1].cells if place else []
    names = bool(cells) and all(map(_is_word, cells))
    mixed = ", " in line.text and re.search(r"\d,\d", line.text)
    doubtful = delimiter == "," and "." not in line.text and (mixed or (names and len(cells) < shape.width))
    if doubtful or (names and 1 < len(cells) != shape.width):
        raise FileFormatError(
            f"row {line.number + 1} is '{shortened(line.text.strip())}', {shape.width} cells, but the row above has "
            f"{len(cells)} names: commas may be decimal signs too",
            hint="state decimal=comma if they are, or correct the names",
            change=("decimal",),
        )
    while place and (len(lines[place - 1].cells) == shape.width or shape.is_row(lines[place - 1].cells)):
        place -= 1
    numbers = tuple(str(k + 1) for k in range(len(lines[place].cells)))
    return Layout(lines[place].number, delimiter, numbers, unnamed=True)


def _commented(line: _Line, delimiter: str | None, width: int) -> _Line:
    """Return a comment without its mark, unless the mark is the name of a count."""
    plain = cells_of(line.text.lstrip("#% \t"), delimiter)
    signed = len(line.cells) == width != len(plain) and line.cells[0] in _MARKS
    return line if signed else line._replace(cells=plain)


def _delimiter(lines: list[str], decimal: str | None) -> str | None:
    """Return the separator that most of the later lines contain, outside of quotes; None for blanks."""
    later = [re.sub(r'"[^"]*"', "", text) for text in lines[len(lines) // 2 :]]
    signs = (";", "\t", ", " if decimal == "," else ",")
    found = next((sign for sign in signs if 2 * sum(sign in text for text in later) > len(later)), None)
    return "," if found is None and decimal == "," and any('","' in text for text in lines) else found


def is_comment(cells: list[str], width: int, delimiter: str | None) -> bool:
    """Return whether a line is a comment; a row of that width may begin like one: #N/A,1,2 or %,1,2."""
    first, whole = cells[0], len(cells) in (width, width + (not cells[-1]))
    if not first.startswith(_MARKS) or not whole or first[1:2].isspace() or (len(first) == 1 and delimiter is None):
        return first.startswith(_MARKS)
    # A spreadsheet fills up the line of a comment with separators.
    return width > 1 and len(first) > 1 and not any(cells[1:]) and not _ERROR.fullmatch(first)


def _is_word(cell: str) -> bool:
    """Return whether a cell is neither a number nor a timestamp."""
    return not is_number(cell) and not is_moment(cell)


def _heading(lines: list[_Line], shape: _Shape) -> Layout | None:
    """Return names, units and the step from the last one or two of these lines; None if they are no names."""
    before, last, end = lines[-2].cells if len(lines) > 1 else [], lines[-1].cells, lines[-1].number + 1
    stated = {name.lower(): cell for name, cell in zip(before, last, strict=False) if is_number(cell)}
    clock = (f"x{_STEP}\t{stated[_STEP]}\ts",) if _STEP in stated else ()
    if not stated.keys().isdisjoint(_CLOCK):
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
        return Layout(end, None, names, stated_units, False, tuple(line.text for line in lines[-2:]), clock)
    names = shape.names(last)
    return Layout(end, None, names, header=(lines[-1].text,)) if names else None
