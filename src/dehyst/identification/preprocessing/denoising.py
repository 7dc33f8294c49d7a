"""Removal of the sensor's jitter from a measured path: jitter would drag elements back and forth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array
from dehyst.identification.preprocessing.cleaning import cycle_time
from dehyst.identification.preprocessing.local_polynomial import local_polynomial
from dehyst.records import Record
from dehyst.records.signals import turning_points, white_noise

# Least turn of the voltage as a part of its range, if above its noise; a hold moves less than a tenth of it in this
# many samples.
_TURN = 2e-3
_HOLD = 8
# Noise below this part of the range has no effect on elements; parts of a cycle in a parabola's window, most samples.
_QUIET = 3e-4
_PART_OF_CYCLE, _WIDEST = 16, 12
# Samples processed at a time.
_BLOCK = 1 << 19


def remove_jitter(piece: Record, noise: float, stroke: float) -> Record:
    """Return a piece whose displacement moves as an actuator does.

    Parameters
    ----------
    piece : Record
        Its delay removed.
    noise, stroke : float
        Standard deviation of the sensor [m], and range of the widest loop [m]: if the noise is significant, parabolas
        through neighbours, over a part of a cycle, come first.
    """
    window = 1
    if noise > _QUIET * stroke:
        window = 2 * (min(int(cycle_time(piece) / piece.sample_time / _PART_OF_CYCLE), _WIDEST) // 2) + 1
    if 5 <= window <= len(piece):
        piece = replace(piece, displacement=local_polynomial(piece.displacement, window, 2))
    return monotone(piece)


def monotone(piece: Record) -> Record:
    """Return a piece whose displacement rises where the voltage rises and falls where it falls, by least squares.

    Where the voltage is held, the displacement moves in one direction, as creep does. The delay must be removed first.
    """
    from scipy.optimize import isotonic_regression

    y = piece.displacement.copy()
    for start, stop, rising in _legs(piece):
        upward = _drifts_up(y[start:stop]) if rising is None else rising
        y[start:stop] = isotonic_regression(y[start:stop], increasing=upward).x
    y.flags.writeable = False
    return replace(piece, displacement=y)


def _drifts_up(y: Array) -> bool:
    quarter = max(y.size // 4, 1)
    return bool(y[-quarter:].mean() >= y[:quarter].mean())


def _legs(piece: Record) -> list[tuple[int, int, bool | None]]:
    """Return the first and last sample of each leg, and whether it rises; None for holds."""
    v = piece.voltage
    least = max(_TURN * float(np.ptp(v)), 6 * white_noise(v))
    cuts = np.unique(np.concatenate([[0, v.size], turning_points(v, least), _holds(v, least)]))
    legs: list[tuple[int, int, bool | None]] = []
    for a, b in zip(cuts[:-1].tolist(), cuts[1:].tolist(), strict=True):
        change = float(v[min(b, v.size - 1)] - v[a])
        legs.append((a, b, None if abs(change) < least else change > 0))
    return legs


def _holds(v: Array, least: float) -> NDArray[np.intp]:
    """Return the samples where the voltage comes to rest and leaves it."""
    if v.size <= _HOLD:
        return np.zeros(0, dtype=np.intp)
    # The range of a window, because its ends are equal at a turn; within noise nothing moves.
    still_range = max(0.1 * least, 6 * white_noise(v))
    windows = np.lib.stride_tricks.sliding_window_view(v, _HOLD + 1)
    parts = [np.ptp(windows[start : start + _BLOCK], axis=1) < still_range for start in range(0, len(windows), _BLOCK)]
    ahead = np.concatenate(parts)
    still = np.concatenate([ahead, np.full(_HOLD, ahead[-1])]) | np.concatenate([np.full(_HOLD, ahead[0]), ahead])
    return np.flatnonzero(still[1:] != still[:-1]) + 1
