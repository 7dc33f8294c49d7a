"""First-order reversal curves in records, and the Everett function that they determine."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dehyst._errors import IdentifyError
from dehyst._types import Array
from dehyst.baselines.training import Training
from dehyst.records import Record

# Part of the range within which an end of it counts as reached, and within which two curves count as one.
_NEAR = 0.01
# A curve driven more than this many times as fast as the slowest of the same turn does not count.
_SLOW = 2.0


@dataclass(frozen=True, eq=False)
class _Curve:
    """One curve: the voltage at which it turned off the major loop, and E along it; voltages increase.

    `rate` is the mean rate of its voltage [V/s].
    """

    turn: float
    voltage: Array
    everett: Array
    rate: float

    def at(self, nodes: Array, near: float) -> Array:
        """Return E at voltages; NaN at those farther than `near` [V] from the curve."""
        reached = (nodes >= self.voltage[0] - near) & (nodes <= self.voltage[-1] + near)
        return np.where(reached, np.interp(nodes, self.voltage, self.everett), np.nan)


def everett_table(training: Training, n: int, least: float) -> Array:
    """Read E [m] at the nodes (n + 1, n + 1), and make it increase by at least `least` [m] from node to node.

    Raise `IdentifyError` if there are fewer than three curves of one kind.
    """
    low, high = training.limits
    falling: list[_Curve] = []
    rising: list[_Curve] = []
    for piece, rows in zip(training.pieces, training.kept, strict=True):
        for falls, curve in _curves(piece, int(rows[0]) if rows.size else len(piece), low, high):
            (falling if falls else rising).append(curve)
    kinds = [_merged(curves, _NEAR * (high - low)) for curves in (falling, rising)]
    enough = [len(curves) > 2 for curves in kinds]
    if not any(enough):
        raise IdentifyError(
            f"got {len(kinds[0])} falling and {len(kinds[1])} rising first-order reversal curves, need at least three "
            "of one kind. Record descending tops or reversal curves (dehyst excite), or use non-negative least "
            "squares, which takes records of any shape"
        )
    nodes = np.linspace(low, high, n + 1)
    tables = [_table(curves, nodes, falls=i == 0) for i, curves in enumerate(kinds) if enough[i]]
    return _growing(np.mean(tables, axis=0), least)


def _curves(piece: Record, first: int, low: float, high: float) -> Iterator[tuple[bool, _Curve]]:
    """Yield whether it falls, and the curve, of each leg after `first` that turned off a branch of the major loop."""
    v, y, near = piece.voltage, piece.displacement, _NEAR * (high - low)
    turns = piece.reversals()
    ends = np.append(turns, len(v) - 1)
    for k in range(len(turns)):
        a, b = int(ends[k]), int(ends[k + 1])
        if a < first or b - a < 4:
            continue
        before, falls = v[ends[k - 1]] if k else v[a], bool(v[b] < v[a])
        outermost = v[a] > high - near if falls else v[a] < low + near
        from_end = before < low + near if falls else before > high - near
        if outermost or (k and from_end):
            leg = slice(a, b + 1)
            order = np.argsort(v[leg], kind="stable")
            everett = y[a] - y[leg] if falls else y[leg] - y[a]
            rate = float(abs(v[b] - v[a]) / (piece.time[b] - piece.time[a]))
            yield falls, _Curve(float(v[a]), v[leg][order], everett[order], rate)


def _merged(curves: list[_Curve], near: float) -> list[_Curve]:
    """Return one curve for each turning point, sorted; repeated ones are averaged, each as far as it goes.

    Where some were driven much faster than others, only the slow ones count: the model is rate-independent.
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
        curve = PchipInterpolator(places[order], values[order])
        others = slice(j + 1, n + 1) if falls else slice(0, j)
        within = np.clip(nodes[others], places.min(), places.max())
        if falls:
            table[others, j] = curve(within)
        else:
            table[j, others] = curve(within)
    return table


def _growing(table: Array, least: float) -> Array:
    """Raise every node to at least `least` above the nodes within its triangle."""
    for i in range(1, len(table)):
        for j in range(i - 1, -1, -1):
            inner = max(table[i - 1, j] if i - 1 > j else 0.0, table[i, j + 1] if j + 1 < i else 0.0)
            table[i, j] = max(table[i, j], inner + least)
    return table
