"""Problems and answers of the convex program, and the algebra of interior points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array

# Largest relative duality gap of an optimum.
OPTIMAL = 1e-6
# Tolerance of an inequality, relative to its largest coefficient times the largest unknown.
MET = 1e-9
TINY = float(np.finfo(np.float64).tiny)
_RIDGES = 10.0 ** np.arange(-15, 1, 2)
_REFINEMENTS = 2


@dataclass(frozen=True, eq=False)
class Problem:
    """Minimise || rows x - goal || with x[free:] >= 0 and matrix x >= lower.

    `free`: number of coefficients that may be negative; they come first. `matrix`, `lower` (m, q) and (m,): linear
    inequalities, m = 0 for none.
    """

    rows: Array
    goal: Array
    free: int
    matrix: Array
    lower: Array

    @property
    def unknowns(self) -> int:
        """Number q of coefficients."""
        return int(self.rows.shape[1])

    def meets(self, x: Array) -> bool:
        """Return whether x meets the inequalities up to rounding; x[free:] >= 0 is assumed."""
        size = max(1.0, float(np.abs(x).max(initial=0.0)))
        return bool(np.all(self.matrix @ x >= self.lower - MET * size))

    def answer(self, x: Array, gap: float, method: str) -> Answer:
        """Return coefficients with their relative duality gap, optimal if that is small and the inequalities hold."""
        optimal = abs(gap) <= OPTIMAL and self.meets(x)
        return Answer(x, f"{'optimal' if optimal else 'no optimum'} ({method})", optimal, gap)

    def failed(self, status: str) -> Answer:
        """Return an answer without an optimum."""
        return Answer(np.zeros(self.unknowns), status, False, float("nan"))


@dataclass(frozen=True, eq=False)
class Answer:
    """Coefficients (q,), the solver's status, whether they are optimal, and the relative duality gap."""

    x: Array
    status: str
    optimal: bool
    gap: float


def spread(values: NDArray[Any], places: NDArray[np.intp], size: int) -> NDArray[Any]:
    """Return `size` values, zero at all places but these."""
    whole = np.zeros(size, dtype=values.dtype)
    whole[places] = values
    return whole


def reach(values: Array, step: Array) -> float:
    """Return the largest part of a step, at most 1, that leaves the values above zero."""
    down = step < 0
    return float(min(1.0, np.min(-values[down] / step[down], initial=1.0)))


def corrector_target(mean: float, predicted: float) -> float:
    """Return Mehrotra's complementarity for the corrector, from the present mean and the predictor's."""
    return (predicted / mean) ** 3 * mean


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
