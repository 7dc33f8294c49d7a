"""Least squares with coefficients that may not be negative, and linear inequalities among them.

    minimise || A x - b ||_2,   x[free:] >= 0,   C x >= l

The program is solved on a triangle of A. Large, well-conditioned problems use the Cholesky factor of the Gram matrix:
half the work of a QR factorisation, at the square of the condition number, which two corrections by the true gradient
compensate (corrected semi-normal equations). Others use a QR factorisation by chunks of rows. With bounds alone: Lawson
and Hanson's non-negative least squares. With inequalities: an interior point finds the active ones, then equations
give the numbers (Mehrotra's predictor and corrector; bounds enter the normal matrix on its diagonal only).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array, Mask
from dehyst.identification.solvers.problem import (
    OPTIMAL,
    TINY,
    Answer,
    Problem,
    barrier_matrix,
    corrector_target,
    failed,
    reach,
    regularised_solver,
    spread,
)

_STEPS = 100


def interior_point(
    gram: Array, linear: Array, free: int, inequalities: tuple[Array, Array], close: float
) -> tuple[Array, Array, Array]:
    """Return x, multipliers of the bounds (0 for free coefficients) and of the inequalities.

    `gram`, `linear` (q, q) and (q,): G and c. `free`: number of coefficients without a bound; they come first.
    `inequalities` (m, q) and (m,): C and l. `close`: mean complementarity at which the method ends.
    """
    matrix, lower = inequalities
    q, bounded = linear.size, linear.size - free
    x, slack, dual = np.ones(q), np.ones(bounded + lower.size), np.ones(bounded + lower.size)
    unit = float(np.diag(gram).max(initial=0.0)) or 1.0
    for _ in range(_STEPS):
        pull = gram @ x - linear - matrix.T @ dual[bounded:]
        pull[free:] -= dual[:bounded]
        missed = np.concatenate([x[free:], matrix @ x - lower]) - slack
        mean = float(slack @ dual) / max(dual.size, 1)
        if mean < close and np.abs(pull).max() < 1e-12 * unit and np.abs(missed).max(initial=0.0) < 1e-12:
            break
        newton = _Newton(gram, matrix, free, (pull, missed), slack, dual)
        _, ds, dz = newton.step(np.zeros(dual.size))
        length = min(reach(slack, ds), reach(dual, dz))
        after = float((slack + length * ds) @ (dual + length * dz)) / max(dual.size, 1)
        dx, ds, dz = newton.step(corrector_target(mean, after) - ds * dz)
        length = 0.995 * min(reach(slack, ds), reach(dual, dz))
        x, slack, dual = x + length * dx, slack + length * ds, dual + length * dz
    x[free:] = np.maximum(x[free:], 0.0)
    return x, np.concatenate([np.zeros(free), dual[:bounded]]), dual[bounded:]


class _Newton:
    """Newton's equations at a point; `left` are the dual and the primal residual."""

    def __init__(
        self, gram: Array, matrix: Array, free: int, left: tuple[Array, Array], slack: Array, dual: Array
    ) -> None:
        self._matrix, self._free, (self._pull, self._missed) = matrix, free, left
        self._slack, self._dual, self._ratio = slack, dual, dual / slack
        bounded = gram.shape[0] - free
        normal = gram + barrier_matrix(matrix, dual[bounded:], slack[bounded:])
        places = np.arange(free, gram.shape[0])
        normal[places, places] += self._ratio[:bounded]
        self._solve = regularised_solver(normal)

    def step(self, target: Array) -> tuple[Array, Array, Array]:
        """Return changes of x, slack and dual that bring slack times dual to the target."""
        force = target / self._slack - self._dual - self._ratio * self._missed
        bounded = force.size - len(self._matrix)
        right = self._matrix.T @ force[bounded:] - self._pull
        right[self._free :] += force[:bounded]
        dx = self._solve(right)
        moved = np.concatenate([dx[self._free :], self._matrix @ dx])
        return dx, moved + self._missed, force - self._ratio * moved


# The interior point ends when the mean complementarity is this part of the objective at zero.
_CLOSE = 1e-13
_ROUNDS = 50


@dataclass(frozen=True, eq=False)
class Minimum:
    """Coefficients, multipliers of the inequalities, free coefficients and active inequalities.

    `multipliers` (m,): not negative. `moving` (q,) bool: coefficients that are unbounded or above zero. `active` (m,)
    bool: inequalities met with equality. `status`: the method that found it.
    """

    x: Array
    multipliers: Array
    moving: Mask
    active: Mask
    status: str


