"""The cells of a text table: their numbers, the decimal sign, and timestamps in seconds.

A point or a comma before three digits may group digits: `12,011` can be 12.011 or 12011. A file shows its decimal sign
by a cell as `0,5`, which cannot group; where no cell shows it, the user states it. Digits in groups are not read.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterable, Iterator
from datetime import date
from typing import NamedTuple

import numpy as np

from dehyst._errors import DecimalSignError, FileFormatError
from dehyst._types import Array

# Yields blocks of lines, each with the number of lines before it.
Blocks = Callable[[], Iterable[tuple[int, list[str]]]]
_SIGNS = {".": "point", ",": "comma"}
# A number with a sign, one whose sign may group digits, and one in a notation that Python does not read.
_SIGNED = r"[-+]?(?:\d+\{0}\d*|\{0}\d+)(?:[eE][-+]?\d+)?"
_DOUBTFUL = re.compile(r"[-+]?[1-9]\d{0,2}[.,]\d{3}")
_NUMBER = re.compile(r"[-+]?\d[\d.,]*(?:[eE][-+]?\d+)?")
# Characters of a cell that a message shows.
_SHOWN = 40


def cells_of(line: str, delimiter: str | None) -> list[str]:
    """Return the cells of a line."""
    cells = line.split(delimiter)
    if '"' in line:
        sign = delimiter[0] if delimiter else " "
        cells = next(csv.reader([line.strip(" ")], delimiter=sign, skipinitialspace=True))
    return [cell.strip() for cell in cells]


def number_in(cell: str, decimal: str = ".") -> float:
    """Return a cell's number, NaN if empty; raise ValueError for what only Python reads: 1_000, other digits."""
    if "_" in cell or not cell.isascii() or (decimal == "," and "." in cell):
        raise ValueError(cell)
    return float(cell.replace(decimal, ".") or "nan")


def is_number(cell: str) -> bool:
    """Return whether a cell is a number, also in a notation that Python does not read; an empty cell is not."""
    try:
        number_in(cell)
    except ValueError:
        return _NUMBER.fullmatch(cell) is not None
    return bool(cell)


class DecimalSign:
    """The decimal sign of a table: the one that the user states, else the one that cells show, or a point.

    `first`: for each sign, the first cell with it, in words. `known`: the sign that a cell shows without doubt; empty
    if there is none yet.
    """

    def __init__(self, delimiter: str | None, given: str | None) -> None:
        self.delimiter, self.given, self.first, self.known = delimiter, given, dict[str, str](), given or ""

    @property
    def sign(self) -> str:
        """The sign by which numbers are read."""
        return self.given or next(iter(self.first), ".")

    def look(self, before: int, block: list[str]) -> None:
        """Look for signs in a block of lines, `before` which others are; raise `FileFormatError` if cells show both."""
        for sign in () if self.given else [sign for sign in _SIGNS if sign != self.known]:
            cells = _signed(before, block, self.delimiter, sign)
            for line, cell in cells:
                self.first.setdefault(sign, f"row {line} holds '{cell[:_SHOWN]}'")
                if not _DOUBTFUL.fullmatch(cell):
                    self.known = sign
                    break
        if len(self.first) > 1:
            raise FileFormatError(
                f"{self.first['.']} and {self.first[',']}, need one decimal sign in a file, and no groups of digits",
                hint="save it with points, or state the sign: columns with the other one are left out",
                change=("decimal",),
            )

    def demand(self) -> None:
        """Raise `DecimalSignError` if no cell shows whether the sign groups digits."""
        # Numbers that commas or blanks separate usually have a decimal point.
        if self.known or not self.first or (self.sign == "." and self.delimiter in (",", ", ", None)):
            return
        raise DecimalSignError(
            f"{self.first[self.sign]}, which is a number with three decimals or a thousand times as large: no cell "
            f"shows whether the {_SIGNS[self.sign]} is the decimal sign or groups digits",
            hint=f'give "{_SIGNS[self.sign]}" if it is the decimal sign; else save it without groups of digits',
            change=("decimal",),
        )


