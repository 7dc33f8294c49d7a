"""Text tables: decoded, their rows read at once or one by one, and the sampling that lines above the table state."""

from __future__ import annotations

import codecs
import io
import re
import warnings
from array import array
from collections.abc import Callable, Iterator
from dataclasses import replace
from math import isfinite
from typing import NamedTuple

import numpy as np

from dehyst._errors import DecimalSignError, FileFormatError
from dehyst._units import FACTORS, symbol_of
from dehyst.records.formats.columns import Column, shortened, without_groups
from dehyst.records.formats.file_content import Allowance
from dehyst.records.formats.table_layout import (
    ERROR,
    UNIT_BEHIND,
    Cells,
    Layout,
    Notation,
    cells_of,
    layout_of,
    notation_of,
    number_in,
    pointed,
)
from dehyst.records.formats.timestamps import Moment, clock_of, is_moment, moment

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


class _Clock(NamedTuple):
    """Seconds from one sample to the next, as a key of the header states it, and whether it states the unit."""

    step: float
    key: str
    stated: bool


def with_clock_of_header(
    columns: list[Column], header: str, delimiter: str | None, notation: Callable[[], Notation]
) -> list[Column]:
    """Return columns with the time that the lines above a table state, in the place of one that counts samples.

    Nothing changes if the header states no step, or if a column has a time with its unit. If steps contradict one
    another, or their decimal sign is unknown, the time has a fault. A step without a unit is taken for seconds, as a
    guess. `delimiter`: the separator of the table. `notation`: function that returns that of its numbers.
    """
    if not columns or any(column.parts[1] in FACTORS["time"] for column in columns):
        return columns
    place = next((k for k, column in enumerate(columns) if _counts(column)), None)
    lines = [line for line in header.split("\n")[-_LINES:] if len(line) <= _LONGEST]
    entries = [entry for line in lines if (entry := _entry(line, delimiter))]
    named = place is None and any("time" in column.quantities for column in columns)
    if named or not any(entry.kind in ("step", "rate") for entry in entries):
        return columns
    rest = [column for k, column in enumerate(columns) if k != place]
    try:
        clocks, start = _stated(entries, _floats(entries, delimiter, notation))
    except FileFormatError as error:
        return [Column("time", np.empty(0), "s", f"{error}; or give the sample rate in Hz"), *rest]
    if not clocks:
        return columns
    clock = next((clock for clock in clocks if clock.stated), clocks[0])
    guessed = "" if clock.stated else f"time step of {clock.step:g} s, from '{clock.key}' in the header without a unit"
    counts = np.arange(float(columns[0].data.size)) if place is None else columns[place].data
    with np.errstate(all="ignore"):
        return [Column("time", start + clock.step * counts, "s", guessed=guessed), *rest]


def _counts(column: Column) -> bool:
    """Return whether a column holds whole numbers that follow one another."""
    data = column.data
    return bool(data.size > 1 and data[0] % 1 == 0 and np.all(np.diff(data) == 1))


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


def _floats(entries: list[_Entry], delimiter: str | None, notation: Callable[[], Notation]) -> dict[str, float]:
    """Return the numbers of a header as they are written; raise FileFormatError if they can be read in two ways.

    One that could have three decimals, or a group of digits, has the notation of the table.
    """
    keys = {number: one.key for one in entries for number, _ in one.numbers}
    texts = list(keys)
    if not any(sign in text for text in texts for sign in ".,"):
        return {text: float(text) for text in texts}
    data = "".join(f"{text}\n" for text in texts).encode()

    def where(place: int) -> str:
        return f"'{keys[texts[data[:place].count(10)]]}'"

    # Numbers between commas or blanks have no other decimal sign than the point by habit.
    cells = Cells(data, 0, None if delimiter in (",", None) else delimiter, where, "the header")
    table = notation() if any(_DOUBTFUL.fullmatch(text) for text in texts) else Notation(shown=False)
    try:
        body = pointed(cells, notation_of(cells, table.decimal if table.shown else None))
        return {text: float(number) for text, number in zip(texts, body.split(), strict=True)}
    except DecimalSignError:
        raise
    except (FileFormatError, ValueError) as error:
        words = ", ".join(f"'{key}' of {text}" for text, key in keys.items())
        raise FileFormatError(f"the header states {words}, need the decimal sign of the table; correct it") from error


