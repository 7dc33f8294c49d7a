"""Branches of closed loops: their symmetry, their closure and creep.

Symmetry: V_up and V_down are the voltages of a loop's branches at u, the displacement from its centre, minus the
centre's voltage:

    V_up(u) + V_down(-u) = 0                               with a linear spring (Lemma 2)
    V_up(u) - V_down(u) = V_up(-u) - V_down(-u)            with any spring and any slip elements

The first sum has an even part, the bend of the middle line, which a nonlinear spring follows, and an odd part, half of
the residual of the second equation, which no spring follows.

Closure: within an epoch no further cart starts to slide. A cycle that returns to its voltage returns to its
displacement, and each extreme of the voltage leaves the actuator in one state, whatever came before.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import sqrt
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array
from dehyst.identification.preprocessing.regressors import epochs
from dehyst.identification.rules import RULES
from dehyst.records import Record, white_noise

# Turning points closer to each other than this part of the stroke are the same.
_SAME = 0.02
# Least samples of a line: with fewer, linear interpolation is better.
_FEWEST = 4

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
    turns = [0, *record.reversals().tolist(), len(record) - 1]
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


_PLACES = 40


@dataclass(frozen=True, eq=False)
class Mirrored:
    """A loop, its cycles read at places that lie symmetrically about its centre.

    `range`, `middle`: width and centre [m]. `place` (K,): u [m], from the centre of each cycle, which removes a slow
    drift of the sensor. `rising`, `falling` (M, K): V_up and V_down [V] of each cycle, minus the mean voltage of its
    turning points. `noise`: standard deviation of a sample [m]. `gain`: largest part of its variance that a reading
    keeps. `opening`: mean distance of the ends of descending and ascending branches [m]: it limits the accuracy with an
    open loop.
    """

    record: str
    range: float
    middle: float
    place: Array
    rising: Array
    falling: Array
    noise: float
    gain: float
    opening: float

    @classmethod
    def of(cls, family: Family, noise: float) -> Mirrored:
        """Read the branches of a family; `noise` is the standard deviation of a sample [m]."""
        half = min(max(0.01 * family.range, 4 * noise), 0.1 * family.range)
        place = np.linspace(half - 0.5 * family.range, 0.5 * family.range - half, _PLACES)
        # Symmetric to the last bit, so that a symmetric loop gives exactly 0.
        place = 0.5 * (place - place[::-1])
        rising, falling, gains = list[Array](), list[Array](), list[Array]()
        pairs = list(zip(family.descending, family.ascending, strict=False))
        for down, up in pairs:
            y, v = (float(0.25 * (down[k][0] + down[k][-1] + up[k][0] + up[k][-1])) for k in (0, 1))
            for branch, read in ((up, rising), (down, falling)):
                voltage, kept = averaged_at((branch[0] - y, branch[1] - v), place, half)
                read.append(voltage)
                gains.append(kept)
        apart = np.mean([(down[0][0] - up[0][-1], down[0][-1] - up[0][0]) for down, up in pairs], axis=0)
        return cls(
            family.record,
            family.range,
            0.5 * (family.top + family.bottom),
            place,
            np.array(rising),
            np.array(falling),
            noise,
            float(np.max(np.mean(gains, axis=0))),
            float(np.abs(apart).sum()),
        )

    @property
    def cycles(self) -> int:
        """Number of cycles M."""
        return len(self.rising)

    @cached_property
    def _slopes(self) -> tuple[Array, Array, Array]:
        """Slopes of the rising and of the falling branch, and the RMS of both at u and -u (K,) [V/m]."""
        rising, falling = (np.gradient(branch.mean(axis=0), self.place) for branch in (self.rising, self.falling))
        squares = rising**2 + falling**2
        return np.asarray(rising), np.asarray(falling), np.asarray(np.sqrt(0.25 * (squares + squares[::-1])))

    def asymmetry(self) -> tuple[Array, float]:
        """Return the distance of the loop from its mirror image (K,) [m], and the floor of its largest value [m]."""
        rising, falling, _ = self._slopes
        slope = np.sqrt(0.5 * (rising**2 + falling[::-1] ** 2))
        return self._distance(self.rising + self.falling[:, ::-1], slope, 2, (rising + falling[::-1]) / slope)

    def width_asymmetry(self) -> tuple[Array, float]:
        """Return the width at u minus the width at -u (K,) [m], and the floor of its largest value [m]."""
        rising, falling, slope = self._slopes
        narrowing, width = rising - falling, self.rising - self.falling
        return self._distance(width - width[:, ::-1], slope, 4, (narrowing - narrowing[::-1]) / slope)

    def middle_asymmetry(self) -> Array:
        """Return the distance of the middle line from its mirror image (K,) [m]."""
        middle = (self.rising + self.falling).mean(axis=0)
        return np.asarray(0.5 * (middle + middle[::-1]) / self._slopes[2])

    def _distance(self, voltage: Array, slope: Array, readings: int, centre: Array) -> tuple[Array, float]:
        """Return the mean over cycles of voltages (M, K), in metres, and the floor of its largest absolute value.

        Noise alone stays below the floor with 95 % probability. Its variance is that of the sensor's white noise, of
        which each of the `readings` keeps its gain, and which enters the centre, the mean of four samples at turning
        points, with the factor `centre` (K,); or that of the scatter between cycles if larger. The opening is added.
        """
        from scipy.special import ndtri

        distance = voltage / slope
        variance = self.noise**2 * (readings * self.gain + 0.5 * float((centre**2).max()))
        if self.cycles > 1:
            variance = max(variance, float(distance.var(axis=0, ddof=1).mean()))
        floor = float(ndtri(1 - RULES.check_risk / (2 * _PLACES))) * sqrt(variance / self.cycles) + self.opening
        return distance.mean(axis=0), floor


_MOST_AT_TURN = 16
# Least samples of a line.
_FEWEST_RETURNS = 4


def gaps(record: Record, noise: float) -> tuple[Array, Array]:
    """Find the cycles in a known state that return to their voltage.

    `record`: without gaps, its delay removed. `noise`: standard deviation of the sensor [m].

    Returns
    -------
    gaps, noises : (n,) array
        Distance between end and start of each, and its standard deviation by the sensor's noise [m].
    """
    v, same = record.voltage, _same(record)
    stretches = epochs(record, noise)
    closures: list[tuple[float, float]] = []
    for cycle in record.cycles():
        ends = np.array([cycle.start, cycle.stop - 1])
        inside = any(epoch.turn <= ends[0] and ends[1] < epoch.stop for epoch in stretches)
        if inside and abs(v[ends[1]] - v[ends[0]]) <= same:
            (start, end), gain = _levels(record, ends)
            closures.append((end - start, noise * sqrt(2 * gain)))
    open_by, noises = np.array(closures).reshape(-1, 2).T
    return open_by, noises


def creep(pieces: list[tuple[Record, Array]], noise: float, risk: float) -> tuple[float, float] | None:
    """Fit the slope of the displacement at the ends of the voltages over creep curves.

    `pieces`: without gaps, delays removed; the curve in decades. `noise`: standard deviation of the sensor [m]. `risk`:
    probability that scatter alone exceeds the floor.

    Returns
    -------
    slope, floor : float
        [m a decade]; None if no extreme is reached often enough.
    """
    from scipy.special import stdtrit

    # Creep curve and level (n, 2) at the turning points of either extreme of each epoch's voltages.
    groups = []
    for piece, curve in pieces:
        v, same = piece.voltage, _same(piece)
        turns = np.append(piece.reversals(), len(piece) - 1)
        for epoch in epochs(piece, noise):
            inside = turns[(turns >= epoch.turn) & (turns < epoch.stop)]
            for extreme in (v[: epoch.stop].min(), v[: epoch.stop].max()):
                at = inside[np.abs(v[inside] - extreme) <= same]
                if at.size > 1:
                    groups.append(np.column_stack([curve[at], _levels(piece, at)[0]]))
    if not groups:
        return None
    x, y = np.vstack([group - group.mean(axis=0) for group in groups]).T
    free = x.size - len(groups) - 1
    if free < 1:
        return None
    slope = float(x @ y / (x @ x))
    residual = y - slope * x
    spread = sqrt(float(residual @ residual) / free / float(x @ x))
    return slope, float(stdtrit(free, 1 - risk / 2)) * spread


def _same(record: Record) -> float:
    """Return the largest difference of voltages [V] that count as equal."""
    span = float(np.ptp(record.voltage))
    return min(max(2e-3 * span, 6 * white_noise(record.voltage)), 0.02 * span)


def _levels(record: Record, turns: NDArray[np.intp]) -> tuple[Array, float]:
    """Return the displacement [m] at turning points, corrected for their voltage, and the gain of its noise variance.

    It is read off lines through the same few samples before each, because branches arrive at different slopes.
    """
    v, y = record.voltage, record.displacement
    slope = float(np.ptp(v)) / record.stroke
    count = _MOST_AT_TURN
    for turn in turns.tolist():
        # In a hold the actuator creeps: a few samples at most, of nearly the turn's voltage.
        before = np.abs(v[max(0, turn - _MOST_AT_TURN + 1) : turn + 1] - v[turn]) > 2 * _same(record)
        count = min(count, int(np.argmax(np.append(before[::-1], True))))
    rows = turns[:, None] + np.arange(1 - count, 1)
    x = v[rows] - v[turns][:, None]
    middle, spread = x.mean(axis=1), x.var(axis=1)
    level, gain = y[rows].mean(axis=1), np.full(turns.size, 1 / count)
    if count >= _FEWEST_RETURNS and spread.min() > 0:
        tilt = ((x - middle[:, None]) * y[rows]).mean(axis=1) / spread
        level, gain = level - tilt * middle, gain * (1 + middle**2 / spread)
    return np.asarray(level - v[turns] / slope), float(gain.max())
