"""Conversion of quantities with units to plain numbers; an unknown unit is an error and never dropped."""

from __future__ import annotations

from collections.abc import Mapping
from inspect import isroutine
from typing import Any

import numpy as np

from dehyst._errors import DehystError, ModelError


def _named(unit: str, names: str) -> dict[str, str]:
    return dict.fromkeys(names.split(", "), unit)


# The name of a value where it enters, and its unit. A name that is missing here takes plain numbers only.
# Frequencies are missing on purpose: libraries of units convert rad/s to Hz without the factor 2 pi.
UNITS = {
    **_named("V", "voltage, limits, peaks, wave, state: voltage, spring voltages, transformer knots"),
    **_named("V", "transformer drives, thresholds, present, base"),
    **_named("m", "displacement, trajectory, state: displacement, carts, creep strains, elongation"),
    **_named("m", "smooth elongations, smooth elements: length, breakaway, breakaway elongations"),
    **_named("m", "spring knots, grade knots"),
    **_named("s", "time, delay, lag, period, hold, ramp, settle, dwell, approach, seconds, creep time constants"),
    **_named("s", "times, lowpasses"),
    **_named("V/m", "stiffnesses, creep stiffnesses, smooth elements: stiffness"),
    **_named("N/m", "load_stiffness, mechanical_stiffness, electrical_stiffness"),
    "transformer_ratio": "N/V",
    "load": "N",
    "temperature": "degC",
    "velocity": "m/s",
    "speed": "m/s",
    "acceleration": "m/s**2",
    **_named("V/s", "slew_rate, recorded_slew_rate"),
    "sample_rate": "Hz",
}
# Units that need no library, by the unit that they convert to: how many of each make one of it, and zeros of scales.
COUNTS = {
    "m": {"m": 1.0, "mm": 1e3, "um": 1e6, "µm": 1e6, "μm": 1e6, "nm": 1e9, "pm": 1e12},
    "s": {"s": 1.0, "ms": 1e3, "us": 1e6, "µs": 1e6, "μs": 1e6, "ns": 1e9, "min": 1 / 60},
    "V": {"V": 1.0, "mV": 1e3, "kV": 1e-3},
    "degC": {"degC": 1.0, "°C": 1.0, "C": 1.0, "K": 1.0, "degF": 1.8, "°F": 1.8, "F": 1.8},
    "N": {"N": 1.0, "mN": 1e3, "uN": 1e6, "µN": 1e6, "μN": 1e6, "kN": 1e-3},
}
# Temperatures of a laboratory [degC].
COLDEST, HOTTEST = -273.15, 1000.0
_ZEROS = {"K": 273.15, "degF": 32.0, "°F": 32.0, "F": 32.0}
# The quantities and their units: SI units (degC) in one of each.
SI = {"time": "s", "voltage": "V", "displacement": "m", "temperature": "degC", "load": "N"}
FACTORS = {quantity: {unit: 1 / count for unit, count in COUNTS[si].items()} for quantity, si in SI.items()}
# The words for the units, in lower case; a symbol counts more.
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
_PLAIN = frozenset({float, int, bool, str, bytes, type(None), np.float64, np.float32, np.int64, np.int32, np.bool_})


def plain(values: Any, what: str, unit: str | None = None, *, error: type[DehystError] = ModelError) -> Any:
    """Return values without units: unchanged if they have no units, otherwise converted.

    An object has units if it, or an object in it, has an attribute `units` or `unit`, as in pint, astropy, unyt and
    quantities.

    `values`: a number, an array, a list. `what`: its name in messages. `unit`: the unit to convert to; by default the
    unit of the name in `UNITS`. Raise `error` if a unit cannot be converted, no unit is known for the name, or a value
    is masked or complex.
    """
    kind = type(values)
    if kind in _PLAIN or (kind is np.ndarray and values.dtype.kind not in "Oc"):
        return values
    unit = UNITS.get(what) if unit is None else unit
    if isinstance(values, list | tuple):
        plain_already = _PLAIN.issuperset(map(type, values))
        return values if plain_already else [plain(value, what, unit, error=error) for value in values]
    _refuse_masked(values, what, error)
    stored = getattr(getattr(values, "dtype", None), "kind", "")
    if stored == "c":
        raise error(argument=what, got="complex numbers", need="real ones", hint="give their real part, or magnitude")
    # What has units is the object or what it wraps, but not the memory of an array, which is called `data` too.
    inner = None if isinstance(values, np.ndarray) else getattr(values, "data", None)
    for candidate in (inner, values):
        if _unit_of(candidate):
            return _converted(candidate, what, unit, error)
    if stored == "O":
        objects = np.asarray(values)
        return plain(objects.tolist(), what, unit, error=error) if objects.ndim else values
    return values


def _refuse_masked(values: Any, what: str, error: type[DehystError]) -> None:
    mask = getattr(values, "mask", None)
    # That of a table or a series of pandas is a method.
    if isinstance(mask, np.ndarray | np.bool_ | bool) and np.any(mask):
        raise error(argument=what, got="an array with masked values", need="all of them")


def _unit_of(values: Any) -> str:
    attributes = (getattr(values, name, None) for name in ("units", "unit"))
    return next((str(unit) for unit in attributes if unit is not None and not isroutine(unit)), "")


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
    # Dividing by 1e6 rounds once, multiplying by 1e-6 twice.
    return above / count if count > 1 else above * (1 / count)


def per_metre(units: str, *, error: type[DehystError] = ModelError) -> float:
    """Return how many of a unit of length make one metre: 1e6 for "um"; raise `error` for another word."""
    if not isinstance(units, str) or units not in COUNTS["m"]:
        known = ", ".join(f"'{name}'" for name in COUNTS["m"] if name.isascii())
        raise error(f"units: got {units!r}, need a unit of length: one of {known}")
    return COUNTS["m"][units]


def _converted(quantity: Any, what: str, unit: str | None, error: type[DehystError]) -> Any:
    got = _unit_of(quantity)
    if unit is None:
        raise error(argument=what, got=f"a quantity in {got}", need="plain numbers without a unit")
    methods = (getattr(quantity, name, None) for name in ("to_value", "to", "rescale"))
    convert = next((method for method in methods if callable(method)), None)
    if convert is None and got == unit:
        return plain(np.asarray(getattr(quantity, "values", quantity)), what, unit, error=error)
    refusal = f"{what}: got a quantity in {got}, need one that can be converted to {unit}, or plain numbers in {unit}"
    if convert is None:
        known = next((counts for counts in COUNTS.values() if got in counts and unit in counts), {})
        if known and not {got, unit} & _ZEROS.keys() and isinstance(getattr(quantity, "attrs", None), Mapping):
            # An array of xarray, whose unit is a word among its attributes.
            return plain(np.asarray(quantity.values) / (known[got] / known[unit]), what, unit, error=error)
        raise error(refusal)
    try:
        converted = convert(unit)
    except Exception as cause:  # Libraries of units have no error in common.
        raise error(refusal) from cause
    for name in ("magnitude", "value"):
        converted = getattr(converted, name, converted)
    if _unit_of(converted):
        raise error(refusal)
    _refuse_masked(converted, what, error)
    return np.asarray(converted)[()]
