"""Identifiability of the stiffnesses from turning points, independent of noise."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from dehyst._types import Array
from dehyst.identification.preprocessing.regressors import collect
from dehyst.identification.regression.regression import Regression
from dehyst.identification.rules import RULES
from dehyst.identification.solvers.least_squares import triangle_of
from dehyst.identification.structure import Grid
from dehyst.records import Record, turning_points

_MOST_ROWS = 20_000
# Number of Maxwell-slip elements with which turning points are probed.
_PROBES = 10
# Smaller singular values [V/V] are rounding, also if all are.
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Identifiability:
    """How many combinations of the stiffnesses records determine, with the spring and each record's constant free.

    `values` (m,): singular values of the columns of the elements that slide in some record, all else projected out,
    largest first [V/V]: the RMS voltage of a change of 1 V of breakaway voltages in this direction, for any spring.
    `probing`: whether they belong to ten Maxwell-slip elements instead of a model with more parts, whose columns depend
    on more than turning points.
    """

    values: Array
    probing: bool = False

    @property
    def subject(self) -> str:
        """Subject of the directions, as text."""
        return "ten plain elements" if self.probing else "the stiffnesses"

    @property
    def of(self) -> int:
        """Total number of directions."""
        return self.values.size

    @property
    def determined(self) -> int:
        """Number of directions that the records determine."""
        least = max(RULES.determined / max(self.of, 1) ** 2 * self.values.max(initial=0.0), _ROUNDING)
        return int(np.count_nonzero(self.values > least))


def identifiability(records: list[Record], grid: Grid, *, relaxed: Collection[int] = ()) -> Identifiability:
    """Compute the directions of the stiffnesses that the records determine.

    Noise makes all samples of a record differ, which would raise the numerical rank of measured rows. So the rank is
    that of the outlines of the paths.

    `records`: pieces without gaps, on a common displacement axis. `relaxed`: numbers of the records that start with no
    element strained.
    """
    breakaway = grid.breakaway
    spacing = float(np.diff(breakaway, prepend=0.0).min())
    turns = [_turns(record, spacing, grid.knots[[0, -1]]) for record in records]
    points = int(np.clip(_MOST_ROWS // max(1, sum(map(len, turns))), 20, 4 * breakaway.size + 20))
    numbered = []
    for q, places in enumerate(turns):
        if len(places) > 2 or (q in relaxed and len(places) > 1):
            # Straight legs between turning points, the voltage equal to the displacement.
            legs = [np.linspace(a, b, points + 1)[1:] for a, b in pairwise(places)]
            path = np.concatenate([places[:1], *legs])
            outline = Record(np.arange(path.size, dtype=float), path, path, "outline")
            numbered.append((q, outline, np.zeros(path.size)))
    rows, _ = collect(numbered, breakaway, [0.0] * len(numbered), relaxed=relaxed)
    count = int(np.count_nonzero(grid.movable))
    if not len(rows) or not count:
        return Identifiability(np.zeros(count))
    values = np.linalg.svd(projected(Regression(rows, grid, 0.0, np.zeros(len(records)))))[1]
    padded = np.zeros(count)
    padded[: values.size] = values / np.sqrt(len(rows))
    return Identifiability(padded)


def projected(regression: Regression) -> Array:
    """Return columns of the movable elements over their rho, all others projected out: a triangle (m, m)."""
    grid, others = regression.grid, np.hstack([regression.nuisances(), regression.spring_parts])
    others = others / np.maximum(np.abs(others).max(axis=0), np.finfo(float).tiny)
    slip = regression.rows.elongation[:, grid.movable] / grid.breakaway[grid.movable]
    triangle = triangle_of(np.hstack([others, slip]))
    return triangle[others.shape[1] :, others.shape[1] :]


def probed(records: list[Record], span: tuple[float, float]) -> Identifiability:
    """Return the directions of ten Maxwell-slip elements over a stroke [m] that the turning points determine.

    A structure with more parts has more coefficients than records determine; smoothing settles the rest. If ten slip
    elements stay open, smoothing cannot predict loops that turn elsewhere.
    """
    stroke = span[1] - span[0]
    rho = 0.5 * stroke / _PROBES * np.arange(1.0, _PROBES + 1)
    grid = Grid.maxwell_slip(rho, np.linspace(*span, _PROBES + 1), 2 * rho < stroke * (1 - 1e-9))
    return replace(identifiability(records, grid), probing=True)


def _turns(record: Record, spacing: float, ends: Array) -> list[float]:
    """Return the turning points of the displacement [m], closer ones than `spacing` merged, at most three equal cycles.

    Those near an end of the spring's knots are moved there: the grid of elements covers that range.
    """
    y = record.displacement
    points = y[[0, *turning_points(y, max(spacing, 8 * record.noise)).tolist(), len(y) - 1]]
    order = np.argsort(points)
    place = points.copy()
    start = 0
    for i in range(1, order.size + 1):
        if i == order.size or points[order[i]] - points[order[start]] > spacing:
            mean = points[order[start:i]].mean()
            near = np.abs(ends - mean)
            place[order[start:i]] = ends[near.argmin()] if near.min() < spacing else mean
            start = i
    kept: list[float] = []
    for turn in place.tolist():
        if not kept or turn != kept[-1]:
            kept.append(turn)
        if len(kept) >= 6 and kept[-6:-4] == kept[-4:-2] == kept[-2:]:
            del kept[-2:]
    return kept
