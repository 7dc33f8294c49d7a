"""Least squares with coefficients that may not be negative, and linear inequalities among them.

    minimise || A x - b ||_2,   x[free:] >= 0,   C x >= l

The program is solved on a triangle of A. Large, well-conditioned problems use the Cholesky factor of the Gram matrix:
half the work of a QR factorisation, at the square of the condition number, which two corrections by the true gradient
compensate (corrected semi-normal equations). Others use a QR factorisation by chunks of rows. With bounds alone: Lawson
and Hanson's non-negative least squares. With inequalities: an interior point finds the active ones, then equations
give the numbers.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array
from dehyst.identification.solvers.problem import OPTIMAL, TINY, Answer, Problem, failed, spread
from dehyst.identification.solvers.quadratic import Quadratic

_CHUNK = 8192
# Below this many multiplications the cost of a QR factorisation does not matter.
_CHEAP = 2e8
# Largest condition number of a triangle from a Gram matrix that the corrections compensate.
_GRAM_CONDITION = 1e6
_CORRECTIONS = 2


def triangle_of(matrix: Array) -> Array:
    """Return the triangle R of the QR factorisation, (min(n, q), q), by chunks of rows."""
    triangle = np.zeros((0, matrix.shape[1]))
    for start in range(0, max(len(matrix), 1), _CHUNK):
        below = np.vstack([triangle, matrix[start : start + _CHUNK]])
        triangle = np.asarray(np.linalg.qr(below, mode="r"), dtype=np.float64)
    return triangle


def least_squares(problem: Problem) -> Answer:
    """Minimise the sum of squares."""
    n, q = problem.rows.shape
    if n * q * q > _CHEAP and n > 4 * q:
        answer = _by_gram(problem)
        if answer is not None and answer.gap < 1e-3 * OPTIMAL:
            return answer
    return _by_qr(problem)


def _by_gram(problem: Problem) -> Answer | None:
    """Solve by the Cholesky factor of the Gram matrix; None if that is ill conditioned."""
    from scipy.linalg import LinAlgError, cholesky, solve_triangular

    rows, goal = problem.rows, problem.goal
    size = np.sqrt(np.einsum("ij,ij->j", rows, rows))
    if not np.all(size):
        return None
    try:
        triangle = cholesky((rows.T @ rows) / np.outer(size, size)) * size
    except LinAlgError:
        return None
    if _condition(triangle / size) > _GRAM_CONDITION:
        return None
    image = solve_triangular(triangle, rows.T @ goal, trans="T")
    quadratic = Quadratic(triangle, image, problem.free, problem.matrix, problem.lower)
    minimum = quadratic.minimum()
    for _ in range(_CORRECTIONS):
        misfit = solve_triangular(triangle, rows.T @ (goal - rows @ minimum.x), trans="T")
        minimum = quadratic.corrected(minimum, misfit)
    return _certified(problem, minimum.x, minimum.multipliers, minimum.status)


def _condition(triangle: Array) -> float:
    """Return the condition number in the 1-norm."""
    from scipy.linalg.lapack import dtrcon

    inverse, _ = dtrcon(triangle)
    return 1 / inverse if inverse > 0 else np.inf


def _by_qr(problem: Problem) -> Answer:
    whole = triangle_of(np.column_stack([problem.rows, problem.goal]))
    return of_triangle(whole, problem)


def of_triangle(whole: Array, frame: Problem) -> Answer:
    """Minimise the sum of squares, given the triangle of rows and goal side by side; `frame` has the limits."""
    p, q = frame.free, frame.unknowns
    head, image = whole[:q, :-1], whole[:q, -1]
    independent = _independent(head[:, :p])
    if independent.size < p:
        # A dependent free column would absorb a direction of the residual: its coefficient stays zero.
        kept = np.concatenate([independent, np.arange(p, q)])
        fewer = triangle_of(whole[:, np.append(kept, q)])
        return spread(of_triangle(fewer, frame.of_columns(kept, independent.size)), kept, q)
    minimum = Quadratic(head, image, p, frame.matrix, frame.lower).minimum()
    if not np.all(np.isfinite(minimum.x)):
        return failed(frame, minimum.status)
    # For squares the triangle is equivalent to its rows.
    return _certified(
        replace(frame, rows=whole[:, :-1], goal=whole[:, -1]), minimum.x, minimum.multipliers, minimum.status
    )


def _certified(problem: Problem, x: Array, multipliers: Array, status: str) -> Answer:
    """Certify stationarity: x'g and the slacks must vanish, and g may not be negative where x is bounded."""
    p, goal = problem.free, problem.goal
    residual = problem.rows @ x - goal
    gradient = problem.rows.T @ residual - problem.matrix.T @ multipliers
    slack = problem.matrix @ x - problem.lower
    defect = abs(gradient @ x) + np.maximum(-gradient[p:], 0).sum() + abs(multipliers @ slack)
    gap = float(defect) / max(float(goal @ goal), float(residual @ residual), TINY)
    optimal = gap < OPTIMAL and problem.meets(x)
    return Answer(x, f"{'optimal' if optimal else 'no optimum'} ({status})", optimal, gap)


def _independent(columns: Array) -> NDArray[np.intp]:
    """Return the columns that are independent of one another, in order."""
    from scipy.linalg import qr

    if not columns.shape[1]:
        return np.zeros(0, dtype=np.intp)
    triangle, order = qr(columns, mode="r", pivoting=True)
    diagonal = np.abs(np.diag(triangle))
    return np.sort(order[: int(np.count_nonzero(diagonal > 1e-12 * diagonal[0]))])
