"""Least squares with coefficients that may not be negative, and linear inequalities among them.

    minimise || A x - b ||_2,   x[free:] >= 0,   C x >= l

The program is solved on a triangle of A. Large, well-conditioned problems use the Cholesky factor of the Gram matrix:
half the work of a QR factorisation, at the square of the condition number, which two corrections by the true gradient
compensate (corrected semi-normal equations). Others use a QR factorisation by chunks of rows. With bounds alone: Lawson
and Hanson's non-negative least squares. With inequalities: an interior point finds the active ones, then equations
give the numbers (Mehrotra's predictor and corrector; bounds enter the normal matrix on its diagonal only).

Cross-validation solves many programs that differ by a few rows: their sums G = A'A and c = A'b are differences of sums,
and their active sets differ by a few coefficients (`NormalEquations`). Coefficients and inequalities are exchanged all
at once, and one at a time where that does not end (block principal pivoting; Portugal, Judice and Vicente 1994, Math.
Comput. 63, 625).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array, Mask
from dehyst.identification.solvers.problem import (
    OPTIMAL,
    TINY,
    Answer,
    Problem,
    corrector_target,
    reach,
    regularised_solver,
    spread,
)

_CHUNK = 8192
# Below this many multiplications the cost of a QR factorisation does not matter.
_CHEAP = 2e8
# Largest condition number of a triangle from a Gram matrix that the corrections compensate.
_GRAM_CONDITION = 1e6
_CORRECTIONS = 2
# Steps of the interior point; it ends when the mean complementarity is this part of the objective at zero.
_STEPS, _CLOSE = 100, 1e-13
# Exchanges of limits after it.
_ROUNDS = 50


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
    return _of_triangle(triangle_of(np.column_stack([problem.rows, problem.goal])), problem)


def _by_gram(problem: Problem) -> Answer | None:
    """Solve by the Cholesky factor of the Gram matrix; None if that is ill conditioned."""
    from scipy.linalg import LinAlgError, cholesky, solve_triangular
    from scipy.linalg.lapack import dtrcon

    rows, goal, p = problem.rows, problem.goal, problem.free
    size = np.sqrt(np.einsum("ij,ij->j", rows, rows))
    if not np.all(size):
        return None
    try:
        triangle = cholesky((rows.T @ rows) / np.outer(size, size)) * size
    except LinAlgError:
        return None
    inverse, _ = dtrcon(triangle / size)
    if not inverse >= 1 / _GRAM_CONDITION:
        return None
    program = replace(problem, rows=triangle, goal=solve_triangular(triangle, rows.T @ goal, trans="T"))
    minimum = _minimum(program)
    x, multipliers = minimum.x, minimum.multipliers
    for _ in range(_CORRECTIONS):
        # R^-T times the true negative gradient; active limits stay active.
        misfit = solve_triangular(triangle, rows.T @ (goal - rows @ x), trans="T")
        left = replace(program, goal=misfit, lower=program.lower - program.matrix @ x)
        step, change = _on_face(left, minimum.moving, minimum.active)
        x, multipliers = x + step, np.maximum(change, 0.0)
        x[p:] = np.maximum(x[p:], 0.0)
    return _certified(problem, x, multipliers, minimum.status)


def _of_triangle(whole: Array, frame: Problem) -> Answer:
    """Minimise the sum of squares, given the triangle of rows and goal side by side; `frame` has the limits."""
    p, q = frame.free, frame.unknowns
    head, image = whole[:q, :-1], whole[:q, -1]
    independent = _independent(head[:, :p])
    if independent.size < p:
        # A dependent free column would absorb a direction of the residual: its coefficient stays zero.
        kept = np.concatenate([independent, np.arange(p, q)])
        fewer = replace(frame, rows=frame.rows[:, kept], matrix=frame.matrix[:, kept], free=independent.size)
        answer = _of_triangle(triangle_of(whole[:, np.append(kept, q)]), fewer)
        return replace(answer, x=spread(answer.x, kept, q))
    minimum = _minimum(replace(frame, rows=head, goal=image))
    if not np.all(np.isfinite(minimum.x)):
        return frame.failed(minimum.status)
    # For squares the triangle is equivalent to its rows.
    whole_problem = replace(frame, rows=whole[:, :-1], goal=whole[:, -1])
    return _certified(whole_problem, minimum.x, minimum.multipliers, minimum.status)


def _certified(problem: Problem, x: Array, multipliers: Array, status: str) -> Answer:
    """Certify stationarity: x'g and the slacks must vanish, and g may not be negative where x is bounded."""
    p, goal = problem.free, problem.goal
    residual = problem.rows @ x - goal
    gradient = problem.rows.T @ residual - problem.matrix.T @ multipliers
    slack = problem.matrix @ x - problem.lower
    defect = abs(gradient @ x) + np.maximum(-gradient[p:], 0).sum() + abs(multipliers @ slack)
    gap = float(defect) / max(float(goal @ goal), float(residual @ residual), TINY)
    return problem.answer(x, gap, status)


