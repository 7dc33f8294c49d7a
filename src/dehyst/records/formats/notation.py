"""The decimal sign of a text table, decided once for the whole file, and its numbers in the notation of Python.

A sign between digits is a decimal sign or groups thousands. `0,5` and `50,1234` have a decimal comma for certain, and
`1,234,567` and `1,234.5` have commas that group; `12,011` can be both. What is certain decides for the others; where
nothing is certain, two readings are possible, and the file is refused.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

from dehyst._errors import DecimalSignError, FileFormatError

SIGNS = (".", ",")
# A number with groups or with a decimal comma, which Python does not read.
WRITTEN = re.compile(r"[-+]?(?:\d+(?:[.,]\d{3})+(?:[.,]\d*)?|\d+,\d*|,\d+)(?:[eE][-+]?\d+)?")
_OTHER = {".": ",", ",": "."}
_NAMES = {".": "point", ",": "comma"}
# Bytes of a cell that a message shows.
_SHOWN = 40


class Notation(NamedTuple):
    """The decimal sign of a table, whether the other sign groups digits, and whether a cell or the user shows that."""

    decimal: str = "."
    grouped: bool = False
    shown: bool = True


class Cells:
    """The cells of a table's rows: bytes, the place at which they start, their separator.

    `where`: function of a place that returns its line and column, in words.
    """

    def __init__(self, data: bytes, start: int, delimiter: str | None, where: Callable[[int], str]) -> None:
        self.data, self.start, self.delimiter, self.where = data, start, delimiter, where
        # The last line of a file may be cut off in the middle of a number.
        self._end = data.rfind(b"\n") + 1
        if self._end <= start:
            self._end = len(data)
        # Between commas, a cell with a comma is in quotes.
        marks = {".": b".", ",": b'"' if delimiter == "," else b","}
        self._used = {sign for sign, mark in marks.items() if data.find(mark, start) >= 0}

    def find(self, kind: str, sign: str) -> str:
        """Return the first cell of a kind with a sign and its place, in words; empty if there is none."""
        if sign not in self._used or (kind == "mixed" and len(self._used) < 2):
            return ""
        match = _pattern(kind, sign, self.delimiter).search(self.data, self.start, self._end)
        if match is None:
            return ""
        return f"{self.where(match.start('number'))} holds '{match['number'][:_SHOWN].decode()}'"


def notation_of(cells: Cells, given: str | None) -> Notation:
    """Return the notation of a table's numbers; `given`: the decimal sign that the user states.

    Raise `DecimalSignError` if the cells allow both signs. Raise `FileFormatError` if there are two decimal signs, or
    another than the given one.
    """
    certain = {sign: cells.find("decimal", sign) or cells.find("mixed", sign) for sign in SIGNS}
    if given is not None:
        other = _OTHER[given]
        if contrary := certain[other] or cells.find("groups", given):
            raise FileFormatError(
                f'got the decimal sign "{given}", but {contrary}',
                hint="leave it out, or save it with one sign",
                change=("decimal",),
            )
        grouped = cells.find("groups", other) or cells.find("mixed", given) or cells.find("doubtful", other)
        return Notation(given, bool(grouped))
    if certain["."] and certain[","]:
        raise FileFormatError(
            f"{certain['.']} and {certain[',']}, need one decimal sign in a file; save it with points"
        )
    if found := next((sign for sign in SIGNS if certain[sign]), ""):
        other = _OTHER[found]
        grouped = cells.find("mixed", found) or cells.find("groups", other)
        if not grouped and (doubtful := cells.find("doubtful", other)):
            raise FileFormatError(
                f"{doubtful}, while {certain[found]} with a decimal {_NAMES[found]}",
                hint=f'if the {_NAMES[other]} groups digits there, give the decimal sign "{found}"; else save the file '
                "with one sign",
                change=("decimal",),
            )
        return Notation(found, bool(grouped))
    # No sign is a decimal sign for certain.
    groups = {sign: cells.find("groups", sign) for sign in SIGNS}
    if groups["."] and groups[","]:
        raise FileFormatError(
            f"{groups['.']} and {groups[',']}, need one sign that groups digits; save it without groups"
        )
    if found := next((sign for sign in SIGNS if groups[sign]), ""):
        return Notation(_OTHER[found], grouped=True)
    unsure = {sign: cells.find("doubtful", sign) for sign in SIGNS}
    # Numbers between commas or blanks have no other decimal sign by habit.
    if not unsure[","] and (cells.delimiter in (",", None) or not unsure["."]):
        return Notation(shown=False)
    sign = "," if unsure[","] else "."
    raise DecimalSignError(
        f"{unsure[sign]}, which is a number with three decimals or a thousand times as large: no cell shows whether "
        f"the {_NAMES[sign]} is the decimal sign or groups digits",
        hint=f'give "{sign}" if it is the decimal sign, "{_OTHER[sign]}" if it groups digits',
        change=("decimal",),
    )


def pointed(cells: Cells, notation: Notation, numbers_only: bool = False) -> bytes:
    """Return the bytes from the start on, with decimal points and without groups.

    `numbers_only`: whether commas in cells that are no numbers stay.
    """
    body, other = cells.data[cells.start :], _OTHER[notation.decimal]

    def replaced(kind: str, sign: str, by: bytes) -> bytes:
        pattern, mark = _pattern(kind, sign, cells.delimiter), sign.encode()
        return pattern.sub(lambda match: match["before"] + match["number"].replace(mark, by), body)

    if notation.grouped:
        body = replaced("grouped", other, b"")
    if notation.decimal == ".":
        return body
    if cells.delimiter == "," or numbers_only:
        return replaced("any", ",", b".")
    return body.replace(b",", b".")


@cache
def _pattern(kind: str, sign: str, delimiter: str | None) -> re.Pattern[bytes]:
    """Return the pattern of a whole cell that holds a number of a kind.

    "decimal": `sign` is its only sign, and a decimal sign. "mixed": the same behind groups. "groups": `sign` occurs
    twice, so that it groups. "doubtful": once, before three digits. "grouped": it groups, with or without decimals.
    """
    s, o, power = re.escape(sign), re.escape(_OTHER[sign]), r"(?:[eE][-+]?\d+)?"
    number = {
        "decimal": (
            rf"(?:(?:(?:0\d*|\d{{4,}}){s}\d*|{s}\d+|\d+{s}(?:\d{{1,2}}|\d{{4,}})?){power}"
            rf"|\d+{s}\d{{3}}[eE][-+]?\d+)"
        ),
        "mixed": rf"[1-9]\d{{0,2}}(?:{o}\d{{3}})+{s}\d*{power}",
        "groups": rf"[1-9]\d{{0,2}}(?:{s}\d{{3}}){{2,}}",
        "doubtful": rf"[1-9]\d{{0,2}}{s}\d{{3}}",
        "grouped": rf"[1-9]\d{{0,2}}(?:{s}\d{{3}})+(?:{o}\d*{power})?",
        "any": rf"\d*{s}\d*{power}",
    }[kind]
    # Between commas, a cell with a comma is in quotes.
    quoted = delimiter == "," and (sign == "," or kind == "mixed")
    if delimiter is None:
        before, after = r'(?<![^ \t\n])"?', r'(?="?(?:[ \t]|$))'
    elif quoted:
        before, after = r'(?:^|,) *" *', r'(?= *" *(?:,|$))'
    else:
        before, after = rf'(?:^|{delimiter})[ "]*', rf'(?=[ "]*(?:{delimiter}|$))'
    return re.compile(rf"(?m)(?P<before>{before})(?P<number>[-+]?{number}){after}".encode())
