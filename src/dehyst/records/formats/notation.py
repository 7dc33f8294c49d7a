"""The numbers and the timestamps of a text table, in the notation of Python and in seconds.

A sign between digits is a decimal sign or groups thousands. `0,5` and `50,1234` have a decimal comma for certain, and
`1,234,567` and `1,234.5` have commas that group; `12,011` can be both. What is certain decides for the file; where
nothing is certain, two readings are possible, and the file is refused.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import suppress
from datetime import datetime
from functools import cache
from typing import NamedTuple

import numpy as np

from dehyst._errors import DecimalSignError, FileFormatError
from dehyst._types import Array

SIGNS = (".", ",")
_OTHER = {".": ",", ",": "."}
_NAMES = {".": "point", ",": "comma"}
_STAMP = re.compile(
    r"(?:(\d{4}-\d\d?-\d\d?|\d\d?\.\d\d?\.\d{4}|\d\d?/\d\d?/\d{4})[T, ]+)?"
    r"(\d\d?):(\d\d):(\d\d)(?:[.,](\d+))?\s*(AM|PM|am|pm)?\s*(Z|([+-]\d\d):?(\d\d))?"
)
_DATES = ("%Y-%m-%d", "%d.%m.%Y", "%d/%m/%Y", "%m/%d/%Y")
_DAY, _HOUR = 86_400, 3600
# Characters of a timestamp; the search for one takes their number squared.
_LONGEST = 64
# Longest time step [s] beside which an hour more, or less, is a change of the clock.
_LONGEST_STEP = 600


class Notation(NamedTuple):
    """The decimal sign of a table, whether the other sign groups digits, and whether a cell or the user shows that."""

    decimal: str = "."
    grouped: bool = False
    shown: bool = True


def notation_of(find: Callable[[str, str], str], delimiter: str | None, commas: bool, given: str | None) -> Notation:
    """Return the notation of a table's numbers.

    `find`: function of a kind of cells and of a sign, see `pattern_of`, that returns the first such cell and its place,
    in words; empty if there is none. `delimiter`: separator of the cells. `commas`: whether a cell may have a comma.
    `given`: the decimal sign that the user states.

    Raise `DecimalSignError` if the cells allow both signs. Raise `FileFormatError` if there are two decimal signs, or
    another than the given one.
    """
    certain = {".": find("certain", ".")}
    if certain["."] and not commas and given != ",":
        return Notation()
    certain[","] = find("certain", ",")
    if given is not None and (contrary := certain[_OTHER[given]]):
        hint = "leave it out, or save it with one sign"
        raise FileFormatError(f'got the decimal sign "{given}", but {contrary}', hint=hint, change=("decimal",))
    if certain["."] and certain[","]:
        raise FileFormatError(
            f"{certain['.']} and {certain[',']}, need one decimal sign in a file; save it with points"
        )
    sign = given or next((sign for sign in SIGNS if certain[sign]), "")
    if not sign:
        unsure = {sign: find("doubtful", sign) for sign in SIGNS}
        # Numbers between commas or blanks have no other decimal sign by habit.
        if not unsure[","] and (delimiter in (",", None) or not unsure["."]):
            return Notation(shown=False)
        sign = "," if unsure[","] else "."
        raise DecimalSignError(
            f"{unsure[sign]}, which is a number with three decimals or a thousand times as large: no cell shows "
            f"whether the {_NAMES[sign]} is the decimal sign or groups digits",
            hint=f'give "{sign}" if it is the decimal sign, "{_OTHER[sign]}" if it groups digits',
            change=("decimal",),
        )
    other = _OTHER[sign]
    doubtful = find("doubtful", other)
    grouped = bool(find("groups", sign))
    if doubtful and not grouped and given is None:
        raise FileFormatError(
            f"{doubtful}, while {certain[sign]} with a decimal {_NAMES[sign]}",
            hint=f'if the {_NAMES[other]} groups digits there, give the decimal sign "{sign}"; else save one sign only',
            change=("decimal",),
        )
    return Notation(sign, grouped or bool(doubtful))


def pointed(block: str, notation: Notation, delimiter: str | None) -> str:
    """Return a block of rows with decimal points and without groups."""
    if not notation.grouped and (notation.decimal == "." or delimiter != ","):
        return block if notation.decimal == "." else block.replace(",", ".")
    other, pattern = _OTHER[notation.decimal], pattern_of("number", notation.decimal, delimiter)
    return pattern.sub(lambda m: m[0].replace(m["number"], m["number"].replace(other, "").replace(",", ".")), block)


def readings(text: str) -> dict[str, float]:
    """Return what a number means with each decimal sign that it can have."""
    return {
        sign: float(pointed(text, Notation(sign, grouped=True), None))
        for sign in SIGNS
        if pattern_of("number", sign, None).fullmatch(text) or re.fullmatch(r"[-+]?\d+(?:[eE][-+]?\d+)?", text)
    }


@cache
def pattern_of(kind: str, sign: str, delimiter: str | None) -> re.Pattern[str]:
    """Return the pattern of a whole cell that holds a number with signs, if `sign` is the decimal sign.

    "number": any. "certain": that cannot be written with the other decimal sign. "groups": that has groups for certain.
    "doubtful": `sign` stands before three digits, so that it can group them.
    """
    # Between commas, a cell with a comma is in quotes.
    signs = {".": r"\.", ",": r"(?(quoted),|(?!))" if delimiter == "," else ","}
    s, o, power = signs[sign], signs[_OTHER[sign]], r"(?:[eE][-+]?\d+)?"
    begin, end = rf"(?:^|{delimiter}) *", rf" *(?:{delimiter}|$)"
    if delimiter is None:
        begin, end = r"(?<![^ \t\n])", r"[ \t]|$"
    before, after = rf'{begin}(?P<quoted>")? *', rf'(?=(?(quoted) *")(?:{end}))'
    groups = rf"[1-9]\d{{0,2}}(?:{o}\d{{3}})+"
    number = rf"(?:{groups}(?:{s}\d*{power})?|\d+{s}\d*{power}|{s}\d+{power})"
    body = {
        "number": number,
        "certain": rf"(?![1-9]\d{{0,2}}(?:{s}|{o})\d{{3}}{after}){number}",
        "groups": rf"(?:{groups}{s}\d*{power}|{groups}{o}\d{{3}})",
        "doubtful": rf"[1-9]\d{{0,2}}{s}\d{{3}}",
    }[kind]
    return re.compile(rf"(?m){before}(?P<number>[-+]?{body}){after}")


class Moment(NamedTuple):
    """A timestamp: its origin, its date as written, the whole seconds of this day, and the fraction of a second.

    `origin`: "UTC" or "local time"; without a date "midnight" or "midnight UTC".
    """

    origin: str
    date: str
    seconds: int
    fraction: float


def moment(cell: str) -> Moment:
    """Return a timestamp: ISO 8601, day.month.year, month/day/year or day/month/year, or the time of day alone.

    Raise ValueError for any other text.
    """
    match = _STAMP.fullmatch(cell.strip()) if len(cell) <= _LONGEST and cell.isascii() else None
    if match is None:
        raise ValueError(cell)
    date, hours, minutes, whole, fraction, half, zone, ahead, more = match.groups()
    origin = " ".join(("midnight",) * (not date) + ("UTC",) * bool(zone)) or "local time"
    offset = _HOUR * int(ahead) + 60 * int(ahead[0] + more) if ahead else 0
    hour = int(hours) % 12 + 12 * (half in ("PM", "pm")) if half else int(hours)
    seconds = _HOUR * hour + 60 * int(minutes) + int(whole) - offset
    return Moment(origin, date or "", seconds, float(f"0.{fraction or 0}"))


def is_moment(cell: str) -> bool:
    """Return whether a cell is a timestamp."""
    with suppress(ValueError):
        return bool(moment(cell))
    return False


def clock_of(moments: list[Moment]) -> tuple[Array, tuple[str, int, float]]:
    """Return the times [s] of timestamps since the first one, and its origin, whole seconds and fraction.

    A time of day that jumps back by half a day is the next day's. Raise `ValueError` with the reason if they count from
    different origins, the order of day and month is unknown, or the local time changes by an hour.
    """
    origin = moments[0].origin
    if origins := sorted({one.origin for one in moments} - {origin}):
        raise ValueError(
            f"its times count from {origin} and from {origins[0]}; write all with date and offset from UTC"
        )
    days = _days({one.date for one in moments})
    whole = np.array([_DAY * days[one.date] + one.seconds for one in moments], dtype=np.int64)
    fraction = np.array([one.fraction for one in moments])
    seconds = (whole - whole[0]) + (fraction - fraction[0])
    if origin.startswith("midnight"):
        seconds = seconds + _DAY * np.cumsum(np.diff(seconds, prepend=seconds[0]) < -_DAY / 2)
    steps = np.diff(seconds)
    usual = float(np.median(steps)) if steps.size > 2 else 0.0
    changed = np.flatnonzero(np.abs(np.abs(steps - usual) - _HOUR) <= 0.5 * usual)
    if not origin.endswith("UTC") and 0 < usual < _LONGEST_STEP and changed.size:
        i = int(changed[0])
        raise ValueError(
            f"its local time goes on by {steps[i]:.6g} s after sample {i}, otherwise by {usual:.3g} s: the clock was "
            "changed by an hour, for summer time perhaps; write the times in UTC, or give the sample rate in Hz"
        )
    # The one day of which the month is unknown is the origin.
    origin = origin if all(days.values()) or not moments[0].date else f"{origin} of {moments[0].date}"
    return seconds, (origin, int(whole[0]), moments[0].fraction)


def _days(dates: set[str]) -> dict[str, int]:
    """Return the days of all dates; 0 without a date, or for a single one that can be read in two ways."""
    found: list[dict[str, int]] = []
    for form in _DATES if dates != {""} else ():
        with suppress(ValueError):
            found.append({date: datetime.strptime(date, form).toordinal() for date in dates})
    if len(found) != 1 and (len(dates) > 1 or not (found or "" in dates)):
        raise ValueError(
            f"its dates {'may be' if found else 'are neither all'} month/day/year {'or' if found else 'nor all'} "
            "day/month/year; write the dates as 2026-03-04, or give the sample rate in Hz"
        )
    return found[0] if len(found) == 1 else dict.fromkeys(dates, 0)