def _independent(columns: Array) -> NDArray[np.intp]:
    """Return the columns that are independent of one another, in order."""
    from scipy.linalg import qr

    if not columns.shape[1]:
        return np.zeros(0, dtype=np.intp)
    triangle, order = qr(columns, mode="r", pivoting=True)
    diagonal = np.abs(np.diag(triangle))
    return np.sort(order[: int(np.count_nonzero(diagonal > 1e-12 * diagonal[0]))])


@dataclass(frozen=True, eq=False)
class _Minimum:
    """Coefficients, multipliers of the inequalities, free coefficients and active inequalities.

    `multipliers` (m,): not negative. `moving` (q,) bool: coefficients that are unbounded or above zero. `active` (m,)
    bool: inequalities met with equality. `status`: the method that found it.
    """

    x: Array
    multipliers: Array
    moving: Mask
    active: Mask
    status: str


def _minimum(program: Problem) -> _Minimum:
    """Solve a program whose rows are a triangle."""
    if not program.lower.size:
        found = _by_nnls(program)
        if found is not None:
            return found
    triangle, image, p = program.rows, program.goal, program.free
    close = _CLOSE * max(float(image @ image), TINY)
    x, bound, multipliers = interior_point(triangle.T @ triangle, triangle.T @ image, program, close)
    moving = x > bound
    moving[:p] = True
    active = program.matrix @ x - program.lower < multipliers
    inside = _Minimum(x, multipliers, moving, active, "interior point")
    # Exchange limits until the equations on the active ones meet all others.
    for _ in range(_ROUNDS):
        x, multipliers = _on_face(program, moving, active)
        zero, flat = 1e-13 * np.abs(x).max(initial=1.0), 1e-12 * np.abs(image).max(initial=0.0)
        gradient = triangle.T @ (triangle @ x - image)
        wrong = _violated(program, (x, multipliers, gradient), moving, active, zero, flat)
        if not wrong.any():
            x[p:] = np.maximum(x[p:], 0.0)
            return _Minimum(x, np.maximum(multipliers, 0.0), moving, active, "interior point and active set")
        moving, active = moving ^ wrong[: moving.size], active ^ wrong[moving.size :]
    return inside


def _by_nnls(program: Problem) -> _Minimum | None:
    """Solve by Lawson and Hanson's method, free coefficients eliminated; None if it does not end."""
    from scipy.linalg import solve_triangular
    from scipy.optimize import nnls

    triangle, image, p, q = program.rows, program.goal, program.free, program.unknowns
    x = np.zeros(q)
    try:
        if p < q:  # SciPy's nnls breaks the heap when it is given no column
            x[p:], _ = nnls(triangle[p:, p:], image[p:], maxiter=50 * q + 1000)
    except RuntimeError:
        return None
    if p:
        x[:p] = solve_triangular(triangle[:p, :p], image[:p] - triangle[:p, p:] @ x[p:])
    moving = (x > 0) | (np.arange(q) < p)
    return _Minimum(x, np.zeros(0), moving, np.zeros(0, dtype=bool), "non-negative least squares")


