"""Text tables: decoded, their rows read at once or one by one, and the sampling that lines above the table state."""

from __future__ import annotations

import codecs
import io
import re
import warnings
from array import array
from collections.abc import Iterator
from dataclasses import replace
from math import isfinite
from typing import NamedTuple

import numpy as np

from dehyst._errors import DecimalSignError, FileFormatError
from dehyst._units import FACTORS, symbol_of
from dehyst.records.formats.columns import Column, shortened, without_groups
from dehyst.records.formats.file_content import Allowance
from dehyst.records.formats.notation import Cells, Notation, notation_of, pointed
from dehyst.records.formats.table_layout import ERROR, UNIT_BEHIND, Layout, cells_of, layout_of, number_in
from dehyst.records.formats.timestamps import Moment, clock_of, is_moment, moment

# Longest line [bytes] and most columns of a measurement.
_LONGEST_LINE, WIDEST = 1_000_000, 10_000
_CHUNK = 1 << 20
# Bytes by which an encoding is recognised.
_HEAD = 4096
_COMMENT = re.compile(rb"(?m)^[ \t\v\f]*[#%].*")
# A sign of a comment within a cell: 2#3.
_GLUED = re.compile(rb"[^\s#]#")
# An empty line that is not the last: in a table of one column, a missing number.
_HOLE = re.compile(rb"\n[ \t]*\n[ \t]*[^\s]")


def as_utf8(data: bytes) -> bytes:
    """Return text in UTF-16, which Windows programs write as "Unicode text", in UTF-8; other bytes as they are."""
    head, encoding = data[:_HEAD], ""
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        encoding = "utf-16"
    elif b"\0" in head:
        # Latin letters and digits leave every second byte 0.
        big, little = (part.count(0) / max(len(part), 1) for part in (head[::2], head[1::2]))
        encoding = "utf-16-be" if big > 0.8 and not little else "utf-16-le" if little > 0.8 and not big else ""
    try:
        return data.decode(encoding).encode() if encoding else data
    except UnicodeError:
        return data


class Text(NamedTuple):
    """A text file: bytes with uniform line ends, encoding, byte and line at which the rows start, header line."""

    data: bytes
    encoding: str
    start: int
    first: int
    header: str


def text_of(data: bytes) -> Text:
    """Find the header; raise FileFormatError for a file that is not text, or has too long lines for a table."""
    if b"\0" in data:
        raise FileFormatError("not a text file (it holds NUL bytes); save it as UTF-8 text or correct its suffix")
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    encoding, decoder = "utf-8", codecs.getincrementaldecoder("utf-8")()
    try:
        for start in range(0, len(data), _CHUNK):
            decoder.decode(data[start : start + _CHUNK], final=start + _CHUNK >= len(data))
    except UnicodeDecodeError:
        # Instruments write the micro sign so.
        encoding = "latin-1"
    start = 0
    # Each stretch of the greatest length is searched backwards for a line end, which takes few steps.
    while len(data) - start > _LONGEST_LINE:
        end = data.rfind(b"\n", start, start + _LONGEST_LINE + 1)
        if end < 0:
            number = data.count(b"\n", 0, start) + 1
            raise FileFormatError(
                f"line {number} is longer than {_LONGEST_LINE} bytes, longer than any row of a measurement; check that "
                "this is a table with a line for each sample"
            )
        start = end + 1
    start, number = _begin(data), 0
    while start < len(data):
        end = data.find(b"\n", start)
        end, begin, number = (len(data) if end < 0 else end), start, number + 1
        start, line = end + 1, data[begin:end].decode(encoding)
        if line.strip() and line.lstrip()[0] not in "#%":
            return Text(data, encoding, start, number, line)
    raise FileFormatError("nothing but blank and comment lines; a header line and rows are needed")


def _begin(data: bytes) -> int:
    return len(codecs.BOM_UTF8) * data.startswith(codecs.BOM_UTF8)


