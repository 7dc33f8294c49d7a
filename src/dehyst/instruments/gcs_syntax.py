"""The client's half of PI's general command set (GCS 2.0) as text: commands, answers, recorded arrays, errors.

Written from the public command set. An answer is one or more lines; every line but the last ends with a space before
its line feed. Parsing is strict: an invalid answer raises `LinkError` with what was got.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence

import numpy as np

from dehyst._errors import LinkError, RigError
from dehyst._types import Array
from dehyst.records import GCS_END, GCS_SEPARATORS, gcs_entries

# Every controller's input buffer holds a line of this many characters.
_LINE = 500
_DECIMALS = 6
# Longer answers are cut in messages.
_SHOWN = 60

_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d{1,3})?", re.ASCII)
_INTEGER = re.compile(r"[+-]?\d{1,15}", re.ASCII)
_WORD = re.compile(r"[!-~]+")
_NAME = re.compile(r"[A-Za-z0-9_-]{1,16}")
_COMMAND = re.compile(r"(\*?[A-Z]{2,4}\??|#\d{1,2})(?=[\s{\[<(-]|$)")
_OPTION = re.compile(r"(\d{1,6})\s*=\s*(\S.*)")
_PARAMETER = re.compile(r"(\S+)\s+(?:0[xX]([0-9A-Fa-f]{1,8})|(\d{1,10}))")


def command(word: str, *arguments: object) -> str:
    """Return one line without its end; raises RigError for an argument that would break the line."""
    parts = [str(argument) for argument in arguments]
    for part in parts:
        if not _WORD.fullmatch(part):
            raise RigError(f"{word}: got the argument {part!r}, need one word of printable characters")
    return " ".join([word, *parts])


def volts(value: float, low: float = -math.inf, high: float = math.inf) -> str:
    """Return a voltage as text, rounded to 1 uV, or where this exceeds `low` or `high` [V], this limit with all digits.

    Raise `RigError` if it is not a number within `low` and `high`.
    """
    if not low <= value <= high or not math.isfinite(value):
        raise RigError(f"{value} V is not within {low:.6g} to {high:.6g} V; nothing was sent")
    # The shortest text that reads back as the same number, without an exponent and a minus before 0.
    return np.format_float_positional(min(max(round(value, _DECIMALS), low), high) + 0.0, trim="-")


def wave_points(table: int, points: Sequence[str], longest: int = _LINE) -> Iterator[str]:
    """Yield the commands that fill a wave table with points (as text), each of `longest` characters at most.

    The first clears the table (X), the others append (&).
    """
    first = 0
    while first < len(points):
        sign = "&" if first else "X"
        available = longest - len(f"WAV {table} {sign} PNT 1 {len(points)}")
        count = size = 0
        while first + count < len(points) and (size := size + 1 + len(points[first + count])) <= available:
            count += 1
        yield command("WAV", table, sign, "PNT", 1, count, *points[first : first + count])
        first += count


def line_of(raw: bytes) -> tuple[str, bool]:
    """Return the text of one line, from `raw` that ends with a line feed, and whether the answer goes on.

    Raise `LinkError` if it has no line feed, or characters that are not printable ASCII.
    """
    body = raw[:-1].removesuffix(b"\r")
    # Some controllers' lists contain tabs.
    if not raw.endswith(b"\n") or any(not 32 <= byte < 127 and byte != 9 for byte in body):
        raise LinkError(f"got {shown(raw)}, need a line of printable ASCII")
    text = body.decode("ascii")
    return text.rstrip(), text.endswith(" ")


def real(text: str) -> float:
    """Return a finite number; raises LinkError."""
    value = float(text) if _NUMBER.fullmatch(text) else math.nan
    if not math.isfinite(value):
        raise LinkError(f"got {shown(text)}, need a finite number")
    return value


def integer(text: str) -> int:
    """Return a whole number; raises LinkError."""
    if not _INTEGER.fullmatch(text):
        raise LinkError(f"got {shown(text)}, need a whole number")
    return int(text)


def error(lines: Sequence[str]) -> int:
    """Return the number in an answer of ERR?; raises LinkError."""
    return integer(single(lines))


def single(lines: Sequence[str]) -> str:
    """Return the only line of an answer; raises LinkError."""
    if len(lines) != 1 or not lines[0]:
        raise LinkError(f"got {shown(lines)}, need one line")
    return lines[0]


def pairs(lines: Sequence[str]) -> dict[str, str]:
    """Return `key=value` lines as texts; raises LinkError, also for a repeated key."""
    texts: dict[str, str] = {}
    for line in lines:
        key, equals, value = line.partition("=")
        key, value = key.strip(), value.strip()
        if not (key and equals and value) or key in texts:
            raise LinkError(f"got {shown(lines)}, need lines like 1=12.5, each key once")
        texts[key] = value
    return texts


def values(lines: Sequence[str], keys: Sequence[str]) -> list[float]:
    """Return the finite numbers of exactly these keys, in this order; raises LinkError."""
    texts = pairs(lines)
    if texts.keys() != set(keys):
        raise LinkError(f"got {shown(lines)}, need a value of {', '.join(keys)}")
    return [real(texts[key]) for key in keys]


def parameter(lines: Sequence[str], item: str, number: int) -> float:
    """Return one parameter from an answer of SPA? like `1 0x0E000200=0.00005`; raises LinkError."""
    key, _, value = single(lines).partition("=")
    match = _PARAMETER.fullmatch(key.strip())
    if not match or match[1] != item or (int(match[2], 16) if match[2] else int(match[3])) != number:
        raise LinkError(f"got {shown(lines)}, need the parameter {number:#010x} of {item}")
    return real(value.strip())


def names(lines: Sequence[str]) -> list[str]:
    """Return axes, from an answer of SAI?; raises LinkError."""
    axes = [line.strip() for line in lines]
    if len(set(axes)) != len(axes) or not axes or any(not _NAME.fullmatch(name) for name in axes):
        raise LinkError(f"got {shown(lines)}, need the names of axes, one per line")
    return axes


def commands(lines: Sequence[str]) -> frozenset[str]:
    """Return the commands that an answer of HLP? lists; raises LinkError if there are none."""
    listed = frozenset(match.group(1) for line in lines if (match := _COMMAND.match(line.strip())))
    if not listed:
        raise LinkError(f"got {shown(lines)}, need a list of commands")
    return listed


def options(lines: Sequence[str]) -> tuple[int, int] | None:
    """Return the numbers of DRC of position and voltage, from an answer of HDR?; None if it does not have both."""
    listed, within = {}, False
    for line in lines:
        if line.lstrip().startswith("#"):
            within = "recordoption" in line.lower().replace(" ", "")
        elif within and (match := _OPTION.fullmatch(line.strip())):
            listed[int(match.group(1))] = match.group(2).lower()
    found = []
    for names in (
        ("current position", "actual position", "real position"),
        ("voltage of output", "output voltage", "piezo voltage", "voltage"),
    ):
        matches = [
            # A control voltage lies before the amplifier: it comes last.
            (order, "control" in text, number)
            for order, name in enumerate(names)
            for number, text in listed.items()
            if name in text
        ]
        if not matches:
            return None
        found.append(min(matches)[-1])
    return found[0], found[1]


def shown(got: object) -> str:
    """Return the repr of an answer, cut to a length that fits a message."""
    if isinstance(got, Sequence) and not isinstance(got, str | bytes) and len(got) == 1:
        got = got[0]
    text = repr(got[: 4 * _SHOWN] if isinstance(got, str | bytes | list | tuple) else got)
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN - 15]} ... {text[-10:]}"


def table(lines: Sequence[str], rows: int, columns: int) -> tuple[float, Array]:
    """Return the time [s] from row to row and the columns (columns, rows) of an answer of DRR?, in its own units.

    Raise `LinkError` if the header is incomplete or has other sizes, or a row is not `columns` finite numbers.
    """
    stripped = [line.strip() for line in lines]
    if GCS_END not in stripped:
        raise LinkError(f"got {shown(lines)}, need an array with a header that ends {GCS_END}")
    end = stripped.index(GCS_END)
    if strange := next((line for line in stripped[:end] if not line.startswith("#")), ""):
        raise LinkError(f"got {shown(strange)} in the header of an array, need lines that begin with #")
    header = dict(gcs_entries(stripped[:end]))
    for key, needed in (("TYPE", 1), ("DIM", columns), ("NDATA", rows)):
        size = integer(header.get(key, ""))
        if size != needed:
            raise LinkError(f"got an array with {key} = {size}, need {needed}")
    sample_time = real(header.get("SAMPLE_TIME", ""))
    if sample_time <= 0:
        raise LinkError(f"got an array with SAMPLE_TIME = {sample_time}, need a time above 0 s")
    separator = integer(header.get("SEPARATOR", "32"))
    if str(separator) not in GCS_SEPARATORS:
        raise LinkError(f"got an array with SEPARATOR = {separator}, need 32 (space), 9, 44 or 59")
    words = [line.split(None if separator in (9, 32) else chr(separator)) for line in stripped[end + 1 :]]
    if len(words) != rows or {len(row) for row in words} != {columns}:
        raise LinkError(f"got {shown(stripped[end + 1 :])}, need {rows} rows of {columns} numbers; was the answer cut?")
    return sample_time, np.array([[real(word.strip()) for word in row] for row in words]).T.copy()


_NARROW = "the voltage is out of its limits, which are narrower than it reported; request narrower limits"
# Errors of the public list that the commands of this driver can cause.
ERRORS = {
    7: _NARROW,
    17: _NARROW,
    66: _NARROW,
    73: "the wave generator is in command of the axis",
    79: "open-loop commands are not allowed with the servo on",
    215: "the cable between controller and stage may be broken",
    302: _NARROW,
    333: "its hardware has failed",
    405: _NARROW,
    -1024: "the position error was too large, and it switched the servo off",
}
