"""The convex program: fit rows in L1, L2 or L-infinity with some coefficients not negative.

    minimise || W (F a + P x - b) ||,   a free, x >= 0, C x >= l

L1 is `least_absolute_blocks`, L2 is `quadratic`; L-infinity is a linear program solved by HiGHS with row generation.
Each answer comes with its duality gap.

Cross-validation solves many least-squares programs that differ by a few rows: their sums G = A'A and c = A'b are
differences of sums, and their active sets differ by a few coefficients (`NormalEquations`). Coefficients and
inequalities are exchanged all at once, and one at a time where that does not end (block principal pivoting; Portugal,
Judice and Vicente 1994, Math. Comput. 63, 625).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import IdentifyError
from dehyst._types import Array, Mask
from dehyst.identification.solvers import highs
from dehyst.identification.solvers.least_absolute_blocks import Blocks, Whole, least_absolute
from dehyst.identification.solvers.problem import TINY, Answer, Problem, failed, inequalities, spread
from dehyst.identification.solvers.quadratic import Quadratic, interior_point, least_squares, of_triangle, triangle_of

# Coefficients and multipliers may be negative by so much of the largest one, or of the largest gradient.
_ZERO, _FLAT = 1e-9, 1e-8
# Exchanges of all limits that make nothing better before one at a time, and exchanges in all.
_PATIENCE, _EXCHANGES = 5, 80
# The diagonal of G being one: keeps factors of dependent columns finite.
_RIDGE, _RIDGE_OF_LIMITS, _REFINEMENTS = 1e-13, 1e-12, 3
_CLOSE = 1e-11
# Of columns that depend on one another: changes predictions by less than any noise.
_INDEPENDENT = 1e-8


@dataclass(frozen=True, eq=False)
class ActiveSet:
    """Coefficients that are not at a bound (q,), and inequalities that are met with equality (m,)."""

    moving: Mask
    active: Mask

    def of_limits(self, count: int) -> ActiveSet:
        """Return the same among `count` inequalities, the new ones not active."""
        return ActiveSet(self.moving, np.append(self.active[:count], np.zeros(max(count - self.active.size, 0), bool)))


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
        scaled = _UnitProgram(
            self.gram[np.ix_(kept, kept)] / np.outer(scale, scale),
            self.image[kept] / scale / unit,
            int(np.count_nonzero(kept < self.free)),
            matrix / size[:, None],
            lower / size,
        )
        near = np.ones(kept.size, dtype=bool) if start is None else start.moving[kept]
        met = np.zeros(lower.size, dtype=bool) if start is None else start.of_limits(lower.size).active
        x, moving, active = scaled.exchanged(near, met) or scaled.ridged().exchanged(near, met) or scaled.from_inside()
        return spread(x / scale * unit, kept, diagonal.size), ActiveSet(spread(moving, kept, diagonal.size), active)


@dataclass(frozen=True, eq=False)
class _UnitProgram:
    """The program with a unit diagonal of G and an image of unit length."""

    gram: Array
    image: Array
    free: int
    matrix: Array
    lower: Array

    def ridged(self) -> _UnitProgram:
        """Return a program nearby whose columns are independent: exchanges end where they may go round otherwise."""
        return replace(self, gram=self.gram + _INDEPENDENT * np.eye(len(self.gram)))

    def from_inside(self) -> tuple[Array, Mask, Mask]:
        """Return the minimum, its moving coefficients and active inequalities, by an interior point first."""
        x, bound, multipliers = interior_point(self.gram, self.image, self.free, (self.matrix, self.lower), _CLOSE)
        moving, active = x > bound, self.matrix @ x - self.lower < multipliers
        solution = self.exchanged(moving, active)
        if solution is not None:
            return solution
        # Orthogonal factors of each face: slower, and right where limits nearly depend on one another.
        values, vectors = np.linalg.eigh(self.gram)
        root = np.sqrt(np.maximum(values, _RIDGE))
        basis, triangle = np.linalg.qr(root[:, None] * vectors.T)
        minimum = Quadratic(
            triangle, basis.T @ (vectors.T @ self.image / root), self.free, self.matrix, self.lower
        ).minimum()
        return minimum.x, minimum.moving, minimum.active

    def exchanged(self, moving: Mask, active: Mask) -> tuple[Array, Mask, Mask] | None:
        """Exchange limits until none is violated; None if that does not end."""
        moving, active = moving.copy(), active.copy()
        moving[: self.free] = True
        least, patience = moving.size + active.size + 1, _PATIENCE
        for _ in range(_EXCHANGES):
            solution = self._on_face(moving, active)
            if solution is None:
                return None
            x, wrong, unmet = self._violations(*solution, moving, active)
            count = int(np.count_nonzero(wrong) + np.count_nonzero(unmet))
            if not count:
                # Limits that contradict one another, or have no column that moves, cannot all be met.
                missed = np.abs(self.matrix[active] @ x - self.lower[active]).max(initial=0.0)
                if not missed <= _ZERO * max(np.abs(x).max(initial=0.0), 1.0):
                    return None
                x[self.free :] = np.maximum(x[self.free :], 0.0)
                return x, moving, active
            least, patience = (count, _PATIENCE) if count < least else (least, patience - 1)
            if patience < 0:
                wrong, unmet = _last_alone(wrong, unmet)
            moving, active = moving ^ wrong, active ^ unmet
        return None

    def _violations(self, x: Array, multipliers: Array, moving: Mask, active: Mask) -> tuple[Array, Mask, Mask]:
        """Return x, and the coefficients and inequalities that are on the wrong side of their limits."""
        pull = self.gram @ x - self.image - self.matrix.T @ multipliers
        size, steep = np.abs(x).max(initial=TINY), np.abs(self.image).max(initial=TINY)
        wrong = np.where(moving, x < -_ZERO * size, pull < -_FLAT * steep)
        wrong[: self.free] = False
        left = self.matrix @ x - self.lower
        unmet = np.where(active, multipliers < -_FLAT * steep, left < -_ZERO * size)
        return x, wrong, unmet

    def _on_face(self, moving: Mask, active: Mask) -> tuple[Array, Array] | None:
        """Return x and multipliers with these limits as equations; None if they have no solution."""
        from scipy.linalg.lapack import dpotrf, dpotrs

        columns, limits = np.flatnonzero(moving), np.flatnonzero(active)
        x, multipliers = np.zeros(moving.size), np.zeros(active.size)
        if not columns.size:
            return None if limits.size else (x, multipliers)
        part = np.asfortranarray(self.gram[np.ix_(columns, columns)])
        part[np.diag_indices(columns.size)] += _RIDGE
        factor, failure = dpotrf(part, lower=1, overwrite_a=1, clean=0)
        if failure:
            return None
        some = dpotrs(factor, self.image[columns], lower=1)[0]
        if limits.size:
            equations = self.matrix[np.ix_(limits, columns)]
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
                force = dpotrs(factor, self.lower[limits] - equations @ some, lower=1)[0]
                if not np.all(np.isfinite(force)):
                    return None
                multipliers[limits] += force
                some = some + response @ force
        x[columns] = some
        return x, multipliers


def _last_alone(wrong: Mask, unmet: Mask) -> tuple[Mask, Mask]:
    """Return the last of both alone (Murty's rule, which ends)."""
    both = np.concatenate([wrong, unmet])
    alone = np.zeros(both.size, dtype=bool)
    alone[np.flatnonzero(both)[-1]] = True
    return alone[: wrong.size], alone[wrong.size :]


Norm = Literal["l1", "l2", "linf"]
NORMS: tuple[Norm, ...] = ("l1", "l2", "linf")
_ROWS_AT_A_TIME = 200
_ROUNDS = 60
_NO_POINT = "no coefficients that are not negative keep the inequalities"


@dataclass(frozen=True)
class Solution:
    """The solution of the program.

    `free`, `nonnegative`: a and x. `residual` (n,): F a + P x - b, not weighted; empty where rows were read in blocks.
    `gap`: primal minus dual objective, relative to the larger of the primal one and that of a = x = 0; not negative
    except by rounding. `active_set`: of a least-squares program solved from sums: the start of one nearby.
    `inequalities` (m, q) and (m,): those that the program came to need.
    """

    free: Array
    nonnegative: Array
    residual: Array
    optimal: bool
    status: str
    gap: float
    active_set: ActiveSet | None = None
    inequalities: tuple[Array, Array] | None = None


def solve(
    free: Array,
    nonnegative: Array,
    target: Array,
    *,
    weights: Array | None = None,
    norm: Norm = "l1",
    constraints: tuple[Array, Array] | None = None,
) -> Solution:
    """Solve the program.

    `free`, `nonnegative` (n, p) and (n, q): columns F and P. `target` (n,): b. `weights` (n,): positive weights W;
    default 1. `constraints` (m, q) and (m,): C and l of the inequalities C x >= l, met to 1e-9 of the largest
    coefficient. Raise `IdentifyError` if the norm is unknown, there are fewer rows than free columns, or the
    constraints do not fit the columns.
    """
    if norm not in NORMS:
        raise IdentifyError(argument="norm", got=repr(norm), need=f"one of {', '.join(NORMS)}")
    p, columns = free.shape[1], np.hstack([free, nonnegative])
    if len(target) < max(p, 1):
        raise IdentifyError(f"got {len(target)} rows for {columns.shape[1]} unknowns, need more samples that count")
    w = np.ones(len(target)) if weights is None else weights / weights.max()
    scale, scale_b = _scales(columns, target)
    matrix, lower = inequalities(constraints, p, scale)
    problem = Problem(columns / scale * w[:, None], target / scale_b * w, p, matrix, lower / scale_b)
    if _impossible(problem):
        answer = failed(problem, _NO_POINT)
    elif norm == "l2":
        answer = least_squares(problem)
    else:
        answer = _BY_BLOCKS[norm](Whole(problem.rows, problem.goal), problem)
    x = answer.x / scale * scale_b
    return Solution(x[:p], x[p:], columns @ x - target, answer.optimal, answer.status, answer.gap)


class WeightedBlocks(Protocol):
    """Rows of a program in blocks, iterated any number of times: free columns, those not negative, target, weights."""

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[tuple[Array, Array, Array, Array]]: ...


def solve_blocks(
    table: WeightedBlocks,
    like: tuple[Array, Array, Array],
    *,
    norm: Norm = "l1",
    constraints: tuple[Array, Array] | None = None,
) -> Solution:
    """Solve the program of rows of which only a block is in memory at a time.

    `like`: some of the rows, which define the scales: free columns, those not negative, target. `constraints` (c, q)
    and (c,): as for `solve`.

    Returns
    -------
    Solution
        Without residuals; the gap covers all rows.
    """
    p, columns = like[0].shape[1], np.hstack(like[:2])
    scale, scale_b = _scales(columns, like[2])
    matrix, lower = inequalities(constraints, p, scale)
    frame = Problem(np.zeros((0, scale.size)), np.zeros(0), p, matrix, lower / scale_b)
    blocks = _Scaled(table, scale, scale_b)
    answer = failed(frame, _NO_POINT) if _impossible(frame) else _BY_BLOCKS[norm](blocks, frame)
    x = answer.x / scale * scale_b
    return Solution(x[:p], x[p:], np.zeros(0), answer.optimal, answer.status, answer.gap)


def _scales(columns: Array, target: Array) -> tuple[Array, float]:
    """Return the largest sizes of the columns (q,) and of the target, 1 for those that are zero."""
    scale = np.abs(columns).max(axis=0, initial=0.0)
    scale[scale == 0] = 1.0
    return scale, float(np.abs(target).max()) or 1.0


@dataclass(frozen=True, eq=False)
class _Scaled:
    """Blocks of a table, weighted and scaled to the order of one."""

    table: WeightedBlocks
    scale: Array
    scale_b: float

    def __len__(self) -> int:
        return len(self.table)

    def __iter__(self) -> Iterator[tuple[Array, Array]]:
        for free, nonnegative, target, weights in self.table:
            rows = np.hstack([free, nonnegative])
            rows *= weights[:, None] / self.scale
            yield rows, target / self.scale_b * weights


def _impossible(problem: Problem) -> bool:
    """Return whether no coefficients meet the inequalities."""
    q, p = problem.unknowns, problem.free
    if not problem.lower.size:
        return False
    bounds = np.where(np.arange(q) < p, -np.inf, 0.0), np.full(q, np.inf)
    above = np.full(problem.lower.size, np.inf)
    return not highs.minimum(np.zeros(q), bounds, problem.matrix, (problem.lower, above)).optimal


def _l2(blocks: Blocks, frame: Problem) -> Answer:
    triangle = np.zeros((0, frame.unknowns + 1))
    for rows, goal in blocks:
        triangle = triangle_of(np.vstack([triangle, np.column_stack([rows, goal])]))
    return of_triangle(triangle, frame)


def _linf(blocks: Blocks, frame: Problem) -> Answer:
    q, p = frame.unknowns, frame.free
    cost = np.append(np.zeros(q), 1.0)
    bounds = np.append(np.where(np.arange(q) < p, -np.inf, 0.0), 0.0), np.full(q + 1, np.inf)
    kept = np.hstack([frame.matrix, np.zeros((frame.lower.size, 1))])
    selection = _Selection.evenly(blocks)
    for _ in range(_ROUNDS):
        rows, goal, ones = selection.rows, selection.goal, np.ones((selection.goal.size, 1))
        both = np.vstack([np.hstack([rows, -ones]), np.hstack([-rows, -ones]), -kept])
        upper = np.concatenate([goal, -goal, -frame.lower])
        solution = highs.minimum(cost, bounds, both, (np.full(upper.size, -np.inf), upper))
        if not solution.optimal:
            return failed(frame, solution.status)
        x = solution.value[:q]
        worst, largest = _Selection.worst(blocks, x, solution.objective + 1e-9)
        more = selection.joined(worst)
        if more is selection:
            unit = max(float(np.abs(goal).max()) for _, goal in blocks)
            gap = (largest - solution.objective) / max(unit, largest, TINY)
            return Answer(x, f"optimal ({solution.status})", True, gap)
        selection = more
    return failed(frame, "row generation did not end")


@dataclass(frozen=True, eq=False)
class _Selection:
    """Selected rows, their targets and their places among all."""

    rows: Array
    goal: Array
    places: NDArray[np.intp]

    @classmethod
    def evenly(cls, blocks: Blocks) -> _Selection:
        n = len(blocks)
        places = np.unique(np.linspace(0, n - 1, min(n, _ROWS_AT_A_TIME)).astype(int))
        parts, place = [], 0
        for rows, goal in blocks:
            local = places[(places >= place) & (places < place + goal.size)] - place
            parts.append((rows[local], goal[local]))
            place += goal.size
        some, goals = (np.concatenate(column) for column in zip(*parts, strict=True))
        return cls(some, goals, places)

    @classmethod
    def worst(cls, blocks: Blocks, x: Array, limit: float) -> tuple[_Selection, float]:
        """Select the rows with the largest residuals above a limit; also return the largest residual of all."""
        selection = cls(np.zeros((0, x.size)), np.zeros(0), np.zeros(0, dtype=np.intp))
        sizes, largest, place = np.zeros(0), 0.0, 0
        for rows, goal in blocks:
            residual = np.abs(rows @ x - goal)
            largest = max(largest, float(residual.max(initial=0.0)))
            local = np.flatnonzero(residual > limit)
            local = local[np.argsort(residual[local], kind="stable")[::-1][:_ROWS_AT_A_TIME]]
            sizes = np.append(sizes, residual[local])
            order = np.argsort(sizes, kind="stable")[::-1][:_ROWS_AT_A_TIME]
            selection = cls(
                np.concatenate([selection.rows, rows[local]])[order],
                np.append(selection.goal, goal[local])[order],
                np.append(selection.places, local + place)[order],
            )
            sizes, place = sizes[order], place + goal.size
        return selection, largest

    def joined(self, worst: _Selection) -> _Selection:
        """Return these rows and the new ones of another selection; itself if there are none."""
        new = np.flatnonzero(~np.isin(worst.places, self.places))
        if not new.size:
            return self
        return _Selection(
            np.concatenate([self.rows, worst.rows[new]]),
            np.append(self.goal, worst.goal[new]),
            np.append(self.places, worst.places[new]),
        )


_BY_BLOCKS = {"l1": least_absolute, "l2": _l2, "linf": _linf}
