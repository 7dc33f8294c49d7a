"""The times of a text table: its timestamps as seconds since the first one, and the step that its header states."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import datetime
from functools import lru_cache
from math import isfinite
from typing import NamedTuple

import numpy as np

from dehyst._errors import DecimalSignError, FileFormatError
from dehyst._types import Array
from dehyst._units import FACTORS, symbol_of
from dehyst.records.formats.columns import Column
from dehyst.records.formats.notation import Notation, readings

_STAMP = re.compile(
    r"(?:(\d{4}-\d\d?-\d\d?|\d\d?\.\d\d?\.\d{4}|\d\d?/\d\d?/\d{4})[T, ]+)?"
    r"(\d\d?):(\d\d):(\d\d)(?:[.,](\d+))?\s*([AaPp][Mm])?\s*(Z|([+-]\d\d):?(\d\d))?"
)
# How `datetime` reads a date with each separator: month before day, and day before month.
_DATES = {"-": ("%Y-%m-%d",) * 2, ".": ("%d.%m.%Y",) * 2, "/": ("%m/%d/%Y", "%d/%m/%Y")}
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


def moment(cell: str) -> Moment:
    """Return a timestamp: ISO 8601, day.month.year, month/day/year or day/month/year, or the time of day alone.

    Raise ValueError for any other text.
    """
    match = _STAMP.fullmatch(cell.strip()) if len(cell) <= _LONGEST and cell.isascii() else None
    days = _days(match[1] or "") if match else (None, None)
    if match is None or days == (None, None):
        raise ValueError(cell)
    hours, half = int(match[2]), (match[6] or "").lower()
    if half:
        hours = hours % 12 + (12 if half == "pm" else 0)
    zone = 60 * (60 * int(match[8] or 0) + int((match[8] or "+")[0] + (match[9] or "0")))
    origin = " ".join(("midnight",) * (not match[1]) + ("UTC",) * bool(match[7])) or "local time"
    seconds = _HOUR * hours + 60 * int(match[3]) + int(match[4]) - zone
    return Moment(origin, days, seconds, float(f"0.{match[5] or 0}"))


@lru_cache(maxsize=64)
def _days(text: str) -> tuple[int | None, int | None]:
    """Return `Moment.days` of a date; (0, 0) without one."""
    days: list[int | None] = [None, None]
    for k, form in enumerate(_DATES[text.strip("0123456789")[0]] if text else ()):
        with suppress(ValueError):
            days[k] = datetime.strptime(text, form).toordinal()
    return (days[0], days[1]) if text else (0, 0)


def is_moment(cell: str) -> bool:
    """Return whether a cell is a timestamp."""
    with suppress(ValueError):
        return bool(moment(cell))
    return False


def clock_of(moments: list[Moment]) -> tuple[Array, tuple[tuple[str, int, float], ...]]:
    """Return the times [s] of timestamps since the first one, and its origin, whole seconds and fraction.

    There are two of these if the order of day and month is unknown. A time of day that jumps back by half a day is the
    next day's. Raise `ValueError` with the reason if they count from different origins, the order of day and month
    changes the times between them, times repeat, or the local time changes by an hour.
    """
    origin = moments[0].origin
    if origins := sorted({one.origin for one in moments} - {origin}):
        raise ValueError(
            f"its times count from {origin} and from {origins[0]}; write all with date and offset from UTC"
        )
    fraction = np.array([one.fraction for one in moments])
    ways: list[tuple[Array, tuple[str, int, float]]] = []
    for order in (0, 1):
        days = [one.days[order] for one in moments]
        if None not in days:
            whole = _DAY * np.array(days, dtype=np.int64) + np.array([one.seconds for one in moments])
            seconds = (whole - whole[0]) + (fraction - fraction[0])
            if origin.startswith("midnight"):
                seconds = seconds + _DAY * np.cumsum(np.diff(seconds, prepend=seconds[0]) < -_DAY / 2)
            ways.append((seconds, (origin, int(whole[0]), moments[0].fraction)))
    if not ways:
        raise ValueError(f"its dates are neither all month/day/year nor all day/month/year; {_AGAIN}")
    if len(ways) > 1 and not np.array_equal(ways[0][0], ways[1][0]):
        ways = [(seconds, began) for seconds, began in ways if np.all(np.diff(seconds) >= 0)] or ways
        if len(ways) > 1:
            raise ValueError(f"its dates may be month/day/year or day/month/year, which are different times; {_AGAIN}")
    _refuse_steps(ways[0][0], not origin.endswith("UTC"))
    return ways[0][0], tuple(dict.fromkeys(began for _, began in ways))


def _refuse_steps(seconds: Array, local: bool) -> None:
    """Raise ValueError for times that repeat, and where `local` ones change by an hour beside short steps."""
    steps = np.diff(seconds)
    usual = float(np.median(steps)) if steps.size > 2 else 0.0
    changed = np.flatnonzero(np.abs(np.abs(steps - usual) - _HOUR) <= 0.5 * usual)
    if local and 0 < usual < _LONGEST_STEP and changed.size:
        i = int(changed[0])
        raise ValueError(
            f"its local time goes on by {steps[i]:.6g} s after sample {i}, otherwise by {usual:.3g} s: the clock was "
            "changed by an hour, for summer time perhaps; write the times in UTC, or give the sample rate in Hz"
        )
    count = np.count_nonzero(steps == 0)
    if count and steps.min() >= 0 and seconds[-1] > 0:
        raise ValueError(
            f"{count} of its {seconds.size} times are the same as the one before: the clock is too coarse. "
            f"If these are even, give the sample rate, {steps.size / seconds[-1]:.6g} Hz by the first and last time"
        )


# Letters of the words for the time from one sample to the next, for samples a second, for the time of the first sample,
# and for the unit of times.
_KINDS = {
    word: kind
    for kind, words in {
        "step": "xinc xincr xincrement sampleinterval samplinginterval sampleperiod samplingperiod timestep "
        "tinc deltat timeincrement deltax dt hincrement horizontalinterval abtastintervall abtastzeit "
        "abtastperiode zeitschritt",
        "rate": "samplerate samplingrate samplefrequency samplingfrequency samplespersecond abtastrate abtastfrequenz "
        "sampling",
        "start": "xorg xorigin xzero xstart starttime firsttime horizontaloffset",
        "unit": "xunit xunits horizontalunit horizontalunits timeunit timeunits zeiteinheit",
    }.items()
    for word in words.split()
}
_HERTZ = {"hz": 1.0, "khz": 1e3, "mhz": 1e6, "ghz": 1e9, "s/s": 1.0, "sa/s": 1.0, "ks/s": 1e3, "ms/s": 1e6}
# A number that a comma between cells cuts into 10 and 000.
_CUT = re.compile(r"\d,0\d")
_VALUE = re.compile(r"\s*([-+]?[.,]?\d[\d.,]*(?:[eE][-+]?\d+)?)\s*([^\W\d]+(?:/[^\W\d]+)?)?\s*")
# Key, unit in brackets, and the rest of a line.
_LINE = re.compile(r"[#%;\s\"]*([A-Za-z][^\[\](){}:=;,\t\"\d]*)(?:[\[(]([^\[\]()]*)[\])])?[\s\":=;,]+(.*)")
# The longest line that is looked at.
_LONGEST_LINE = 400
# Relative difference of steps that state the same.
_SAME = 1e-6


# What the header states, its key, the number as it is written, and its unit.
_Entry = tuple[str, str, str, str]


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
    entries = [entry for line in lines if len(line) <= _LONGEST_LINE for entry in _entries(line, delimiter)]
    named = place is None and any("time" in column.quantities for column in columns)
    if named or not any(kind in ("step", "rate") for kind, _, _, _ in entries):
        return columns
    rest = [column for k, column in enumerate(columns) if k != place]
    try:
        clocks, start = _stated(entries, notation)
    except FileFormatError as error:
        return [Column("time", np.empty(0), "s", f"{error}; or give the sample rate in Hz"), *rest]
    if not clocks:
        return columns
    step, key, stated = next((clock for clock in clocks if clock[2]), clocks[0])
    guessed = "" if stated else f"time step of {step:g} s, from {key} in the header without a unit"
    counts = np.arange(float(columns[0].data.size)) if place is None else columns[place].data
    with np.errstate(all="ignore"):
        return [Column("time", start + step * counts, "s", guessed=guessed), *rest]


def _counts(column: Column) -> bool:
    """Return whether a column counts samples: whole numbers that rise by one, or by more where samples are left out."""
    steps = np.diff(column.data)
    if not steps.size or column.data[0] % 1 or np.any(steps % 1) or steps.min() != 1:
        return False
    return bool(steps.max() == 1) or not (column.quantities or symbol_of(column.parts[1]))


def _entries(line: str, delimiter: str | None) -> list[_Entry]:
    """Return what a line as "XInc, 0.01, s", "# Sample interval [ms] = 2" or "dt 0,01" states."""
    match = _LINE.fullmatch(line)
    key = re.sub(r"[^a-z]", "", match[1].lower()) if match else ""
    if match is None or key not in _KINDS:
        return []
    # A comma between digits belongs to a number, where the cells are not between commas.
    comma = "," if delimiter == "," and not _CUT.search(match[3]) else r",(?!\d)|(?<!\d),"
    cells = [cell.strip(' "') for cell in re.split(r"[;\t]" if re.search(r"[;\t]", match[3]) else comma, match[3])]
    if _KINDS[key] == "unit":
        return [("unit", key, "", symbol_of(cell)) for cell in cells if symbol_of(cell)]
    found = []
    for cell, after in zip(cells, [*cells[1:], ""], strict=True):
        value = _VALUE.fullmatch(cell)
        unit = value[2] if value else ""
        unit = unit or (after if symbol_of(after) or after.lower() in _HERTZ else "") or match[2] or ""
        # The word "sampling" alone can mean anything; 12.05.2024 is no number.
        if value and readings(value[1]) and (unit or key != "sampling"):
            found.append((_KINDS[key], key, value[1], unit))
    return found


def _stated(entries: list[_Entry], notation: Callable[[], Notation]) -> tuple[list[tuple[float, str, bool]], float]:
    """Return the equal steps that a header states, and the time of its first sample [s]; raise FileFormatError.

    Of each step the seconds, its words, and whether it has a unit.
    """
    common = next((unit for kind, _, _, unit in entries if kind == "unit"), "")
    clocks: list[tuple[float, str, bool]] = []
    start = 0.0
    for kind, key, text, unit in (entry for entry in entries if entry[0] != "unit"):
        words, known = f"'{key}' of '{text}'", readings(text)
        sign = next(iter(known)) if len(set(known.values())) == 1 else notation().decimal if notation().shown else ""
        if not sign:
            raise DecimalSignError(f"the header states {words}, which can be read in two ways; give the decimal sign")
        number, factor = known[sign], FACTORS["time"].get(symbol_of(unit or common))
        in_seconds = number * (factor or 1.0) if factor or not unit else 0.0
        hertz = number * _HERTZ.get(unit.lower(), 0.0 if unit else 1.0)
        if kind == "step":
            clocks.append((in_seconds, words, factor is not None))
        elif kind == "rate" and hertz > 0:
            clocks.append((1 / hertz, words, bool(unit)))
        elif kind == "start":
            start = in_seconds
    clocks = [clock for clock in clocks if isfinite(clock[0]) and clock[0] > 0]
    steps = [step for step, _, _ in clocks]
    if steps and max(steps) - min(steps) > _SAME * max(steps):
        raise FileFormatError(f"the header states different steps: {', '.join(c[1] for c in clocks)}; correct it")
    return clocks, start
