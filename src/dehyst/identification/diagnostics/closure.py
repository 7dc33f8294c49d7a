"""Closure of cycles: how far they stay open, and creep at the ends of the voltages.

Within an epoch no further cart starts to slide: a cycle that returns to its voltage returns to its displacement, and
each extreme of the voltage leaves the actuator in one state, whatever came before.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array
from dehyst.identification.preprocessing.regressors import epochs
from dehyst.records import Record
from dehyst.records.signals import white_noise

_MOST_AT_TURN = 16
# Least samples of a line.
_FEWEST = 4


def gaps(record: Record, noise: float) -> tuple[Array, Array]:
    """Find the cycles in a known state that return to their voltage.

    Parameters
    ----------
    record : Record
        Without gaps, its delay removed.
    noise : float
        Standard deviation of the sensor [m].

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

    Parameters
    ----------
    pieces : list of (Record, creep curve (n,))
        Without gaps, delays removed; the curve in decades.
    noise : float
        Standard deviation of the sensor [m].
    risk : float
        Probability that scatter alone exceeds the floor.

    Returns
    -------
    slope, floor : float
        [m a decade]; None if no extreme is reached often enough.
    """
    from scipy.special import stdtrit

    groups = [group for piece, curve in pieces for group in _returns(piece, curve, noise)]
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


def _returns(record: Record, curve: Array, noise: float) -> list[Array]:
    """Return creep curve and level [m] (n, 2) at the turning points of either extreme of each epoch's voltages."""
    v, same = record.voltage, _same(record)
    turns = np.append(record.reversals(), len(record) - 1)
    groups = []
    for epoch in epochs(record, noise):
        inside = turns[(turns >= epoch.turn) & (turns < epoch.stop)]
        for extreme in (v[: epoch.stop].min(), v[: epoch.stop].max()):
            at = inside[np.abs(v[inside] - extreme) <= same]
            if at.size > 1:
                groups.append(np.column_stack([curve[at], _levels(record, at)[0]]))
    return groups


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
    count = min(_near(v, turn, 2 * _same(record)) for turn in turns.tolist())
    rows = turns[:, None] + np.arange(1 - count, 1)
    x = v[rows] - v[turns][:, None]
    middle, spread = x.mean(axis=1), x.var(axis=1)
    level, gain = y[rows].mean(axis=1), np.full(turns.size, 1 / count)
    if count >= _FEWEST and spread.min() > 0:
        tilt = ((x - middle[:, None]) * y[rows]).mean(axis=1) / spread
        level, gain = level - tilt * middle, gain * (1 + middle**2 / spread)
    return np.asarray(level - v[turns] / slope), float(gain.max())


def _near(v: Array, turn: int, width: float) -> int:
    """Count the samples up to a turning point of nearly its voltage, a few at most: in a hold the actuator creeps."""
    before = np.abs(v[max(0, turn - _MOST_AT_TURN + 1) : turn + 1] - v[turn]) > width
    return int(np.argmax(np.append(before[::-1], True)))
