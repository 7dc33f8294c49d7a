"""Least absolute deviations of any number of rows, read in blocks, of which a few are in memory.

A sample of the rows gives a first answer. Residuals far from zero there rarely change their sign: these rows enter the
program only by their sum, each times its sign (Portnoy and Koenker 1997, Stat. Sci. 12, 279). With these signs as their
duals, a dual point of the small program is one of the whole program, whatever the signs are. So the duality gap over
all rows certifies each answer, and rows with a wrong sign return to the program until that gap is closed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array
from dehyst.identification.solvers.least_absolute import PrimalDual, dual_value, least_absolute_deviations
from dehyst.identification.solvers.problem import OPTIMAL, TINY, Answer, Problem, failed

# Up to so many rows a coefficient a sample saves nothing.
_WHOLE = 60
# Most numbers in a sample of rows, and in all rows of a program: 8 bytes each.
_SAMPLED_NUMBERS, _MOST_NUMBERS = 8_000_000, 24_000_000
_ROUNDS = 12
# Ratio of all rows to a sample above which a sample of middle size comes between them.
_LEAP = 10
# The gap that ends the rounds, relative to the objective, and relative to the objective at zero.
_CLOSE = 0.1 * OPTIMAL
_EXACT = 1e-12
_UNSEEN = 1e-10
# Rows with numbers so many times the typical ones are never thinned, up to so many a coefficient.
_HEAVY, _MOST_HEAVY = 20.0, 10


class Blocks(Protocol):
    """Rows and targets (k, q) and (k,) in blocks, iterated any number of times; n rows in all."""

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[tuple[Array, Array]]: ...


@dataclass(frozen=True, eq=False)
class Whole:
    """Rows in memory, in one block."""

    rows: Array
    goal: Array

    def __len__(self) -> int:
        return self.goal.size

    def __iter__(self) -> Iterator[tuple[Array, Array]]:
        yield self.rows, self.goal


@dataclass(frozen=True, eq=False)
class _Thinned:
    """Every step-th row of blocks, thinned by `_thin`; the length does not count heavy rows."""

    blocks: Blocks
    step: int

    def __len__(self) -> int:
        return len(range(0, len(self.blocks), self.step))

    def __iter__(self) -> Iterator[tuple[Array, Array]]:
        place, usual = 0, 0.0
        for rows, goal in self.blocks:
            usual = usual or _typical_size(rows)
            some = _thin(rows, goal, place, self.step, usual)
            place += goal.size
            if some[1].size:
                yield some


def _typical_size(rows: Array) -> float:
    """Return the median over rows of their largest number."""
    return max(float(np.median(np.abs(rows[:: len(rows) // 4096 + 1]).max(axis=1))), TINY)


def _thin(rows: Array, goal: Array, place: int, step: int, usual: float) -> tuple[Array, Array]:
    """Return every step-th row of a block that begins at `place`, and all heavy ones at a step-th of their weight.

    A few heavy rows may matter as much as all others: they must neither be missed by chance nor represent others.
    """
    every = np.zeros(goal.size, dtype=bool)
    every[-place % step :: step] = True
    heavy = np.maximum(rows.max(axis=1), -rows.min(axis=1)) > _HEAVY * usual
    if step == 1 or not heavy.any() or np.count_nonzero(heavy) > max(_MOST_HEAVY * rows.shape[1], goal.size // step):
        return rows[every], goal[every]
    every &= ~heavy
    return np.concatenate([rows[every], rows[heavy] / step]), np.concatenate([goal[every], goal[heavy] / step])


@dataclass(frozen=True, eq=False)
class _Divided:
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


def least_absolute(blocks: Blocks, frame: Problem) -> Answer:
    """Minimise the sum of absolute residuals of all rows; `frame` has the limits but no rows."""
    n, q = len(blocks), frame.unknowns
    size = min(max(int(n ** (2 / 3) * q ** (1 / 3)), 20 * q), _SAMPLED_NUMBERS // max(q, 1))
    if n <= max(2 * size, _WHOLE * q):
        return _solve_all_rows(_sample(blocks, frame, 1)[0])
    sample, unit = _sample(blocks, frame, -(-n // size))
    first = least_absolute(Whole(sample.rows, sample.goal), frame)
    if not first.optimal:
        return _solve_all_rows(_sample(blocks, frame, 1)[0]) if n * q <= _MOST_NUMBERS else first
    x, step = first.x, int((n / size) ** 0.5)
    if n > _LEAP * size:
        # After so small a sample too many signs would be in doubt.
        middle = _solve_reduced(_Thinned(blocks, step), frame, sample, x, unit / step)
        x = middle.x if middle.optimal else x
    return _solve_reduced(blocks, frame, sample, x, unit)


def _solve_all_rows(problem: Problem) -> Answer:
    pull, unit = np.zeros(problem.unknowns), max(float(np.abs(problem.goal).sum()), TINY)
    solution = least_absolute_deviations(problem, pull, unit)
    if not solution.optimal:
        return failed(problem, solution.status)
    primal = float(np.abs(problem.goal - problem.rows @ solution.x).sum())
    value, lacking = dual_value(problem, pull, solution.y, solution.multipliers, solution.x)
    return _with_gap(problem, solution, primal - value + lacking, max(unit, primal), solution.status)


def _with_gap(frame: Problem, solution: PrimalDual, gap: float, unit: float, method: str) -> Answer:
    optimal = abs(gap) <= OPTIMAL * unit and frame.meets(solution.x)
    return Answer(solution.x, f"{'optimal' if optimal else 'no optimum'} ({method})", optimal, gap / unit)


def _sample(blocks: Blocks, frame: Problem, step: int) -> tuple[Problem, float]:
    """Return every step-th row, thinned by `_thin`, and the sum of absolute targets of all."""
    rows, goals, place, unit, usual = [], [], 0, TINY, 0.0
    for block, goal in blocks:
        usual = usual or _typical_size(block)
        some, those = (block, goal) if step == 1 else _thin(block, goal, place, step, usual)
        rows.append(some)
        goals.append(those)
        place += goal.size
        unit += float(np.abs(goal).sum())
    whole = np.concatenate(rows) if len(rows) > 1 else rows[0]
    return replace(frame, rows=whole, goal=np.concatenate(goals)), unit


def _solve_reduced(blocks: Blocks, frame: Problem, sample: Problem, x: Array, unit: float) -> Answer:
    n, most = len(blocks), _MOST_NUMBERS // frame.unknowns
    doubt, room = _SignDoubt.of(sample), min(2 * sample.goal.size, _SAMPLED_NUMBERS // (2 * frame.unknowns))
    divided, centre = _divide_rows(blocks, frame, x, doubt, room)
    if centre <= _EXACT * unit:
        # Zeros are a dual point: the objective cannot fall, and signs of rounding errors have no meaning.
        return Answer(x, f"optimal (a sample of {sample.goal.size} of {n} rows meets all)", True, centre / unit)
    # If more than half of the rows are in the program, all of them may be, if memory permits.
    best = failed(frame, "no round of the reduction gave an answer")
    for k in range(1, _ROUNDS + 1):
        solution = least_absolute_deviations(divided.problem, divided.pull, unit)
        primal, wrong = _check_signs(blocks, divided, solution.x, most) if solution.optimal else (np.inf, None)
        if wrong is not None:
            value, lacking = dual_value(divided.problem, divided.pull, solution.y, solution.multipliers, solution.x)
            gap = primal - value - divided.value + lacking
            if not gap / unit > best.gap:
                method = f"{solution.status}, on {divided.places.size} of {n} rows in round {k}"
                best = _with_gap(frame, solution, gap, max(unit, primal), method)
            if gap <= max(_CLOSE * primal, _EXACT * unit) or not wrong.places.size:
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
        divided, centre = _divide_rows(blocks, frame, x, doubt, room)
    return best if best.optimal or n > most else _solve_all_rows(_sample(blocks, frame, 1)[0])


@dataclass(frozen=True, eq=False)
class _SignDoubt:
    """Doubt about the sign of a residual: its size over the shift that the sample's uncertainty may cause.

    `root` (q, q): root of the inverse of the sample's Gram matrix: rows times it are as long as the square root of
    their leverage.
    """

    sample: Problem
    root: Array

    @classmethod
    def of(cls, sample: Problem) -> _SignDoubt:
        values, vectors = np.linalg.eigh(sample.rows.T @ sample.rows / sample.goal.size)
        # What the sample does not contain, such as a constant of few rows, is in the greatest doubt.
        return cls(sample, vectors / np.sqrt(np.maximum(values, 0.0) + _UNSEEN * values.max(initial=TINY)))

    def score(self, rows: Array, residual: Array) -> Array:
        """Return a score of each row (n,), small where the sign is in doubt."""
        shift = rows @ self.root
        return np.asarray(np.abs(residual) / np.sqrt(np.einsum("ij,ij->i", shift, shift) + TINY))

    def cuts(self, x: Array, share: float) -> Array:
        """Return for each group of rows the score below which this share of its rows in the sample lies.

        Each group keeps its share: a group with a free coefficient needs enough rows to balance the sum of the others,
        even if its record is fitted less well.
        """
        residual = self.sample.goal - self.sample.rows @ x
        scores, groups = self.score(self.sample.rows, residual), _groups(self.sample, self.sample.rows)
        cuts = np.full(self.sample.free + 1, np.inf)
        for group in np.unique(groups):
            cuts[group] = np.quantile(scores[groups == group], min(share, 1.0))
        return cuts


def _divide_rows(blocks: Blocks, frame: Problem, x: Array, doubt: _SignDoubt, room: int) -> tuple[_Divided, float]:
    """Keep about `room` rows whose sign is most in doubt, add up the others; also the sum of absolute residuals."""
    parts: list[tuple[Array, Array, NDArray[np.intp]]] = []
    pull, value, primal, place, left = np.zeros(frame.unknowns), 0.0, 0.0, 0, room + room // 2
    cuts = doubt.cuts(x, room / len(blocks))
    for rows, goal in blocks:
        residual = goal - rows @ x
        kept = np.flatnonzero(doubt.score(rows, residual) <= cuts[_groups(frame, rows)])[:left]
        signs = _signs(residual)
        signs[kept] = 0.0
        primal += float(np.abs(residual).sum())
        pull += signs @ rows
        value += float(signs @ goal)
        parts.append((rows[kept], goal[kept], kept + place))
        place, left = place + goal.size, left - kept.size
    some, goals, places = (np.concatenate(column) for column in zip(*parts, strict=True))
    return _Divided(replace(frame, rows=some, goal=goals), places, x, pull, value), primal


def _groups(frame: Problem, rows: Array) -> NDArray[np.intp]:
    """Return the first free coefficient of each row (n,), such as its epoch's constant; their number if none."""
    nonzero = rows[:, : frame.free] != 0
    return (
        np.where(nonzero.any(axis=1), nonzero.argmax(axis=1), frame.free)
        if frame.free
        else np.zeros(len(rows), np.intp)
    )


