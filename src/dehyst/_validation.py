"""Numbers, arrays and options that come from outside, checked: each error states what was got and what is needed."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from math import inf, nan
from numbers import Integral, Real

import numpy as np
from numpy.typing import ArrayLike

from dehyst._computable import MOST_ADDED, demand_magnitudes
from dehyst._errors import IdentifyError, ModelError
from dehyst._types import Array
from dehyst._units import plain


def untimely(time: Array, samples: int) -> str:
    """Why times are none of so many samples: how many there are, or where they do not increase."""
    if time.size != samples:
        return f"time: got {time.size} values for {samples} samples, need one a sample"
    first = int(np.argmax(np.diff(time) <= 0)) + 1
    before, after = time[first - 1], time[first]
    return f"time: got {after:.9g} s after {before:.9g} s at value {first}, need strictly increasing times"


def vector(values: ArrayLike, what: str, unit: str | None = None) -> Array:
    """Return `values` as a contiguous one-dimensional array of finite doubles; quantities in `unit`, see `plain`.

    Raises
    ------
    ModelError
        If it has another number of dimensions, is not numeric, has another unit, or holds NaN or infinity.
    """
    return spanned(values, what, unit)[0]


def spanned(values: ArrayLike, what: str, unit: str | None = None) -> tuple[Array, float, float]:
    """Return what `vector` does, and its least and its largest value, which are finite only if all are; NaN of none."""
    array = _doubles(values, what, unit)
    if array.ndim != 1:
        raise ModelError(f"{what}: got an array of shape {array.shape}, need one dimension")
    if not array.size:
        return array, math.nan, math.nan
    low, high = float(np.minimum.reduce(array)), float(np.maximum.reduce(array))
    if not (math.isfinite(low) and math.isfinite(high)):
        bad = np.flatnonzero(~np.isfinite(array))
        raise ModelError(f"{what}: {bad.size} of {array.size} values are not finite, the first at index {bad[0]}")
    return array, low, high


def matrix(values: ArrayLike, what: str, unit: str | None = None) -> Array:
    """Return `values` as a contiguous two-dimensional array of finite doubles; raises as `vector` does."""
    array = _doubles(values, what, unit)
    if array.ndim != 2:
        raise ModelError(f"{what}: got an array of shape {array.shape}, need two dimensions")
    if not np.isfinite(array).all():
        raise ModelError(f"{what}: {np.count_nonzero(~np.isfinite(array))} of {array.size} values are not finite")
    return array


def _doubles(values: ArrayLike, what: str, unit: str | None) -> Array:
    numbers = plain(values, what, unit)
    try:
        given = np.asarray(numbers)
        if given.dtype.kind not in "iuf" and given.size:
            raise TypeError
        return np.array(given, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise ModelError(f"{what}: got {type(values).__name__}, need an array of numbers") from error


def number(value: object, what: str, unit: str | None = None) -> float:
    """Return `value` as a finite float; a quantity in `unit`, see `plain`.

    Raises
    ------
    ModelError
        If it is no number, has another unit, or is NaN or infinite.
    """
    found = plain(value, what, unit)
    if isinstance(found, Real) and not isinstance(found, bool):
        try:
            as_float = float(found)
        except OverflowError:
            as_float = math.inf
        if math.isfinite(as_float):
            return as_float
    raise ModelError(f"{what}: got {value!r}, need a finite number")


def interval(limits: Sequence[float]) -> tuple[float, float]:
    """Check voltage limits [V].

    Raises
    ------
    ModelError
        If they are not two finite numbers, the lower one first.
    """
    pair = plain(limits, "limits")
    ends = [number(end, "limits") for end in pair] if isinstance(pair, Sequence | np.ndarray) else []
    if len(ends) != 2 or ends[0] >= ends[1]:
        raise ModelError(f"limits: got {limits}, need two finite voltages, the lower one first")
    demand_magnitudes(ends, "limits [V]", MOST_ADDED)
    return ends[0], ends[1]


def demand(holds: bool, name: str, got: object, needed: str) -> None:
    """Refuse an option, in the words of every refusal here, unless something holds.

    Raises
    ------
    IdentifyError
    """
    if not holds:
        raise IdentifyError(f"{name}: got {got!r}, need {needed}")


def count(value: object, name: str, least: int = 1, most: int | None = 500) -> int:
    """Return a whole number from `least` to `most`, or without end; refuse anything else with `IdentifyError`."""
    if isinstance(value, Integral) and not isinstance(value, bool) and least <= int(value) <= (most or inf):
        return int(value)
    raise IdentifyError(f"{name}: got {value!r}, need a whole number from {least}{f' to {most}' if most else ''}")


def fraction(value: object, name: str, least: float | None = None) -> float:
    """Return a number below 1 and above 0, or from `least`; refuse anything else with `IdentifyError`."""
    holds = 0 < _real(value) < 1 if least is None else least <= _real(value) < 1
    demand(holds, name, value, "a fraction between 0 and 1" if least is None else f"a number from {least:g} to below 1")
    return _real(value)


def between(value: object, name: str, least: float, most: float, what: str = "a number") -> float:
    """Return a number from `least` to `most`; refuse anything else with `IdentifyError`, asking for `what`."""
    demand(least <= _real(value) <= most, name, value, f"{what} between {least:g} and {most:g}")
    return _real(value)


def seconds(value: object, name: str) -> float:
    """Return seconds, 0 or more; refuse anything else with `IdentifyError`."""
    demand(0 <= _real(value) < inf, name, value, "a number of seconds, 0 or more")
    return _real(value)


def numbers(values: ArrayLike, name: str) -> Array:
    """Return finite numbers (n,); refuse anything else with `IdentifyError`."""
    try:
        return vector(values, name)
    except ModelError as error:
        raise IdentifyError(str(error)) from error


def choice(value: object, name: str, among: Collection[str]) -> None:
    """Refuse with `IdentifyError` what is none of these words."""
    demand(value in among, name, value, f"one of {', '.join(among)}")


def _real(value: object) -> float:
    """Return a number as it is, and anything else as none."""
    return float(value) if isinstance(value, Real) and not isinstance(value, bool) else nan
