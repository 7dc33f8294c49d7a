"""Text tables: decoded in blocks, numbers read by NumPy, else row by row; the time that the lines above state."""

from __future__ import annotations

import codecs
import io
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, BinaryIO, TextIO

import numpy as np

from dehyst._errors import FileFormatError
from dehyst._types import Array
from dehyst._units import FACTORS, symbol_of
from dehyst.records.formats.column import Allowance, Column, shortened
from dehyst.records.formats.notation import (
    Blocks,
    Moment,
    cells_of,
    clock_of,
    decimal_sign,
    is_moment,
    moment,
    number_in,
)
from dehyst.records.formats.table_layout import Layout, is_comment, layout_of

# Longest line of a measurement [characters].
_LONGEST_LINE = 1_000_000
# Characters that are read at once; growth of the memory for numbers.
_BLOCK, _GROWTH = 100_000, 1.25


def _blocks(text: TextIO, whole_lines: bool, skip: int = 0) -> Iterator[tuple[int, list[str]]]:
    """Yield blocks of the lines after the first `skip` ones, each with the number of lines before it.

    `whole_lines`: leave out a last line without a line end.
    """
    text.seek(0)
    for _ in range(skip):
        text.readline()
    number = skip
    while block := text.readlines(_BLOCK):
        # A block ends after a line, which may be as long as this.
        if len(block[-1]) > _LONGEST_LINE:
            raise FileFormatError(
                f"row {number + len(block)} is longer than {_LONGEST_LINE} characters, longer than any row of a "
                "measurement; check that this is a table with a row for each sample"
            )
        if lines := block[:-1] if whole_lines and not block[-1].endswith("\n") else block:
            yield number, lines
        number += len(block)


def read_text(
    stream: BinaryIO, allowance: Allowance, decimal: str | None = None, whole_lines: bool = False
) -> list[Column]:
    """Read the columns of a text file; columns of words have a fault, columns without names are `unnamed`."""
    # Windows programs write UTF-16 as "Unicode text", instruments the micro sign in Latin-1.
    wide = stream.read(2) in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
    for encoding in ("utf-16" if wide else "utf-8-sig", "latin-1"):
        # It converts the line ends of all systems to line feeds.
        text = io.TextIOWrapper(stream, encoding)
        with suppress(UnicodeDecodeError):
            try:
                return _read(partial(_blocks, text, whole_lines), allowance, decimal or allowance.decimal)
            finally:
                text.detach()
    raise FileFormatError("no text; save it as UTF-8 text or correct its suffix")


def _read(
    blocks: Callable[..., Iterator[tuple[int, list[str]]]], allowance: Allowance, decimal: str | None
) -> list[Column]:
    """Read the columns of a text in blocks of lines."""
    head = [line.rstrip("\n") for line in next((block for _, block in blocks()), [])]
    if any("\0" in line for line in head):
        raise FileFormatError("no text (it holds NUL bytes); save it as UTF-8 text or correct its suffix")
    layout = layout_of(head, decimal)
    table = _Table(partial(blocks, layout.first), layout, decimal)
    columns = table.columns(allowance)
    # Separators without a name: an empty column, or what stands beside the table.
    columns = [column for column in columns if column.name or np.isfinite(column.data).any()]
    return _with_clock(columns, layout.above, table.decimal or ".")


