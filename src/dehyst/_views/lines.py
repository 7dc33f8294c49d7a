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


def ends(low: float, high: float, unit: str) -> str:
    """Return an interval as text, with decimals down to a thousandth of its width: "-0.003 to 16.154 um"."""
    width = abs(high - low)
    decimals = min(12, max(0, 3 - floor(log10(width)))) if 0 < width < inf else 6
    written = [f"{end:.{decimals}f}" if abs(end) < 1e15 else f"{end:.6g}" for end in (low, high)]
    # Without zeros at the end, and without a minus before nothing.
    low_, high_ = (str(float(text)).removesuffix(".0") if "e" not in text else text for text in written)
    return f"{low_.removeprefix('-') if float(low_) == 0 else low_} to {high_} {unit}"


def span_of(values: Array, unit: str, factor: float = 1.0) -> str:
    """Return the range of numbers as text, "0 to 200 V"; "none" if there are no numbers."""
    if not values.size:
        return "none"
    return ends(float(values.min()) * factor, float(values.max()) * factor, unit)


def length(metres: float) -> str:
    """Return a length as text in um, or in nm below 1 um."""
    return f"{metres * 1e9:.3g} nm" if abs(metres) < 1e-6 else f"{metres * 1e6:.4g} um"


def percent(part: float, whole: float) -> str:
    """Return a ratio as text in percent with two digits; "not known" if it is not a number."""
    if not (whole > 0 and np.isfinite(part)):
        return "not known"
    return f"{digits(100 * part / whole)} %"
