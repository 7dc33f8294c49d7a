"""What records can tell about the stiffnesses, whatever their noise: a matter of where the motion turned."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from dehyst._native import Array
from dehyst.record import Record
from dehyst.regression import Regression
from dehyst.rows import collect
from dehyst.signals import turning_points

_MOST_ROWS = 20_000


def directions(records: list[Record], breakaway: Array, regression: Regression) -> tuple[int, int]:
    """Directions of the stiffnesses that the records determine, and how many there are.

    Noise makes every sample of a record a little different from every other, and a numerical rank of measured rows
    takes that for knowledge. So the rank is that of the paths' outlines.

    Parameters
    ----------
    records : list of Record
        Pieces without gaps, on one displacement axis.
    breakaway : (N,) array
        rho [m].
    regression : Regression
        Whose knots and movable elements count.
    """
    spacing = float(np.diff(breakaway, prepend=0.0).min())
    ends = regression.knots[[0, -1]]
    turns = [_turns(record, spacing, ends) for record in records]
    points = int(np.clip(_MOST_ROWS // max(1, sum(map(len, turns))), 20, 4 * breakaway.size + 20))
    outlines = [_outline(places, points) for places in turns if len(places) > 2]
    if not outlines:
        return 0, int(np.count_nonzero(regression.movable))
    numbered = [(q, outline, np.zeros(len(outline))) for q, outline in enumerate(outlines)]
    rows, _ = collect(numbered, breakaway, [0.0] * len(outlines))
    if not len(rows):
        return 0, int(np.count_nonzero(regression.movable))
    return replace(regression, rows=rows, datum=np.zeros(len(outlines)), drifting=()).determined()


def _turns(record: Record, spacing: float, ends: Array) -> list[float]:
    """Turning points of the displacement [m], those closer than `spacing` made one; a cycle is told thrice at most.

    Those near an end of the spring's knots are put there: the grid of elements is laid over that range.
    """
    y = record.displacement
    found = y[[0, *turning_points(y, max(spacing, 8 * record.noise)).tolist(), len(y) - 1]]
    order = np.argsort(found)
    place = found.copy()
    start = 0
    for i in range(1, order.size + 1):
        if i == order.size or found[order[i]] - found[order[start]] > spacing:
            mean = found[order[start:i]].mean()
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


def _outline(turns: list[float], points: int) -> Record:
    """Straight legs between turning points; the voltage rises and falls with the displacement."""
    legs = [np.linspace(a, b, points + 1)[1:] for a, b in pairwise(turns)]
    path = np.concatenate([[turns[0]], *legs])
    return Record(np.arange(path.size, dtype=float), path, path, "outline")