def _signs(residual: Array) -> Array:
    return np.where(residual >= 0, 1.0, -1.0)


@dataclass(frozen=True, eq=False)
class _WrongSigns:
    """Rows with a residual of another sign than assumed: (k, q), (k,), (k,), and the assumed signs (k,)."""

    rows: Array
    goal: Array
    places: NDArray[np.intp]
    signs: Array


def _check_signs(blocks: Blocks, divided: _Divided, x: Array, most: int) -> tuple[float, _WrongSigns]:
    """Return the sum of absolute residuals of all rows, and at most `most` + 1 rows with wrong signs."""
    primal, place, room = 0.0, 0, most + 1
    empty = np.zeros(0)
    parts = [(np.zeros((0, x.size)), empty, empty.astype(np.intp), empty)]
    for rows, goal in blocks:
        residual, signs = goal - rows @ x, _signs(goal - rows @ divided.signs_of)
        primal += float(np.abs(residual).sum())
        kept = slice(*np.searchsorted(divided.places, [place, place + goal.size]))
        signs[divided.places[kept] - place] = 0.0
        wrong = np.flatnonzero(residual * signs < 0)[:room]
        parts.append((rows[wrong], goal[wrong], wrong + place, signs[wrong]))
        place, room = place + goal.size, room - wrong.size
    return primal, _WrongSigns(*(np.concatenate(column) for column in zip(*parts, strict=True)))


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
    return replace(
        divided,
        problem=replace(problem, rows=rows, goal=goal),
        places=np.sort(places),
        pull=divided.pull - more.signs @ more.rows,
        value=divided.value - float(more.signs @ more.goal),
    )
