"""Algebra of interior points: step lengths, the corrector's target, nearly singular equations."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dehyst._types import Array
from dehyst.identification.solvers.problem import TINY

_RIDGES = 10.0 ** np.arange(-15, 1, 2)
_REFINEMENTS = 2


def reach(values: Array, step: Array) -> float:
    """Return the largest part of a step, at most 1, that leaves the values above zero."""
    down = step < 0
    return float(min(1.0, np.min(-values[down] / step[down], initial=1.0)))


def corrector_target(mean: float, predicted: float) -> float:
    """Return Mehrotra's complementarity for the corrector, from the present mean and the predictor's."""
    return (predicted / mean) ** 3 * mean


def barrier_matrix(limits: Array, dual: Array, slack: Array) -> Array:
    """Return limits' diag(dual / slack) limits (q, q): what the inequalities add to the normal matrix."""
    return np.asarray((limits.T * (dual / slack)) @ limits)


def regularised_solver(normal: Array) -> Callable[[Array], Array]:
    """Return a function that solves normal x = right for a symmetric, positive semidefinite matrix.

    The matrix is scaled to a unit diagonal and gets the smallest ridge with which its Cholesky factor exists; two
    refinements remove the effect of the ridge.
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
