"""The fit that rivals driven by voltage share: slopes of curves on plays by nonnegative least squares."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dehyst._native import Array

_QUARTERS = 4


@dataclass(frozen=True, eq=False)
class Rows:
    """Samples that count, of all records, stacked.

    Attributes
    ----------
    plays : (n, N) array
        Outputs z_i [V].
    known : (n, N) bool array
        Whether play i is in a known state: else it stands still.
    lowpasses : (n, K) array
        Outputs [V].
    offsets, drifts : (n, E) and (n, D) array
        Columns of what records cannot be told without: a constant for each stretch, creep since a record's start.
    displacement : (n,) array
        [m].
    """

    plays: Array
    known: NDArray[np.bool_]
    lowpasses: Array
    offsets: Array
    drifts: Array
    displacement: Array

    def __len__(self) -> int:
        return len(self.displacement)

    @property
    def nuisance(self) -> Array:
        """Offsets and drifts."""
        return np.concatenate([self.offsets, self.drifts], axis=1)

    def ramps(self, knots: Sequence[Array]) -> Array:
        """Columns (n, p) of the slopes of each play's curve, and of the low-passes; plays not known are left out."""
        curves = [ramps(z, k) * known[:, None] for z, k, known in zip(self.plays.T, knots, self.known.T, strict=True)]
        return np.concatenate([*curves, self.lowpasses], axis=1)

    def thinned(self, most: int) -> Rows:
        """About `most` of the rows, evenly."""
        step = max(1, len(self) // most)
        if step == 1:
            return self
        return Rows(*(getattr(self, name)[::step] for name in self.__dataclass_fields__))


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
) -> tuple[Array, float]:
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
    weights : (p,) array
    rms : float
        Of the residual, the nuisances at their best.
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
    miss = float(np.linalg.norm(r[:, :-1] @ found - r[:, -1]))
    return least + found * y_scale / scale, miss * y_scale / np.sqrt(target.size)


def differences(shape: Sequence[int], *, beside: Sequence[tuple[int, int]] = ((0, 1), (1, 0))) -> Array:
    """Rows (m, p) that take the difference of neighbours in a table whose row i has shape[i] places, row 0 left alone.

    `beside` are the neighbours' steps (rows, places).
    """
    first = np.cumsum([0, *shape])
    pairs = [(first[i] + j, first[i + di] + j + dj)
             for i in range(1, len(shape)) for j in range(shape[i]) for di, dj in beside
             if i + di < len(shape) and 0 <= j + dj < shape[i + di]]  # fmt: skip
    rows = np.zeros((len(pairs), int(first[-1])))
    for row, (a, b) in zip(rows, pairs, strict=True):
        row[[a, b]] = 1.0, -1.0
    return rows


def left_out(rows: Rows, columns: Array, floors: Array, rough: Array, smoothing: float) -> float:
    """RMS [m] over quarters of the stretches, each left out of a fit that then predicts it, but for its offset."""
    blocks = np.zeros(len(rows), dtype=np.intp)
    for offset in rows.offsets.T:
        stretch = np.flatnonzero(offset)
        blocks[stretch] = np.arange(stretch.size) * _QUARTERS // max(stretch.size, 1)
    squares = 0.0
    for block in range(_QUARTERS):
        kept, out = blocks != block, blocks == block
        weights, _ = nonnegative(columns[kept], rows.nuisance[kept], rows.displacement[kept], floors, rough, smoothing)
        left, offsets = rows.displacement[out] - columns[out] @ weights, rows.offsets[out]
        missed = left - offsets @ np.linalg.lstsq(offsets, left, rcond=None)[0]
        squares += float(missed @ missed)
    return float(np.sqrt(squares / len(rows)))
