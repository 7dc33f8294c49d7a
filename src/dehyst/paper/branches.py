"""Branches of closed loops."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np

from dehyst._types import Array
from dehyst.records import Record, reversals

# Turning points closer to each other than this part of the stroke are the same.
_SAME = 0.02

Branch: TypeAlias = "tuple[Array, Array]"


class Family(NamedTuple):
    """Branches of one record between the same turning points.

    `record`: its name. `bottom`, `top`: mean turning points [m]. `descending`, `ascending`: in the order of motion,
    both turning points among them.
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
    turns = [0, *reversals(record).tolist(), len(record) - 1]
    y, v = record.displacement, record.voltage
    same = _SAME * record.stroke
    # Turning points of the first branch of each group; descending and ascending branches.
    groups: list[tuple[float, float, tuple[list[Branch], list[Branch]]]] = []
    for before, start, end in zip(turns[:-2], turns[1:-1], turns[2:], strict=True):
        if abs(y[start] - y[before]) < abs(y[end] - y[start]) - same:
            continue
        low, high = sorted((float(y[start]), float(y[end])))
        group = next((one for one in groups if abs(one[0] - low) < same and abs(one[1] - high) < same), None)
        if group is None:
            group = low, high, ([], [])
            groups.append(group)
        down, up = group[2]
        (up if y[end] > y[start] else down).append((y[start : end + 1], v[start : end + 1]))
    found = []
    for _, _, (down, up) in groups:
        if down and up:
            bottoms = [y[-1] for y, _ in down] + [y[0] for y, _ in up]
            tops = [y[0] for y, _ in down] + [y[-1] for y, _ in up]
            found.append(Family(record.name, float(np.mean(bottoms)), float(np.mean(tops)), down, up))
    return found


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
