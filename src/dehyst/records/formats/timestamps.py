"""Timestamps of a text table as seconds since the first of them."""

from __future__ import annotations

import re
from contextlib import suppress
from datetime import date
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from dehyst._types import Array

_DATES = r"(\d{4})-(\d\d?)-(\d\d?)[T ]+|(\d\d?)\.(\d\d?)\.(\d{4})[T, ]+|(\d\d?)/(\d\d?)/(\d{4})[T, ]+"
_STAMP = re.compile(rf"(?:{_DATES})?(\d\d?):(\d\d):(\d\d)(?:[.,](\d+))?\s*([AaPp][Mm])?\s*(Z|([+-]\d\d):?(\d\d))?")
_DAY, _HOUR = 86_400, 3600
# Characters of a timestamp; the search for one takes their number squared.
_LONGEST = 64
# Longest time step [s] beside which an hour more, or less, is a change of the clock.
_LONGEST_STEP = 600
_AGAIN = "write the dates as 2026-03-04, or give the sample rate in Hz"


class Moment(NamedTuple):
    """A timestamp: its origin, its day, the whole seconds of this day, and the fraction of a second.

    `origin`: "UTC" or "local time"; without a date "midnight" or "midnight UTC". `days`: the day read as
    month/day/year, and read as day/month/year; None where this is not a date.
    """

    origin: str
    days: tuple[int | None, int | None]
    seconds: int
    fraction: float


class Elapsed(NamedTuple):
    """The times [s] of timestamps since the first one, and its possible values: origin, whole seconds, fraction.

    There are two values if the order of day and month is unknown.
    """

    seconds: Array
    began: tuple[tuple[str, int, float], ...]


def moment(cell: str) -> Moment:
    """Return a timestamp: ISO 8601, day.month.year, month/day/year or day/month/year, or the time of day alone.

    Raise ValueError for any other text.
    """
    match = _STAMP.fullmatch(cell.strip()) if len(cell) <= _LONGEST else None
    days = _days(*match.groups()[:9]) if match else (None, None)
    if match is None or not cell.isascii() or days == (None, None):
        raise ValueError(cell)
    hours, half = int(match[10]), (match[14] or "").lower()
    if half:
        hours = hours % 12 + (12 if half == "pm" else 0)
    zone = 60 * (60 * int(match[16] or 0) + int((match[16] or "+")[0] + (match[17] or "0")))
    origin = " ".join(("midnight",) * (days == (0, 0)) + ("UTC",) * bool(match[15])) or "local time"
    seconds = _HOUR * hours + 60 * int(match[11]) + int(match[12]) - zone
    return Moment(origin, days, seconds, float(f"0.{match[13] or 0}"))


@lru_cache(maxsize=64)
def _days(*parts: str | None) -> tuple[int | None, int | None]:
    """Return `Moment.days` of year, month, day; day, month, year; and of two numbers and a year with slashes."""

    def day(*numbers: str | None) -> int | None:
        with suppress(ValueError):
            return date(*(int(number or 0) for number in numbers)).toordinal()
        return None

    if year := parts[8]:
        return day(year, parts[6], parts[7]), day(year, parts[7], parts[6])
    year, month, number = parts[:3] if parts[0] else parts[5:2:-1]
    return (day(year, month, number),) * 2 if year else (0, 0)


def is_moment(cell: str) -> bool:
    """Return whether a cell is a timestamp."""
    try:
        moment(cell)
    except ValueError:
        return False
    return True


def clock_of(moments: list[Moment]) -> Elapsed:
    """Return the times of timestamps; a time of day that jumps back by half a day is the next day's.

    Raise `ValueError` with the reason if they count from different origins, the order of day and month changes the
    times between them, or the local time changes by an hour.
    """
    origin = moments[0].origin
    if origins := sorted({one.origin for one in moments} - {origin}):
        raise ValueError(
            f"its times count from {origin} and from {origins[0]}; write all with date and offset from UTC"
        )
    fraction = np.array([one.fraction for one in moments])
    readings = []
    for order in (0, 1):
        days = [one.days[order] for one in moments]
        if None not in days:
            whole = _DAY * np.array(days, dtype=np.int64) + np.array([one.seconds for one in moments])
            seconds = (whole - whole[0]) + (fraction - fraction[0])
            if origin.startswith("midnight"):
                seconds = seconds + _DAY * np.cumsum(np.diff(seconds, prepend=seconds[0]) < -_DAY / 2)
            readings.append(Elapsed(seconds, ((origin, int(whole[0]), moments[0].fraction),)))
    if not readings:
        raise ValueError(f"its dates are neither all month/day/year nor all day/month/year; {_AGAIN}")
    if len(readings) > 1 and not np.array_equal(readings[0].seconds, readings[1].seconds):
        readings = [one for one in readings if np.all(np.diff(one.seconds) >= 0)] or readings
        if len(readings) > 1:
            raise ValueError(f"its dates may be month/day/year or day/month/year, which are different times; {_AGAIN}")
    if not origin.endswith("UTC"):
        _refuse_change(readings[0].seconds)
    return Elapsed(readings[0].seconds, tuple(dict.fromkeys(began for one in readings for began in one.began)))


def _refuse_change(seconds: Array) -> None:
    """Raise ValueError where local times change by an hour, as they do in spring and autumn, beside short steps."""
    steps = np.diff(seconds)
    usual = float(np.median(steps)) if steps.size > 2 else 0.0
    changed = np.flatnonzero(np.abs(np.abs(steps - usual) - _HOUR) <= 0.5 * usual)
    if 0 < usual < _LONGEST_STEP and changed.size:
        i = int(changed[0])
        raise ValueError(
            f"its local time goes on by {steps[i]:.6g} s after sample {i}, otherwise by {usual:.3g} s: the clock was "
            "changed by an hour, for summer time perhaps; write the times in UTC, or give the sample rate in Hz"
        )