@dataclass(frozen=True, eq=False)
class Quadratic:
    """The program: triangle R (k, q), image d (k,), number of free coefficients, inequalities (m, q) and (m,)."""

    triangle: Array
    image: Array
    free: int
    matrix: Array
    lower: Array

    def minimum(self) -> Minimum:
        """Solve the program."""
        if not self.lower.size:
            solution = self._by_nnls()
            if solution is not None:
                return solution
        x, z, multipliers = self._interior()
        slack = self.matrix @ x - self.lower
        moving = x > z
        moving[: self.free] = True
        return self._exchange_limits(Minimum(x, multipliers, moving, slack < multipliers, "interior point"))

    def corrected(self, minimum: Minimum, misfit: Array) -> Minimum:
        """Return a corrected minimum, given R^-T times the true negative gradient at it; active limits stay active."""
        step, change = self._on_face(minimum.moving, minimum.active, misfit, self.lower - self.matrix @ minimum.x)
        x = minimum.x + step
        x[self.free :] = np.maximum(x[self.free :], 0.0)
        multipliers = np.maximum(change, 0.0)
        return Minimum(x, multipliers, minimum.moving, minimum.active, minimum.status)

    def gradient(self, x: Array) -> Array:
        """Return the gradient of the objective (q,)."""
        return np.asarray(self.triangle.T @ (self.triangle @ x - self.image))

    def _by_nnls(self) -> Minimum | None:
        """Solve by Lawson and Hanson's method, free coefficients eliminated; None if it does not end."""
        from scipy.linalg import solve_triangular
        from scipy.optimize import nnls

        p, q = self.free, self.triangle.shape[1]
        x = np.zeros(q)
        try:
            if p < q:  # SciPy's nnls breaks the heap when it is given no column
                x[p:], _ = nnls(self.triangle[p:, p:], self.image[p:], maxiter=50 * q + 1000)
        except RuntimeError:
            return None
        if p:
            x[:p] = solve_triangular(self.triangle[:p, :p], self.image[:p] - self.triangle[:p, p:] @ x[p:])
        moving = (x > 0) | (np.arange(q) < p)
        return Minimum(x, np.zeros(0), moving, np.zeros(0, dtype=bool), "non-negative least squares")

    def _exchange_limits(self, first: Minimum) -> Minimum:
        """Exchange limits until the equations on the active ones meet all others; `first` if that does not end."""
        moving, active = first.moving.copy(), first.active.copy()
        for _ in range(_ROUNDS):
            x, multipliers = self._on_face(moving, active, self.image, self.lower)
            size = np.abs(x).max(initial=1.0)
            reduced = self.gradient(x) - self.matrix.T @ multipliers
            below = moving & (x < -1e-13 * size)
            below[: self.free] = False
            missed = ~active & (self.matrix @ x < self.lower - 1e-13 * size)
            steep = np.abs(self.image).max(initial=0.0)
            pulled = ~moving & (reduced < -1e-12 * steep)
            loose = active & (multipliers < -1e-12 * steep)
            if not (below.any() or missed.any() or pulled.any() or loose.any()):
                x[self.free :] = np.maximum(x[self.free :], 0.0)
                return Minimum(x, np.maximum(multipliers, 0.0), moving, active, "interior point and active set")
            moving, active = (moving & ~below) | pulled, (active & ~loose) | missed
        return first

    def _on_face(self, moving: Mask, active: Mask, image: Array, lower: Array) -> tuple[Array, Array]:
        """Solve least squares over the moving coefficients, active inequalities as equations; also multipliers (m,)."""
        from scipy.linalg import lstsq, qr, solve_triangular

        x, multipliers = np.zeros(moving.size), np.zeros(active.size)
        some, equations = self.triangle[:, moving], self.matrix[np.ix_(active, moving)]
        basis, factor, order = qr(equations.T, pivoting=True)
        diagonal = np.abs(np.diag(factor))
        rank = int(np.count_nonzero(diagonal > 1e-12 * diagonal.max(initial=0.0)))
        kept = np.flatnonzero(active)[order[:rank]]
        fixed = basis[:, :rank] @ solve_triangular(factor[:rank, :rank], lower[kept], trans="T")
        null = some @ basis[:, rank:]
        rest = lstsq(null, image - some @ fixed, lapack_driver="gelsy", cond=1e-14)[0] if null.shape[1] else np.zeros(0)
        x[moving] = fixed + basis[:, rank:] @ rest
        pull = self.triangle[:, moving].T @ (self.triangle @ x - image)
        multipliers[kept] = solve_triangular(factor[:rank, :rank], basis[:, :rank].T @ pull)
        return x, multipliers

    def _interior(self) -> tuple[Array, Array, Array]:
        """Return x, multipliers of the bounds (0 for free ones) and of the inequalities."""
        gram, linear = self.triangle.T @ self.triangle, self.triangle.T @ self.image
        close = _CLOSE * max(float(self.image @ self.image), TINY)
        return interior_point(gram, linear, self.free, (self.matrix, self.lower), close)


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
    return of_triangle(triangle_of(np.column_stack([problem.rows, problem.goal])), problem)


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


def of_triangle(whole: Array, frame: Problem) -> Answer:
    """Minimise the sum of squares, given the triangle of rows and goal side by side; `frame` has the limits."""
    p, q = frame.free, frame.unknowns
    head, image = whole[:q, :-1], whole[:q, -1]
    independent = _independent(head[:, :p])
    if independent.size < p:
        # A dependent free column would absorb a direction of the residual: its coefficient stays zero.
        kept = np.concatenate([independent, np.arange(p, q)])
        fewer = triangle_of(whole[:, np.append(kept, q)])
        answer = of_triangle(fewer, frame.of_columns(kept, independent.size))
        return replace(answer, x=spread(answer.x, kept, q))
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
