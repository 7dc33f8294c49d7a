"""Quantities with units: converted to plain numbers in the unit that is computed with, or refused; never stripped."""

from __future__ import annotations

from inspect import isroutine
from typing import Any

import numpy as np

from dehyst._errors import ModelError

# What a value is called where it enters, and its unit. A name that is missing here takes plain numbers only.
# Frequencies are missing on purpose: libraries of units convert rad/s to Hz without the factor 2 pi.
UNITS = {
    **dict.fromkeys(
        (
            "voltage",
            "limits",
            "peaks",
            "wave",
            "state: voltage",
            "spring voltages",
            "transformer knots",
            "transformer drives",
            "thresholds",
            "present",
            "base",
        ),
        "V",
    ),
    **dict.fromkeys(
        (
            "displacement",
            "trajectory",
            "state: displacement",
            "carts",
            "creep strains",
            "elongation",
            "smooth elongations",
            "smooth elements: length",
            "breakaway",
            "breakaway elongations",
            "spring knots",
            "grade knots",
        ),
        "m",
    ),
    **dict.fromkeys(
        (
            "time",
            "delay",
            "lag",
            "period",
            "hold",
            "ramp",
            "settle",
            "dwell",
            "approach",
            "seconds",
            "creep time constants",
            "times",
            "lowpasses",
        ),
        "s",
    ),
    **dict.fromkeys(("stiffnesses", "creep stiffnesses", "smooth elements: stiffness"), "V/m"),
    **dict.fromkeys(("load_stiffness", "mechanical_stiffness", "electrical_stiffness"), "N/m"),
    "transformer_ratio": "N/V",
    "load": "N",
    "velocity": "m/s",
    "speed": "m/s",
    "acceleration": "m/s**2",
    "slew_rate": "V/s",
    "sample_rate": "Hz",
}
_PLAIN = frozenset({float, int, bool, str, bytes, type(None), np.float64, np.float32, np.int64, np.int32, np.bool_})


def plain(values: Any, what: str, unit: str | None = None) -> Any:
    """Return values without units: as they are if they have none, otherwise converted.

    An object has units if it has an attribute `units` or `unit`, as those of pint, astropy, unyt and quantities, or if
    such objects are in it.

    Parameters
    ----------
    values : Any
        A number, an array, a list.
    what : str
        Its name in messages.
    unit : str, optional
        The unit to convert to; by default that of the name in `UNITS`.

    Raises
    ------
    ModelError
        If the unit cannot be converted, none is known for the name, or a value is masked.
    """
    kind = type(values)
    if kind in _PLAIN or (kind is np.ndarray and values.dtype.kind != "O"):
        return values
    unit = UNITS.get(what) if unit is None else unit
    if isinstance(values, list | tuple):
        return values if _PLAIN.issuperset(map(type, values)) else [plain(value, what, unit) for value in values]
    _refuse_masked(values, what)
    quantity = _quantity(values)
    if quantity is not None:
        return _converted(quantity, what, unit)
    if getattr(getattr(values, "dtype", None), "kind", "") == "O":
        objects = np.asarray(values)
        return plain(objects.tolist(), what, unit) if objects.ndim else values
    return values


def _refuse_masked(values: Any, what: str) -> None:
    mask = getattr(values, "mask", None)
    # That of a table or a series of pandas is a method.
    if isinstance(mask, np.ndarray | np.bool_ | bool) and np.any(mask):
        raise ModelError(f"{what}: got an array with masked values, need all of them")


def _quantity(values: Any) -> Any:
    """What has the units: the object, or what it is wrapped around; None if nothing has."""
    # Not the memory of an array, which is called `data` too.
    inner = None if isinstance(values, np.ndarray) else getattr(values, "data", None)
    return next((one for one in (inner, values) if _unit_of(one)), None)


def _unit_of(values: Any) -> str:
    found = (getattr(values, name, None) for name in ("units", "unit"))
    return next((str(unit) for unit in found if unit is not None and not isroutine(unit)), "")


def _converted(quantity: Any, what: str, unit: str | None) -> Any:
    got = _unit_of(quantity)
    if unit is None:
        raise ModelError(f"{what}: got a quantity in {got}, need plain numbers without a unit")
    methods = (getattr(quantity, name, None) for name in ("to_value", "to", "rescale"))
    convert = next((method for method in methods if callable(method)), None)
    if convert is None and got == unit:
        return plain(np.asarray(getattr(quantity, "values", quantity)), what, unit)
    refusal = f"{what}: got a quantity in {got}, need one that can be converted to {unit}, or plain numbers in {unit}"
    if convert is None:
        raise ModelError(refusal)
    try:
        found = convert(unit)
    except Exception as error:  # Libraries of units have no error in common.
        raise ModelError(refusal) from error
    for name in ("magnitude", "value"):
        found = getattr(found, name, found)
    if _unit_of(found):
        raise ModelError(refusal)
    _refuse_masked(found, what)
    return np.asarray(found)[()]