class _Table:
    """The rows of a text file, read block by block.

    `count`: rows so far. `faults`, `clocks`: why a column cannot be read, and the timestamps of one that has them.
    `hole`: line of the first empty row since the last row. `headers`: lines of repeated headers.
    """

    def __init__(self, blocks: Blocks, layout: Layout, decimal: str | None) -> None:
        self.blocks, self.layout, self.delimiter = blocks, layout, layout.delimiter
        self.names, self.width = layout.names, len(layout.names)
        self.decimal = decimal or ""
        self.count, self.hole = 0, 0
        self.faults: dict[int, str] = {}
        self.clocks: dict[int, list[Moment]] = {}
        self.headers: list[int] = []

    def columns(self, allowance: Allowance) -> list[Column]:
        """Read all rows; raise FileFormatError if there are none, or if these are several tables."""
        columns = [np.empty(0) for _ in range(self.width)]
        for number, block in self.blocks():
            # Rows without any sign are the same under either one.
            self.decimal = self.decimal or decimal_sign(number, block, self.delimiter)
            numbers = self._at_once(block)
            numbers = self._by_rows(number, block) if numbers is None else numbers
            end = self.count + len(numbers)
            allowance.take(numbers.size, "the next part of its rows")
            for column, values in zip(columns, numbers.T, strict=True):
                if end > column.size:
                    # Memory grows in its place.
                    column.resize(int(_GROWTH * end), refcheck=False)
                column[self.count : end] = values
            self.count = end
        if not self.count:
            raise FileFormatError("a header but no rows; export the measurement again")
        if self.headers:
            starts = ", ".join(map(str, [self.layout.first + 1, *self.headers]))
            raise FileFormatError(
                f"{len(self.headers) + 1} tables, which begin at the rows {starts}: these are several records",
                hint="save each in a file of its own, and give all of them as records of one actuator",
            )
        for column in columns:
            column.resize(self.count, refcheck=False)
            # The record shares it.
            column.flags.writeable = False
        return [self._column(place, column) for place, column in enumerate(columns)]

    def _at_once(self, lines: list[str]) -> Array | None:
        """Read a block whose lines are all rows of numbers; return None for other blocks."""
        if self.clocks or self.hole or (self.decimal and self.decimal in (self.delimiter or "")):
            return None
        # A point beside decimal commas must not be read as one.
        rows = [line.replace(".", "'").replace(",", ".") for line in lines] if self.decimal == "," else lines
        try:
            data = np.loadtxt(rows, delimiter=self.delimiter, comments=None, ndmin=2)
        except ValueError:
            return None
        return data if data.shape == (len(rows), self.width) else None

    def _by_rows(self, before: int, lines: list[str]) -> Array:
        """Read a block row by row: slow, but it finds the line of an error and allows text columns and timestamps."""
        rows = dict(self._cells(before, lines))
        if not rows:
            return np.empty((0, self.width))
        if not self.count:
            first = next(iter(rows.values()))
            self.clocks = {place: [] for place, cell in enumerate(first) if is_moment(cell)}
        columns = enumerate(zip(*rows.values(), strict=True))
        return np.column_stack([self._parsed(place, list(rows), cells) for place, cells in columns])

    def _parsed(self, place: int, numbers: list[int], cells: Sequence[str]) -> Array:
        """Return the numbers of a column; NaN for one that has timestamps, or a fault."""
        values: list[Any] = self.clocks.get(place, [])
        is_clock = place in self.clocks
        try:
            for cell in cells if place not in self.faults else ():
                values.append(moment(cell) if is_clock else number_in(cell, self.decimal or "."))
        except ValueError:
            kind = "timestamp" if is_clock else "number with a decimal comma" if self.decimal == "," else "number"
            kind += ", nor a timestamp as 2026-03-04T12:00:00" * (not is_clock and cell.count(":") == 2)
            line = numbers[cells.index(cell)]
            self.faults[place] = f"row {line} holds '{shortened(cell)}', which is no {kind}; correct it"
        return np.full(len(cells), np.nan) if is_clock or place in self.faults else np.array(values)

    def _cells(self, before: int, lines: list[str]) -> Iterator[tuple[int, list[str]]]:
        """Yield line number and cells of each row, without comments; raise FileFormatError for a wrong length."""
        delimiter, width, count = self.delimiter, self.width, self.count
        for number, line in enumerate(lines, before + 1):
            if not line.strip(f"{delimiter or ''} \t\n"):
                if count and (width == 1 or (delimiter is not None and delimiter in line)):
                    self.hole = self.hole or number
                continue
            if line.rstrip("\n") in self.layout.header:
                if line.rstrip("\n") == self.layout.header[0]:
                    self.headers.append(number + 1)
                continue
            cells = cells_of(line, delimiter)
            if is_comment(cells, width, delimiter):
                continue
            if self.hole:
                raise FileFormatError(
                    f"row {self.hole} is empty within the table, which moves the samples behind it; fill it "
                    "in, or remove it if no sample is missing"
                )
            if len(cells) == width + 1 and not cells[-1]:
                cells.pop()
            if len(cells) != width:
                raise FileFormatError(
                    f"row {number} has {len(cells)} cells where the header has {width}: "
                    f"'{(delimiter or ' ').join(cells)[:60]}'; correct it"
                )
            count += 1
            yield number, cells

    def _column(self, place: int, data: Array) -> Column:
        """Return a column with the numbers that were read, or with the times of its timestamps."""
        fault, moments = self.faults.get(place, ""), self.clocks.get(place, [])
        stated = self.layout.units[place] if place < len(self.layout.units) else ""
        if moments and not fault:
            try:
                data = clock_of(moments)
            except ValueError as error:
                fault = str(error)
        data, began = (np.empty(0), None) if fault else (data, next(iter(moments), None))
        unit = "s" if moments else symbol_of(stated) or stated
        return Column(self.names[place], data, unit, fault, unnamed=self.layout.unnamed, began=began)


