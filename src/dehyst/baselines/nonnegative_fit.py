"""The fit that rivals driven by voltage share: slopes of curves on plays by nonnegative least squares."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dehyst._types import Array
from dehyst.records.metrics import rms


class Solved(NamedTuple):
    """Weights (p,), coefficients of the nuisances (B,) and the RMS residual."""

    weights: Array
    free: Array
    rms: float


def ramps(z: Array, knots: Array) -> Array:
    """Columns (n, K + 1) whose weights are the slopes of a curve through (knots[0], 0), or (0, 0) without knots."""
    edges = np.concatenate([[-np.inf], knots, [np.inf]])
    origin = knots[0] if knots.size else 0.0
    return np.asarray(np.clip(z[:, None], edges[:-1], edges[1:]) - np.clip(origin, edges[:-1], edges[1:]))


def nonnegative(
    columns: Array,
    nuisance: Array,
    target: Array,
    floors: Array | None = None,
    rough: Array | None = None,
    smoothing: float = 0.0,
) -> Solved:
    """Weights of columns, each at its floor or above, beside nuisances of any sign: least squares.

    Parameters
    ----------
    columns : (n, p) array
    nuisance : (n, B) array
    target : (n,) array
    floors : (p,) array, optional
        Least weights; by default 0.
    rough : (m, p) array, optional
        Combinations of the weights that had better be small; by default each weight.
    smoothing : float, optional
        Weight of their squares, relative to the largest mean square of a column.

    Returns
    -------
    Solved
    """
    from scipy.optimize import nnls

    count = columns.shape[1]
    least = np.zeros(count) if floors is None else floors
    scale, y_scale = float(np.sqrt(np.mean(columns**2, axis=0)).max()), float(np.ptp(target))
    rest = (target - columns @ least) / y_scale
    # What is left of a triangular factor below the nuisances' rows is the same problem without them.
    r = np.asarray(np.linalg.qr(np.column_stack([nuisance, columns / scale, rest]), mode="r"))
    r = r[nuisance.shape[1] :, nuisance.shape[1] :]
    penalty = np.sqrt(smoothing * target.size) * (np.eye(count) if rough is None else rough)
    bent = -penalty @ least * scale / y_scale
    found, _ = nnls(np.concatenate([r[:, :-1], penalty]), np.append(r[:, -1], bent), maxiter=30 * count)
    weights = least + found * y_scale / scale
    left = target - columns @ weights
    free = np.asarray(np.linalg.lstsq(nuisance, left, rcond=None)[0], dtype=np.float64)
    return Solved(weights, free, rms(left - nuisance @ free))


def differences(shape: Sequence[int], *, beside: Sequence[tuple[int, int]] = ((0, 1), (1, 0))) -> Array:
    """Rows (m, p) that take the difference of neighbours in a table whose row i has shape[i] places, row 0 left alone.

    `beside` are the neighbours' steps (rows, places).
    """
    first = np.cumsum([0, *shape])
    pairs = [
        (first[i] + j, first[i + di] + j + dj)
        for i in range(1, len(shape))
        for j in range(shape[i])
        for di, dj in beside
        if i + di < len(shape) and 0 <= j + dj < shape[i + di]
    ]
    rows = np.zeros((len(pairs), int(first[-1])))
    for row, (a, b) in zip(rows, pairs, strict=True):
        row[[a, b]] = 1.0, -1.0
    return rows
