"""Units in the headers of files and in the names of columns, and their conversion to SI units."""

from __future__ import annotations

from typing import Any

from dehyst._errors import DehystError, ModelError

# For each SI unit (degC), how many of each other unit make one of it; and the zeros of temperature scales.
COUNTS = {
    "m": {"m": 1.0, "mm": 1e3, "um": 1e6, "µm": 1e6, "μm": 1e6, "nm": 1e9, "pm": 1e12},
    "s": {"s": 1.0, "ms": 1e3, "us": 1e6, "µs": 1e6, "μs": 1e6, "ns": 1e9, "min": 1 / 60},
    "V": {"V": 1.0, "mV": 1e3, "kV": 1e-3},
    "degC": {"degC": 1.0, "°C": 1.0, "C": 1.0, "K": 1.0, "degF": 1.8, "°F": 1.8, "F": 1.8},
    "N": {"N": 1.0, "mN": 1e3, "uN": 1e6, "µN": 1e6, "μN": 1e6, "kN": 1e-3},
}
# Possible temperatures in a laboratory [degC].
COLDEST, HOTTEST = -273.15, 1000.0
_ZEROS = {"K": 273.15, "degF": 32.0, "°F": 32.0, "F": 32.0}
# The quantities, each with its SI unit (degC).
SI = {"time": "s", "voltage": "V", "displacement": "m", "temperature": "degC", "load": "N"}
FACTORS = {quantity: {unit: 1 / count for unit, count in COUNTS[si].items()} for quantity, si in SI.items()}
# The words for the units, in lower case; a symbol has priority.
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
        "degC": "celsius centigrade degc",
        "K": "kelvin",
        "degF": "fahrenheit degf",
        "N": "newton newtons",
        "mN": "millinewton millinewtons",
    }.items()
    for word in words.split()
}


def symbol_of(unit: str) -> str:
    """Return the symbol for a unit that is written as a symbol or a word, with or without brackets; "" if unknown."""
    bare = unit.strip().strip("[]()").strip()
    return bare if any(bare in known for known in COUNTS.values()) else _WORDS.get(bare.lower(), "")


def quantity_of(unit: str) -> str:
    """Return the quantity that a unit measures, as in `SI`; "" if the unit is unknown."""
    symbol = symbol_of(unit)
    return next((quantity for quantity, known in FACTORS.items() if symbol in known), "")


def in_si(values: Any, unit: str) -> Any:
    """Convert values from a unit symbol of `COUNTS` to SI units, or to degC."""
    count = next(known[unit] for known in COUNTS.values() if unit in known)
    above = values - _ZEROS[unit] if unit in _ZEROS else values
    # Division by 1e6 rounds once, multiplication by 1e-6 twice.
    return above if count == 1 else above / count if count > 1 else above * (1 / count)


def per_metre(units: str, *, error: type[DehystError] = ModelError) -> float:
    """Return how many of a unit of length make one metre: 1e6 for "um"; raise `error` for an unknown unit."""
    if not isinstance(units, str) or units not in COUNTS["m"]:
        known = ", ".join(f"'{name}'" for name in COUNTS["m"] if name.isascii())
        raise error(f"units: got {units!r}, need a unit of length: one of {known}")
    return COUNTS["m"][units]