def read_text(data: bytes, allowance: Allowance, decimal: str | None = None) -> list[Column]:
    """Read the columns of a text file; those with words have a fault, those without a name say so.

    `decimal`: the decimal sign; by default from the allowance, or as the file shows. Raise
    `FileFormatError` for no text, no rows, rows that differ in length from the header, or more than allowed.
    """
    text = text_of(data)
    layout = layout_of(text.data, _begin(text.data), text.encoding)
    if layout is None:
        return TextTable.of(text, _layout_of_first_line(text)).columns(allowance, decimal)
    table = TextTable.of(text, layout)
    columns = table.columns(allowance, decimal)
    if layout.names and not any(layout.names[:3]):
        return [column for column in columns if column.name]
    columns = _with_clock_of_counts(columns, layout)
    above = text.data[max(layout.start - _CHUNK, 0) : layout.start].decode(text.encoding, errors="replace")
    return _with_clock_of_header(columns, above, table, decimal or allowance.decimal)


def _layout_of_first_line(text: Text) -> Layout:
    """Return the layout of a table whose header is the first line."""
    delimiter = next((d for d in ";\t," if d in re.sub(r'"[^"]*"', "", text.header)), None)
    names = cells_of(UNIT_BEHIND.sub("", text.header) if delimiter is None else text.header, delimiter)
    if len(names) > 1 and not names[-1]:
        names.pop()
    try:
        for name in names:
            number_in(name if delimiter == "," else name.replace(",", "."))
    except ValueError:
        return Layout(text.start, text.first, delimiter, tuple(names))
    raise FileFormatError(_unnamed(Layout(0, text.first - 1, delimiter, row=text.header.strip())))


def _unnamed(layout: Layout) -> str:
    return (
        f"line {layout.first + 1} is '{layout.row[:60]}', but a header line with names and units is needed first, "
        "not behind a # or %; try time_s,voltage_V,displacement_um"
    )


