"""The coupling matrix and its inverse, in an order of sums that generated C repeats bit for bit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst._validation import matrix

# A stage whose inverse multiplies errors by more is no stage that can be driven.
_WORST_CONDITION = 1e3


def checked_coupling(coupling: object, count: int) -> Array:
    """Return a coupling matrix (axes, axes); raise `ModelError` unless it is square, regular and 1 on its diagonal."""
    table = matrix(coupling, "coupling")  # type: ignore[arg-type]
    if table.shape != (count, count):
        raise ModelError(f"coupling: got {table.shape[0]} x {table.shape[1]} numbers for {count} axes, need one a pair")
    if np.any(np.diag(table) != 1):
        raise ModelError(f"coupling: got the diagonal {np.diag(table).tolist()}, need 1 for each axis itself")
    condition = float(np.linalg.cond(table))
    if not condition < _WORST_CONDITION:
        raise ModelError(
            f"coupling: got a matrix of condition {condition:.3g}, need one below {_WORST_CONDITION:g}: its axes "
            "cannot be distinguished"
        )
    return table


def inverse(coupling: Array) -> Array:
    """Return the inverse (axes, axes) of a coupling matrix."""
    return np.ascontiguousarray(np.linalg.inv(coupling))


def apply(table: Array, columns: Array) -> Array:
    """Return ``columns @ table.T`` (n, axes), summed from the first axis to the last; the identity changes no bit."""
    result = np.empty_like(columns)
    for i, row in enumerate(table):
        total = row[0] * columns[:, 0]
        for j in range(1, len(row)):
            total = total + row[j] * columns[:, j]
        result[:, i] = total
    return result


def dot(row: Sequence[float], values: Sequence[float]) -> float:
    """Return the sum of products, from the first to the last."""
    total = row[0] * values[0]
    for j in range(1, len(row)):
        total += row[j] * values[j]
    return total


def reachable(table: Sequence[Sequence[float]], wanted: Sequence[float], known: dict[int, float]) -> list[float]:
    """Return the displacements of all axes if some actuators are clamped and the other axes move as wanted.

    With D the inverse coupling `table`, w = D y. For the axes K in `known`, w_k is given and y_k follows:
    ``sum_l in K D_kl y_l = w_k - sum_f not in K D_kf y_f``, solved by elimination without pivoting in the order of the
    axes. The displacement of every other axis stays as wanted.

    Parameters
    ----------
    table : (axes, axes) nested sequence of float
        Inverse of the coupling matrix.
    wanted : (axes,) sequence of float
        Wanted displacements y [m].
    known : dict
        For axes whose actuator is clamped, the displacement w_k [m] of its actuator.
    """
    axes, result = sorted(known), list(wanted)
    free = [j for j in range(len(result)) if j not in known]
    rows = [[table[k][m] for m in axes] for k in axes]
    right = []
    for k in axes:
        total = known[k]
        for f in free:
            total -= table[k][f] * result[f]
        right.append(total)
    size = len(axes)
    for p in range(size):
        for q in range(p + 1, size):
            factor = rows[q][p] / rows[p][p]
            for r in range(p, size):
                rows[q][r] -= factor * rows[p][r]
            right[q] -= factor * right[p]
    for p in reversed(range(size)):
        for q in range(p + 1, size):
            right[p] -= rows[p][q] * right[q]
        right[p] /= rows[p][p]
    for k, y in zip(axes, right, strict=True):
        result[k] = y
    return result
