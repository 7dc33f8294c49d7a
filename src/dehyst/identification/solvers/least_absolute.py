"""Least sum of absolute deviations of rows that fit into memory, certified by its duality gap.

An interior point (`l1_interior_point`), then the vertex next to it; if rounding leaves too wide a gap, HiGHS on the
dual: max b'y + l'm, A'y + C'm + t <= 0 (= 0 for free coefficients), abs(y) <= 1, m >= 0, whose row duals are x.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dehyst._types import Array
from dehyst.identification.solvers import highs
from dehyst.identification.solvers.l1_interior_point import Pair, interior
from dehyst.identification.solvers.problem import OPTIMAL, Problem

# Of few rows the optimal vertex is found: a wider gap is due to rounding.
_FEW = 5000
_TIGHT = 1e-4
# Of a reduced program with more rows HiGHS takes longer than another selection of rows.
_MOST_HIGHS = 20_000
# Largest residual, the goal being of order one, of rows that the optimum meets; most such rows that are used.
_MET = 1e-7
_MOST_MET = 5000


@dataclass(frozen=True, eq=False)
class Deviations:
    """A point, a dual point, and the method that found them.

    Attributes
    ----------
    x, y, multipliers : (q,), (n,) and (m,) array
    status : str
    optimal : bool
        Whether the method ended; `dual_value` returns how good they are.
    """

    x: Array
    y: Array
    multipliers: Array
    status: str
    optimal: bool


def least_absolute_deviations(problem: Problem, pull: Array, unit: float) -> Deviations:
    """Minimise the sum of absolute residuals less pull'x.

    Parameters
    ----------
    problem : Problem
    pull : (q,) array
        Sum of the rows with a residual of known sign, each times its sign.
    unit : float
        Sum of absolute targets of all rows: the gap is relative to it, or to the objective if that is larger.
    """
    pair = interior(problem, pull)
    x = _polished(problem, pull, pair.x)
    limit = OPTIMAL * (_TIGHT if problem.goal.size <= _FEW else 1.0)
    objective = float(np.abs(problem.goal - problem.rows @ x).sum() - pull @ x)
    value, lacking = dual_value(problem, pull, pair.y, pair.multipliers, x)
    if abs(objective - value) + lacking <= limit * max(unit, abs(objective)) and problem.meets(x):
        return Deviations(x, pair.y, pair.multipliers, f"interior point, {pair.iterations} steps", True)
    if problem.goal.size > _MOST_HIGHS and np.any(pull):
        return Deviations(pair.x, pair.y, pair.multipliers, "no optimum of the rows that were kept", False)
    return _by_highs(problem, pull, pair)


def dual_value(problem: Problem, pull: Array, y: Array, multipliers: Array, x: Array) -> tuple[float, float]:
    """Return the value of a dual point, and its infeasibility priced at x."""
    lacking = problem.rows.T @ y + problem.matrix.T @ multipliers + pull
    lacking[problem.free :] = np.maximum(lacking[problem.free :], 0.0)
    return float(problem.goal @ y + problem.lower @ multipliers), float(np.abs(lacking) @ np.abs(x))


def _by_highs(problem: Problem, pull: Array, pair: Pair) -> Deviations:
    n, q = problem.rows.shape
    m = problem.lower.size
    limits = np.where(np.arange(q) < problem.free, -pull, -np.inf), -pull
    box = np.append(-np.ones(n), np.zeros(m)), np.append(np.ones(n), np.full(m, np.inf))
    both, cost = np.vstack([problem.rows, problem.matrix]).T, -np.append(problem.goal, problem.lower)
    solution = highs.minimum(cost, box, both, limits, solver="ipm")
    if not solution.optimal:
        solution = highs.minimum(cost, box, both, limits, solver="simplex")
    if not solution.optimal:
        return Deviations(pair.x, pair.y, pair.multipliers, solution.status, False)
    x = -solution.row_dual
    x[problem.free :] = np.maximum(x[problem.free :], 0.0)
    return Deviations(_polished(problem, pull, x), solution.value[:n], solution.value[n:], solution.status, True)


def _polished(problem: Problem, pull: Array, x: Array) -> Array:
    """Return the vertex next to x, met rows solved exactly, small coefficients at zero; x if that is worse."""
    rows, goal, p = problem.rows, problem.goal, problem.free
    residual = np.abs(rows @ x - goal)
    used = np.flatnonzero((np.arange(x.size) < p) | (x > 1e-9 * np.abs(x).max(initial=0.0)))
    active = problem.matrix @ x < problem.lower + 1e-9 * np.abs(x).max(initial=1.0)
    order = np.argsort(residual, kind="stable")
    n_met = int(np.count_nonzero(residual < _MET))
    tight = order[: max(used.size - np.count_nonzero(active), n_met)]
    tight = tight[:: -(-tight.size // _MOST_MET) or 1]
    refined = np.zeros_like(x)
    equations = np.vstack([rows[np.ix_(tight, used)], problem.matrix[np.ix_(active, used)]])
    refined[used] = np.linalg.lstsq(equations, np.append(goal[tight], problem.lower[active]), rcond=None)[0]
    refined[p:] = np.maximum(refined[p:], 0.0)
    better = np.abs(rows @ refined - goal).sum() - pull @ refined <= residual.sum() - pull @ x
    return refined if better and problem.meets(refined) else x
