"""Preisach's model by its Everett function, from records of any shape or from first-order reversal curves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dehyst import IdentifyError, ModelError
from dehyst._types import Array
from dehyst._validation import count, fraction, keep, number
from dehyst.records import Record, reversals, rms
from dehyst.trust import AbstractBaseline
from dehyst_rivals import _rivals as compiled
from dehyst_rivals.least_squares import solve
from dehyst_rivals.training import Training, fit_with_delay

_MOST_ROWS = 8000
_MOST_CELLS = 80
# Distance, as a part of the range, at which an end of the range counts as reached and two curves count as one.
_NEAR = 0.01
# A curve is left out if it was recorded more than this many times as fast as the slowest one with the same turn.
_SLOW = 2.0


@dataclass(frozen=True, eq=False)
class PreisachState:
    """The memory: present voltage [V] and displacement [m], and nested reversals, outermost first.

    `turns` (k, 2): voltage and displacement at each reversal; the first one is the plane's lowest voltage, then maxima
    and minima alternate. With an odd number of reversals, the branch rises.
    """

    voltage: float
    displacement: float
    turns: Array


@final
@dataclass(frozen=True, eq=False)
class Preisach(AbstractBaseline):
    """Preisach's model by its Everett function on a square grid of voltages.

    Between nodes E is bilinear, which is a constant density in each square cell; in the triangles on the diagonal it is
    linear, which makes them reversible. Then y is piecewise linear along every branch, and the inverse exact. Beyond
    the grid no relay switches and y continues with its mean slope.

    `limits`: lowest and highest voltage of the plane [V]. `everett` (n + 1, n + 1): E [m] at (alpha, beta) of node (i,
    j), i > j; the rest is ignored. E must be strictly greater for a triangle than for any triangle inside it, so that y
    follows v. `bottom`: displacement with every relay down [m]. Raise `ModelError` if the table is no square, or does
    not increase away from the diagonal.
    """

    limits: tuple[float, float]
    everett: Array
    bottom: float = 0.0
    delay: float = 0.0
    state: PreisachState = field(init=False, repr=False)

    def __post_init__(self) -> None:
        table = np.array(self.everett, dtype=np.float64)
        if table.ndim != 2 or table.shape[0] != table.shape[1] or len(table) < 2 or not np.isfinite(table).all():
            raise ModelError(f"everett: got an array of shape {table.shape}, need a square of two or more finite nodes")
        table = np.tril(table, -1)
        low, high = (number(end, "limits") for end in self.limits)
        keep(self, limits=(low, high))
        if low >= high:
            raise ModelError(argument="limits", got=self.limits, need="two voltages, the lower one first")
        below = np.tri(len(table) - 1, dtype=bool)
        if np.any(np.diff(table, axis=0)[:, :-1][below] <= 0) or np.any(np.diff(table, axis=1)[1:][below] >= 0):
            raise ModelError(
                "everett: does not increase away from the diagonal everywhere, so that the displacement would fall "
                "while the voltage rises; need a density that is nowhere negative and a reversible share"
            )
        keep(self, everett=table, bottom=number(self.bottom, "bottom"))
        # All relays are down, at the lowest voltage.
        keep(self, state=PreisachState(low, self.bottom, np.array([[low, self.bottom]])))

    @property
    def parameters(self) -> int:
        """Number of coefficients: one for each cell, and a constant."""
        n = len(self.everett) - 1
        return n * (n + 1) // 2 + 1

    def _run(
        self, drive: Array, state: PreisachState, time: ArrayLike | None, *, inverse: bool
    ) -> tuple[Array, PreisachState]:
        if not _nested(state, *self.limits):
            raise ModelError(
                "state: got turns that are not nested, need a PreisachState that a motion of this model returned"
            )
        (low, high), cells = self.limits, len(self.everett) - 1
        mean = float(self.everett[-1, 0]) / (high - low)
        numbers = np.array([low, (high - low) / cells, self.bottom, mean, mean])
        turns, table = np.ascontiguousarray(state.turns).ravel(), self.everett.ravel()
        out, turns, v, y = compiled.preisach(
            numbers, table, cells, turns, state.voltage, state.displacement, drive, inverse
        )
        return out, PreisachState(v, y, turns.reshape(-1, 2))

    @classmethod
    def fit(
        cls,
        records: Record | Sequence[Record],
        *,
        cells: int = 40,
        smoothing: float = 1e-5,
        slope_floor: float = 0.1,
        delay: float | None = None,
    ) -> Preisach:
        """Fit the density by non-negative least squares, from records of any shape.

        Each sample is linear in the densities if its nested reversals are known. A penalty on second differences
        determines the densities that the records do not determine. Parameters are those of every model, see
        `training`, `cells`: cells n of a side of the plane, n (n + 1) / 2 densities, and `smoothing`: weight of
        the penalty, 0 for none. The relays on the diagonal provide the least slope.
        """
        n = count(cells, "cells", 2, _MOST_CELLS)
        fraction(smoothing, "smoothing", 0.0)
        fraction(slope_floor, "slope_floor", 1e-6)

        def fit_model(training: Training) -> tuple[Preisach, float]:
            few = training.subsample(_MOST_ROWS)
            table, constants, residual = _densities(few, n, smoothing, slope_floor * few.stroke / n)
            return cls(few.limits, table, float(constants[few.reference]), few.delay), residual

        return fit_with_delay(records, delay, fit_model)

    @classmethod
    def from_reversal_curves(
        cls,
        records: Record | Sequence[Record],
        *,
        cells: int = 40,
        slope_floor: float = 0.1,
        delay: float | None = None,
    ) -> Preisach:
        """Compute the Everett function from first-order reversal curves by the classical method (Mayergoyz, Sec. 1.2).

        A branch that falls from a top, which was reached from the lowest voltage, gives E(top, beta) down to its next
        turn. A branch that rises from a bottom, which was reached from the highest voltage, gives E(alpha, bottom).
        Between curves E is interpolated without overshoot, and is then made to increase away from the diagonal.

        `records` hold the curves. `cells`, `slope_floor`, `delay` and errors are those of `fit`; fewer than three
        curves also raise `IdentifyError`.
        """
        n = count(cells, "cells", 2, _MOST_CELLS)
        fraction(slope_floor, "slope_floor", 1e-6)

        def fit_model(training: Training) -> tuple[Preisach, float]:
            table = _everett_table(training, n, slope_floor * training.stroke / n)
            model = cls(training.limits, table, 0.0, training.delay)
            made = training.sampled(lambda piece: model.simulate(piece.voltage).displacement)
            bottom, residual = training.fit_constant(training.displacement - made)
            return replace(model, bottom=bottom), residual

        return fit_with_delay(records, delay, fit_model)


def _nested(start: PreisachState, low: float, high: float) -> bool:
    """Return whether the reversals begin with the lowest voltage, their minima rise and their maxima fall."""
    if start.turns.ndim != 2 or not np.isfinite(start.turns).all() or not len(start.turns):
        return False
    at = start.turns[:, 0]
    last = min(max(start.voltage, low), high)
    order = np.concatenate([at[::2], [last], at[1::2][::-1]])
    return bool(at[0] == low and at.max() <= high and np.all(np.diff(order) >= 0))


def _densities(training: Training, n: int, smoothing: float, least: float) -> tuple[Array, Array, float]:
    """Return Everett's table, the nuisances' coefficients and the RMS residual; diagonal cells hold `least` [m]."""
    columns, cells = _columns(training, n), np.tril_indices(n)
    floor = (least * np.eye(n))[cells]
    rough = _second_differences(n) * np.sqrt(smoothing * len(training)) * n
    solution = solve(
        np.vstack([training.nuisances, np.zeros((len(rough), training.nuisances.shape[1]))]),
        np.vstack([columns, rough]),
        np.concatenate([training.displacement - columns @ floor, -rough @ floor]),
    )
    density, table = np.zeros((n, n)), np.zeros((n + 1, n + 1))
    density[cells] = solution.nonnegative + floor
    table[1:, :-1] = np.cumsum(np.cumsum(density, axis=0)[:, ::-1], axis=1)[:, ::-1]
    return table, solution.free, rms(solution.residual[: len(training)])


def _columns(training: Training, n: int) -> Array:
    """Return the part of each cell that is up at each fitted sample (rows, n (n + 1) / 2), by rows of cells."""
    low, high = training.limits
    parts = []
    for piece, rows in zip(training.pieces, training.kept, strict=True):
        nodes = compiled.preisach_weights(low, (high - low) / n, n, piece.voltage, rows).reshape(-1, n + 1, n + 1)
        # The triangle of a node contains every cell with alpha below and beta above the node.
        held = np.cumsum(nodes[:, :0:-1], axis=1)[:, ::-1]
        parts.append(np.cumsum(held, axis=2)[:, :, :-1][:, *np.tril_indices(n)])
    return np.concatenate(parts)


def _second_differences(n: int) -> Array:
    """Return second differences (rows, cells) of the densities along both sides of the plane and the diagonal."""
    place = np.full((n, n), -1)
    place[np.tril_indices(n)] = np.arange(n * (n + 1) // 2)
    lines = [place[i + 1 :, i] for i in range(n)] + [place[i, :i] for i in range(n)] + [np.diagonal(place)]
    triples = [(a, b, c) for line in lines for a, b, c in zip(line, line[1:], line[2:], strict=False)]
    rough = np.zeros((len(triples), n * (n + 1) // 2))
    index: NDArray[np.intp] = np.array(triples, dtype=np.intp).reshape(-1, 3)
    for column, weight in zip(index.T, (1.0, -2.0, 1.0), strict=True):
        rough[np.arange(len(triples)), column] = weight
    return rough


@dataclass(frozen=True, eq=False)
class _Curve:
    """A first-order reversal curve: the voltage at which it left the major loop, and E along it.

    Voltages increase; `rate` is their mean rate [V/s].
    """

    turn: float
    voltage: Array
    everett: Array
    rate: float

    def at(self, nodes: Array, near: float) -> Array:
        """Return E at voltages; NaN at voltages farther than `near` [V] from the curve."""
        reached = (nodes >= self.voltage[0] - near) & (nodes <= self.voltage[-1] + near)
        return np.where(reached, np.interp(nodes, self.voltage, self.everett), np.nan)


def _everett_table(training: Training, n: int, least: float) -> Array:
    """Read E [m] at the nodes (n + 1, n + 1), and make it increase by at least `least` [m] from node to node.

    Raise `IdentifyError` if there are fewer than three curves of one kind.
    """
    low, high = training.limits
    found: dict[bool, list[_Curve]] = {True: [], False: []}
    for piece, rows in zip(training.pieces, training.kept, strict=True):
        for falls, curve in _curves(piece, int(rows[0]) if rows.size else len(piece), low, high):
            found[falls].append(curve)
    falling, rising = (_merged(curves, _NEAR * (high - low)) for curves in found.values())
    nodes = np.linspace(low, high, n + 1)
    tables = [_table(curves, nodes, falls=curves is falling) for curves in (falling, rising) if len(curves) > 2]
    if not tables:
        raise IdentifyError(
            f"got {len(falling)} falling and {len(rising)} rising first-order reversal curves, need at least three of "
            "one kind. Record descending tops or reversal curves (dehyst excite), or use non-negative least squares, "
            "which accepts records of any shape"
        )
    table = np.asarray(np.mean(tables, axis=0))
    # Raise every node above all nodes inside its triangle.
    for i in range(1, n + 1):
        for j in range(i - 1, -1, -1):
            inner = max(table[i - 1, j] if i - 1 > j else 0.0, table[i, j + 1] if j + 1 < i else 0.0)
            table[i, j] = max(table[i, j], inner + least)
    return table


def _curves(piece: Record, first: int, low: float, high: float) -> Iterator[tuple[bool, _Curve]]:
    """Yield, for each branch after `first` that leaves the major loop, whether it falls, and its curve."""
    v, y, near = piece.voltage, piece.displacement, _NEAR * (high - low)
    turns = reversals(piece)
    ends = np.append(turns, len(v) - 1)
    for k in range(len(turns)):
        a, b = int(ends[k]), int(ends[k + 1])
        if a < first or b - a < 4:
            continue
        before, falls = v[ends[k - 1]] if k else v[a], bool(v[b] < v[a])
        outermost = v[a] > high - near if falls else v[a] < low + near
        from_end = before < low + near if falls else before > high - near
        if outermost or (k and from_end):
            branch = slice(a, b + 1)
            order = np.argsort(v[branch], kind="stable")
            everett = y[a] - y[branch] if falls else y[branch] - y[a]
            rate = float(abs(v[b] - v[a]) / (piece.time[b] - piece.time[a]))
            yield falls, _Curve(float(v[a]), v[branch][order], everett[order], rate)


def _merged(curves: list[_Curve], near: float) -> list[_Curve]:
    """Return one curve for each turning point, sorted; repeated curves are averaged as far as each extends.

    If some curves were recorded much faster than others, only the slow ones are used, because the model is
    rate-independent.
    """
    groups: list[list[_Curve]] = []
    for curve in sorted(curves, key=lambda curve: curve.turn):
        if groups and curve.turn - groups[-1][0].turn < near:
            groups[-1].append(curve)
        else:
            groups.append([curve])
    merged = []
    for group in groups:
        shared = np.linspace(min(c.voltage[0] for c in group), max(c.voltage[-1] for c in group), 200)
        everett = np.array([c.at(shared, near) for c in group])
        finite, rate = np.isfinite(everett), np.array([c.rate for c in group])
        slowest = np.where(finite, rate[:, None], np.inf).min(axis=0)
        counts = finite & (rate[:, None] <= _SLOW * slowest)
        mean = np.where(counts, everett, 0.0).sum(axis=0) / np.maximum(counts.sum(axis=0), 1)
        known = finite.any(axis=0)
        turn = float(np.mean([c.turn for c in group]))
        merged.append(_Curve(turn, shared[known], mean[known], float(rate.min())))
    return merged


def _table(curves: list[_Curve], nodes: Array, *, falls: bool) -> Array:
    """Return E at the nodes: zero on the diagonal, monotone cubics between curves."""
    from scipy.interpolate import PchipInterpolator

    n, near = nodes.size - 1, 0.5 * (nodes[1] - nodes[0])
    turns = np.array([curve.turn for curve in curves])
    everett = np.array([curve.at(nodes, near) for curve in curves])
    table = np.zeros((n + 1, n + 1))
    for j, node in enumerate(nodes):
        beyond = (turns > node + near if falls else turns < node - near) & np.isfinite(everett[:, j])
        places, values = np.append(turns[beyond], node), np.append(everett[beyond, j], 0.0)
        if places.size < 2:
            continue
        order = np.argsort(places)
        others = slice(j + 1, n + 1) if falls else slice(0, j)
        within = np.clip(nodes[others], places.min(), places.max())
        table[(others, j) if falls else (j, others)] = PchipInterpolator(places[order], values[order])(within)
    return table
