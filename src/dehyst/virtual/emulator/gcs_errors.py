"""The public error numbers of GCS 2.0, and the reading of arguments, which raises them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import IntEnum

from dehyst._errors import DehystError


class GcsError(IntEnum):
    """Error numbers that ERR? returns."""

    NONE = 0
    SYNTAX = 1
    UNKNOWN_COMMAND = 2
    TOO_LONG = 3
    SERVO_OFF = 5
    POSITION = 7
    STOPPED = 10
    AXIS = 15
    PARAMETER_RANGE = 17
    PARAMETER_COUNT = 24
    NOT_A_NUMBER = 25
    MISSING = 26
    UNKNOWN_PARAMETER = 54
    RECORD_TABLE = 57
    RECORD_OPTION = 58
    WAVE_TOO_LARGE = 67
    WAVE_RUNNING = 73
    NO_WAVE_SELECTED = 75
    NOT_RECORDED = 77
    SERVO_ON = 79
    BROKEN_CABLE = 215
    VOLTAGE = 302
    WAVE_WITH_SERVO = 303


class CommandError(DehystError):
    """A refused command; its error number is latched until ERR?."""

    def __init__(self, error: GcsError) -> None:
        super().__init__(f"error {error.value}: {error.name.lower().replace('_', ' ')}")
        self.error = error


def demand(holds: bool, error: GcsError) -> None:
    """Raise CommandError unless `holds`."""
    if not holds:
        raise CommandError(error)


def real(word: str) -> float:
    """Read a finite number."""
    try:
        value = float(word)
    except ValueError:
        raise CommandError(GcsError.NOT_A_NUMBER) from None
    # Python accepts more as numbers than a controller does.
    demand(math.isfinite(value) and word.isascii() and "_" not in word, GcsError.NOT_A_NUMBER)
    return value


def whole(word: str, least: int = 0, most: int | None = None, error: GcsError = GcsError.PARAMETER_RANGE) -> int:
    """Read a whole number, decimal or with 0x, from `least` to `most`."""
    try:
        value = int(word, 16 if word.lower().startswith("0x") else 10)
    except ValueError:
        raise CommandError(GcsError.NOT_A_NUMBER) from None
    demand(least <= value and (most is None or value <= most), error)
    return value


def demand_count(words: Sequence[str], least: int, most: int | None = None) -> None:
    """Raise CommandError for too few or too many arguments; by default `most` is `least`."""
    demand(len(words) >= least, GcsError.MISSING)
    demand(len(words) <= (least if most is None else most), GcsError.PARAMETER_COUNT)


def numeral(value: float) -> str:
    """Write a number as controllers do, with enough digits."""
    return f"{value:.12g}"


def lines(*texts: str) -> str:
    """Join the lines of an answer: all but the last end with a space."""
    return " \n".join(texts) + "\n"