def _violated(
    program: Problem, at: tuple[Array, Array, Array], moving: Mask, active: Mask, zero: float, flat: float
) -> Mask:
    """Return which coefficients, then inequalities (q + m,), are on the wrong side of their limits.

    `at`: x, multipliers and gradient. `zero`, `flat`: how far below zero they may be.
    """
    x, multipliers, gradient = at
    wrong = np.where(moving, x < -zero, gradient - program.matrix.T @ multipliers < -flat)
    wrong[: program.free] = False
    left = program.matrix @ x - program.lower
    return np.append(wrong, np.where(active, multipliers < -flat, left < -zero))


def _on_face(program: Problem, moving: Mask, active: Mask) -> tuple[Array, Array]:
    """Solve least squares over the moving coefficients, active inequalities as equations; also multipliers (m,)."""
    from scipy.linalg import lstsq, qr, solve_triangular

    x, multipliers = np.zeros(moving.size), np.zeros(active.size)
    some, equations = program.rows[:, moving], program.matrix[np.ix_(active, moving)]
    basis, factor, order = qr(equations.T, pivoting=True)
    diagonal = np.abs(np.diag(factor))
    rank = int(np.count_nonzero(diagonal > 1e-12 * diagonal.max(initial=0.0)))
    kept = np.flatnonzero(active)[order[:rank]]
    fixed = basis[:, :rank] @ solve_triangular(factor[:rank, :rank], program.lower[kept], trans="T")
    null = some @ basis[:, rank:]
    left = program.goal - some @ fixed
    rest = lstsq(null, left, lapack_driver="gelsy", cond=1e-14)[0] if null.shape[1] else np.zeros(0)
    x[moving] = fixed + basis[:, rank:] @ rest
    pull = some.T @ (program.rows @ x - program.goal)
    multipliers[kept] = solve_triangular(factor[:rank, :rank], basis[:, :rank].T @ pull)
    return x, multipliers


def interior_point(gram: Array, linear: Array, program: Problem, close: float) -> tuple[Array, Array, Array]:
    """Minimise x'G x / 2 - c'x within the limits of a program.

    `gram`, `linear` (q, q) and (q,): G and c. `close`: mean complementarity at which the method ends.

    Returns
    -------
    x, multipliers of the bounds (q,), 0 for free coefficients, and of the inequalities (m,)
    """
    free, matrix, lower = program.free, program.matrix, program.lower
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
        step = _newton(gram, matrix, slack, dual, pull, missed)
        _, ds, dz = step(np.zeros(dual.size))
        length = min(reach(slack, ds), reach(dual, dz))
        after = float((slack + length * ds) @ (dual + length * dz)) / max(dual.size, 1)
        dx, ds, dz = step(corrector_target(mean, after) - ds * dz)
        length = 0.995 * min(reach(slack, ds), reach(dual, dz))
        x, slack, dual = x + length * dx, slack + length * ds, dual + length * dz
    x[free:] = np.maximum(x[free:], 0.0)
    return x, np.concatenate([np.zeros(free), dual[:bounded]]), dual[bounded:]


def _newton(
    gram: Array, matrix: Array, slack: Array, dual: Array, pull: Array, missed: Array
) -> Callable[[Array], tuple[Array, Array, Array]]:
    """Return a function: target of slack times dual -> changes of x, slack and dual, by Newton's equations.

    `pull`, `missed`: the dual and the primal residual.
    """
    bounded, ratio = slack.size - len(matrix), dual / slack
    places = np.arange(gram.shape[0] - bounded, gram.shape[0])
    normal = gram + (matrix.T * ratio[bounded:]) @ matrix
    normal[places, places] += ratio[:bounded]
    solve = regularised_solver(normal)

    def step(target: Array) -> tuple[Array, Array, Array]:
        force = target / slack - dual - ratio * missed
        right = matrix.T @ force[bounded:] - pull
        right[places] += force[:bounded]
        dx = solve(right)
        moved = np.concatenate([dx[places], matrix @ dx])
        return dx, moved + missed, force - ratio * moved

    return step


