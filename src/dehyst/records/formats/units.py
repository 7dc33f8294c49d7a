"""The units of columns, in the words of instruments and programs, and the scales of amplifiers and sensors."""

from __future__ import annotations

import re
from math import isfinite
from typing import NamedTuple

import numpy as np

from dehyst._errors import FileFormatError
from dehyst._types import Array

UNITS: dict[str, dict[str, float]] = {
    "time": {"s": 1, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ns": 1e-9, "min": 60},
    "voltage": {"V": 1, "mV": 1e-3, "kV": 1e3},
    "displacement": {"m": 1, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6, "nm": 1e-9, "pm": 1e-12},
}
# The words for the units, in lower case; a symbol in the name of a column counts more.
_WORDS = {
    word: symbol
    for symbol, words in {
        "s": "second seconds sec secs sekunde sekunden",
        "ms": "millisecond milliseconds msec millisekunde millisekunden",
        "us": "microsecond microseconds usec",
        "ns": "nanosecond nanoseconds nsec",
        "min": "minute minutes minuten",
        "V": "volt volts",
        "mV": "millivolt millivolts",
        "kV": "kilovolt kilovolts",
        "m": "meter meters metre metres",
        "mm": "millimeter millimeters millimetre millimetres",
        "um": "micrometer micrometers micrometre micrometres micron microns mikrometer",
        "nm": "nanometer nanometers nanometre nanometres",
        "pm": "picometer picometers picometre picometres",
    }.items()
    for word in words.split()
}
_SCALE = re.compile(r"\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*([^\W\d]+)\s*/\s*([^\W\d]+)\s*")
_EXAMPLES = {"voltage": "100 V/V", "displacement": "10 um/V"}
# Largest voltage [V] and range of strokes [m] of piezo actuators: no hint leads outside of them.
HIGHEST_VOLTAGE, STROKES = 1500.0, (1e-9, 1e-3)
_USUAL = {"time": ("s", "ms"), "voltage": ("V", "mV"), "displacement": ("um", "nm", "mm", "m")}
# A stroke of many piezo actuators [m].
_STROKE = 1e-5


def symbol_of(unit: str) -> str:
    """Return the symbol for a unit that is written as a symbol or a word, with or without brackets; "" if unknown."""
    bare = unit.strip().strip("[]()").strip()
    if any(bare in known for known in UNITS.values()):
        return bare
    return _WORDS.get(bare.lower(), "")


def quantity_of(unit: str) -> str:
    """Return the quantity of a unit; "" if it is unknown."""
    symbol = symbol_of(unit)
    return next((quantity for quantity, known in UNITS.items() if symbol in known), "")


class Scale(NamedTuple):
    """The scale of an amplifier's monitor or of a sensor.

    `factor`: SI units of the quantity for one volt (or one `per`) at the plug. `per`: the unit of the column if the
    file states none. `words`: the scale as it was given.
    """

    factor: float
    per: str
    words: str

    def refusal(self, unit: str) -> str:
        """Return why a column of this unit cannot be scaled; empty if it can."""
        return "" if quantity_of(unit) == quantity_of(self.per) else f"the scale {self.words} is for {self.per}"

    def apply(self, unit: str) -> float:
        """Return what one `unit` of the column means in SI units of the quantity."""
        known = UNITS[quantity_of(self.per)]
        return self.factor * known[symbol_of(unit)] / known[self.per]


def scale_of(quantity: str, text: str) -> Scale:
    """Parse a scale as "100 V/V" or "10 um/V".

    Raises
    ------
    FileFormatError
        It is no number with two units, its first unit is not of the quantity, or the number is 0 or not finite.
    """
    got = f"'{text}'" if isinstance(text, str) else repr(text)
    what = f"{quantity}_scale: got {got}, need a number with two units, as in '{_EXAMPLES[quantity]}'"
    match = _SCALE.fullmatch(text) if isinstance(text, str) else None
    if match is None:
        point = "; with a decimal point" if "," in str(text) else ""
        raise FileFormatError(f"{what}{point}")
    try:
        number, unit, per = float(match[1]), symbol_of(match[2]), symbol_of(match[3])
    except ValueError as error:
        raise FileFormatError(what) from error
    if not isfinite(number) or number == 0:
        raise FileFormatError(f"{what}; the number is finite and not 0")
    if unit not in UNITS[quantity]:
        raise FileFormatError(f"{what}; the first unit is one of {', '.join(UNITS[quantity])}")
    if not per:
        raise FileFormatError(f"{what}; the second unit is that of the file, V or mV for instance")
    return Scale(number * UNITS[quantity][unit], per, f"{match[1]} {match[2]}/{match[3]}")


def plausible_unit(quantity: str, data: Array) -> str:
    """Return the most likely unit in which a column is plausible for a piezo actuator; empty if there is none."""
    with np.errstate(all="ignore"):
        size = float(np.ptp(data)) if quantity == "displacement" else float(np.abs(data).max(initial=0.0))
    sizes = {unit: size * UNITS[quantity][unit] for unit in _USUAL[quantity]}
    low, high = {"displacement": STROKES, "voltage": (0.0, HIGHEST_VOLTAGE), "time": (0.0, 1e7)}[quantity]
    plausible = [unit for unit, value in sizes.items() if low <= value <= high]
    if quantity != "displacement" or 0.01 * _STROKE <= sizes["um"] <= 100 * _STROKE:
        return plausible[0] if plausible else ""
    return min(plausible, key=lambda unit: abs(np.log10(sizes[unit] / _STROKE)), default="")
