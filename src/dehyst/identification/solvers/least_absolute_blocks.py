"""Least absolute deviations of any number of rows, seen in blocks, a few of which are in memory.

A sample of the rows gives a first answer. Rows whose residual is far from zero there hardly ever change its sign: they
enter the program only by their sum, each times its sign (Portnoy and Koenker 1997, Stat. Sci. 12, 279). With these
signs for their duals the small program's dual point is one of the whole program, whatever the signs: so each answer is
proven by a gap over all rows, and rows whose sign proves wrong go back into the program until that gap is closed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array
from dehyst.identification.solvers.least_absolute import Deviations, dual_value, least_absolute_deviations
from dehyst.identification.solvers.problem import OPTIMAL, TINY, Answer, Problem, failed

# Up to so many rows for each coefficient a sample gains nothing.
_WHOLE = 60
# Numbers that a sample of rows may have, and all rows in a program: 8 bytes each.
_SAMPLED_NUMBERS, _MOST_NUMBERS = 8_000_000, 24_000_000
_ROUNDS = 12
# A sample is followed by all rows only if they are not more than so many times as many.
_LEAP = 10
# The gap that ends the rounds, relative to the objective, and relative to that at zero where there is none.
_CLOSE = 0.1 * OPTIMAL
_EXACT = 1e-12
_UNSEEN = 1e-10
# Rows with numbers so many times as large as usual stand for themselves alone, up to so many for each coefficient.
_HEAVY, _MOST_HEAVY = 20.0, 10


class Blocks(Protocol):
    """Rows and targets (k, q) and (k,) that can be gone through again and again, n in all."""

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
class _Every:
    """Every step-th row of others, as `_thin` thins them; their number leaves the heavy ones out."""

    blocks: Blocks
    step: int

    def __len__(self) -> int:
        return len(range(0, len(self.blocks), self.step))

    def __iter__(self) -> Iterator[tuple[Array, Array]]:
        place, usual = 0, 0.0
        for rows, goal in self.blocks:
            usual = usual or _usual(rows)
            some = _thin(rows, goal, place, self.step, usual)
            place += goal.size
            if some[1].size:
                yield some


def _usual(rows: Array) -> float:
    """Largest number of a row, as it is in most of them."""
    return max(float(np.median(np.abs(rows[:: len(rows) // 4096 + 1]).max(axis=1))), TINY)


def _thin(rows: Array, goal: Array, place: int, step: int, usual: float) -> tuple[Array, Array]:
    """Of a block that begins at a place, every step-th row, and all heavy ones at a step-th of their weight.

    A few heavy rows may decide as much as all others: chance must not leave them out, nor weigh them for others.
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

    Attributes
    ----------
    problem : Problem
        Rows that are kept.
    places : (k,) int array
        Their places among all rows, ascending.
    signs_of : (q,) array
        The coefficients that gave the others their signs.
    pull, value : (q,) array and float
        Sums of the other rows and of their targets, each times its sign.
    """

    problem: Problem
    places: NDArray[np.intp]
    signs_of: Array
    pull: Array
    value: float


def least_absolute(blocks: Blocks, frame: Problem) -> Answer:
    """Minimise the sum of absolute residuals of all rows; `frame` has the limits, and no rows."""
    n, q = len(blocks), frame.unknowns
    size = min(max(int(n ** (2 / 3) * q ** (1 / 3)), 20 * q), _SAMPLED_NUMBERS // max(q, 1))
    if n <= max(2 * size, _WHOLE * q):
        return _whole(_sample(blocks, frame, 1)[0])
    sample, unit = _sample(blocks, frame, -(-n // size))
    first = least_absolute(Whole(sample.rows, sample.goal), frame)
    if not first.optimal:
        return _whole(_sample(blocks, frame, 1)[0]) if n * q <= _MOST_NUMBERS else first
    x, step = first.x, int((n / size) ** 0.5)
    if n > _LEAP * size:
        # From so few rows the last step would leave too many signs in doubt.
        middle = _reduced(_Every(blocks, step), frame, sample, x, unit / step)
        x = middle.x if middle.optimal else x
    return _reduced(blocks, frame, sample, x, unit)


def _whole(problem: Problem) -> Answer:
    pull, unit = np.zeros(problem.unknowns), max(float(np.abs(problem.goal).sum()), TINY)
    found = least_absolute_deviations(problem, pull, unit)
    if not found.optimal:
        return failed(problem, found.status)
    primal = float(np.abs(problem.goal - problem.rows @ found.x).sum())
    value, lacking = dual_value(problem, pull, found.y, found.multipliers, found.x)
    return _judged(problem, found, primal - value + lacking, max(unit, primal), found.status)


def _judged(frame: Problem, found: Deviations, gap: float, unit: float, how: str) -> Answer:
    optimal = abs(gap) <= OPTIMAL * unit and frame.meets(found.x)
    return Answer(found.x, f"{'optimal' if optimal else 'no optimum'} ({how})", optimal, gap / unit)


def _sample(blocks: Blocks, frame: Problem, step: int) -> tuple[Problem, float]:
    """Every step-th row, as `_thin` thins them, and the sum of absolute targets of all."""
    rows, goals, place, unit, usual = [], [], 0, TINY, 0.0
    for block, goal in blocks:
        usual = usual or _usual(block)
        some, those = (block, goal) if step == 1 else _thin(block, goal, place, step, usual)
        rows.append(some)
        goals.append(those)
        place += goal.size
        unit += float(np.abs(goal).sum())
    whole = np.concatenate(rows) if len(rows) > 1 else rows[0]
    return replace(frame, rows=whole, goal=np.concatenate(goals)), unit


def _reduced(blocks: Blocks, frame: Problem, sample: Problem, x: Array, unit: float) -> Answer:
    n, most = len(blocks), _MOST_NUMBERS // frame.unknowns
    doubt, room = _Doubt.of(sample), min(2 * sample.goal.size, _SAMPLED_NUMBERS // (2 * frame.unknowns))
    divided, centre = _divide(blocks, frame, x, doubt, room)
    if centre <= _EXACT * unit:
        # Zeros are a dual point: nothing is left to gain, and signs of rounding errors would mean nothing.
        return Answer(x, f"optimal (a sample of {sample.goal.size} of {n} rows meets all)", True, centre / unit)
    # Where more than half of the rows are in the program all of them may as well be, if they may at all.
    best = failed(frame, "no round of the reduction gave an answer")
    for k in range(1, _ROUNDS + 1):
        found = least_absolute_deviations(divided.problem, divided.pull, unit)
        primal, wrong = _checked(blocks, divided, found.x, most) if found.optimal else (np.inf, None)
        if wrong is not None:
            value, lacking = dual_value(divided.problem, divided.pull, found.y, found.multipliers, found.x)
            gap = primal - value - divided.value + lacking
            if not gap / unit > best.gap:
                how = f"{found.status}, on {divided.places.size} of {n} rows in round {k}"
                best = _judged(frame, found, gap, max(unit, primal), how)
            if gap <= max(_CLOSE * primal, _EXACT * unit) or not wrong.places.size:
                break
            many = divided.places.size + wrong.places.size
            if n <= min(most, 2 * many):
                break
            # Where more signs are wrong than rows are kept, others should be kept, next to the better answer.
            if many <= most and (many <= 2 * divided.places.size or primal >= centre):
                divided = _with(divided, wrong)
                continue
        if primal < centre:
            x = found.x
        elif room < most:
            # Too many signs are wrong: the other rows pull harder than the kept ones can hold.
            room = min(2 * room, most)
        else:
            break
        if n <= min(most, 2 * room):
            break
        divided, centre = _divide(blocks, frame, x, doubt, room)
    return best if best.optimal or n > most else _whole(_sample(blocks, frame, 1)[0])


@dataclass(frozen=True, eq=False)
class _Doubt:
    """How much the sign of a residual is in doubt: its size over how far a sample's answer may shift it.

    Attributes
    ----------
    sample : Problem
    root : (q, q) array
        Root of the inverse of the sample's Gram matrix: rows times it are as long as the square root of their leverage.
    """

    sample: Problem
    root: Array

    @classmethod
    def of(cls, sample: Problem) -> _Doubt:
        values, vectors = np.linalg.eigh(sample.rows.T @ sample.rows / sample.goal.size)
        # What the sample does not see at all, as a constant of few rows, is in the greatest doubt.
        return cls(sample, vectors / np.sqrt(np.maximum(values, 0.0) + _UNSEEN * values.max(initial=TINY)))

    def score(self, rows: Array, residual: Array) -> Array:
        """Small where the sign is in doubt (n,)."""
        shift = rows @ self.root
        return np.asarray(np.abs(residual) / np.sqrt(np.einsum("ij,ij->i", shift, shift) + TINY))

    def cuts(self, x: Array, share: float) -> Array:
        """For each group of rows, the score below which this share of those in the sample lies.

        Were the rows of a record that is followed less well all summed up, the few of it that are left could not hold
        the sum where a free coefficient is its own.
        """
        residual = self.sample.goal - self.sample.rows @ x
        scores, groups = self.score(self.sample.rows, residual), _groups(self.sample, self.sample.rows)
        cuts = np.full(self.sample.free + 1, np.inf)
        for group in np.unique(groups):
            cuts[group] = np.quantile(scores[groups == group], min(share, 1.0))
        return cuts


def _divide(blocks: Blocks, frame: Problem, x: Array, doubt: _Doubt, room: int) -> tuple[_Divided, float]:
    """Keep some `room` rows whose sign is most in doubt and add up the others; the sum of all absolute residuals."""
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
    """The first free coefficient of each row (n,), such as its epoch's constant; their number if it has none."""
    own = rows[:, : frame.free] != 0
    return np.where(own.any(axis=1), own.argmax(axis=1), frame.free) if frame.free else np.zeros(len(rows), np.intp)