class TextTable(NamedTuple):
    """The rows of a text file, and the names and known properties of their columns.

    `start`, `first`: byte at which they begin, and number of the line before. `delimiter`: separator, None for blanks.
    `units`: as the file states them. `unnamed`: why the names are numbers, if the file has none.
    """

    data: bytes
    encoding: str
    start: int
    first: int
    delimiter: str | None
    names: list[str]
    units: tuple[str, ...]
    unnamed: str

    @classmethod
    def of(cls, text: Text, layout: Layout) -> TextTable:
        """Return the table of a text whose place is known; raise FileFormatError for more columns than any has."""
        names, unnamed = list(layout.names), ""
        if not names:
            count = len(cells_of(layout.row, layout.delimiter))
            names, unnamed = [str(k + 1) for k in range(count)], _unnamed(layout)
        if len(names) > 1 and not names[-1]:
            names.pop()
        if len(names) > WIDEST:
            raise FileFormatError(
                f"the header has {len(names)} columns, at most {WIDEST} are read; check the separator, or keep time, "
                "voltage and displacement only"
            )
        units = (*layout.units, *[""] * len(names))[: len(names)]
        return cls(text.data, text.encoding, layout.start, layout.first, layout.delimiter, names, units, unnamed)

    def columns(self, allowance: Allowance, decimal: str | None = None) -> list[Column]:
        """Read the columns, see `read_text`."""
        cells = self.cells()
        notation, table = notation_of(cells, decimal or allowance.decimal), self
        if notation.decimal != "." or notation.grouped:
            table = self._replace(data=pointed(cells, notation), start=0)
        allowance.take((table.data.count(b"\n", table.start) + 1) * len(self.names), "the number of its lines")
        return [
            without_groups(replace(column, unit=column.unit or symbol_of(unit) or unit, unnamed=self.unnamed, ends=end))
            for column, unit, end in zip(table._at_once() or table._by_rows(), self.units, self._ends(), strict=True)
        ]

    def cells(self) -> Cells:
        """Return the cells of the rows."""

        def where(place: int) -> str:
            begin = self.data.rfind(b"\n", 0, place) + 1
            number = self.first + self.data.count(b"\n", self.start, place) + 1
            column = len(cells_of(self.data[begin:place].decode(self.encoding).strip(" ") + "0", self.delimiter)) - 1
            return f"line {number}, column '{shortened(self.names[min(column, len(self.names) - 1)])}'"

        return Cells(self.data, self.start, self.delimiter, where)

    def _ends(self) -> list[tuple[str, str]]:
        """Return the first and the last cell of each column as the file has them; none for rows of other lengths."""
        count = len(self.names)
        rows = [next(self._rows(), None)]
        stop = len(self.data.rstrip())
        while stop > self.start and len(rows) < 2:
            begin = self.data.rfind(b"\n", self.start, stop) + 1 or self.start
            last = next(self._replace(data=self.data[begin:stop], start=0)._rows(), None)
            rows = [row for row in (*rows, last) if row]
            stop = begin - 1
        cells = [row[1][:count] for row in rows if row and len(row[1]) >= count]
        return list(zip(*cells, strict=True)) if len(cells) == 2 else [("", "")] * count

    def _rows(self) -> Iterator[tuple[int, list[str]]]:
        """Yield line number and cells of each row, without comments; an empty row has no cells."""
        start, number, data, delimiter = self.start, self.first, self.data, self.delimiter
        while start < len(data):
            end = data.find(b"\n", start)
            end = len(data) if end < 0 else end
            line, start, number = data[start:end].decode(self.encoding), end + 1, number + 1
            if not line.strip(f"{delimiter or ''} \t"):
                if len(self.names) == 1 or (delimiter is not None and delimiter in line):
                    yield number, []
            elif line.lstrip()[:1] not in ("#", "%") or self._is_row(line):
                yield number, cells_of(line, delimiter)

    def _is_row(self, comment: str) -> bool:
        """Return whether a line that begins as a comment does has as many cells as a row: #N/A,1,2 or %,1,2."""
        bare, width = comment.strip(" "), len(self.names)
        if self.delimiter is None or width == 1:
            return len(bare.split()) == width and bare[1:2].strip() != ""
        first, _, rest = bare.partition(self.delimiter)
        # A spreadsheet fills up the line of a comment with separators.
        filled = rest.strip(f"{self.delimiter} ") or len(first) == 1 or ERROR.fullmatch(first.strip())
        return bool(filled) and bare.count(self.delimiter) in (width - 1, width - 1 + bare.endswith(self.delimiter))

    def _at_once(self) -> list[Column]:
        """Read all columns at once if all cells of all rows are numbers; else return none."""
        first = next((cells for _, cells in self._rows()), [])
        if len(first) != len(self.names) or (len(self.names) == 1 and _HOLE.search(self.data, self.start)):
            return []
        comments = (match[0].decode(self.encoding) for match in _COMMENT.finditer(self.data, self.start))
        if any(map(self._is_row, comments)) or _GLUED.search(self.data, self.start):
            return []
        percent = self.data.find(b"%", self.start) >= 0
        stream = io.BytesIO(re.sub(rb"(?m)^[ \t\v\f]*%", b"#", self.data[self.start :]) if percent else self.data)
        stream.seek(0 if percent else self.start)
        try:
            with warnings.catch_warnings(action="ignore"), np.errstate(all="ignore"):
                lines = io.TextIOWrapper(stream, encoding=self.encoding, newline="\n")
                data = np.loadtxt(lines, delimiter=self.delimiter, ndmin=2)
        except ValueError:
            return []
        if data.shape[1] != len(self.names) or not len(data):
            return []
        return [Column(name, column.copy()) for name, column in zip(self.names, data.T, strict=True)]

    def _by_rows(self) -> list[Column]:
        """Read row by row: slow, but it finds the line of an error and allows text columns and timestamps."""
        columns = [array("d") for _ in self.names]
        clocks: dict[int, list[Moment]] = {}
        faults: dict[int, str] = {}
        empty = True
        for number, cells in self._whole_rows():
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
                        faults[place] = (
                            f"line {number} holds '{shortened(cell)}', which is no {kind}; correct or remove that row"
                        )
                        columns[place] = array("d")
        if empty:
            raise FileFormatError("a header but no rows; export the measurement again")
        found = []
        for place, name in enumerate(self.names):
            column = Column(name, np.array(columns[place]), "s" if place in clocks else "", faults.get(place, ""))
            if place in clocks and place not in faults:
                try:
                    clock = clock_of(clocks[place])
                    column = replace(column, data=clock.seconds, began=clock.began)
                except ValueError as error:
                    column = replace(column, fault=str(error))
            found.append(column)
        return found

    def _whole_rows(self) -> Iterator[tuple[int, list[str]]]:
        """Yield line number and cells of each row; raise FileFormatError for rows that differ from the header."""
        empty, hole = True, 0
        for number, cells in self._rows():
            if not cells:
                hole = hole or (0 if empty else number)
                continue
            if hole:
                raise FileFormatError(
                    f"line {hole} is an empty row within the table, which moves the samples behind it; fill it in, or "
                    "remove it if no sample is missing"
                )
            if len(cells) == len(self.names) + 1 and not cells[-1]:
                cells.pop()
            if len(cells) != len(self.names):
                raise FileFormatError(
                    f"line {number} has {len(cells)} cells where the header has {len(self.names)}: "
                    f"'{(self.delimiter or ' ').join(cells)[:60]}'; correct or remove that line"
                )
            empty = False
            yield number, cells


