"""Whether displacements and voltages may be meant for a model: most that lie far outside of it have another unit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dehyst._types import Array

# Largest magnitude over that of the range from which on a displacement is more likely in another unit.
_UNITS = ((1e2, "millimetres"), (3e4, "micrometres"), (3e7, "nanometres"))
ANYWAY = "or pass extrapolate=True to compute it anyway"


@dataclass(frozen=True)
class Range:
    """Displacements [m] or voltages [V] that a model is made for, the lower end first."""

    low: float
    high: float

    def joined(self, *others: tuple[float, float]) -> Range:
        """The range that holds the others too."""
        return Range(min([self.low, *(low for low, _ in others)]), max([self.high, *(high for _, high in others)]))

    def strays(self, low: float, high: float) -> bool:
        """Whether one of two numbers lies farther outside than the range is wide."""
        width = self.high - self.low
        return low < self.low - width or high > self.high + width

    def astray(self, values: Array) -> tuple[float, float] | None:
        """Least and largest of values (n,) if one of them lies farther outside than the range is wide, else None."""
        if not values.size:
            return None
        low, high = float(np.minimum.reduce(values)), float(np.maximum.reduce(values))
        return (low, high) if self.strays(low, high) else None


def displacement_words(got: tuple[float, float], reach: Range) -> str:
    """What is wrong with displacements [m] that stray from the reach of a model."""
    ratio = max(map(abs, got)) / max(abs(reach.low), abs(reach.high), reach.high - reach.low)
    reaches = f"the model reaches {_ends(1e6 * reach.low, 1e6 * reach.high, 4)} um"
    if ratio <= _UNITS[0][0]:
        return (
            f"displacement: got {_ends(1e6 * got[0], 1e6 * got[1])} um, {reaches}; both count from the sensor's zero "
            "in the records that it was identified from"
        )
    unit = [name for least, name in _UNITS if ratio > least][-1]
    return f"displacement: got {_ends(*got)} m, {reaches}; is this in {unit}? Need metres"


def voltage_words(got: tuple[float, float], identified: Range) -> str:
    """What is wrong with voltages [V] that stray from those that a model was identified from."""
    return (
        f"voltage: got {_ends(*got)} V, the model was identified from {_ends(identified.low, identified.high)} V; "
        "check the unit, and that the model is of this actuator"
    )


def _ends(low: float, high: float, digits: int = 6) -> str:
    return f"{low:.{digits}g}" if low == high else f"{low:.{digits}g} to {high:.{digits}g}"
