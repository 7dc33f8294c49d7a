"""Least absolute deviations by a primal-dual interior point on the boxed dual (Frisch and Newton).

    minimise sum |b - A x| - t'x,   x[free:] >= 0,   C x >= l
    maximise b'y + l'm,   A'y + C'm + w + t = 0,   -1 <= y <= 1,   m, w >= 0,   w[:free] = 0

t stands for rows whose residual's sign is known: it is the sum of these rows, each times its sign (Portnoy and Koenker
1997, Stat. Sci. 12, 279). Each iteration solves q equations twice (Mehrotra's predictor and corrector); the matrix is
scaled to a unit diagonal, given a ridge that grows until its factor exists, and the answer is refined.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import numpy as np

from dehyst._types import Array
from dehyst.identification.solvers.interior_point import reach, regularised
from dehyst.identification.solvers.problem import TINY, Problem

_STEPS = 80
# The interior point ends when complementarity is this part of the sum of absolute residuals, or of the targets.
_CLOSE = 1e-11
_EXACT = 1e-14
_FARTHEST = 0.9995
# Residuals at the start are no smaller than this part of the targets: the start needs room.
_LEAST = 1e-3
# Of what pulls at the coefficients, the part that their limits are taken to hold at the start.
_PULLED = 0.3
_BLOCKED = 0.2
_CENTRING = 0.5
# Steps without progress before the best point so far is taken, rounding letting no better one be found: while products
# are left, and once there are none.
_PATIENCE, _SPENT = 15, 2
_PIECE = 4096


@dataclass(frozen=True, eq=False)
class Pair:
    """A point and a dual point.

    Attributes
    ----------
    x, y, multipliers : (q,), (n,) and (m,) array
        Coefficients, duals of the rows in [-1, 1], and of the inequalities, not negative.
    iterations : int
    """

    x: Array
    y: Array
    multipliers: Array
    iterations: int


def interior(problem: Problem, pull: Array | None = None, start: Array | None = None) -> Pair:
    """Minimise the sum of absolute residuals less `pull` (q,) times x, from `start` (q,) or the least squares."""
    point = _PrimalDualPoint(problem, np.zeros(problem.unknowns) if pull is None else pull, start)
    best, least, since, steps = copy(point), point.left(), 0, 0
    # Weights of rows that are met overflow at the very end; such steps are not taken.
    with np.errstate(all="ignore"):
        while least > 0 and since <= (_SPENT if point.spent() else _PATIENCE) and steps < _STEPS:
            point.step()
            steps += 1
            left, since = point.left(), since + 1
            if left < least:
                best, least, since = copy(point), left, 0
    x = best.x.copy()
    x[problem.free :] = np.maximum(x[problem.free :], 0.0)
    return Pair(x, best.y, best.m, steps)


class _PrimalDualPoint:
    """Primal and dual variables, all strictly inside; letters as in the programs above, u - v = b - A x = rest."""

    def __init__(self, problem: Problem, pull: Array, start: Array | None) -> None:
        self._p, self._pull = problem, pull
        a, b, c = problem.rows, problem.goal, problem.matrix
        self._bounded = slice(problem.free, None)
        x = regularised(a.T @ a)(a.T @ b) if start is None else start.copy()
        size = float(np.abs(x).max(initial=0.0)) or 1.0
        x[self._bounded] = np.maximum(x[self._bounded], 1e-2 * size)
        self.x, self.rest = x, b - a @ x
        rest = self.rest
        usual = max(float(np.abs(rest).mean()), _LEAST * float(np.abs(b).mean())) or 1.0
        self.u, self.v = np.maximum(rest, 0) + usual, np.maximum(-rest, 0) + usual
        # Apart from y, lest a row's distance from its limit be lost in rounding.
        self.one, self.other = np.ones(b.size), np.ones(b.size)
        self.s = np.maximum(c @ x - problem.lower, 0.1 * size)
        # Limits hold against what rows with these residuals pull: a smaller price would start too near them.
        pulled = _PULLED * float(np.abs(a.T @ (rest / (np.abs(rest) + usual)) + pull).mean())
        self._price = max(usual / size * b.size / x.size, 1e-2 * b.size / x.size, pulled)
        self.m, self.w = np.full(c.shape[0], self._price), np.full(x.size - problem.free, self._price)
        self._floor = _EXACT * max(float(np.abs(b).sum()), TINY)
        self.missed = self._dual_missed()

    @property
    def y(self) -> Array:
        """Duals of the rows."""
        return 0.5 * (self.other - self.one)

    def left(self) -> float:
        """Complementarity and what the points' feasibility lacks, priced; 0 once they are within tolerance."""
        left = self._complementarity() + float(np.abs(self.missed) @ np.abs(self.x))
        left += float(np.abs(self._short()) @ np.maximum(self.m, self._price))
        return left if left > self._tolerance() else 0.0

    def spent(self) -> bool:
        """Whether complementarity is within tolerance: what is left is rounding."""
        return self._complementarity() <= self._tolerance()

    def _tolerance(self) -> float:
        return max(_CLOSE * float(np.abs(self.rest).sum()), self._floor)

    def _short(self) -> Array:
        """What the inequalities lack."""
        return np.asarray(self._p.lower - self._p.matrix @ self.x + self.s)

    def _complementarity(self) -> float:
        inner = float(self.u @ self.one + self.v @ self.other)
        return inner + float(self.s @ self.m + self.w @ self.x[self._bounded])

    def _dual_missed(self) -> Array:
        left = self._p.rows.T @ self.y + self._p.matrix.T @ self.m + self._pull
        left[self._bounded] += self.w
        return np.asarray(-left)

    def step(self) -> None:
        """Go one step, if there is any."""
        places = 2 * self.u.size + self.s.size + self.w.size
        mean = self._complementarity() / places
        newton = _NewtonL1(self)
        change = self._aimed(newton, 0.0)
        after = self._moved(change, *self._reach(change))._complementarity() / places
        change = self._aimed(newton, (after / mean) ** 3 * mean, change)
        lengths = self._reach(change)
        if min(lengths) < _BLOCKED:
            # Some product is far below the mean and blocks the way: go back to the middle first.
            change = self._aimed(newton, _CENTRING * mean)
            lengths = self._reach(change)
        if all(np.isfinite(part).all() for part in change):
            self.__dict__.update(self._moved(change, *(_FARTHEST * length for length in lengths)).__dict__)
            self.rest, self.missed = self._p.goal - self._p.rows @ self.x, self._dual_missed()

    def _aimed(self, newton: _NewtonL1, aim: float, before: tuple[Array, ...] | None = None) -> tuple[Array, ...]:
        """Changes that bring all complementarities to `aim`, of second order if the predictor's changes are given."""
        targets = [
            aim - self.u * self.one,
            aim - self.v * self.other,
            aim - self.s * self.m,
            aim - self.w * self.x[self._bounded],
        ]
        if before is not None:
            du, dv, ds, dx, dy, dm, dw = before
            second = du * dy, -dv * dy, -ds * dm, -dw * dx[self._bounded]
            targets = [first + more for first, more in zip(targets, second, strict=True)]
        return newton.towards(*targets)

    def _reach(self, change: tuple[Array, ...]) -> tuple[float, float]:
        """How far the primal and the dual variables may go."""
        du, dv, ds, dx, dy, dm, dw = change
        primal = min(
            reach(self.u, du), reach(self.v, dv), reach(self.s, ds), reach(self.x[self._bounded], dx[self._bounded])
        )
        return primal, min(reach(self.one, -dy), reach(self.other, dy), reach(self.m, dm), reach(self.w, dw))

    def _moved(self, change: tuple[Array, ...], primal: float, dual: float) -> _PrimalDualPoint:
        du, dv, ds, dx, dy, dm, dw = change
        moved = copy(self)
        moved.u, moved.v, moved.s = self.u + primal * du, self.v + primal * dv, self.s + primal * ds
        moved.x, moved.one, moved.other = self.x + primal * dx, self.one - dual * dy, self.other + dual * dy
        moved.m, moved.w = self.m + dual * dm, self.w + dual * dw
        return moved