# Words, by their letters, for a sample time or a sample rate: the unit says which of the two.
_SAMPLING = re.compile(
    r"(?:sampl(?:e|ing)|abtast)(?:intervall?|period|rate|frequency|frequenz|zeit)|sampling|timestep|deltat|dt|"
    r"horizontalinterval|xinc(?:r|rement)?"
)
_HERTZ = {"hz": 1.0, "khz": 1e3, "mhz": 1e6, "ghz": 1e9, "s/s": 1.0, "sa/s": 1.0, "ks/s": 1e3, "ms/s": 1e6}
# Key, unit in brackets, number, and unit of a line.
_STATED = re.compile(
    r"[#%;\s\"]*([A-Za-z][A-Za-z _]*)(?:[\[(]([^\[\]()]*)[\])])?[\s\":=;,]+"
    r"([-+]?[.,]?\d(?:[\d.,]*\d)?(?:[eE][-+]?\d+)?)[\s\";,]*([^\W\d]+(?:/[^\W\d]+)?)?(?![^\s\";,]).*"
)
# The longest line that is searched, and the relative difference of steps that count as equal.
_LONGEST_STATED, _SAME = 400, 1e-6


def _with_clock(columns: list[Column], lines: Sequence[str], decimal: str) -> list[Column]:
    """Return columns with the time that the `lines` above a table state, in the place of one that counts samples.

    Nothing changes without a single step with its unit, or if there is a column of time.
    """
    if not columns or any(column.parts[1] in FACTORS["time"] for column in columns):
        return columns
    place = next((k for k, column in enumerate(columns) if column.is_counter), None)
    named = place is None and any("time" in column.quantities for column in columns)
    steps = [
        step
        for line in lines
        if len(line) <= _LONGEST_STATED and (match := _STATED.fullmatch(line)) and (step := _stated(match, decimal))
    ]
    if named or not steps or not max(steps) - min(steps) <= _SAME * max(steps):
        return columns
    rest = [column for k, column in enumerate(columns) if k != place]
    counts = np.arange(float(columns[0].data.size)) if place is None else columns[place].data
    with np.errstate(all="ignore"):
        return [Column("time", steps[0] * counts, "s"), *rest]


def _stated(match: re.Match[str], decimal: str) -> float | None:
    """Return the step [s] that a line states, NaN if it can be read in two ways; or None."""
    if not _SAMPLING.fullmatch(re.sub(r"[^a-z]", "", match[1].lower())):
        return None
    unit = match[4] or match[2] or ""
    hertz, seconds = _HERTZ.get(unit.lower(), 0.0), FACTORS["time"].get(symbol_of(unit), 0.0)
    try:
        value = number_in(match[3], decimal) if not {*match[3]} & {",", "."} - {decimal} else np.nan
    except ValueError:
        value = np.nan
    if value <= 0 or not (hertz or seconds):
        return None
    return 1 / (hertz * value) if hertz else seconds * value
