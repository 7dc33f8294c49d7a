"""The one convex program: fit rows in L1, L2 or L-infinity with some coefficients not negative.

    minimise || W (F a + P x - b) ||,   a free, x >= 0

L1 and L-infinity are linear programs solved by HiGHS, L1 in its dual form (max b'l, P'l <= 0, F'l = 0, abs(l) <= w:
few rows, and x is their duals), L-infinity by row generation; L2 is non-negative least squares on the triangle of a QR
factorisation, after the free coefficients are eliminated. Each answer comes with its duality gap.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import IdentifyError
from dehyst._native import Array

Norm = Literal["l1", "l2", "linf"]
NORMS: tuple[Norm, ...] = ("l1", "l2", "linf")
_ROWS_AT_A_TIME = 200
_ROUNDS = 60
# Largest relative duality gap of an optimum.
_OPTIMAL = 1e-6


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
        Primal minus dual objective over the objective of a = x = 0, never negative but for rounding.
    """

    free: Array
    nonnegative: Array
    residual: Array
    optimal: bool
    status: str
    gap: float


def solve(
    free: Array, nonnegative: Array, target: Array, *, weights: Array | None = None, norm: Norm = "l1"
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

    Raises
    ------
    IdentifyError
        If the norm is unknown or there are fewer rows than free columns.
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
    rows, goal = columns / scale * w[:, None], target / scale_b * w
    x, status, optimal, gap = {"l1": _l1, "l2": _l2, "linf": _linf}[norm](rows, goal, p)
    x = x / scale * scale_b
    return Solution(x[:p], x[p:], columns @ x - target, optimal, status, gap)


Answer = tuple[Array, str, bool, float]


def triangle_of(matrix: Array) -> Array:
    """Triangle R of the QR factorisation."""
    return np.asarray(np.linalg.qr(matrix, mode="r"), dtype=np.float64)


def _l2(rows: Array, goal: Array, p: int) -> Answer:
    from scipy.linalg import solve_triangular
    from scipy.optimize import nnls

    independent = _independent(rows[:, :p])
    if independent.size < p:
        # A dependent free column would swallow a direction of the residual: it stays at zero.
        kept = np.concatenate([independent, np.arange(p, rows.shape[1])])
        x, status, optimal, gap = _l2(rows[:, kept], goal, independent.size)
        return _spread(x, kept, rows.shape[1]), status, optimal, gap
    triangle = triangle_of(np.column_stack([rows, goal]))
    k = min(rows.shape[1], triangle.shape[0])
    head, x = triangle[:k, :-1], np.zeros(rows.shape[1])
    try:
        if p < x.size:  # SciPy's nnls breaks the heap when it is given no column
            x[p:], _ = nnls(head[p:, p:], triangle[p:k, -1], maxiter=50 * rows.shape[1] + 1000)
    except RuntimeError as error:
        return x, f"non-negative least squares: {error}", False, float("nan")
    if p:
        x[:p] = solve_triangular(head[:p, :p], triangle[:p, -1] - head[:p, p:] @ x[p:])
    residual = rows @ x - goal
    slack = rows.T @ residual
    # What is left of stationarity: x'g must vanish, and g may not be negative where x is not bounded above.
    gap = float(abs(slack @ x) + np.maximum(-slack[p:], 0).sum()) / max(float(goal @ goal), np.finfo(float).tiny)
    return x, "optimal (non-negative least squares)", gap < _OPTIMAL, gap


def _independent(columns: Array) -> NDArray[np.intp]:
    """Columns that are independent of one another, in order."""
    from scipy.linalg import qr

    if not columns.shape[1]:
        return np.zeros(0, dtype=np.intp)
    triangle, order = qr(columns, mode="r", pivoting=True)
    diagonal = np.abs(np.diag(triangle))
    return np.sort(order[: int(np.count_nonzero(diagonal > 1e-12 * diagonal[0]))])


def _spread(x: Array, places: NDArray[np.intp], size: int) -> Array:
    whole = np.zeros(size)
    whole[places] = x
    return whole


def _l1(rows: Array, goal: Array, p: int) -> Answer:
    n, q = rows.shape
    upper = np.zeros(q)
    lower = np.where(np.arange(q) < p, 0.0, -np.inf)
    # Weights are in the rows already, so that the multipliers share one box and the program is scaled to O(1).
    answer = _highs(-goal, (-np.ones(n), np.ones(n)), rows.T, (lower, upper), solver="ipm")
    if not answer.optimal:
        answer = _highs(-goal, (-np.ones(n), np.ones(n)), rows.T, (lower, upper), solver="simplex")
    if not answer.optimal:
        return np.zeros(q), answer.status, False, float("nan")
    x = -answer.row_dual
    x[p:] = np.maximum(x[p:], 0.0)
    x = _polished(rows, goal, p, x)
    primal, dual = float(np.abs(rows @ x - goal).sum()), -answer.objective
    return x, f"optimal ({answer.status})", True, (primal - dual) / max(float(np.abs(goal).sum()), np.finfo(float).tiny)


def _polished(rows: Array, goal: Array, p: int, x: Array) -> Array:
    """The vertex next to x: rows with no residual solved exactly, small coefficients at zero; x if that is worse."""
    residual = np.abs(rows @ x - goal)
    used = np.flatnonzero((np.arange(x.size) < p) | (x > 1e-9 * np.abs(x).max(initial=0.0)))
    tight = np.argsort(residual, kind="stable")[: max(used.size, int(np.count_nonzero(residual < 1e-7)))]
    refined = np.zeros_like(x)
    refined[used] = np.linalg.lstsq(rows[np.ix_(tight, used)], goal[tight], rcond=None)[0]
    refined[p:] = np.maximum(refined[p:], 0.0)
    return refined if np.abs(rows @ refined - goal).sum() <= residual.sum() else x


def _linf(rows: Array, goal: Array, p: int) -> Answer:
    n, q = rows.shape
    cost = np.append(np.zeros(q), 1.0)
    bounds = np.append(np.where(np.arange(q) < p, -np.inf, 0.0), 0.0), np.full(q + 1, np.inf)
    chosen = np.unique(np.linspace(0, n - 1, min(n, _ROWS_AT_A_TIME)).astype(int))
    for _ in range(_ROUNDS):
        some, ones = rows[chosen], np.ones((chosen.size, 1))
        both = np.vstack([np.hstack([some, -ones]), np.hstack([-some, -ones])])
        limits = np.full(2 * chosen.size, -np.inf), np.concatenate([goal[chosen], -goal[chosen]])
        answer = _highs(cost, bounds, both, limits, solver="simplex")
        if not answer.optimal:
            return np.zeros(q), answer.status, False, float("nan")
        x = answer.value[:q]
        residual = np.abs(rows @ x - goal)
        worst = np.argsort(residual, kind="stable")[::-1][:_ROWS_AT_A_TIME]
        worst = worst[residual[worst] > answer.objective + 1e-9]
        added = np.setdiff1d(worst, chosen)
        if not added.size:
            gap = (float(residual.max()) - answer.objective) / max(float(np.abs(goal).max()), np.finfo(float).tiny)
            return x, f"optimal ({answer.status})", True, gap
        chosen = np.union1d(chosen, added)
    return x, "row generation did not end", False, float("nan")


@dataclass(frozen=True)
class Program:
    """HiGHS's answer to a linear program."""

    value: Array
    row_dual: Array
    objective: float
    optimal: bool
    status: str


def _highs(
    cost: Array, bounds: tuple[Array, Array], rows: Array, limits: tuple[Array, Array], *, solver: str
) -> Program:
    """Minimise cost'x with bounds on x and limits on rows x (dense), on one thread."""
    return _run(_passed(cost, bounds, rows, limits, solver), solver)


def _passed(cost: Array, bounds: tuple[Array, Array], rows: Array, limits: tuple[Array, Array], solver: str) -> Any:
    import highspy

    m, n = rows.shape
    lp: Any = highspy.HighsLp()
    lp.num_col_, lp.num_row_ = n, m
    lp.col_cost_, lp.col_lower_, lp.col_upper_ = cost, bounds[0], bounds[1]
    lp.row_lower_, lp.row_upper_ = limits
    lp.a_matrix_.format_ = highspy.MatrixFormat.kColwise
    lp.a_matrix_.start_ = np.arange(n + 1) * m
    lp.a_matrix_.index_ = np.tile(np.arange(m), n)
    lp.a_matrix_.value_ = np.ascontiguousarray(rows.T).ravel()
    make_highs: Any = highspy.Highs
    highs = make_highs()
    for option, value in (("output_flag", False), ("threads", 1), ("solver", solver), ("random_seed", 0),
                          ("primal_feasibility_tolerance", 1e-9), ("dual_feasibility_tolerance", 1e-9)):  # fmt: skip
        highs.setOptionValue(option, value)
    highs.passModel(lp)
    return highs


def _run(highs: Any, solver: str) -> Program:
    import highspy

    highs.run()
    status = highs.getModelStatus()
    solution = highs.getSolution()
    return Program(
        np.array(solution.col_value),
        np.array(solution.row_dual),
        float(highs.getInfo().objective_function_value),
        status == highspy.HighsModelStatus.kOptimal,
        f"HiGHS {solver}: {highs.modelStatusToString(status)}",
    )


def linear_programs(
    costs: Array, bounds: tuple[Array, Array], rows: Array, limits: tuple[Array, Array]
) -> Iterator[Program]:
    """Minimise each of many costs (p, n) over one polytope, each from the optimum of the one before; see below."""
    highs = _passed(costs[0], bounds, rows, limits, "simplex")
    every = np.arange(rows.shape[1], dtype=np.int32)
    # From one optimum to the next the point stays feasible: the primal simplex goes on where the dual would start anew.
    for k, cost in enumerate(costs):
        highs.changeColsCost(every.size, every, cost)
        highs.setOptionValue("simplex_strategy", 4 if k else 1)
        yield _run(highs, "simplex")


def linear_program(
    cost: Array, bounds: tuple[Array, Array], rows: Array, limits: tuple[Array, Array]
) -> tuple[Array, float, bool, str, float]:
    """Minimise cost'x, bounds[0] <= x <= bounds[1], limits[0] <= rows x <= limits[1].

    Returns the optimum, its value, whether it is one, the solver's word and the dual's value.
    """
    answer = _highs(cost, bounds, rows, limits, solver="simplex")
    reduced = cost - rows.T @ answer.row_dual
    dual = _support(answer.row_dual, *limits) + _support(reduced, *bounds)
    return answer.value, answer.objective, answer.optimal, answer.status, dual


def _support(multipliers: Array, lower: Array, upper: Array) -> float:
    """Least value of multipliers'z over lower <= z <= upper, rounding at infinite bounds left out."""
    bound = np.where(multipliers > 0, lower, upper)
    finite = np.isfinite(bound)
    return float(multipliers[finite] @ bound[finite])
