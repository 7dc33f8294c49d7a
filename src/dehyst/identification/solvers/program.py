"""The convex program: fit rows in L1, L2 or L-infinity with some coefficients not negative.

    minimise || W (F a + P x - b) ||,   a free, x >= 0, C x >= l

L1 is `least_absolute_blocks`, L2 is `least_squares`; L-infinity is a linear program solved by HiGHS with row
generation. Each answer comes with its duality gap.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import IdentifyError
from dehyst._types import Array
from dehyst.identification.solvers import highs
from dehyst.identification.solvers.least_absolute_blocks import Blocks, Whole, least_absolute
from dehyst.identification.solvers.least_squares import least_squares, of_triangle, triangle_of
from dehyst.identification.solvers.normal_equations import ActiveSet
from dehyst.identification.solvers.problem import TINY, Answer, Problem, failed, inequalities

Norm = Literal["l1", "l2", "linf"]
NORMS: tuple[Norm, ...] = ("l1", "l2", "linf")
_ROWS_AT_A_TIME = 200
_ROUNDS = 60
_NO_POINT = "no coefficients that are not negative keep the inequalities"


@dataclass(frozen=True)
class Solution:
    """The solution of the program.

    Attributes
    ----------
    free, nonnegative : array
        a and x.
    residual : (n,) array
        F a + P x - b, not weighted; empty where rows were read in blocks.
    gap : float
        Primal minus dual objective, relative to the larger of the primal one and that of a = x = 0; not negative
        except by rounding.
    active_set : ActiveSet or None
        Of a least-squares program solved from sums: the start of one nearby.
    inequalities : (m, q) and (m,) array, or None
        Those that the program came to need.
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

    Parameters
    ----------
    free, nonnegative : (n, p) and (n, q) array
        Columns F and P.
    target : (n,) array
        b.
    weights : (n,) array, optional
        Positive weights W; default 1.
    norm : {"l1", "l2", "linf"}
    constraints : (m, q) and (m,) array, optional
        C and l of the inequalities C x >= l, met to 1e-9 of the largest coefficient.

    Raises
    ------
    IdentifyError
        If the norm is unknown, there are fewer rows than free columns, or the constraints do not fit the columns.
    """
    if norm not in NORMS:
        raise IdentifyError(f"norm: got {norm!r}, need one of {', '.join(NORMS)}")
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

    Parameters
    ----------
    table : WeightedBlocks
    like : (m, p), (m, q) and (m,) array
        Some of the rows, which define the scales: free columns, those not negative, target.
    norm : {"l1", "l2", "linf"}
    constraints : (c, q) and (c,) array, optional
        As for `solve`.

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
    return not highs.minimum(np.zeros(q), bounds, problem.matrix, (problem.lower, above), solver="simplex").optimal


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
        solution = highs.minimum(cost, bounds, both, (np.full(upper.size, -np.inf), upper), solver="simplex")
        if not solution.optimal:
            return failed(frame, solution.status)
        x = solution.value[:q]
        worst, largest = _Selection.worst(blocks, x, solution.objective + 1e-9)
        more = selection.joined(worst)
        if more is selection:
            gap = (largest - solution.objective) / max(_largest(blocks), largest, TINY)
            return Answer(x, f"optimal ({solution.status})", True, gap)
        selection = more
    return failed(frame, "row generation did not end")


def _largest(blocks: Blocks) -> float:
    """Return the largest size of a target."""
    return max(float(np.abs(goal).max()) for _, goal in blocks)


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
