"""Least absolute deviations by a primal-dual interior point on the boxed dual (Frisch and Newton).

    minimise sum |b - A x| - t'x,   x[free:] >= 0,   C x >= l
    maximise b'y + l'm,   A'y + C'm + w + t = 0,   -1 <= y <= 1,   m, w >= 0,   w[:free] = 0

t represents rows with a residual of known sign: it is the sum of these rows, each times its sign (Portnoy and Koenker
1997, Stat. Sci. 12, 279). Each iteration solves q equations twice (Mehrotra's predictor and corrector); the matrix is
scaled to a unit diagonal and gets a ridge that grows until its factor exists, and the solution is refined.
`least_absolute_deviations` returns the vertex next to the interior point, certified by its duality gap. If rounding
leaves too wide a gap, HiGHS solves the dual, max b'y + l'm, A'y + C'm + t <= 0 (= 0 for free coefficients),
abs(y) <= 1, m >= 0, whose row duals are x.

Of many rows, a sample gives a first answer (`least_absolute`). Residuals far from zero there rarely change their sign:
these rows enter the program only by t. With these signs as their duals, a dual point of the small program is one of the
whole program, whatever the signs are. So the duality gap over all rows certifies each answer, and rows with a wrong
sign return to the program until that gap is closed.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array
from dehyst.identification.solvers import highs
from dehyst.identification.solvers.problem import (
    OPTIMAL,
    TINY,
    Answer,
    Problem,
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
    best, (least, close), since, steps = copy(point), point.remaining(), 0, 0
    # Weights of rows without residual overflow at the very end; such steps are not taken.
    with np.errstate(all="ignore"):
        while least > 0 and since <= (_LAST if close else _PATIENCE) and steps < _STEPS:
            point.step()
            left, close = point.remaining()
            steps, since = steps + 1, since + 1
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

    def remaining(self) -> tuple[float, bool]:
        """Return complementarity plus the priced infeasibility of both points, 0 once they are within tolerance.

        Also whether complementarity is within tolerance, so that only rounding is left.
        """
        complementarity, tolerance = self._complementarity(), max(_CLOSE * float(np.abs(self.rest).sum()), self._floor)
        left = complementarity + float(np.abs(self.missed) @ np.abs(self.x))
        left += float(np.abs(self._short()) @ np.maximum(self.m, self._price))
        return left if left > tolerance else 0.0, complementarity <= tolerance

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
        mean, changes_to = self._complementarity() / places, self._newton()
        change = changes_to(0.0)
        after = self._stepped(change, *self._reach(change))._complementarity() / places
        change = changes_to(corrector_target(mean, after), change)
        lengths = self._reach(change)
        if min(lengths) < _BLOCKED:
            # Some product is far below the mean and blocks the step: return to the central path first.
            change = changes_to(_CENTRING * mean)
            lengths = self._reach(change)
        if all(np.isfinite(part).all() for part in change):
            self.__dict__.update(self._stepped(change, *(_FARTHEST * length for length in lengths)).__dict__)
            self.rest, self.missed = self._p.goal - self._p.rows @ self.x, self._dual_residual()

    def _newton(self) -> Callable[..., tuple[Array, ...]]:
        """Return a function of Newton's equations, reduced to the q coefficients.

        It returns the changes of u, v, s, x, y, m, w that bring all complementarities to an aim, of second order if it
        gets the predictor's changes.
        """
        p, bounded, x = self._p, self._bounded, self.x[self._bounded]
        weight, ratio, below = 1 / (self.u / self.up + self.v / self.down), self.m / self.s, self.w / x
        normal = _gram(p.rows, weight) + (p.matrix.T * ratio) @ p.matrix
        places = np.arange(p.free, p.unknowns)
        normal[places, places] += below
        solve = regularised_solver(normal)
        short, left = self._short(), self.rest - self.u + self.v

        def changes(aim: float, before: tuple[Array, ...] | None = None) -> tuple[Array, ...]:
            ru, rv = aim - self.u * self.up, aim - self.v * self.down
            rs, rx = aim - self.s * self.m, aim - self.w * x
            if before is not None:
                du, dv, ds, dx, dy, dm, dw = before
                ru, rv, rs, rx = ru + du * dy, rv - dv * dy, rs - ds * dm, rx - dw * dx[bounded]
            goal = left - ru / self.up + rv / self.down
            force = (rs + self.m * short) / self.s
            right = p.rows.T @ (weight * goal) + p.matrix.T @ force - self.missed
            right[bounded] += rx / x
            dx = solve(right)
            dy, ds = weight * (goal - p.rows @ dx), p.matrix @ dx - short
            du, dv = (ru + self.u * dy) / self.up, (rv - self.v * dy) / self.down
            return du, dv, ds, dx, dy, rs / self.s - ratio * ds, rx / x - below * dx[bounded]

        return changes

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
    value, lacking = dual_value(problem, pull, pair, x)
    if abs(objective - value) + lacking <= limit * max(unit, abs(objective)) and problem.meets(x):
        return replace(pair, x=x)
    if problem.goal.size > _MOST_HIGHS and np.any(pull):
        return replace(pair, status="no optimum of the rows that were kept", optimal=False)
    return _by_highs(problem, pull, pair)


def dual_value(problem: Problem, pull: Array, dual: PrimalDual, x: Array) -> tuple[float, float]:
    """Return the value of a dual point, and its infeasibility priced at x."""
    lacking = problem.rows.T @ dual.y + problem.matrix.T @ dual.multipliers + pull
    lacking[problem.free :] = np.maximum(lacking[problem.free :], 0.0)
    return float(problem.goal @ dual.y + problem.lower @ dual.multipliers), float(np.abs(lacking) @ np.abs(x))


def _by_highs(problem: Problem, pull: Array, pair: PrimalDual) -> PrimalDual:
    """Solve the dual program, whose multipliers are the coefficients."""
    n, m, p = problem.goal.size, problem.lower.size, problem.free
    box = np.append(-np.ones(n), np.zeros(m)), np.append(np.ones(n), np.full(m, np.inf))
    both, cost = np.vstack([problem.rows, problem.matrix]).T, -np.append(problem.goal, problem.lower)
    program = cost, box, (both[:p], -pull[:p]), (both[p:], -pull[p:])
    solution = highs.minimum(*program, "highs-ipm")
    if not solution.optimal:
        solution = highs.minimum(*program)
    if not solution.optimal:
        return replace(pair, status=solution.status, optimal=False)
    x = -solution.multipliers
    x[p:] = np.maximum(x[p:], 0.0)
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


# Up to so many rows a coefficient a sample saves nothing.
_WHOLE = 60
# Most numbers in a sample of rows, and in all rows of a program: 8 bytes each.
_SAMPLED_NUMBERS, _MOST_NUMBERS = 8_000_000, 24_000_000
_ROUNDS = 12
# Ratio of all rows to a sample above which a sample of middle size comes between them.
_LEAP = 10
# The gap that ends the rounds, relative to the objective, and relative to the objective at zero.
_GAP_CLOSED, _GAP_EXACT = 0.1 * OPTIMAL, 1e-12
_UNSEEN = 1e-10
# Rows with numbers so many times the typical ones are never thinned, up to so many a coefficient.
_HEAVY, _MOST_HEAVY = 20.0, 10


def least_absolute(problem: Problem) -> Answer:
    """Minimise the sum of absolute residuals."""
    n, q = problem.rows.shape
    size = min(max(int(n ** (2 / 3) * q ** (1 / 3)), 20 * q), _SAMPLED_NUMBERS // max(q, 1))
    if n <= max(2 * size, _WHOLE * q):
        return _solve_all_rows(problem)
    sample, unit = _thinned(problem, -(-n // size)), _size_of_targets(problem)
    first = least_absolute(sample)
    if not first.optimal:
        return _solve_all_rows(problem) if n * q <= _MOST_NUMBERS else first
    x, step = first.x, int((n / size) ** 0.5)
    if n > _LEAP * size:
        # After so small a sample too many signs would be in doubt.
        middle = _solve_reduced(_thinned(problem, step), sample, x, unit / step)
        x = middle.x if middle.optimal else x
    return _solve_reduced(problem, sample, x, unit)


def _size_of_targets(problem: Problem) -> float:
    """Return the sum of absolute targets."""
    return max(float(np.abs(problem.goal).sum()), TINY)


def _solve_all_rows(problem: Problem) -> Answer:
    """Solve the program without a reduction."""
    pull, unit = np.zeros(problem.unknowns), _size_of_targets(problem)
    solution = least_absolute_deviations(problem, pull, unit)
    if not solution.optimal:
        return problem.failed(solution.status)
    primal = float(np.abs(problem.goal - problem.rows @ solution.x).sum())
    value, lacking = dual_value(problem, pull, solution, solution.x)
    return problem.answer(solution.x, (primal - value + lacking) / max(unit, primal), solution.status)


def _thinned(problem: Problem, step: int) -> Problem:
    """Return every step-th row, and all heavy ones at a step-th of their weight.

    A few heavy rows may matter as much as all others: they must neither be missed by chance nor represent others.
    """
    if step == 1:
        return problem
    rows, goal = problem.rows, problem.goal
    # The median over rows of their largest number.
    usual = max(float(np.median(np.abs(rows[:: len(rows) // 4096 + 1]).max(axis=1))), TINY)
    every = np.zeros(goal.size, dtype=bool)
    every[::step] = True
    heavy = np.maximum(rows.max(axis=1), -rows.min(axis=1)) > _HEAVY * usual
    if not heavy.any() or np.count_nonzero(heavy) > max(_MOST_HEAVY * rows.shape[1], goal.size // step):
        return replace(problem, rows=rows[every], goal=goal[every])
    every &= ~heavy
    some, targets = (np.concatenate([column[every], column[heavy] / step]) for column in (rows, goal))
    return replace(problem, rows=some, goal=targets)


class _Divided(NamedTuple):
    """Rows in the program, and the sum of the others.

    `problem`: the kept rows. `places` (k,) int: their places among all rows, ascending. `signs_of` (q,): the
    coefficients that define the signs of the others. `pull`, `value` (q,): sums of the other rows and of their targets,
    each times its sign.
    """

    problem: Problem
    places: NDArray[np.intp]
    signs_of: Array
    pull: Array
    value: float


class _WrongSigns(NamedTuple):
    """Rows with a residual of another sign than assumed: (k, q), (k,), (k,), and the assumed signs (k,)."""

    rows: Array
    goal: Array
    places: NDArray[np.intp]
    signs: Array


def _solve_reduced(problem: Problem, sample: Problem, x: Array, unit: float) -> Answer:
    """Solve the program on few rows, whose signs are in doubt next to `x` (q,); `unit` as above."""
    n, most = problem.goal.size, _MOST_NUMBERS // problem.unknowns
    doubt, room = _SignDoubt(sample), min(2 * sample.goal.size, _SAMPLED_NUMBERS // (2 * problem.unknowns))
    divided, centre = _divide_rows(problem, x, doubt, room)
    if centre <= _GAP_EXACT * unit:
        # Zeros are a dual point: the objective cannot fall, and signs of rounding errors have no meaning.
        return Answer(x, f"optimal (a sample of {sample.goal.size} of {n} rows meets all)", True, centre / unit)
    # If more than half of the rows are in the program, all of them may be, if memory permits.
    best = problem.failed("no round of the reduction gave an answer")
    for k in range(1, _ROUNDS + 1):
        solution = least_absolute_deviations(divided.problem, divided.pull, unit)
        primal, wrong = _check_signs(problem, divided, solution.x, most) if solution.optimal else (np.inf, None)
        if wrong is not None:
            value, lacking = dual_value(divided.problem, divided.pull, solution, solution.x)
            gap = primal - value - divided.value + lacking
            if not gap / unit > best.gap:
                method = f"{solution.status}, on {divided.places.size} of {n} rows in round {k}"
                best = problem.answer(solution.x, gap / max(unit, primal), method)
            if gap <= max(_GAP_CLOSED * primal, _GAP_EXACT * unit) or not wrong.places.size:
                break
            many = divided.places.size + wrong.places.size
            if n <= min(most, 2 * many):
                break
            # If more signs are wrong than rows are kept, other rows should be kept, next to the better answer.
            if many <= most and (many <= 2 * divided.places.size or primal >= centre):
                divided = _with_rows(divided, wrong)
                continue
        if primal < centre:
            x = solution.x
        elif room < most:
            # Too many signs are wrong: the kept rows cannot balance the pull of the others.
            room = min(2 * room, most)
        else:
            break
        if n <= min(most, 2 * room):
            break
        divided, centre = _divide_rows(problem, x, doubt, room)
    return best if best.optimal or n > most else _solve_all_rows(problem)


class _SignDoubt:
    """Doubt about the sign of a residual: its size over the shift that the sample's uncertainty may cause."""

    def __init__(self, sample: Problem) -> None:
        values, vectors = np.linalg.eigh(sample.rows.T @ sample.rows / sample.goal.size)
        # A root of the inverse Gram matrix (q, q): rows times it are as long as the square root of their leverage. What
        # the sample does not contain, such as a constant of few rows, is in the greatest doubt.
        self._root = vectors / np.sqrt(np.maximum(values, 0.0) + _UNSEEN * values.max(initial=TINY))
        self._sample = sample

    def score(self, rows: Array, residual: Array) -> Array:
        """Return a score of each row (n,), small where the sign is in doubt."""
        shift = rows @ self._root
        return np.asarray(np.abs(residual) / np.sqrt(np.einsum("ij,ij->i", shift, shift) + TINY))

    def cuts(self, x: Array, share: float) -> Array:
        """Return for each group of rows the score below which this share of its rows in the sample lies.

        Each group keeps its share: a group with a free coefficient needs enough rows to balance the sum of the others,
        even if its record is fitted less well.
        """
        rows, free = self._sample.rows, self._sample.free
        scores, groups = self.score(rows, self._sample.goal - rows @ x), _groups(rows, free)
        cuts = np.full(free + 1, np.inf)
        for group in np.unique(groups):
            cuts[group] = np.quantile(scores[groups == group], min(share, 1.0))
        return cuts


