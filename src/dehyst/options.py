"""Options of an identification, checked: each refusal says what was got and what is needed."""

from __future__ import annotations

from collections.abc import Collection
from math import inf, nan
from numbers import Integral, Real

from numpy.typing import ArrayLike

from dehyst._errors import IdentifyError, ModelError
from dehyst._native import Array, vector


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
