"""Least absolute deviations by a primal-dual interior point on the boxed dual (Frisch and Newton).

    minimise sum |b - A x| - t'x,   x[free:] >= 0,   C x >= l
    maximise b'y + l'm,   A'y + C'm + w + t = 0,   -1 <= y <= 1,   m, w >= 0,   w[:free] = 0

t represents rows with a residual of known sign: it is the sum of these rows, each times its sign (Portnoy and Koenker
1997, Stat. Sci. 12, 279). Each iteration solves q equations twice (Mehrotra's predictor and corrector); the matrix is
scaled to a unit diagonal and gets a ridge that grows until its factor exists, and the solution is refined.

`least_absolute_deviations` returns the vertex next to the interior point, certified by its duality gap. If rounding
leaves too wide a gap, HiGHS solves the dual, max b'y + l'm, A'y + C'm + t <= 0 (= 0 for free coefficients),
abs(y) <= 1, m >= 0, whose row duals are x.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from dehyst._types import Array
from dehyst.identification.solvers import highs
from dehyst.identification.solvers.problem import (
    OPTIMAL,
    TINY,
    Problem,
    barrier_matrix,
    corrector_target,
    reach,
    regularised_solver,
)

_STEPS = 80
# The interior point ends when complementarity is this part of the sum of absolute residuals, or of the targets.
_CLOSE = 1e-11
_EXACT = 1e-14
_FARTHEST = 0.9995
# Least residuals at the start as a part of the targets: the start needs a distance from the limits.
_LEAST = 1e-3
# Part of the gradient that the limits of the coefficients hold at the start.
_PULLED = 0.3
_BLOCKED = 0.2
_CENTRING = 0.5
# Steps without progress after which rounding prevents a better point: while complementarity is above its tolerance,
# and below it.
_PATIENCE, _LAST = 15, 2
_PIECE = 4096
# Rows of smaller weight, relative to the largest one, do not bend a step.
_NEGLIGIBLE = 1e-8


@dataclass(frozen=True, eq=False)
class PrimalDual:
    """A point and a dual point, and the method that found them.

    `x`, `y`, `multipliers`: coefficients, duals of the rows in [-1, 1], and duals of the inequalities, not negative.
    `optimal`: whether the method ended; `dual_value` returns how good they are.
    """

    x: Array
    y: Array
    multipliers: Array
    status: str
    optimal: bool = True


def interior(problem: Problem, pull: Array | None = None, start: Array | None = None) -> PrimalDual:
    """Minimise the sum of absolute residuals less `pull` (q,) times x, from `start` (q,) or least squares."""
    point = _PrimalDualPoint(problem, np.zeros(problem.unknowns) if pull is None else pull, start)
    best, least, since, steps = copy(point), point.remaining(), 0, 0
    # Weights of rows without residual overflow at the very end; such steps are not taken.
    with np.errstate(all="ignore"):
        while least > 0 and since <= (_LAST if point.is_complementary() else _PATIENCE) and steps < _STEPS:
            point.step()
            steps += 1
            left, since = point.remaining(), since + 1
            if left < least:
                best, least, since = copy(point), left, 0
    x = best.x.copy()
    x[problem.free :] = np.maximum(x[problem.free :], 0.0)
    return PrimalDual(x, best.y, best.m, f"interior point, {steps} steps")


class _PrimalDualPoint:
    """Primal and dual variables, all strictly inside; letters as in the programs above, u - v = b - A x = rest."""

    def __init__(self, problem: Problem, pull: Array, start: Array | None) -> None:
        self._p, self._pull = problem, pull
        a, b, c = problem.rows, problem.goal, problem.matrix
        self._bounded = slice(problem.free, None)
        x = regularised_solver(a.T @ a)(a.T @ b) if start is None else start.copy()
        size = float(np.abs(x).max(initial=0.0)) or 1.0
        x[self._bounded] = np.maximum(x[self._bounded], 1e-2 * size)
        self.x, self.rest = x, b - a @ x
        rest = self.rest
        usual = max(float(np.abs(rest).mean()), _LEAST * float(np.abs(b).mean())) or 1.0
        self.u, self.v = np.maximum(rest, 0) + usual, np.maximum(-rest, 0) + usual
        # 1 - y and 1 + y, stored instead of y so that rounding does not lose the distance of a row from its limit.
        self.up, self.down = np.ones(b.size), np.ones(b.size)
        self.s = np.maximum(c @ x - problem.lower, 0.1 * size)
        # The limits balance the pull of rows with these residuals: a smaller price would start too near the limits.
        pulled = _PULLED * float(np.abs(a.T @ (rest / (np.abs(rest) + usual)) + pull).mean())
        self._price = max(usual / size * b.size / x.size, 1e-2 * b.size / x.size, pulled)
        self.m, self.w = np.full(c.shape[0], self._price), np.full(x.size - problem.free, self._price)
        self._floor = _EXACT * max(float(np.abs(b).sum()), TINY)
        self.missed = self._dual_residual()

    @property
    def y(self) -> Array:
        """Duals of the rows."""
        return 0.5 * (self.down - self.up)

    def remaining(self) -> float:
        """Return complementarity plus the priced infeasibility of both points; 0 once they are within tolerance."""
        left = self._complementarity() + float(np.abs(self.missed) @ np.abs(self.x))
        left += float(np.abs(self._short()) @ np.maximum(self.m, self._price))
        return left if left > self._tolerance() else 0.0

    def is_complementary(self) -> bool:
        """Return whether complementarity is within tolerance, so that only rounding is left."""
        return self._complementarity() <= self._tolerance()

    def _tolerance(self) -> float:
        return max(_CLOSE * float(np.abs(self.rest).sum()), self._floor)

    def _short(self) -> Array:
        """Return the residual of the inequalities."""
        return np.asarray(self._p.lower - self._p.matrix @ self.x + self.s)

    def _complementarity(self) -> float:
        inner = float(self.u @ self.up + self.v @ self.down)
        return inner + float(self.s @ self.m + self.w @ self.x[self._bounded])

    def _dual_residual(self) -> Array:
        left = self._p.rows.T @ self.y + self._p.matrix.T @ self.m + self._pull
        left[self._bounded] += self.w
        return np.asarray(-left)

    def step(self) -> None:
        """Take one step, if there is a finite one."""
        places = 2 * self.u.size + self.s.size + self.w.size
        mean = self._complementarity() / places
        newton = _NewtonL1(self)
        change = self._changes_to(newton, 0.0)
        after = self._stepped(change, *self._reach(change))._complementarity() / places
        change = self._changes_to(newton, corrector_target(mean, after), change)
        lengths = self._reach(change)
        if min(lengths) < _BLOCKED:
            # Some product is far below the mean and blocks the step: return to the central path first.
            change = self._changes_to(newton, _CENTRING * mean)
            lengths = self._reach(change)
        if all(np.isfinite(part).all() for part in change):
            self.__dict__.update(self._stepped(change, *(_FARTHEST * length for length in lengths)).__dict__)
            self.rest, self.missed = self._p.goal - self._p.rows @ self.x, self._dual_residual()

    def _changes_to(self, newton: _NewtonL1, aim: float, before: tuple[Array, ...] | None = None) -> tuple[Array, ...]:
        """Return changes that bring all complementarities to `aim`, of second order if the predictor's are given."""
        targets = [
            aim - self.u * self.up,
            aim - self.v * self.down,
            aim - self.s * self.m,
            aim - self.w * self.x[self._bounded],
        ]
        if before is not None:
            du, dv, ds, dx, dy, dm, dw = before
            second = du * dy, -dv * dy, -ds * dm, -dw * dx[self._bounded]
            targets = [first + more for first, more in zip(targets, second, strict=True)]
        return newton.changes(*targets)

    def _reach(self, change: tuple[Array, ...]) -> tuple[float, float]:
        """Return the step lengths of the primal and of the dual variables."""
        du, dv, ds, dx, dy, dm, dw = change
        primal = min(
            reach(self.u, du), reach(self.v, dv), reach(self.s, ds), reach(self.x[self._bounded], dx[self._bounded])
        )
        return primal, min(reach(self.up, -dy), reach(self.down, dy), reach(self.m, dm), reach(self.w, dw))

    def _stepped(self, change: tuple[Array, ...], primal: float, dual: float) -> _PrimalDualPoint:
        du, dv, ds, dx, dy, dm, dw = change
        moved = copy(self)
        moved.u, moved.v, moved.s = self.u + primal * du, self.v + primal * dv, self.s + primal * ds
        moved.x, moved.up, moved.down = self.x + primal * dx, self.up - dual * dy, self.down + dual * dy
        moved.m, moved.w = self.m + dual * dm, self.w + dual * dw
        return moved


