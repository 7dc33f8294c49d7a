"""What a record does when it comes back: cycles that stay open, and creep at the ends of its voltages.

Within an epoch no cart starts to move anew: a cycle that comes back to its voltage comes back to its displacement, and
either extreme of the voltage leaves the actuator in one state only, whatever lay between.
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
# Fewer samples than this make no line.
_FEWEST = 4


def gaps(record: Record, noise: float) -> tuple[Array, Array]:
    """Find the cycles in a known state that come back to their voltage.

    Parameters
    ----------
    record : Record
        In one piece, its delay removed.
    noise : float
        Standard deviation of the sensor [m].

    Returns
    -------
    gaps, noises : (n,) array
        How far each ends from its start, and the standard deviation that the sensor's noise gives it [m].
    """
    v, same = record.voltage, _same(record)
    stretches = epochs(record, noise)
    found: list[tuple[float, float]] = []
    for cycle in record.cycles():
        ends = np.array([cycle.start, cycle.stop - 1])
        inside = any(epoch.turn <= ends[0] and ends[1] < epoch.stop for epoch in stretches)
        if inside and abs(v[ends[1]] - v[ends[0]]) <= same:
            (start, end), gain = _levels(record, ends)
            found.append((end - start, noise * sqrt(2 * gain)))
    open_by, noises = np.array(found).reshape(-1, 2).T
    return open_by, noises


def creep(pieces: list[tuple[Record, Array]], noise: float, risk: float) -> tuple[float, float] | None:
    """Slope of the displacement at the ends of the voltages against creep curves.

    Parameters
    ----------
    pieces : list of (Record, creep curve (n,))
        Without gaps, delays removed; the curve in decades.
    noise : float
        Standard deviation of the sensor [m].
    risk : float
        Probability with which scatter alone surpasses the floor.

    Returns
    -------
    slope, floor : float
        [m a decade]; None if no extreme is met often enough.
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
    rest = y - slope * x
    spread = sqrt(float(rest @ rest) / free / float(x @ x))
    return slope, float(stdtrit(free, 1 - risk / 2)) * spread


def _returns(record: Record, curve: Array, noise: float) -> list[Array]:
    """Creep curve and level [m] at the turning points (n, 2) of either extreme of each epoch's voltages."""
    v, same = record.voltage, _same(record)
    turns = np.append(record.reversals(), len(record) - 1)
    groups = []
    for epoch in epochs(record, noise):
        own = turns[(turns >= epoch.turn) & (turns < epoch.stop)]
        for extreme in (v[: epoch.stop].min(), v[: epoch.stop].max()):
            at = own[np.abs(v[own] - extreme) <= same]
            if at.size > 1:
                groups.append(np.column_stack([curve[at], _levels(record, at)[0]]))
    return groups


def _same(record: Record) -> float:
    """Difference of voltages [V] that are the same."""
    span = float(np.ptp(record.voltage))
    return min(max(2e-3 * span, 6 * white_noise(record.voltage)), 0.02 * span)


def _levels(record: Record, turns: NDArray[np.intp]) -> tuple[Array, float]:
    """Displacement [m] at turning points, less what their voltage makes of it, and the variance kept of its noise.

    Read off lines through the same few samples before each, for branches from elsewhere come in at other slopes.
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
    """Samples up to a turning point whose voltage is nearly its own, a few at most: in a hold it creeps."""
    before = np.abs(v[max(0, turn - _MOST_AT_TURN + 1) : turn + 1] - v[turn]) > width
    return int(np.argmax(np.append(before[::-1], True)))
