"""Inequalities of the program beside its bounds: what tau, starts of creep and graded elements must keep."""

from __future__ import annotations

import numpy as np

from dehyst._types import Array
from dehyst.model.structure import Grid

# Inequalities that one round adds at most, and how far [of the floor] one may be violated.
_ADDED = 40
_VIOLATED = 1e-6


def bounds(grid: Grid, records: int, unknowns: int, least: float) -> tuple[Array, Array]:
    """Return what the last segment of tau has left to give, and starts of creep that a branch can hold.

    Parameters
    ----------
    grid : Grid
    records : int
        Records that may begin strained.
    unknowns : int
        Unknowns of the program that are not negative.
    least : float
        Least slope of tau.

    Returns
    -------
    (p, unknowns) array, (p,) array
        matrix and lower of ``matrix x >= lower``.
    """
    lengths, branches = np.diff(grid.drive), grid.time_constants.size
    spring = int(np.count_nonzero(grid.movable)) * grid.segments
    creep, starts = spring + grid.knots.size - 1, unknowns - 2 * records * branches
    rows = []
    if lengths.size:
        rows.append(np.zeros(unknowns))
        rows[-1][starts - (lengths.size - 1) : starts] = -lengths[:-1]
    for k in range(records * branches):
        rows.append(np.zeros(unknowns))
        rows[-1][creep + k % branches] = float(np.ptp(grid.knots))
        rows[-1][[starts + k, starts + records * branches + k]] = -1
    lower = np.zeros(len(rows))
    lower[: bool(lengths.size)] = -(1 - least) * float(lengths.sum())
    return np.array(rows).reshape(-1, unknowns), lower


def violated(grid: Grid, x: Array, floor: float) -> Array:
    """Return the outermost branches that rise least at the unknowns x (q,), of those that do not rise enough."""
    rising = grid.outermost
    value = rising @ x[: rising.shape[1]]
    worst = np.argsort(value, kind="stable")[:_ADDED]
    return np.asarray(rising[worst[value[worst] < -_VIOLATED * floor]])
