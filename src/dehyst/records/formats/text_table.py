"""Text tables: rows of numbers under one header line; separator and decimal sign follow from the file."""

from __future__ import annotations

import codecs
import csv
import io
import re
import warnings
from array import array
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from dehyst._errors import FileFormatError
from dehyst.records.formats.columns import Column, shortened
from dehyst.records.formats.file_content import Allowance

# Longest line [bytes] and most columns of a measurement.
_LONGEST, _WIDEST = 1_000_000, 10_000
_CHUNK = 1 << 20


class _Text(NamedTuple):
    """A text file: bytes with uniform line ends, encoding, byte and line at which the rows start, header line."""

    data: bytes
    encoding: str
    start: int
    first: int
    header: str


def read_text(data: bytes, allowance: Allowance) -> list[Column]:
    """Read the columns of a text file; those with words have a fault.

    Raises
    ------
    FileFormatError
        No text, no header, no rows, rows that differ in length from the header, or more than allowed.
    """
    path = allowance.path
    text = _text(data, allowance)
    delimiter = next((d for d in ";\t," if d in re.sub(r'"[^"]*"', "", text.header)), None)
    names = _names(text, delimiter, allowance)
    if all(_is_number(name.replace(",", ".") if delimiter != "," else name) for name in names):
        raise FileFormatError(
            f"{path}: line {text.first} is '{text.header.strip()[:60]}', but a header line with names and units is "
            "needed first, not behind a # or %; try time_s,voltage_V,displacement_um"
        )
    text = _with_points(text, delimiter)
    allowance.take((text.data.count(b"\n", text.start) + 1) * len(names), "the number of its lines")
    return _at_once(text, names, delimiter) or _by_rows(text, names, delimiter, allowance)


def _text(data: bytes, allowance: Allowance) -> _Text:
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
            return _Text(data, encoding, start, number, line)
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


def _names(text: _Text, delimiter: str | None, allowance: Allowance) -> list[str]:
    header = text.header
    names = _cells(re.sub(r"(?<!\s)\s+(?=[\[(])", "", header) if delimiter is None else header, delimiter)
    if len(names) > 1 and not names[-1]:
        names.pop()
    if len(names) > _WIDEST:
        raise FileFormatError(
            f"{allowance.path}: the header has {len(names)} columns, at most {_WIDEST} are read; check the separator, "
            "or keep time, voltage and displacement only"
        )
    return names


def _with_points(text: _Text, delimiter: str | None) -> _Text:
    """Replace decimal commas by points, and % by # as the sign of a comment; in the rows only."""
    comma = delimiter in (";", "\t") and text.data.find(b",", text.start) >= 0
    percent = text.data.find(b"%", text.start) >= 0
    if not comma and not percent:
        return text
    body = text.data[text.start :]
    if comma:
        body = body.replace(b",", b".")
    return text._replace(data=re.sub(rb"(?m)^[ \t\v\f]*%", b"#", body) if percent else body, start=0)


def _at_once(text: _Text, names: list[str], delimiter: str | None) -> list[Column]:
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


def _rows(text: _Text, delimiter: str | None) -> Iterator[tuple[int, list[str]]]:
    """Yield line number and cells of each row, without blank lines and comments."""
    start, number, data = text.start, text.first, text.data
    while start < len(data):
        end = data.find(b"\n", start)
        end = len(data) if end < 0 else end
        line, start, number = data[start:end].decode(text.encoding), end + 1, number + 1
        if line.strip(f"{delimiter or ''} \t") and line.lstrip()[:1] not in ("#", "%"):
            yield number, _cells(line, delimiter)


def _cells(line: str, delimiter: str | None) -> list[str]:
    if '"' not in line:
        return [cell.strip() for cell in line.split(delimiter)]
    return [
        cell.strip() for cell in next(csv.reader([line.strip(" ")], delimiter=delimiter or " ", skipinitialspace=True))
    ]


def _number(cell: str) -> float:
    """Return a cell's number, NaN if empty; raise ValueError for numbers of Python only: 1_000, other digits."""
    if "_" in cell or not cell.isascii():
        raise ValueError(cell)
    return float(cell or "nan")


def _is_number(cell: str) -> bool:
    try:
        _number(cell)
    except ValueError:
        return False
    return True


def _by_rows(text: _Text, names: list[str], delimiter: str | None, allowance: Allowance) -> list[Column]:
    """Read row by row: slow, but it finds the line of an error and allows text columns."""
    columns = [array("d") for _ in names]
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
        empty = False
        for place, cell in enumerate(cells):
            if place not in faults:
                try:
                    columns[place].append(_number(cell))
                except ValueError:
                    faults[place] = f"line {number} holds '{shortened(cell)}', which is no number"
                    columns[place] = array("d")
    if empty:
        raise FileFormatError(f"{allowance.path}: a header but no rows; export the measurement again")
    advice = "; correct or remove that row"
    return [
        Column(name, np.array(columns[place]), fault=faults[place] + advice if place in faults else "")
        for place, name in enumerate(names)
    ]
