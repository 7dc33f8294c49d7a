"""One line about an object, for `repr`."""

from __future__ import annotations

from dataclasses import fields
from math import floor, inf, log10

import numpy as np

from dehyst._text import counted, digits, escaped
from dehyst._types import Array


def brief(owner: object) -> str:
    """Describe a dataclass in one line, with arrays by shape and range; a class may use this as its `__repr__`."""
    parts = [f"{each.name}={_shown(getattr(owner, each.name))}" for each in fields(owner) if each.repr]  # type: ignore[arg-type]
    return f"<{type(owner).__name__}: {', '.join(parts)}>"


def _shown(value: object) -> str:
    if isinstance(value, np.ndarray):
        shape = " x ".join(map(str, value.shape))
        return f"{shape} from {value.min():.4g} to {value.max():.4g}" if value.size else "none"
    if isinstance(value, tuple) and len(value) > 2:
        return counted(len(value), "item")
    return f"{value:.6g}" if isinstance(value, float) else escaped(repr(value))


def place(value: float, width: float) -> str:
    """Return a number of a range as text, with decimals to a thousandth of the range's `width`: "16.15", "0"."""
    decimals = min(12, max(0, 3 - floor(log10(width)))) if 0 < width < inf else 6
    # NumPy rounds its numbers otherwise; the sum with 0 removes the minus of -0.
    return f"{round(float(value), decimals) + 0.0:.15g}"


def ends(low: float, high: float, unit: str = "") -> str:
    """Return a range as text, see `place`: "0 to 16.15 um"; one number if the range has no width."""
    written = [place(end, high - low) for end in (low, high)]
    return f"{' to '.join(dict.fromkeys(written))} {unit}".rstrip()


def span_of(values: Array, unit: str, factor: float = 1.0) -> str:
    """Return the range of numbers as text, "0 to 200 V"; "none" if there are no numbers."""
    if not values.size:
        return "none"
    return ends(float(values.min()) * factor, float(values.max()) * factor, unit)


def length(metres: float, *unlike: float) -> str:
    """Return a length as text in um, or in nm below 1 um, see `digits`; rounding is 0."""
    unit, size, count = ("nm", 1e-9, 3) if abs(metres) < 1e-6 else ("um", 1e-6, 4)
    return f"{digits(round(metres / size, 9), count, *(other / size for other in unlike))} {unit}"


def percent(part: float, whole: float, *unlike: float, goal: float = inf) -> str:
    """Return a ratio as text in percent; `unlike` are other parts and `goal` [%] is another ratio, as in `digits`."""
    if not (whole > 0 and np.isfinite(part)):
        return "not known"
    return f"{digits(round(100 * part / whole, 9), 2, goal, *(round(100 * x / whole, 9) for x in unlike))} %"