class _NewtonL1:
    """Newton's equations at a point, reduced to the q coefficients."""

    def __init__(self, at: _PrimalDualPoint) -> None:
        self._at, problem = at, at._p
        self._weight = 1 / (at.u / at.one + at.v / at.other)
        self._ratio = at.m / at.s
        normal = _gram(problem.rows, self._weight) + (problem.matrix.T * self._ratio) @ problem.matrix
        self._below = at.w / at.x[problem.free :]
        places = np.arange(problem.free, problem.unknowns)
        normal[places, places] += self._below
        self._solve = regularised(normal)
        self._missed, self._short = at.missed, at._short()
        self._left = at.rest - at.u + at.v

    def towards(self, ru: Array, rv: Array, rs: Array, rx: Array) -> tuple[Array, ...]:
        """Changes of u, v, s, x, y, m, w that change the four complementarities by these amounts."""
        at, problem = self._at, self._at._p
        goal = self._left - ru / at.one + rv / at.other
        held = (rs + at.m * self._short) / at.s
        right = problem.rows.T @ (self._weight * goal) + problem.matrix.T @ held - self._missed
        right[problem.free :] += rx / at.x[problem.free :]
        dx = self._solve(right)
        dy = self._weight * (goal - problem.rows @ dx)
        ds = problem.matrix @ dx - self._short
        dw = rx / at.x[problem.free :] - self._below * dx[problem.free :]
        return ((ru + at.u * dy) / at.one, (rv - at.v * dy) / at.other, ds, dx, dy, rs / at.s - self._ratio * ds, dw)


def _gram(rows: Array, weight: Array) -> Array:
    """Sum of weighted squares of rows (n, q), piece by piece: a copy of all would take as much room as they."""
    total, root = np.zeros((rows.shape[1], rows.shape[1])), np.sqrt(weight)
    for first in range(0, len(rows), _PIECE):
        piece = rows[first : first + _PIECE] * root[first : first + _PIECE, None]
        total += piece.T @ piece
    return total
