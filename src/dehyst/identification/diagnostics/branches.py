"""Branches of closed loops: legs of a record between the same turning points, and their voltages."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np

from dehyst._types import Array
from dehyst.records import Record

# Turning points closer to each other than this part of the stroke are the same.
_SAME = 0.02
# Least samples of a line: with fewer, linear interpolation is better.
_FEWEST = 4

Branch: TypeAlias = "tuple[Array, Array]"


class Family(NamedTuple):
    """Branches of one record between the same turning points.

    Attributes
    ----------
    record : str
        Its name.
    bottom, top : float
        Mean turning points [m].
    descending, ascending : list of (displacement (n,) [m], voltage (n,) [V])
        In the order of motion, both turning points among them.
    """

    record: str
    bottom: float
    top: float
    descending: list[Branch]
    ascending: list[Branch]

    @property
    def range(self) -> float:
        """Width between the turning points [m]."""
        return self.top - self.bottom

    @property
    def cycles(self) -> int:
        """Pairs of a descending and an ascending branch."""
        return min(len(self.descending), len(self.ascending))


def families(record: Record) -> list[Family]:
    """Group the branches of a record by their turning points.

    A branch is used if the motion before it was at least as wide: then every element that slides on it starts from its
    breakaway elongation. Only closed loops are returned: families with a descending and an ascending branch.
    """
    turns = [0, *record.reversals().tolist(), len(record) - 1]
    y, v = record.displacement, record.voltage
    same = _SAME * record.stroke
    groups: list[tuple[float, float, list[Branch], list[Branch]]] = []

    def family_of(low: float, high: float) -> tuple[list[Branch], list[Branch]]:
        for bottom, top, down, up in groups:
            if abs(bottom - low) < same and abs(top - high) < same:
                return down, up
        groups.append((low, high, [], []))
        return groups[-1][2:]

    for before, start, end in zip(turns[:-2], turns[1:-1], turns[2:], strict=True):
        if abs(y[start] - y[before]) < abs(y[end] - y[start]) - same:
            continue
        low, high = sorted((float(y[start]), float(y[end])))
        down, up = family_of(low, high)
        (up if y[end] > y[start] else down).append((y[start : end + 1], v[start : end + 1]))
    return [Family(record.name, *_mean_turns(down, up), down, up) for _, _, down, up in groups if down and up]


def voltage_at(branch: Branch, places: Array) -> Array:
    """Interpolate the voltage [V] of one branch at displacements `places` (m,) [m], shape (m,).

    Noise moves the displacement of a branch back and forth; the mean of both its envelopes is used. Beyond the
    branch's ends the voltage is constant.
    """
    y, v = branch if branch[0][-1] > branch[0][0] else (branch[0][::-1], branch[1][::-1])
    upper, lower = np.maximum.accumulate(y), np.minimum.accumulate(y[::-1])[::-1]
    monotone = 0.5 * (upper + lower)
    keep = np.append(True, np.diff(monotone) > 0)
    return np.asarray(np.interp(places, monotone[keep], v[keep]))


def averaged_at(branch: Branch, places: Array, half: float) -> tuple[Array, Array]:
    """Read the voltage of one branch at `places` (m,) [m] off lines through the samples within `half` [m] of each.

    Returns
    -------
    voltage, gain : (m,) array
        The gain is the part of the noise variance that a line keeps; 1 where too few samples make a line and
        `voltage_at` is used.
    """
    order = np.argsort(branch[0], kind="stable")
    y, v = branch[0][order], branch[1][order]
    y0, v0 = float(y.mean()), float(v.mean())
    x, at = (y - y0) / half, (places - y0) / half
    columns = np.column_stack([np.ones_like(x), x, x * x, v - v0, x * (v - v0)])
    sums = np.vstack([np.zeros(5), np.cumsum(columns, axis=0)])
    # A sample on either edge of a window is inside it, whatever its last bit.
    edge = 1 + 1e-9
    inside = sums[np.searchsorted(x, at + edge)] - sums[np.searchsorted(x, at - edge)]
    count = np.maximum(inside[:, 0], 1.0)
    _, mx, mxx, mv, mxv = (inside / count[:, None]).T
    spread = mxx - mx**2
    enough = (inside[:, 0] >= _FEWEST) & (spread > 0.05)
    safe = np.where(enough, spread, 1.0)
    voltage = v0 + mv + (mxv - mx * mv) / safe * (at - mx)
    gain = (1 + (at - mx) ** 2 / safe) / count
    return np.where(enough, voltage, voltage_at(branch, places)), np.where(enough, gain, 1.0)


def _mean_turns(down: list[Branch], up: list[Branch]) -> tuple[float, float]:
    bottoms = [y[-1] for y, _ in down] + [y[0] for y, _ in up]
    tops = [y[0] for y, _ in down] + [y[-1] for y, _ in up]
    return float(np.mean(bottoms)), float(np.mean(tops))