def _with_clock_of_counts(columns: list[Column], layout: Layout) -> list[Column]:
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
    rest = enumerate(columns[1:], 1)
    return [clock, *(column for k, column in rest if k not in (place["start"], place["increment"]))]


# Letters of the words for the time from one sample to the next, for samples a second, for the time of the first sample,
# and for the unit of times.
_KINDS = {
    word: kind
    for kind, words in {
        "step": "xinc xincr xincrement sampleinterval samplinginterval sampleperiod samplingperiod timestep "
        "tinc deltat timeincrement deltax dt hincrement horizontalinterval abtastintervall abtastzeit "
        "abtastperiode zeitschritt",
        "rate": "samplerate samplingrate samplefrequency samplingfrequency samplespersecond abtastrate abtastfrequenz",
        "start": "xorg xorigin xzero xstart starttime firsttime horizontaloffset",
        "unit": "xunit xunits horizontalunit horizontalunits timeunit timeunits zeiteinheit",
    }.items()
    for word in words.split()
}
_HERTZ = {"hz": 1.0, "khz": 1e3, "mhz": 1e6, "ghz": 1e9, "s/s": 1.0, "sa/s": 1.0, "ks/s": 1e3, "ms/s": 1e6}
_NUMBER = r"[-+]?(?:\d{1,3}(?:[.,]\d{3})+(?:[.,]\d*)?|\d+[.,]?\d*|[.,]\d+)(?:[eE][-+]?\d+)?"
# A number with three decimals, or with a group of digits; and one that a comma between cells cuts into 10 and 000.
_DOUBTFUL = re.compile(r"[-+]?[1-9]\d{0,2}[.,]\d{3}")
_CUT = re.compile(r"\d,0\d")
_VALUE = re.compile(rf"\s*({_NUMBER})\s*([^\W\d]+(?:/[^\W\d]+)?)?\s*")
# Key, unit in brackets, and the rest of a line.
_LINE = re.compile(r"[#%\s\"]*([A-Za-z][^\[\](){}:=;,\t\"\d]*)(?:[\[(]([^\[\]()]*)[\])])?[\s\":=;,]+(.*)")
# Lines above a table that are looked at, and the longest of them.
_LINES, _LONGEST = 400, 400
# Relative difference of steps that state the same.
_SAME = 1e-6


class _Entry(NamedTuple):
    """A line of the header: its key, the unit behind it, and the cells after it."""

    key: str
    unit: str
    cells: list[str]

    @property
    def kind(self) -> str:
        """What it states: a step, a rate, a start or a unit."""
        return _KINDS[self.key]

    @property
    def numbers(self) -> list[tuple[str, str]]:
        """Each number as it is written, with its unit: beside it, in the next cell, or behind the key."""
        found = []
        for cell, after in zip(self.cells, [*self.cells[1:], ""], strict=True):
            if match := _VALUE.fullmatch(cell):
                beside = match[2] or (after if symbol_of(after) or after.lower() in _HERTZ else "")
                found.append((match[1], beside or self.unit))
        return found


def _with_clock_of_header(columns: list[Column], header: str, table: TextTable, decimal: str | None) -> list[Column]:
    """Return columns with the time that the lines above a table state, in the place of one that counts samples.

    Nothing changes if the header states no step, or if a column has a time with its unit. If steps contradict one
    another, or their decimal sign is unknown, the time has a fault. A step without a unit is taken for seconds, as a
    guess. `decimal`: the decimal sign that the user states.
    """
    if not columns or any(column.parts[1] in FACTORS["time"] for column in columns):
        return columns
    place = next((k for k, column in enumerate(columns) if _counts(column)), None)
    lines = [line for line in header.split("\n")[-_LINES:] if len(line) <= _LONGEST]
    entries = [entry for line in lines if (entry := _entry(line, table.delimiter))]
    named = place is None and any("time" in column.quantities for column in columns)
    if named or not any(entry.kind in ("step", "rate") for entry in entries):
        return columns
    rest = [column for k, column in enumerate(columns) if k != place]
    try:
        clocks, start = _stated(entries, _floats(entries, table, decimal))
    except FileFormatError as error:
        return [Column("time", np.empty(0), "s", f"{error}; or give the sample rate in Hz"), *rest]
    if not clocks:
        return columns
    step, key, stated = next((clock for clock in clocks if clock[2]), clocks[0])
    guessed = "" if stated else f"time step of {step:g} s, from '{key}' in the header without a unit"
    counts = np.arange(float(columns[0].data.size)) if place is None else columns[place].data
    with np.errstate(all="ignore"):
        return [Column("time", start + step * counts, "s", guessed=guessed), *rest]