class _NewtonL1:
    """Newton's equations at a point, reduced to the q coefficients."""

    def __init__(self, at: _PrimalDualPoint) -> None:
        self._at, problem = at, at._p
        self._weight = 1 / (at.u / at.up + at.v / at.down)
        self._ratio = at.m / at.s
        normal = _gram(problem.rows, self._weight) + barrier_matrix(problem.matrix, at.m, at.s)
        self._below = at.w / at.x[problem.free :]
        places = np.arange(problem.free, problem.unknowns)
        normal[places, places] += self._below
        self._solve = regularised_solver(normal)
        self._missed, self._short = at.missed, at._short()
        self._left = at.rest - at.u + at.v

    def changes(self, ru: Array, rv: Array, rs: Array, rx: Array) -> tuple[Array, ...]:
        """Return changes of u, v, s, x, y, m, w that change the four complementarities by these amounts."""
        at, problem = self._at, self._at._p
        goal = self._left - ru / at.up + rv / at.down
        force = (rs + at.m * self._short) / at.s
        right = problem.rows.T @ (self._weight * goal) + problem.matrix.T @ force - self._missed
        right[problem.free :] += rx / at.x[problem.free :]
        dx = self._solve(right)
        dy = self._weight * (goal - problem.rows @ dx)
        ds = problem.matrix @ dx - self._short
        dw = rx / at.x[problem.free :] - self._below * dx[problem.free :]
        return ((ru + at.u * dy) / at.up, (rv - at.v * dy) / at.down, ds, dx, dy, rs / at.s - self._ratio * ds, dw)


