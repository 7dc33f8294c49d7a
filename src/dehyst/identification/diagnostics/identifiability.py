"""Identifiability of the stiffnesses from turning points, independent of noise."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array
from dehyst.identification.preprocessing.regressors import collect
from dehyst.identification.regression.regression import Regression
from dehyst.identification.rules import RULES
from dehyst.identification.solvers.highs import minimum
from dehyst.identification.solvers.least_squares import triangle_of
from dehyst.identification.solvers.problem import spread
from dehyst.identification.structure import Grid
from dehyst.records import Record, turning_points

_MOST_ROWS = 20_000
# Number of Maxwell-slip elements with which turning points are probed.
_PROBES = 10
# Smaller singular values [V/V] are rounding, also if all are.
_ROUNDING = 1e-9
# Smaller coefficients of a combination are left out of its sentence.
_SMALL = 0.02


@dataclass(frozen=True, eq=False)
class Identifiability:
    """Combinations of the stiffnesses that records determine, with the spring and each record's constant free.

    `breakaway` (N,): rho [m]. `movable` (N,) bool: elements that slide in some record; the others act as part of the
    spring. `values` (m,): singular values of the movable elements' columns, all else projected out, largest first
    [V/V]: the RMS voltage of a change of 1 V of breakaway voltages in this direction, for any spring. `vectors` (m, m):
    unit vectors of those changes, one in each row. `probing`: whether they belong to ten Maxwell-slip elements instead
    of a model with more parts, whose columns depend on more than turning points.
    """

    breakaway: Array
    movable: NDArray[np.bool_]
    values: Array
    vectors: Array
    probing: bool = False

    @property
    def subject(self) -> str:
        """Subject of the directions, as text."""
        return "ten plain elements" if self.probing else "the stiffnesses"

    @property
    def of(self) -> int:
        """Total number of directions."""
        return int(np.count_nonzero(self.movable))

    @property
    def determined(self) -> int:
        """Number of directions that the records determine."""
        least = max(RULES.determined / max(self.of, 1) ** 2 * self.values.max(initial=0.0), _ROUNDING)
        return int(np.count_nonzero(self.values > least))

    @cached_property
    def known(self) -> tuple[Array, ...]:
        """Determined combinations ``c @ stiffness``, each (N,), of as few elements as possible."""
        return self._sparse(self.vectors[: self.determined], friction=True)

    @cached_property
    def open(self) -> tuple[Array, ...]:
        """Changes of the stiffnesses, each (N,), without effect on the records, of as few elements as possible."""
        return self._sparse(self.vectors[self.determined :], friction=False)

    @property
    def alone(self) -> NDArray[np.bool_]:
        """(N,) whether an element's stiffness is determined by itself: no open change contains it."""
        touched = np.zeros(self.movable.size, dtype=bool)
        touched[self.movable] = np.linalg.norm(self.vectors[self.determined :], axis=0) > _SMALL
        return self.movable & ~touched

    def sentences(self) -> tuple[str, ...]:
        """Return sentences on determined and open combinations: ``k_3 + k_7 is determined, k_3 - k_7 is not``.

        Empty if `probing`: the numbers of the model are others than those of the probe.
        """
        if self.probing:
            return ()
        if not self.of:
            return ("No element slides in these records: they determine no stiffness.",)
        if self.determined == self.of:
            every = f"The turning points determine all {self.of} stiffnesses of elements that slide."
            return (
                every if self.of > 1 else "The turning points determine the stiffness of the one element that slides.",
            )
        known = [_signature(c) for c in self.known]
        sentences = []
        for change in self.open:
            total = _signature(np.abs(change))
            pair = np.count_nonzero(np.abs(change) > _SMALL) > 1 and total in known
            partner = f"{_words(np.abs(change))} is determined, " if pair else ""
            sentences.append(f"{partner}{_words(change)} is not{'' if partner else ' determined'}.")
        single = [f"k_{signature[0][0]}" for signature in known if len(signature) == 1]
        return (*sentences, f"Determined by themselves: {', '.join(single)}.") if single else tuple(sentences)

    def _sparse(self, basis: Array, *, friction: bool) -> tuple[Array, ...]:
        """Return a basis of the same space, few elements in each vector, by linear programs (least L1); maximum 1."""
        where, scale = np.flatnonzero(self.movable), self.breakaway[self.movable] / self.breakaway[-1]
        # Changes of breakaway voltages are changes of stiffness times rho; combinations transform inversely.
        space = basis * scale if friction else basis / scale
        kept: list[Array] = []
        for candidate in sorted(_sparsest(space), key=lambda one: int(np.count_nonzero(np.abs(one) > _SMALL))):
            if len(kept) < len(basis) and np.linalg.matrix_rank(np.array([*kept, candidate]), tol=1e-3) > len(kept):
                kept.append(candidate)
        # The first coefficient of each is positive.
        return tuple(
            spread(vector * np.sign(vector[_first(vector)]), where, self.movable.size)
            for vector in sorted(kept, key=_first)
        )