def _stated(entries: list[_Entry], floats: dict[str, float]) -> tuple[list[_Clock], float]:
    """Return the equal steps that a header states, and the time of its first sample [s]; raise FileFormatError."""
    common = next((symbol_of(cell) for one in entries if one.kind == "unit" for cell in one.cells), "")
    clocks: list[_Clock] = []
    start = 0.0
    for one in entries:
        for text, written in one.numbers:
            number, factor = floats[text], FACTORS["time"].get(symbol_of(written or common))
            in_seconds = number * (factor or 1.0) if factor or not written else 0.0
            hertz = number * _HERTZ.get(written.lower(), 0.0 if written else 1.0)
            if one.kind == "step" and in_seconds > 0:
                clocks.append(_Clock(in_seconds, one.key, factor is not None))
            elif one.kind == "rate" and hertz > 0:
                clocks.append(_Clock(1 / hertz, one.key, bool(written)))
            elif one.kind == "start":
                start = in_seconds
    clocks = [clock for clock in clocks if isfinite(clock.step) and clock.step > 0]
    steps = [clock.step for clock in clocks]
    if steps and max(steps) - min(steps) > _SAME * max(steps):
        words = ", ".join(f"'{clock.key}' of {clock.step:g} s" for clock in clocks)
        raise FileFormatError(f"the header states different steps: {words}; correct it")
    return clocks, start


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


# Longest line [bytes] and most columns of a measurement.
_LONGEST_LINE, WIDEST = 1_000_000, 10_000
_CHUNK = 1 << 20
_COMMENT = re.compile(rb"(?m)^[ \t\v\f]*[#%].*")
# A sign of a comment within a cell: 2#3.
_GLUED = re.compile(rb"[^\s#]#")
# An empty line that is not the last: in a table of one column, a missing number.
_HOLE = re.compile(rb"\n[ \t]*\n[ \t]*[^\s]")


class Text(NamedTuple):
    """A text file: bytes with uniform line ends, encoding, byte and line at which the rows start, header line."""

    data: bytes
    encoding: str
    start: int
    first: int
    header: str


def read_text(data: bytes, allowance: Allowance, decimal: str | None = None) -> list[Column]:
    """Read the columns of a text file; those with words have a fault, those without a name say so.

    `decimal`: the decimal sign, by default that of the allowance, or the one that the file shows.

    Raise `FileFormatError` for no text, no rows, rows that differ in length from the header, or more than allowed.
    """
    text = text_of(data, allowance)
    layout = layout_of(text.data, len(codecs.BOM_UTF8) * text.data.startswith(codecs.BOM_UTF8), text.encoding)
    if layout is None:
        return columns_below(text, _layout_of_first_line(text, allowance), allowance, decimal)
    columns = columns_below(text, layout, allowance, decimal)
    if layout.names and not any(layout.names[:3]):
        return [column for column in columns if column.name]
    below = text._replace(start=layout.start, first=layout.first)

    def notation() -> Notation:
        cells = _cells(below, [column.name for column in columns], layout.delimiter, allowance)
        return notation_of(cells, decimal or allowance.decimal)

    columns = with_clock_of_counts(columns, layout)
    above = text.data[max(layout.start - _CHUNK, 0) : layout.start].decode(text.encoding, errors="replace")
    return with_clock_of_header(columns, above, layout.delimiter, notation)


