"""Timestamps of a text table as seconds since the first of them."""

from __future__ import annotations

import re
from datetime import date

import numpy as np

from dehyst._types import Array

_DATES = r"(\d{4})-(\d\d?)-(\d\d?)[T ]+|(\d\d?)\.(\d\d?)\.(\d{4})[T, ]+|(\d\d?)/(\d\d?)/(\d{4})[T, ]+"
_STAMP = re.compile(rf"(?:{_DATES})?(\d\d?):(\d\d):(\d\d)(?:[.,](\d+))?\s*([AaPp][Mm])?\s*(?:Z|([+-]\d\d):?(\d\d))?")
_DAY = 86_400
# Characters of a timestamp; the search for one takes their number squared.
_LONGEST = 64


def moment(cell: str) -> tuple[int, float]:
    """Return a timestamp as whole seconds and their fraction.

    ISO 8601, day.month.year, month/day/year, or the time of day alone. Raise ValueError for any other text.
    """
    match = _STAMP.fullmatch(cell.strip()) if len(cell) <= _LONGEST else None
    if match is None or not cell.isascii():
        raise ValueError(cell)
    year, month, day = match[1], match[2], match[3]
    if match[6]:
        day, month, year = match[4], match[5], match[6]
    elif match[9]:
        month, day, year = match[7], match[8], match[9]
    days = date(int(year), int(month), int(day)).toordinal() if year else 0
    hours, half = int(match[10]), (match[14] or "").lower()
    if half:
        hours = hours % 12 + (12 if half == "pm" else 0)
    zone = 60 * (60 * int(match[15] or 0) + int((match[15] or "+")[0] + (match[16] or "0")))
    whole = _DAY * days + 3600 * hours + 60 * int(match[11]) + int(match[12]) - zone
    return whole, float(f"0.{match[13] or 0}")


def is_moment(cell: str) -> bool:
    """Return whether a cell is a timestamp."""
    try:
        moment(cell)
    except ValueError:
        return False
    return True


def elapsed(moments: list[tuple[int, float]]) -> Array:
    """Return the seconds since the first of some moments; a time of day that jumps back by half a day is the next."""
    if not moments:
        return np.empty(0)
    whole, fraction = (np.array(part) for part in zip(*moments, strict=True))
    seconds = (whole - whole[0]) + (fraction - fraction[0])
    if whole.max() < _DAY:
        seconds = seconds + _DAY * np.cumsum(np.diff(seconds, prepend=seconds[0]) < -_DAY / 2)
    return np.asarray(seconds, dtype=np.float64)