def _divide_rows(problem: Problem, x: Array, doubt: _SignDoubt, room: int) -> tuple[_Divided, float]:
    """Keep about `room` rows whose sign is most in doubt, add up the others; also the sum of absolute residuals."""
    rows, goal = problem.rows, problem.goal
    cuts, residual = doubt.cuts(x, room / goal.size), goal - rows @ x
    kept = np.flatnonzero(doubt.score(rows, residual) <= cuts[_groups(rows, problem.free)])[: room + room // 2]
    signs = np.where(residual >= 0, 1.0, -1.0)
    signs[kept] = 0.0
    few = replace(problem, rows=rows[kept], goal=goal[kept])
    return _Divided(few, kept, x, signs @ rows, float(signs @ goal)), float(np.abs(residual).sum())


def _groups(rows: Array, free: int) -> NDArray[np.intp]:
    """Return the first free coefficient of each row (n,), such as its epoch's constant; their number if none."""
    nonzero = np.hstack([rows[:, :free] != 0, np.ones((len(rows), 1), dtype=bool)])
    return np.asarray(nonzero.argmax(axis=1))


def _check_signs(problem: Problem, divided: _Divided, x: Array, most: int) -> tuple[float, _WrongSigns]:
    """Return the sum of absolute residuals of all rows, and at most `most` + 1 rows with wrong signs."""
    rows, goal = problem.rows, problem.goal
    residual, signs = goal - rows @ x, np.where(goal - rows @ divided.signs_of >= 0, 1.0, -1.0)
    signs[divided.places] = 0.0
    wrong = np.flatnonzero(residual * signs < 0)[: most + 1]
    return float(np.abs(residual).sum()), _WrongSigns(rows[wrong], goal[wrong], wrong, signs[wrong])


def _with_rows(divided: _Divided, more: _WrongSigns) -> _Divided:
    """Keep these rows too, written directly to their places: joining and sorting would need a second copy."""
    places = np.concatenate([divided.places, more.places])
    place = np.empty(places.size, np.intp)
    place[np.argsort(places, kind="stable")] = np.arange(places.size)
    old, new = np.split(place, [divided.places.size])
    problem = divided.problem
    rows, goal = np.empty((place.size, problem.unknowns)), np.empty(place.size)
    rows[old], rows[new] = problem.rows, more.rows
    goal[old], goal[new] = problem.goal, more.goal
    return divided._replace(
        problem=replace(problem, rows=rows, goal=goal),
        places=np.sort(places),
        pull=divided.pull - more.signs @ more.rows,
        value=divided.value - float(more.signs @ more.goal),
    )