# Of programs of sums: coefficients and multipliers may be negative by so much of the largest one, or of the largest
# gradient.
_ZERO, _FLAT = 1e-9, 1e-8
# Exchanges of all limits that make nothing better before one at a time, and exchanges in all.
_PATIENCE, _EXCHANGES = 5, 80
# The diagonal of G being one: keeps factors of dependent columns finite.
_RIDGE, _RIDGE_OF_LIMITS, _REFINEMENTS = 1e-13, 1e-12, 3
_CLOSE_OF_SUMS = 1e-11
# Of columns that depend on one another: changes predictions by less than any noise.
_INDEPENDENT = 1e-8


@dataclass(frozen=True, eq=False)
class ActiveSet:
    """Coefficients that are not at a bound (q,), and inequalities that are met with equality (m,)."""

    moving: Mask
    active: Mask


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """G (q, q), c (q,), and the number of free coefficients, which come first."""

    gram: Array
    image: Array
    free: int

    def __add__(self, other: NormalEquations) -> NormalEquations:
        return NormalEquations(self.gram + other.gram, self.image + other.image, self.free)

    def __sub__(self, other: NormalEquations) -> NormalEquations:
        return NormalEquations(self.gram - other.gram, self.image - other.image, self.free)

    @classmethod
    def of_rows(cls, rows: Array, goal: Array, free: int) -> NormalEquations:
        """Return the sums of rows (n, q) with targets (n,)."""
        return cls(rows.T @ rows, rows.T @ goal, free)

    def minimum(self, inequalities: tuple[Array, Array], start: ActiveSet | None = None) -> tuple[Array, ActiveSet]:
        """Return the coefficients (q,), zero for columns without rows, and their active set.

        `inequalities` (m, q) and (m,): C and l; met to 1e-9 of the largest term, columns being scaled to one length.
        `start`: of a program nearby; by default no coefficient is at its bound.
        """
        diagonal = np.sqrt(np.maximum(np.diag(self.gram), 0.0))
        kept = np.flatnonzero(diagonal > 1e-12 * diagonal.max(initial=TINY))
        scale = diagonal[kept]
        unit = float(np.linalg.norm(self.image[kept] / scale)) or 1.0
        # An inequality of a free coefficient without rows has nothing to hold.
        lost = np.setdiff1d(np.arange(self.free), kept)
        holding = ~np.any(inequalities[0][:, lost] != 0, axis=1)
        matrix, lower = inequalities[0][:, kept] / scale * unit * holding[:, None], inequalities[1] * holding
        size = np.abs(matrix).max(axis=1, initial=0.0)
        size[size == 0] = 1.0
        scaled = Problem(
            self.gram.take(kept, 0).take(kept, 1) / np.outer(scale, scale),
            self.image[kept] / scale / unit,
            int(np.count_nonzero(kept < self.free)),
            matrix / size[:, None],
            lower / size,
        )
        near, met = np.ones(kept.size, dtype=bool), np.zeros(lower.size, dtype=bool)
        if start is not None:
            # Inequalities that the program nearby did not have are not active.
            near, common = start.moving[kept], min(lower.size, start.active.size)
            met[:common] = start.active[:common]
        found = _exchanged_by_sums(scaled, near, met)
        if found is None:
            # With independent columns exchanges end where they may go round otherwise.
            ridged = replace(scaled, rows=scaled.rows + _INDEPENDENT * np.eye(kept.size))
            found = _exchanged_by_sums(ridged, near, met) or _from_inside(scaled)
        x, moving, active = found
        return spread(x / scale * unit, kept, diagonal.size), ActiveSet(spread(moving, kept, diagonal.size), active)


