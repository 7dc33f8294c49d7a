"""What interior points share: how far a step may go, and positive definite equations that are nearly dependent."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dehyst._types import Array
from dehyst.identification.solvers.problem import TINY

_RIDGES = 10.0 ** np.arange(-15, 1, 2)
_REFINEMENTS = 2


def reach(values: Array, step: Array) -> float:
    """Largest part of a step, at most all of it, that leaves the values above zero."""
    down = step < 0
    return float(min(1.0, np.min(-values[down] / step[down], initial=1.0)))


def regularised(normal: Array) -> Callable[[Array], Array]:
    """A function that solves normal x = right for a symmetric, positive semidefinite matrix.

    The matrix is scaled to a unit diagonal and gets the smallest ridge with which its Cholesky factor exists; two
    refinements take the ridge's effect off again.
    """
    from scipy.linalg import LinAlgError, cho_factor, cho_solve

    diagonal = np.diag(normal)
    scale = 1 / np.sqrt(np.maximum(diagonal, max(float(diagonal.max(initial=0.0)) * 1e-30, TINY)))
    scaled = normal * np.outer(scale, scale)
    factor = np.eye(scale.size), False
    for ridge in _RIDGES:
        try:
            factor = cho_factor(scaled + ridge * np.eye(scale.size), check_finite=False)
            break
        except LinAlgError:
            continue

    def solve(right: Array) -> Array:
        target = right * scale
        x = cho_solve(factor, target, check_finite=False)
        for _ in range(_REFINEMENTS):
            x += cho_solve(factor, target - scaled @ x, check_finite=False)
        return np.asarray(x * scale)

    return solve
