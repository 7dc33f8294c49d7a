"""The convex program: fit rows in L1 or L2 with some coefficients not negative.

    minimise || W (F a + P x - b) ||,   a free, x >= 0, C x >= l

L1 is `least_absolute`, L2 is `least_squares`. Each answer comes with its duality gap.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from dehyst._errors import IdentifyError
from dehyst._types import Array
from dehyst.identification.solvers import highs
from dehyst.identification.solvers.least_absolute import least_absolute
from dehyst.identification.solvers.least_squares import ActiveSet, least_squares
from dehyst.identification.solvers.problem import Answer, Problem

Norm = Literal["l1", "l2"]
NORMS: tuple[Norm, ...] = ("l1", "l2")
# Free columns, columns that are not negative, target and weights.
Table = tuple[Array, Array, Array, Array]


@dataclass(frozen=True)
class Solution:
    """The solution of the program.

    `free`, `nonnegative`: a and x. `residual` (n,): F a + P x - b, not weighted.
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
    scale, unit = _scales(columns, target)
    rows, goal = columns / scale * w[:, None], target / unit * w
    answer = _answer(Problem(rows, goal, p, *_scaled_limits(constraints, p, scale, unit)), norm)
    x = answer.x / scale * unit
    return Solution(x[:p], x[p:], columns @ x - target, answer.optimal, answer.status, answer.gap)


def _scales(columns: Array, target: Array) -> tuple[Array, float]:
    """Return the largest sizes of the columns (q,) and of the target, 1 for those that are zero."""
    scale = np.abs(columns).max(axis=0, initial=0.0)
    scale[scale == 0] = 1.0
    return scale, float(np.abs(target).max()) or 1.0


def _scaled_limits(
    constraints: tuple[Array, Array] | None, free: int, scale: Array, unit: float
) -> tuple[Array, Array]:
    """Check and return (matrix, lower) on all scaled coefficients, rows scaled to a largest number of one.

    Raise `IdentifyError` if shapes do not fit or a number is not finite.
    """
    bounded = scale.size - free
    if constraints is None or not np.size(constraints[1]):
        return np.zeros((0, scale.size)), np.zeros(0)
    matrix, lower = (np.asarray(part, dtype=np.float64) for part in constraints)
    if matrix.ndim != 2 or matrix.shape[1] not in (bounded, scale.size) or lower.shape != (matrix.shape[0],):
        raise IdentifyError(
            f"constraints: got a matrix of shape {matrix.shape} and lower limits of shape {lower.shape}, need (m, "
            f"{bounded}) and (m,): one column for each coefficient that is not negative, one limit for each row"
        )
    if not (np.all(np.isfinite(matrix)) and np.all(np.isfinite(lower))):
        raise IdentifyError("constraints: got NaN or infinite numbers, need finite ones; leave out rows without limit")
    whole = np.hstack([np.zeros((lower.size, scale.size - matrix.shape[1])), matrix]) / scale
    size = np.abs(whole).max(axis=1, initial=0.0)
    size[size == 0] = 1.0
    return whole / size[:, None], lower / size / unit


def _answer(problem: Problem, norm: Norm) -> Answer:
    """Solve a scaled program."""
    if problem.lower.size and not _can_be_kept(problem):
        return problem.failed("no coefficients that are not negative keep the inequalities")
    return least_absolute(problem) if norm == "l1" else least_squares(problem)


def _can_be_kept(problem: Problem) -> bool:
    """Whether some coefficients that are not negative keep the inequalities."""
    q = problem.unknowns
    bounds = np.where(np.arange(q) < problem.free, -np.inf, 0.0), np.full(q, np.inf)
    none = np.zeros((0, q)), np.zeros(0)
    return highs.minimum(np.zeros(q), bounds, none, (-problem.matrix, -problem.lower)).optimal