def _from_inside(program: Problem) -> tuple[Array, Mask, Mask]:
    """Return the minimum of a program of sums, moving coefficients and active limits, by an interior point first."""
    gram, image = program.rows, program.goal
    x, bound, multipliers = interior_point(gram, image, program, _CLOSE_OF_SUMS)
    found = _exchanged_by_sums(program, x > bound, program.matrix @ x - program.lower < multipliers)
    if found is not None:
        return found
    # Orthogonal factors of each face: slower, and right where limits nearly depend on one another.
    values, vectors = np.linalg.eigh(gram)
    root = np.sqrt(np.maximum(values, _RIDGE))
    basis, triangle = np.linalg.qr(root[:, None] * vectors.T)
    minimum = _minimum(replace(program, rows=triangle, goal=basis.T @ (vectors.T @ image / root)))
    return minimum.x, minimum.moving, minimum.active


def _exchanged_by_sums(program: Problem, moving: Mask, active: Mask) -> tuple[Array, Mask, Mask] | None:
    """Exchange limits until none is violated; None if that does not end.

    `program`: `rows` are G, of unit diagonal, and `goal` is c, of unit length.
    """
    gram, image, free = program.rows, program.goal, program.free
    moving, active = moving.copy(), active.copy()
    moving[:free] = True
    least, patience = moving.size + active.size + 1, _PATIENCE
    for _ in range(_EXCHANGES):
        solution = _face_of_sums(program, moving, active)
        if solution is None:
            return None
        x, multipliers = solution
        zero, flat = _ZERO * np.abs(x).max(initial=TINY), _FLAT * np.abs(image).max(initial=TINY)
        wrong = _violated(program, (x, multipliers, gram @ x - image), moving, active, zero, flat)
        count = int(np.count_nonzero(wrong))
        if not count:
            # Limits that contradict one another, or have no column that moves, cannot all be met.
            missed = np.abs(program.matrix[active] @ x - program.lower[active]).max(initial=0.0)
            if not missed <= _ZERO * max(np.abs(x).max(initial=0.0), 1.0):
                return None
            x[free:] = np.maximum(x[free:], 0.0)
            return x, moving, active
        least, patience = (count, _PATIENCE) if count < least else (least, patience - 1)
        if patience < 0:
            # The last one alone: Murty's rule, which ends.
            wrong[np.flatnonzero(wrong)[:-1]] = False
        moving, active = moving ^ wrong[: moving.size], active ^ wrong[moving.size :]
    return None


def _face_of_sums(program: Problem, moving: Mask, active: Mask) -> tuple[Array, Array] | None:
    """Return x and multipliers with these limits as equations; None if they have no solution."""
    from scipy.linalg.lapack import dpotrf, dpotrs

    columns, limits = np.flatnonzero(moving), np.flatnonzero(active)
    x, multipliers = np.zeros(moving.size), np.zeros(active.size)
    if not columns.size:
        return None if limits.size else (x, multipliers)
    # Of the symmetric G the transpose is the same, and in LAPACK's order without another copy.
    part = program.rows.take(columns, 0).take(columns, 1).T
    part[np.diag_indices(columns.size)] += _RIDGE
    factor, failure = dpotrf(part, lower=1, overwrite_a=1, clean=0)
    if failure:
        return None
    some = dpotrs(factor, program.goal[columns], lower=1)[0]
    if limits.size:
        equations = program.matrix[np.ix_(limits, columns)]
        response = dpotrs(factor, np.asfortranarray(equations.T), lower=1)[0]
        normal = equations @ response
        if not np.all(np.isfinite(normal)):
            return None
        normal[np.diag_indices(limits.size)] += _RIDGE_OF_LIMITS * max(np.trace(normal) / limits.size, TINY)
        factor, failure = dpotrf(np.asfortranarray(normal), lower=1, overwrite_a=1, clean=0)
        if failure:
            return None
        # The ridge leaves a little of the limits unmet: again for what is left, as an augmented Lagrangian does.
        for _ in range(_REFINEMENTS):
            force = dpotrs(factor, program.lower[limits] - equations @ some, lower=1)[0]
            if not np.all(np.isfinite(force)):
                return None
            multipliers[limits] += force
            some = some + response @ force
    x[columns] = some
    return x, multipliers
