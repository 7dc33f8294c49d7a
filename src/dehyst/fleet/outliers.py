"""Outliers of a fleet: robust scores of what an identification measures, over all identified records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from dehyst._types import Array

# Deviations in robust standard deviations beyond which a record is listed: a normal distribution of all quantities
# would have one record in 200 000 there, one with heavy tails (Student's t, 5 degrees) 0.4 % a quantity.
THRESHOLD = 5.0
# A median absolute deviation of a normal distribution.
_MAD = 1.4826
# Fewer records have no distribution.
FEWEST = 8


class ScoredQuantity(NamedTuple):
    """A quantity: name, unit, column, whether its logarithm is taken, and the least deviation that counts as one.

    The least is in the unit, or a part of the value for a logarithm; `relative` columns are in % of the stroke.
    """

    name: str
    unit: str
    column: str
    logarithm: bool = False
    least: float = 0.0
    relative: bool = False

    def value(self, row: Mapping[str, Any]) -> float:
        """Return the value of a row; NaN without one."""
        value = row[self.column]
        if value is None:
            return float("nan")
        return 100 * float(value) / float(row["stroke_um"]) if self.relative else float(value)


QUANTITIES = (
    ScoredQuantity("RMS error", "% of the stroke", "rms_percent", logarithm=True, least=0.1),
    ScoredQuantity("noise", "% of the stroke", "noise_percent", logarithm=True, least=0.1),
    ScoredQuantity("stroke", "um", "stroke_um", logarithm=True, least=0.005),
    ScoredQuantity("width at 25 %", "% of the stroke", "width25_um", least=0.1, relative=True),
    ScoredQuantity("width at 50 %", "% of the stroke", "width50_um", least=0.1, relative=True),
    ScoredQuantity("width at 75 %", "% of the stroke", "width75_um", least=0.1, relative=True),
    ScoredQuantity("drift", "% of the stroke", "drift_percent", least=0.1),
)


@dataclass(frozen=True)
class Outlier:
    """A record with a quantity far from the fleet's median.

    `row`: the number of the `record` among those with a model. `quantity`: its name. `value` and `median` in `unit`;
    `score` in robust standard deviations.
    """

    row: int
    record: str
    quantity: str
    unit: str
    value: float
    median: float
    score: float

    @property
    def words(self) -> str:
        """The quantity beside that of the fleet."""
        return f"{self.quantity} {self.value:.3g} {self.unit} (fleet {self.median:.3g}, z {self.score:+.1f})"

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {
            "record": self.record,
            "quantity": self.quantity,
            "unit": self.unit,
            "value": self.value,
            "median": self.median,
            "z": self.score,
        }


def outliers(
    rows: Sequence[Mapping[str, Any]], names: Sequence[str], threshold: float = THRESHOLD
) -> tuple[Outlier, ...]:
    """Return what is far from the median of the fleet, the farthest first; none of a fleet of fewer than 8 records."""
    found: list[Outlier] = []
    for quantity in QUANTITIES:
        values = np.array([quantity.value(row) for row in rows])
        scores, median = robust_scores(values, quantity)
        found += [
            Outlier(k, names[k], quantity.name, quantity.unit, float(values[k]), median, float(scores[k]))
            for k in np.flatnonzero(np.abs(scores) > threshold).tolist()
        ]
    return tuple(sorted(found, key=lambda one: -abs(one.score)))


def robust_scores(values: Array, quantity: ScoredQuantity) -> tuple[Array, float]:
    """Return scores (n,) and the median: distances from it in robust standard deviations of its own side.

    Two sides, because distributions of errors and widths are skewed. A value that is not known scores 0.
    """
    known = np.isfinite(values) & ((values > 0) | (not quantity.logarithm))
    scores = np.zeros(values.size)
    if np.count_nonzero(known) < FEWEST:
        return scores, float("nan")
    x = np.log(values[known]) if quantity.logarithm else values[known]
    centre = float(np.median(x))
    off = x - centre
    for side in (-1, 1):
        distances = side * off[side * off >= 0]
        scale = max(_MAD * float(np.median(distances)), quantity.least)
        scores[np.flatnonzero(known)[side * off > 0]] = off[side * off > 0] / scale
    return scores, float(np.exp(centre)) if quantity.logarithm else centre