def _counts(column: Column) -> bool:
    """Return whether a column holds whole numbers that follow one another."""
    data = column.data
    return bool(data.size > 1 and data[0] % 1 == 0 and np.all(np.diff(data) == 1))


def _entry(line: str, delimiter: str | None) -> _Entry | None:
    """Return what a line as "XInc, 0.01, s", "# Sample interval [ms] = 2" or "dt 0,01" states; None for others."""
    match = _LINE.fullmatch(line)
    key = re.sub(r"[^a-z]", "", match[1].lower()) if match else ""
    if match is None or key not in _KINDS:
        return None
    if re.search(r"[;\t]", line):
        cells = re.split(r"[;\t]", match[3])
    elif delimiter == "," and not _CUT.search(match[3]):
        cells = cells_of(match[3], ",")
    else:
        # A comma between digits belongs to a number.
        cells = re.split(r",(?!\d)|(?<!\d),", match[3])
    return _Entry(key, match[2] or "", [cell.strip(' "') for cell in cells])


def _floats(entries: list[_Entry], table: TextTable, decimal: str | None) -> dict[str, float]:
    """Return the numbers of a header as they are written; raise FileFormatError if they can be read in two ways.

    One that could have three decimals, or a group of digits, has the notation of the table.
    """
    keys = {number: one.key for one in entries for number, _ in one.numbers}
    texts = list(keys)
    if not any(sign in text for text in texts for sign in ".,"):
        return {text: float(text) for text in texts}
    data = "".join(f"{text}\n" for text in texts).encode()
    # Numbers between commas or blanks have no other decimal sign than the point by habit.
    delimiter = None if table.delimiter in (",", None) else table.delimiter
    cells = Cells(data, 0, delimiter, lambda place: f"'{keys[texts[data[:place].count(10)]]}' in the header")
    doubtful = any(_DOUBTFUL.fullmatch(text) for text in texts)
    given = notation_of(table.cells(), decimal) if doubtful else Notation(shown=False)
    try:
        body = pointed(cells, notation_of(cells, given.decimal if given.shown else None))
        return {text: float(number) for text, number in zip(texts, body.split(), strict=True)}
    except DecimalSignError:
        raise
    except (FileFormatError, ValueError) as error:
        words = ", ".join(f"'{key}' of {text}" for text, key in keys.items())
        raise FileFormatError(f"the header states {words}, need the decimal sign of the table; correct it") from error


def _stated(entries: list[_Entry], floats: dict[str, float]) -> tuple[list[tuple[float, str, bool]], float]:
    """Return the equal steps that a header states, and the time of its first sample [s]; raise FileFormatError.

    Of each step the seconds, its key, and whether it has a unit.
    """
    common = next((symbol_of(cell) for one in entries if one.kind == "unit" for cell in one.cells), "")
    clocks: list[tuple[float, str, bool]] = []
    start = 0.0
    for one in entries:
        for text, written in one.numbers:
            number, factor = floats[text], FACTORS["time"].get(symbol_of(written or common))
            in_seconds = number * (factor or 1.0) if factor or not written else 0.0
            hertz = number * _HERTZ.get(written.lower(), 0.0 if written else 1.0)
            if one.kind == "step" and in_seconds > 0:
                clocks.append((in_seconds, one.key, factor is not None))
            elif one.kind == "rate" and hertz > 0:
                clocks.append((1 / hertz, one.key, bool(written)))
            elif one.kind == "start":
                start = in_seconds
    clocks = [clock for clock in clocks if isfinite(clock[0]) and clock[0] > 0]
    steps = [step for step, _, _ in clocks]
    if steps and max(steps) - min(steps) > _SAME * max(steps):
        words = ", ".join(f"'{key}' of {step:g} s" for step, key, _ in clocks)
        raise FileFormatError(f"the header states different steps: {words}; correct it")
    return clocks, start
