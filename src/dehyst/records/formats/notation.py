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
_OTHER = {".": ",", ",": "."}
_NAMES = {".": "point", ",": "comma"}


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
