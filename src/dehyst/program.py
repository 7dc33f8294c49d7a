"""The one convex program: fit rows in L1, L2 or L-infinity with some coefficients not negative.

    minimise || W (F a + P x - b) ||,   a free, x >= 0, C x >= l

L1 is `reduction`, L2 is `squares`; L-infinity is a linear program solved by HiGHS with row generation. Each answer
comes with its duality gap.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from dehyst import highs
from dehyst._errors import IdentifyError
from dehyst._native import Array
from dehyst.highs import Program, linear_program, linear_programs
from dehyst.problem import TINY, Answer, Problem, failed, inequalities
from dehyst.reduction import Whole, least_absolute
from dehyst.squares import least_squares, triangle_of

__all__ = ["NORMS", "Norm", "Program", "Solution", "linear_program", "linear_programs", "one_thread", "solve",
           "triangle_of"]  # fmt: skip

Norm = Literal["l1", "l2", "linf"]
NORMS: tuple[Norm, ...] = ("l1", "l2", "linf")
_ROWS_AT_A_TIME = 200
_ROUNDS = 60


@contextmanager
def one_thread() -> Iterator[None]:
    """Keep BLAS on one thread: these factorisations gain nothing from more and lose much on a busy machine."""
    import threadpoolctl

    with threadpoolctl.threadpool_limits(1, user_api="blas"):
        yield


@dataclass(frozen=True)
class Solution:
    """The optimum.

    Attributes
    ----------
    free, nonnegative : array
        a and x.
    residual : (n,) array
        F a + P x - b, not weighted.
    gap : float
        Primal minus dual objective over that of a = x = 0, or over the primal one if that is larger; never negative
        but for rounding.
    """

    free: Array
    nonnegative: Array
    residual: Array
    optimal: bool
    status: str
    gap: float


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
    scale_b = float(np.abs(target).max()) or 1.0
    scale = np.abs(columns).max(axis=0, initial=0.0)
    scale[scale == 0] = 1.0
    matrix, lower = inequalities(constraints, p, scale)
    problem = Problem(columns / scale * w[:, None], target / scale_b * w, p, matrix, lower / scale_b)
    if _impossible(problem):
        answer = failed(problem, "no coefficients that are not negative keep the inequalities")
    else:
        answer = {"l1": _l1, "l2": least_squares, "linf": _linf}[norm](problem)
    x = answer.x / scale * scale_b
    return Solution(x[:p], x[p:], columns @ x - target, answer.optimal, answer.status, answer.gap)


def _impossible(problem: Problem) -> bool:
    """Whether nothing keeps the inequalities."""
    q, p = problem.unknowns, problem.free
    if not problem.lower.size:
        return False
    bounds = np.where(np.arange(q) < p, -np.inf, 0.0), np.full(q, np.inf)
    above = np.full(problem.lower.size, np.inf)
    return not highs.minimum(np.zeros(q), bounds, problem.matrix, (problem.lower, above), solver="simplex").optimal


def _l1(problem: Problem) -> Answer:
    frame = replace(problem, rows=problem.rows[:0], goal=problem.goal[:0])
    return least_absolute(Whole(problem.rows, problem.goal), frame)


def _linf(problem: Problem) -> Answer:
    rows, goal, p = problem.rows, problem.goal, problem.free
    n, q = rows.shape
    cost = np.append(np.zeros(q), 1.0)
    bounds = np.append(np.where(np.arange(q) < p, -np.inf, 0.0), 0.0), np.full(q + 1, np.inf)
    kept = np.hstack([problem.matrix, np.zeros((problem.lower.size, 1))])
    chosen = np.unique(np.linspace(0, n - 1, min(n, _ROWS_AT_A_TIME)).astype(int))
    for _ in range(_ROUNDS):
        some, ones = rows[chosen], np.ones((chosen.size, 1))
        both = np.vstack([np.hstack([some, -ones]), np.hstack([-some, -ones]), -kept])
        upper = np.concatenate([goal[chosen], -goal[chosen], -problem.lower])
        answer = highs.minimum(cost, bounds, both, (np.full(upper.size, -np.inf), upper), solver="simplex")
        if not answer.optimal:
            return failed(problem, answer.status)
        x = answer.value[:q]
        residual = np.abs(rows @ x - goal)
        worst = np.argsort(residual, kind="stable")[::-1][:_ROWS_AT_A_TIME]
        worst = worst[residual[worst] > answer.objective + 1e-9]
        added = np.setdiff1d(worst, chosen)
        if not added.size:
            largest = float(residual.max())
            gap = (largest - answer.objective) / max(float(np.abs(goal).max()), largest, TINY)
            return Answer(x, f"optimal ({answer.status})", True, gap)
        chosen = np.union1d(chosen, added)
    return failed(problem, "row generation did not end")