def _ends(text: Text, layout: Layout, count: int) -> list[tuple[str, str]]:
    """Return the first and the last cell of each column as the file has them; none for rows of other lengths."""
    rows = [next(_rows(text, layout.delimiter, count), None)]
    stop = len(text.data.rstrip())
    while stop > text.start and len(rows) < 2:
        begin = text.data.rfind(b"\n", text.start, stop) + 1 or text.start
        rows += [next(_rows(text._replace(data=text.data[begin:stop], start=0), layout.delimiter, count), None)]
        rows, stop = [row for row in rows if row], begin - 1
    cells = [row[1][:count] for row in rows if row and len(row[1]) >= count]
    return list(zip(*cells, strict=True)) if len(cells) == 2 else [("", "")] * count


def columns_below(text: Text, layout: Layout, allowance: Allowance, decimal: str | None = None) -> list[Column]:
    """Read the columns of a table whose place is known, see `read_text`."""
    text, names, unnamed = text._replace(start=layout.start, first=layout.first), list(layout.names), ""
    if not names:
        names, unnamed = [str(k + 1) for k in range(len(cells_of(layout.row, layout.delimiter)))], _unnamed(layout)
    if len(names) > 1 and not names[-1]:
        names.pop()
    _refuse_wide(names, allowance)
    ends = _ends(text, layout, len(names))
    text = _with_points(text, names, layout.delimiter, allowance, decimal or allowance.decimal)
    allowance.take((text.data.count(b"\n", text.start) + 1) * len(names), "the number of its lines")
    columns = _at_once(text, names, layout.delimiter) or _by_rows(text, names, layout.delimiter, allowance)
    units = [*layout.units, *[""] * len(names)]
    return [
        without_groups(replace(column, unit=column.unit or symbol_of(unit) or unit, unnamed=unnamed, ends=end))
        for column, unit, end in zip(columns, units, ends, strict=False)
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
    names = cells_of(UNIT_BEHIND.sub("", text.header) if delimiter is None else text.header, delimiter)
    if len(names) > 1 and not names[-1]:
        names.pop()
    _refuse_wide(names, allowance)
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
    while len(data) - start > _LONGEST_LINE:
        end = data.rfind(b"\n", start, start + _LONGEST_LINE + 1)
        if end < 0:
            number = data.count(b"\n", 0, start) + 1
            raise FileFormatError(
                f"{allowance.path}: line {number} is longer than {_LONGEST_LINE} bytes, longer than any row of a "
                "measurement; check that this is a table with a line for each sample"
            )
        start = end + 1


def _refuse_wide(names: list[str], allowance: Allowance) -> None:
    if len(names) > WIDEST:
        raise FileFormatError(
            f"{allowance.path}: the header has {len(names)} columns, at most {WIDEST} are read; check the separator, "
            "or keep time, voltage and displacement only"
        )


def _with_points(
    text: Text, names: list[str], delimiter: str | None, allowance: Allowance, decimal: str | None
) -> Text:
    """Return the text from its rows on, with decimal points and without groups of digits."""
    cells = _cells(text, names, delimiter, allowance)
    notation = notation_of(cells, decimal)
    if notation.decimal == "." and not notation.grouped:
        return text
    return text._replace(data=pointed(cells, notation), start=0)


def _cells(text: Text, names: list[str], delimiter: str | None, allowance: Allowance) -> Cells:
    """Return the cells of the rows."""

    def where(place: int) -> str:
        begin = text.data.rfind(b"\n", 0, place) + 1
        number = text.first + text.data.count(b"\n", text.start, place) + 1
        column = len(cells_of(text.data[begin:place].decode(text.encoding).strip(" ") + "0", delimiter)) - 1
        return f"line {number}, column '{shortened(names[min(column, len(names) - 1)])}'"

    return Cells(text.data, text.start, delimiter, where, str(allowance.path))


def _at_once(text: Text, names: list[str], delimiter: str | None) -> list[Column]:
    """Read all columns at once if all cells of all rows are numbers; else return none."""
    first = next((cells for _, cells in _rows(text, delimiter, len(names))), [])
    if len(first) != len(names) or (len(names) == 1 and _HOLE.search(text.data, text.start)):
        return []
    comments = (match[0].decode(text.encoding) for match in _COMMENT.finditer(text.data, text.start))
    if any(_is_row(comment, delimiter, len(names)) for comment in comments) or _GLUED.search(text.data, text.start):
        return []
    percent = text.data.find(b"%", text.start) >= 0
    stream = io.BytesIO(re.sub(rb"(?m)^[ \t\v\f]*%", b"#", text.data[text.start :]) if percent else text.data)
    stream.seek(0 if percent else text.start)
    try:
        with warnings.catch_warnings(action="ignore"), np.errstate(all="ignore"):
            lines = io.TextIOWrapper(stream, encoding=text.encoding, newline="\n")
            data = np.loadtxt(lines, delimiter=delimiter, ndmin=2)
    except ValueError:
        return []
    if data.shape[1] != len(names) or not len(data):
        return []
    return [Column(name, column.copy()) for name, column in zip(names, data.T, strict=True)]


def _rows(text: Text, delimiter: str | None, width: int) -> Iterator[tuple[int, list[str]]]:
    """Yield line number and cells of each row, without comments; an empty row has no cells."""
    start, number, data = text.start, text.first, text.data
    while start < len(data):
        end = data.find(b"\n", start)
        end = len(data) if end < 0 else end
        line, start, number = data[start:end].decode(text.encoding), end + 1, number + 1
        if not line.strip(f"{delimiter or ''} \t"):
            if width == 1 or (delimiter is not None and delimiter in line):
                yield number, []
        elif line.lstrip()[:1] not in ("#", "%") or _is_row(line, delimiter, width):
            yield number, cells_of(line, delimiter)


def _is_row(comment: str, delimiter: str | None, width: int) -> bool:
    """Return whether a line that begins as a comment does has as many cells as a row: #N/A,1,2 or %,1,2."""
    bare = comment.strip(" ")
    if delimiter is None or width == 1:
        return len(bare.split()) == width and bare[1:2].strip() != ""
    first, _, rest = bare.partition(delimiter)
    # A spreadsheet fills up the line of a comment with separators.
    filled = rest.strip(f"{delimiter} ") or len(first) == 1 or ERROR.fullmatch(first.strip())
    return bool(filled) and bare.count(delimiter) in (width - 1, width - 1 + bare.endswith(delimiter))


def _is_number(cell: str) -> bool:
    try:
        number_in(cell)
    except ValueError:
        return False
    return True


def _by_rows(text: Text, names: list[str], delimiter: str | None, allowance: Allowance) -> list[Column]:
    """Read row by row: slow, but it finds the line of an error and allows text columns and timestamps."""
    columns = [array("d") for _ in names]
    clocks: dict[int, list[Moment]] = {}
    faults: dict[int, str] = {}
    empty, hole = True, 0
    for number, cells in _rows(text, delimiter, len(names)):
        if not cells:
            hole = hole or (0 if empty else number)
            continue
        if hole:
            raise FileFormatError(
                f"{allowance.path}: line {hole} is an empty row within the table, which moves the samples behind it; "
                "fill it in, or remove it if no sample is missing"
            )
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
    return [
        Column(name, np.empty(0), "s" if place in clocks else "", f"{faults[place]}; correct or remove that row")
        if place in faults
        else _clock(name, clocks[place])
        if place in clocks
        else Column(name, np.array(columns[place]))
        for place, name in enumerate(names)
    ]


def _clock(name: str, moments: list[Moment]) -> Column:
    """Return a column of timestamps as seconds."""
    try:
        clock = clock_of(moments)
    except ValueError as error:
        return Column(name, np.empty(0), "s", str(error))
    return Column(name, clock.seconds, "s", began=clock.began)
