"""Least squares with some coefficients not negative, by Lawson and Hanson's method."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dehyst._types import Array


class Solution(NamedTuple):
    """Coefficients that are free (p,), those that are not negative (q,), and the residual (n,)."""

    free: Array
    nonnegative: Array
    residual: Array


def solve(free: Array, nonnegative: Array, target: Array) -> Solution:
    """Minimise ``|| F a + P x - b ||`` with x >= 0; columns F (n, p) and P (n, q), target b (n,)."""
    from scipy.optimize import nnls

    basis, triangle = np.linalg.qr(free)
    scale = np.maximum(np.linalg.norm(nonnegative, axis=0), np.finfo(np.float64).tiny)
    columns = nonnegative / scale
    rows, left = (column - basis @ (basis.T @ column) for column in (columns, target))
    x = nnls(rows, left, maxiter=50 * rows.shape[1] + 1000)[0] / scale
    a = np.linalg.lstsq(triangle, basis.T @ (target - nonnegative @ x), rcond=None)[0]
    return Solution(a, x, free @ a + nonnegative @ x - target)