def identifiability(records: list[Record], grid: Grid, *, relaxed: Collection[int] = ()) -> Identifiability:
    """Compute the directions of the stiffnesses that the records determine.

    Noise makes all samples of a record differ, which would raise the numerical rank of measured rows. So the rank is
    that of the outlines of the paths.

    `records`: pieces without gaps, on a common displacement axis. `relaxed`: numbers of the records that start with no
    element strained.
    """
    breakaway, movable = grid.breakaway, grid.movable
    spacing = float(np.diff(breakaway, prepend=0.0).min())
    turns = [_turns(record, spacing, grid.knots[[0, -1]]) for record in records]
    points = int(np.clip(_MOST_ROWS // max(1, sum(map(len, turns))), 20, 4 * breakaway.size + 20))
    numbered = []
    for q, places in enumerate(turns):
        if len(places) > 2 or (q in relaxed and len(places) > 1):
            # Straight legs between turning points, the voltage equal to the displacement.
            legs = [np.linspace(a, b, points + 1)[1:] for a, b in pairwise(places)]
            path = np.concatenate([places[:1], *legs])
            outline = Record(np.arange(path.size, dtype=float), path, path, "outline")
            numbered.append((q, outline, np.zeros(path.size)))
    rows, _ = collect(numbered, breakaway, [0.0] * len(numbered), relaxed=relaxed)
    count = int(np.count_nonzero(movable))
    if not len(rows) or not count:
        return Identifiability(breakaway, movable, np.zeros(count), np.eye(count))
    values, vectors = np.linalg.svd(projected(Regression(rows, grid, 0.0, np.zeros(len(records)))))[1:]
    padded = np.zeros(count)
    padded[: values.size] = values / np.sqrt(len(rows))
    return Identifiability(breakaway, movable, padded, vectors)


def projected(regression: Regression) -> Array:
    """Return columns of the movable elements over their rho, all others projected out: a triangle (m, m)."""
    grid, others = regression.grid, np.hstack([regression.nuisances(), regression.spring_parts])
    others = others / np.maximum(np.abs(others).max(axis=0), np.finfo(float).tiny)
    slip = regression.rows.elongation[:, grid.movable] / grid.breakaway[grid.movable]
    triangle = triangle_of(np.hstack([others, slip]))
    return triangle[others.shape[1] :, others.shape[1] :]


def probed(records: list[Record], span: tuple[float, float]) -> Identifiability:
    """Return the directions of ten Maxwell-slip elements over a stroke [m] that the turning points determine.

    A structure with more parts has more coefficients than records determine; smoothing settles the rest. If ten slip
    elements stay open, smoothing cannot predict loops that turn elsewhere.
    """
    stroke = span[1] - span[0]
    rho = 0.5 * stroke / _PROBES * np.arange(1.0, _PROBES + 1)
    grid = Grid.maxwell_slip(rho, np.linspace(*span, _PROBES + 1), 2 * rho < stroke * (1 - 1e-9))
    return replace(identifiability(records, grid), probing=True)


def _turns(record: Record, spacing: float, ends: Array) -> list[float]:
    """Return the turning points of the displacement [m], closer ones than `spacing` merged, at most three equal cycles.

    Those near an end of the spring's knots are moved there: the grid of elements covers that range.
    """
    y = record.displacement
    points = y[[0, *turning_points(y, max(spacing, 8 * record.noise)).tolist(), len(y) - 1]]
    order = np.argsort(points)
    place = points.copy()
    start = 0
    for i in range(1, order.size + 1):
        if i == order.size or points[order[i]] - points[order[start]] > spacing:
            mean = points[order[start:i]].mean()
            near = np.abs(ends - mean)
            place[order[start:i]] = ends[near.argmin()] if near.min() < spacing else mean
            start = i
    kept: list[float] = []
    for turn in place.tolist():
        if not kept or turn != kept[-1]:
            kept.append(turn)
        if len(kept) >= 6 and kept[-6:-4] == kept[-4:-2] == kept[-2:]:
            del kept[-2:]
    return kept


def _sparsest(space: Array) -> list[Array]:
    """Return for each element the vector of the space (rows) of least L1 norm with coefficient 1 there."""
    rank, size = space.shape
    vectors: list[Array] = []
    if not rank:
        return vectors
    basis = np.linalg.qr(space.T)[0].T
    # z = basis' w, split z = p - n with p, n >= 0 and the sum of both least.
    rows = np.hstack([basis.T, -np.eye(size), np.eye(size)])
    cost = np.concatenate([np.zeros(rank), np.ones(2 * size)])
    lower = np.concatenate([np.full(rank, -np.inf), np.zeros(2 * size)])
    upper = np.full(rank + 2 * size, np.inf)
    for i in np.flatnonzero(np.linalg.norm(basis, axis=0) > _SMALL):
        equations = np.vstack([rows, np.concatenate([basis[:, i], np.zeros(2 * size)])])
        goal = np.append(np.zeros(size), 1.0)
        found = minimum(cost, (lower, upper), equations, (goal, goal))
        if found.optimal:
            z = found.value[:rank] @ basis
            vectors.append(z / z[np.argmax(np.abs(z))])
    return vectors


def _first(vector: Array) -> int:
    return int(np.argmax(np.abs(vector) > _SMALL))


def _signature(coefficients: Array) -> tuple[tuple[int, float], ...]:
    """Return the numbers and coefficients, to a tenth, of the elements that are not small."""
    return tuple((int(i) + 1, round(float(coefficients[i]), 1)) for i in np.flatnonzero(np.abs(coefficients) > _SMALL))


def _words(coefficients: Array) -> str:
    """Write a combination: ``k_3 - 0.5 k_7``."""
    text = ""
    for i in np.flatnonzero(np.abs(coefficients) > _SMALL):
        size = f"{abs(coefficients[i]):.2g}"
        sign = "-" if coefficients[i] < 0 else "+"
        text += f" {sign} " if text else sign.replace("+", "")
        text += f"k_{i + 1}" if size == "1" else f"{size} k_{i + 1}"
    return text