def _signed(before: int, block: list[str], delimiter: str | None, sign: str) -> Iterator[tuple[int, str]]:
    """Yield the cells of a block that are numbers with a sign, each with the number of its line."""
    number = re.compile(_SIGNED.format(sign))
    # Between commas, a cell with a comma is in quotes.
    mark = '"' if sign == delimiter else sign
    for line, text in enumerate(block if mark in "".join(block) else (), before + 1):
        # The last line of a file may be cut off in the middle of a number.
        if mark in text and (text.endswith("\n") or len(block) == 1):
            yield from ((line, cell) for cell in filter(number.fullmatch, cells_of(text, delimiter)))


# A time of day after a date or alone, its fraction, and its offset from UTC; the longest timestamp.
_STAMP = re.compile(
    r"(\d{4}([-/])\d\d\2\d\d[T ])?(\d\d?):(\d\d):(\d\d)(?:[.,](\d+))?\s*(Z|([+-]\d\d):?(\d\d))?", re.ASCII
)
_LONGEST = 64
_DAY, _HOUR = 86_400, 3600
# The number of the first of January 1970: nanoseconds since then fit into 64 bits.
_FIRST_DAY = date(1970, 1, 1).toordinal()


class Moment(NamedTuple):
    """A timestamp: its origin ("UTC", "local time", "midnight", "midnight UTC"), and the nanoseconds since then."""

    origin: str
    nanoseconds: int


def moment(cell: str) -> Moment:
    """Return a timestamp: year, month, day and the time of day, or this alone; raise ValueError for any other text."""
    match = is_moment(cell)
    if match is None:
        raise ValueError(cell)
    day, _, hours, minutes, whole, fraction, zone, ahead, more = match.groups()
    origin = ("UTC" if zone else "local time") if day else ("midnight UTC" if zone else "midnight")
    offset = _HOUR * int(ahead) + 60 * int(ahead[0] + more) if ahead else 0
    days = date.fromisoformat(day[:10].replace("/", "-")).toordinal() - _FIRST_DAY if day else 0
    seconds = _DAY * days + _HOUR * int(hours) + 60 * int(minutes) + int(whole) - offset
    return Moment(origin, 1_000_000_000 * seconds + int(f"{fraction or '':0<9.9}"))


def is_moment(cell: str) -> re.Match[str] | None:
    """Return the parts of a cell that is written as a timestamp, see `moment`; None for any other cell."""
    return _STAMP.fullmatch(cell.strip()) if len(cell) <= _LONGEST else None


def clock_of(moments: list[Moment]) -> Array:
    """Return the times [s] of timestamps since the first one.

    A time of day that jumps back by half a day is the next day's. Raise `ValueError` with the reason if they count from
    different origins, or a clock without offset jumps by an hour.
    """
    origin = moments[0].origin
    if origins := sorted({stamp.origin for stamp in moments} - {origin}):
        raise ValueError(
            f"its times count from {origin} and from {origins[0]}; write all with date and offset from UTC"
        )
    seconds = np.array([stamp.nanoseconds - moments[0].nanoseconds for stamp in moments]) / 1e9
    if origin.startswith("midnight"):
        seconds = seconds + _DAY * np.cumsum(np.diff(seconds, prepend=seconds[0]) < -_DAY / 2)
    jumps = np.diff(seconds)
    usual = float(np.median(jumps)) if jumps.size else 0.0
    hour = np.flatnonzero(np.abs(np.abs(jumps - usual) - _HOUR) < 0.5 * min(abs(usual), _HOUR))
    if hour.size and "UTC" not in origin:
        raise ValueError(
            f"its times jump by an hour between samples {hour[0]} and {hour[0] + 1}: summer time, or a pause; "
            "write all with date and offset from UTC, or give the sample rate in Hz"
        )
    return seconds