def _signs(residual: Array) -> Array:
    return np.where(residual >= 0, 1.0, -1.0)


@dataclass(frozen=True, eq=False)
class _Wrong:
    """Rows whose residual has another sign than it was given: (k, q), (k,), (k,), and the signs (k,) they had."""

    rows: Array
    goal: Array
    places: NDArray[np.intp]
    signs: Array


def _checked(blocks: Blocks, divided: _Divided, x: Array, most: int) -> tuple[float, _Wrong]:
    """Sum of absolute residuals of all rows, and rows with wrong signs, one more than `most` at the most."""
    primal, place, room = 0.0, 0, most + 1
    empty = np.zeros(0)
    parts = [(np.zeros((0, x.size)), empty, empty.astype(np.intp), empty)]
    for rows, goal in blocks:
        residual, signs = goal - rows @ x, _signs(goal - rows @ divided.signs_of)
        primal += float(np.abs(residual).sum())
        own = slice(*np.searchsorted(divided.places, [place, place + goal.size]))
        signs[divided.places[own] - place] = 0.0
        wrong = np.flatnonzero(residual * signs < 0)[:room]
        parts.append((rows[wrong], goal[wrong], wrong + place, signs[wrong]))
        place, room = place + goal.size, room - wrong.size
    return primal, _Wrong(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _with(divided: _Divided, more: _Wrong) -> _Divided:
    """The same with these rows kept too, put in their places: joined and then sorted they would be there twice."""
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
