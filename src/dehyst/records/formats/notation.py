"""The cells of a text table: their numbers, the decimal sign, and timestamps in seconds.

A point or a comma before three digits may group digits: `12,011` can be 12.011 or 12011. A file shows its decimal sign
by a cell as `0,5`, which cannot group; where no cell shows it, the user states it. Digits in groups are not read.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterable
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


def decimal_sign(before: int, block: list[str], delimiter: str | None) -> str:
    """Return the decimal sign that a block of rows shows; empty if it shows none.

    `before`: number of lines before the block. Raise `DecimalSignError` if the cells do not show whether a sign groups
    digits, and `FileFormatError` if they show both signs.
    """
    found = {sign: shown for sign in _SIGNS if (shown := _shown(before, block, delimiter, sign))[0]}
    if len(found) > 1:
        raise FileFormatError(
            f"{found['.'][0]} and {found[','][0]}, need one decimal sign in a file, and no groups of digits",
            hint="save it with points, or state the sign: columns with the other one are left out",
            change=("decimal",),
        )
    sign, (first, sure) = next(iter(found.items()), ("", ("", True)))
    # Numbers that commas or blanks separate usually have a decimal point.
    if not sure and not (sign == "." and delimiter in (",", ", ", None)):
        raise DecimalSignError(
            f"{first}, which is a number with three decimals or a thousand times as large: no cell shows whether the "
            f"{_SIGNS[sign]} is the decimal sign or groups digits",
            hint=f'give "{_SIGNS[sign]}" if it is the decimal sign; else save it without groups of digits',
            change=("decimal",),
        )
    return sign


def _shown(before: int, block: list[str], delimiter: str | None, sign: str) -> tuple[str, bool]:
    """Return the first cell of a block with a sign, in words, and whether a cell shows that the sign is decimal."""
    number, first = re.compile(_SIGNED.format(sign)), ""
    # Between commas, a cell with a comma is in quotes.
    mark = '"' if sign == delimiter else sign
    for line, text in enumerate(block if mark in "".join(block) else (), before + 1):
        # The last line of a file may be cut off in the middle of a number.
        if mark not in text or not (text.endswith("\n") or len(block) == 1):
            continue
        for cell in filter(number.fullmatch, cells_of(text, delimiter)):
            first = first or f"row {line} holds '{cell[:_SHOWN]}'"
            if not _DOUBTFUL.fullmatch(cell):
                return first, True
    return first, False


# A time of day after a date or alone, its fraction, its half of a day, and its offset from UTC; the longest timestamp.
_STAMP = re.compile(
    r"(\d{4}([-/])\d\d\2\d\d[T ])?(\d\d?):(\d\d):(\d\d)(?:[.,](\d+))?\s*([AP]M)?\s*(Z|([+-]\d\d):?(\d\d))?",
    re.ASCII | re.IGNORECASE,
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
    if match is None or (match[7] and not 1 <= int(match[3]) <= 12):
        raise ValueError(cell)
    day, _, hours, minutes, whole, fraction, half, zone, ahead, more = match.groups()
    hour = int(hours) % 12 + 12 * (half.upper() == "PM") if half else int(hours)
    origin = ("UTC" if zone else "local time") if day else ("midnight UTC" if zone else "midnight")
    offset = _HOUR * int(ahead) + 60 * int(ahead[0] + more) if ahead else 0
    days = date.fromisoformat(day[:10].replace("/", "-")).toordinal() - _FIRST_DAY if day else 0
    seconds = _DAY * days + _HOUR * hour + 60 * int(minutes) + int(whole) - offset
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
