"""Identifiability of the stiffnesses from turning points, independent of noise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from dehyst._types import Array
from dehyst.identification.regressors import RowSource
from dehyst.identification.rules import RULES
from dehyst.identification.structure import Grid, Structure
from dehyst.model import parts_in_segments
from dehyst.records import Record, turning_points

# Largest number of rows of the regression; number of elements that test turning points.
_MOST_ROWS, _PROBES = 20_000, 10
# Singular values [V/V] below this are rounding errors.
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Identifiability:
    """How many combinations of the stiffnesses records determine, with any spring and constants.

    `values` (m,): singular values of the columns of the elements that slide in some record, without the parts that
    spring and constants explain, largest first [V/V]. A value is the RMS voltage due to a change of the breakaway
    voltages by 1 V in its direction. `subject`: words for the elements, or for ten plain ones instead of a wide model.
    """

    values: Array
    subject: str = "the stiffnesses"

    @property
    def of(self) -> int:
        """Total number of directions."""
        return self.values.size

    @property
    def determined(self) -> int:
        """Number of directions that the records determine."""
        least = max(RULES.determined / max(self.of, 1) ** 2 * self.values.max(initial=0.0), _ROUNDING)
        return int(np.count_nonzero(self.values > least))


def identifiability(records: list[Record], grid: Grid) -> Identifiability:
    """Compute the directions of the stiffnesses of Maxwell-slip elements that the records determine.

    The rank is computed with straight lines between the turning points: noise would raise the rank of measured rows.

    `records`: pieces without gaps, on a common displacement axis.
    """
    rho = grid.breakaway
    spacing = float(np.diff(rho, prepend=0.0).min())
    turns = [_turns(record, spacing, grid.knots[[0, -1]]) for record in records]
    samples = int(np.clip(_MOST_ROWS // max(1, sum(map(len, turns))), 20, 4 * rho.size + 20))
    outlines = []
    for q, places in enumerate(turns):
        if len(places) > 2:
            branches = [np.linspace(a, b, samples + 1)[1:] for a, b in pairwise(places)]
            # The voltages have no effect here; the displacement stands in for them.
            path = np.concatenate([places[:1], *branches])
            outlines.append((q, Record(np.arange(float(path.size)), path, path, "outline")))
    source = RowSource.of(outlines, grid, [0.0] * len(outlines))
    values = np.zeros(np.count_nonzero(grid.movable))
    if len(source) and values.size:
        rows = source.thinned(len(source))
        constants = rows.epoch[:, None] == np.unique(rows.epoch)
        others = np.hstack([constants, parts_in_segments(grid.knots, rows.displacement)])
        others = others / np.maximum(np.abs(others).max(axis=0), np.finfo(float).tiny)
        columns = np.hstack([others, rows.elongation[:, grid.movable] / rho[grid.movable]])
        triangle = np.asarray(np.linalg.qr(columns, mode="r"))[others.shape[1] :, others.shape[1] :]
        found = np.linalg.svd(triangle, compute_uv=False) / np.sqrt(len(rows))
        values[: found.size] = found
    return Identifiability(values)


def probed(records: list[Record], span: tuple[float, float]) -> Identifiability:
    """Return the directions of ten Maxwell-slip elements over a stroke [m] that the turning points determine."""
    grid = Structure(elements=_PROBES, knots=_PROBES + 1).grid(span, span)
    return replace(identifiability(records, grid), subject="ten plain elements")


def _turns(record: Record, spacing: float, ends: Array) -> list[float]:
    """Return turning points [m]; points within `spacing` of each other or of `ends`, and equal cycles, are merged."""
    y = record.displacement
    points = y[[0, *turning_points(y, max(spacing, 8 * record.noise)).tolist(), len(y) - 1]]
    left, places = np.argsort(points), points.copy()
    while left.size:
        alike = left[: np.searchsorted(points[left], points[left[0]] + spacing, side="right")]
        mean = points[alike].mean()
        near = np.abs(ends - mean)
        places[alike] = ends[near.argmin()] if near.min() < spacing else mean
        left = left[alike.size :]
    kept: list[float] = []
    for turn in places.tolist():
        if not kept or turn != kept[-1]:
            kept.append(turn)
        if len(kept) >= 6 and kept[-6:-4] == kept[-4:-2] == kept[-2:]:
            del kept[-2:]
    return kept