def _gram(rows: Array, weight: Array) -> Array:
    """Return the weighted Gram matrix of rows (n, q), by pieces, without a second copy of all rows.

    Near the optimum most weights vanish; what is left out only bends the direction of a step.
    """
    total, root = np.zeros((rows.shape[1], rows.shape[1])), np.sqrt(weight)
    heavy = np.flatnonzero(weight > _NEGLIGIBLE * weight.max(initial=0.0))
    if 4 * heavy.size > 3 * weight.size:
        heavy = np.arange(weight.size)
    for first in range(0, heavy.size, _PIECE):
        places = heavy[first : first + _PIECE]
        piece = rows[places] * root[places, None]
        total += piece.T @ piece
    return total


# Of few rows the optimal vertex is found: a wider gap is due to rounding.
_FEW = 5000
_TIGHT = 1e-4
# Of a reduced program with more rows HiGHS takes longer than another selection of rows.
_MOST_HIGHS = 20_000
# Largest residual, the goal being of order one, of rows that the optimum meets; most such rows that are used.
_MET = 1e-7
_MOST_MET = 5000


def least_absolute_deviations(problem: Problem, pull: Array, unit: float) -> PrimalDual:
    """Minimise the sum of absolute residuals less pull'x.

    `pull` (q,): sum of the rows with a residual of known sign, each times its sign. `unit`: sum of absolute targets of
    all rows: the gap is relative to it, or to the objective if that is larger.
    """
    pair = interior(problem, pull)
    x = _polished(problem, pull, pair.x)
    limit = OPTIMAL * (_TIGHT if problem.goal.size <= _FEW else 1.0)
    objective = float(np.abs(problem.goal - problem.rows @ x).sum() - pull @ x)
    value, lacking = dual_value(problem, pull, pair.y, pair.multipliers, x)
    if abs(objective - value) + lacking <= limit * max(unit, abs(objective)) and problem.meets(x):
        return replace(pair, x=x)
    if problem.goal.size > _MOST_HIGHS and np.any(pull):
        return replace(pair, status="no optimum of the rows that were kept", optimal=False)
    return _by_highs(problem, pull, pair)


def dual_value(problem: Problem, pull: Array, y: Array, multipliers: Array, x: Array) -> tuple[float, float]:
    """Return the value of a dual point, and its infeasibility priced at x."""
    lacking = problem.rows.T @ y + problem.matrix.T @ multipliers + pull
    lacking[problem.free :] = np.maximum(lacking[problem.free :], 0.0)
    return float(problem.goal @ y + problem.lower @ multipliers), float(np.abs(lacking) @ np.abs(x))


def _by_highs(problem: Problem, pull: Array, pair: PrimalDual) -> PrimalDual:
    n, q = problem.rows.shape
    m = problem.lower.size
    limits = np.where(np.arange(q) < problem.free, -pull, -np.inf), -pull
    box = np.append(-np.ones(n), np.zeros(m)), np.append(np.ones(n), np.full(m, np.inf))
    both, cost = np.vstack([problem.rows, problem.matrix]).T, -np.append(problem.goal, problem.lower)
    solution = highs.minimum(cost, box, both, limits, solver="ipm")
    if not solution.optimal:
        solution = highs.minimum(cost, box, both, limits)
    if not solution.optimal:
        return replace(pair, status=solution.status, optimal=False)
    x = -solution.row_dual
    x[problem.free :] = np.maximum(x[problem.free :], 0.0)
    return PrimalDual(_polished(problem, pull, x), solution.value[:n], solution.value[n:], solution.status)


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
