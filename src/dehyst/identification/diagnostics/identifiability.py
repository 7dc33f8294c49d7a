"""What records can tell about the stiffnesses, whatever their noise: a matter of where the motion turned."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array
from dehyst.identification.preprocessing.regressors import Rows, collect
from dehyst.identification.regression.regression import Regression
from dehyst.identification.solvers import program
from dehyst.model.structure import Grid
from dehyst.records import Record
from dehyst.records.signals import turning_points

_MOST_ROWS = 20_000
# Singular values below this share of the largest, over N squared, count as nothing known: those of directions that an
# excitation tells fall with the square of N (0.013 at N = 10, 0.0007 at 40, tops descending in N steps).
_TOLD = 0.1
# Plain elements with which turning points are probed.
_PROBES = 10
# Less than this [V/V] is rounding: a record that tells nothing must not be measured by it.
_ROUNDING = 1e-9
# A coefficient of a combination that is smaller than this is left out of its sentence.
_SMALL = 0.02


@dataclass(frozen=True, eq=False)
class Identifiability:
    """Which combinations of the stiffnesses records determine, the spring and each record's constant being free.

    Attributes
    ----------
    breakaway : (N,) array
        rho [m].
    movable : (N,) bool array
        Elements that slide in some record; the others cannot be told from the spring.
    values : (m,) array
        Singular values of the movable elements' columns, all else projected out, largest first [V/V]: the RMS voltage
        by which a change of 1 V of breakaway voltages in this direction shows, whatever the spring does.
    vectors : (m, m) array
        Unit vectors of those changes, one a row.
    """

    breakaway: Array
    movable: NDArray[np.bool_]
    values: Array
    vectors: Array

    @property
    def of(self) -> int:
        """Number of directions there are."""
        return int(np.count_nonzero(self.movable))

    @property
    def determined(self) -> int:
        """Number of directions that the records tell."""
        least = max(_TOLD / max(self.of, 1) ** 2 * self.values.max(initial=0.0), _ROUNDING)
        return int(np.count_nonzero(self.values > least))

    @cached_property
    def known(self) -> tuple[Array, ...]:
        """Combinations ``c @ stiffness`` that the records tell, each (N,), as few elements in each as can be."""
        return self._sparse(self.vectors[: self.determined], friction=True)

    @cached_property
    def open(self) -> tuple[Array, ...]:
        """Changes of the stiffnesses, each (N,), that the records do not notice, of as few elements as can be."""
        return self._sparse(self.vectors[self.determined :], friction=False)

    @property
    def alone(self) -> NDArray[np.bool_]:
        """(N,) elements whose stiffness the records tell by itself, no open change touching it."""
        touched = np.zeros(self.movable.size, dtype=bool)
        touched[self.movable] = np.linalg.norm(self.vectors[self.determined :], axis=0) > _SMALL
        return self.movable & ~touched

    def sentences(self) -> tuple[str, ...]:
        """What is known and what is not, in words: ``k_3 + k_7 is known, k_3 - k_7 is not``."""
        if not self.of:
            return ("No element slides in these records: they tell nothing of the stiffnesses.",)
        if self.determined == self.of:
            every = f"All {self.of} stiffnesses of elements that slide are known."
            return (every if self.of > 1 else "The stiffness of the one element that slides is known.",)
        known = [_signature(c) for c in self.known]
        said = []
        for change in self.open:
            total = _signature(np.abs(change))
            pair = np.count_nonzero(np.abs(change) > _SMALL) > 1 and total in known
            partner = f"{_words(np.abs(change))} is known, " if pair else ""
            said.append(f"{partner}{_words(change)} is not{'' if partner else ' known'}.")
        single = [f"k_{signature[0][0]}" for signature in known if len(signature) == 1]
        return (*said, f"Known by themselves: {', '.join(single)}.") if single else tuple(said)

    def _sparse(self, basis: Array, *, friction: bool) -> tuple[Array, ...]:
        """A basis of the same space of few elements each, its largest coefficient 1, by linear programs (least L1)."""
        where, scale = np.flatnonzero(self.movable), self.breakaway[self.movable] / self.breakaway[-1]
        # A change of breakaway voltages is a change of stiffness times rho; what is told of them is told the other way.
        space = basis * scale if friction else basis / scale
        found: list[Array] = []
        for candidate in sorted(_sparsest(space), key=_support_size):
            if len(found) < len(basis) and np.linalg.matrix_rank(np.array([*found, candidate]), tol=1e-3) > len(found):
                found.append(candidate)
        return tuple(_spread(vector, where, self.movable.size) for vector in sorted(found, key=_first))


def identifiability(records: list[Record], regression: Regression, *, relaxed: Collection[int] = ()) -> Identifiability:
    """Directions of the stiffnesses that the records determine, and how many there are.

    Noise makes every sample of a record a little different from every other, and a numerical rank of measured rows
    takes that for knowledge. So the rank is that of the paths' outlines.

    Parameters
    ----------
    records : list of Record
        Pieces without gaps, on one displacement axis.
    regression : Regression
        Whose thresholds, knots and movable elements count.
    relaxed : collection of int, optional
        Numbers of the records that start with no element strained.
    """
    breakaway = regression.grid.breakaway
    spacing = float(np.diff(breakaway, prepend=0.0).min())
    ends = regression.knots[[0, -1]]
    turns = [_turns(record, spacing, ends) for record in records]
    points = int(np.clip(_MOST_ROWS // max(1, sum(map(len, turns))), 20, 4 * breakaway.size + 20))
    kept = [(q, places) for q, places in enumerate(turns) if len(places) > 2 or (q in relaxed and len(places) > 1)]
    outlines = [(q, _outline(places, points)) for q, places in kept]
    numbered = [(q, outline, np.zeros(len(outline))) for q, outline in outlines]
    rows, _ = collect(numbered, breakaway, [0.0] * len(outlines), relaxed=relaxed)
    few = replace(regression, rows=rows, datum=np.zeros(len(records)), drifting=())
    movable = regression.movable
    count = int(np.count_nonzero(movable))
    if not len(rows) or not count:
        return Identifiability(breakaway, movable, np.zeros(count), np.eye(count))
    values, vectors = np.linalg.svd(few.projected())[1:]
    found = np.zeros(count)
    found[: values.size] = values / np.sqrt(len(rows))
    return Identifiability(breakaway, movable, found, vectors)


def probe_identifiability(records: list[Record], rows: Rows, span: tuple[float, float]) -> Identifiability:
    """What the turning points of records tell of ten plain elements over a stroke: whether inner loops are there.

    A wider class has more coefficients than any records tell, which smoothing settles; but where ten plain elements are
    left open no smoothing knows what loops that turn elsewhere do.

    Parameters
    ----------
    records : list of Record
        Pieces without gaps, on one displacement axis.
    rows : Rows
        Theirs; of which nothing counts.
    span : (float, float)
        Ends of the stroke [m].
    """
    stroke = span[1] - span[0]
    rho = 0.5 * stroke / _PROBES * np.arange(1.0, _PROBES + 1)
    movable = 2 * rho < stroke * (1 - 1e-9)
    knots = np.linspace(*span, _PROBES + 1)
    return identifiability(records, Regression(rows, Grid.plain(rho, knots, movable), 0.0, np.zeros(len(records))))


def _turns(record: Record, spacing: float, ends: Array) -> list[float]:
    """Turning points of the displacement [m], those closer than `spacing` made one; a cycle is told thrice at most.

    Those near an end of the spring's knots are put there: the grid of elements is laid over that range.
    """
    y = record.displacement
    found = y[[0, *turning_points(y, max(spacing, 8 * record.noise)).tolist(), len(y) - 1]]
    order = np.argsort(found)
    place = found.copy()
    start = 0
    for i in range(1, order.size + 1):
        if i == order.size or found[order[i]] - found[order[start]] > spacing:
            mean = found[order[start:i]].mean()
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


def _outline(turns: list[float], points: int) -> Record:
    """Straight legs between turning points; the voltage rises and falls with the displacement."""
    legs = [np.linspace(a, b, points + 1)[1:] for a, b in pairwise(turns)]
    path = np.concatenate([[turns[0]], *legs])
    return Record(np.arange(path.size, dtype=float), path, path, "outline")


def _sparsest(space: Array) -> list[Array]:
    """For each element the vector of the space (rows) with coefficient 1 there and the least sum of absolute values."""
    rank, size = space.shape
    found: list[Array] = []
    if not rank:
        return found
    basis = np.linalg.qr(space.T)[0].T
    # z = basis' w, split z = p - n with p, n >= 0 and the sum of both least.
    rows = np.hstack([basis.T, -np.eye(size), np.eye(size)])
    cost = np.concatenate([np.zeros(rank), np.ones(2 * size)])
    lower = np.concatenate([np.full(rank, -np.inf), np.zeros(2 * size)])
    upper = np.full(rank + 2 * size, np.inf)
    for i in np.flatnonzero(np.linalg.norm(basis, axis=0) > _SMALL):
        one = np.vstack([rows, np.concatenate([basis[:, i], np.zeros(2 * size)])])
        goal = np.append(np.zeros(size), 1.0)
        x, _, optimal, _, _ = program.linear_program(cost, (lower, upper), one, (goal, goal))
        if optimal:
            z = x[:rank] @ basis
            found.append(z / z[np.argmax(np.abs(z))])
    return found


def _support_size(vector: Array) -> int:
    return int(np.count_nonzero(np.abs(vector) > _SMALL))


def _first(vector: Array) -> int:
    return int(np.argmax(np.abs(vector) > _SMALL))


def _spread(vector: Array, where: NDArray[np.intp], size: int) -> Array:
    """The same with zeros for the elements that do not move, the first coefficient positive."""
    whole = np.zeros(size)
    whole[where] = vector * np.sign(vector[_first(vector)])
    return whole


def _signature(coefficients: Array) -> tuple[tuple[int, float], ...]:
    """Element numbers and coefficients to a tenth, those that count."""
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
