"""Noise and the motion of the mass, taken out of the displacement that drives the elements."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array
from dehyst.identification.cleaning import cycle_time
from dehyst.identification.rules import RULES
from dehyst.model import Dynamics
from dehyst.records import Record, counting, turning_points, white_noise

# Noise below this part of the range has no effect on elements.
_QUIET = 3e-4
# Derivatives are those of a polynomial of fourth order through this many neighbours.
_WINDOW, _ORDER = 9, 4


def remove_dynamics(piece: Record, dynamics: Dynamics | None) -> Record:
    """Return a piece whose displacement is w, the input of the resonance: y + 2 zeta / omega y' + y'' / omega^2."""
    if dynamics is None:
        return piece
    velocity, acceleration = derivatives(piece)
    omega, zeta = dynamics.omega, dynamics.damping
    return replace(piece, displacement=piece.displacement + 2 * zeta / omega * velocity + acceleration / omega**2)


def derivatives(piece: Record) -> tuple[Array, Array]:
    """Return velocity [m/s] and acceleration [m/s2] (n,) of the measured displacement."""
    from scipy.signal import savgol_filter

    y, step = piece.displacement, piece.sample_time
    first, second = (savgol_filter(y, _WINDOW, _ORDER, deriv=derivative, delta=step) for derivative in (1, 2))
    return first, second


# Least turn of the voltage as a part of its range, if above its noise; a hold moves less than a tenth of it in this
# many samples.
_TURN = 2e-3
_HOLD = 8
# Parts of a cycle in a parabola's window, most samples.
_PART_OF_CYCLE, _WIDEST = 16, 12


def disturbs(noise: float, stroke: float) -> bool:
    """Whether a sensor's noise [m] biases Maxwell-slip elements, at a range of the widest loop [m]."""
    return noise > RULES.loud * stroke


def remove_jitter(piece: Record, noise: float, stroke: float) -> Record:
    """Return a piece whose displacement moves as an actuator does.

    `piece`: its delay removed. `noise`, `stroke`: standard deviation of the sensor [m], and range of the widest loop
    [m]: if the noise is significant, parabolas through neighbours, over a part of a cycle, come first; of loud noise
    over wider parts, each branch by itself, or a turn would lie beyond what the actuator reaches.
    """
    from scipy.signal import savgol_filter

    part = int(cycle_time(piece) / piece.sample_time / _PART_OF_CYCLE)
    if disturbs(noise, stroke):
        return _between_turns(piece, 2 * (part // 2) + 1)
    window = 2 * (min(part, _WIDEST) // 2) + 1 if noise > _QUIET * stroke else 1
    y = piece.displacement.copy()
    for start, stop in _stretches(piece):
        if 5 <= window <= stop - start:
            y[start:stop] = savgol_filter(y[start:stop], window, 2)
    return monotone(replace(piece, displacement=y))


def _between_turns(piece: Record, window: int) -> Record:
    """Return a piece whose displacement is smooth and monotone from turn to turn.

    An error at a turn stays in the elements for the whole branch after it. So a turn is the mean of what both branches
    show, and no sample of a branch lies beyond its turns, as the ends of a monotone fit to noise do.
    """
    from scipy.signal import savgol_filter

    y, branches = piece.displacement.copy(), _counted_branches(piece)
    sums, counts = np.zeros(y.size), np.zeros(y.size)
    for start, stop, _ in branches:
        # The turn is the first sample of the next branch.
        own = slice(start, min(stop + 1, y.size))
        values = piece.displacement[own]
        width = min(window, 2 * ((values.size - 1) // 2) + 1)
        sums[own] += savgol_filter(values, width, 2) if width >= 5 else values
        counts[own] += 1
    smooth = np.divide(sums, counts, out=y, where=counts > 0)
    path = monotone(replace(piece, displacement=smooth)).displacement.copy()
    for start, stop, _ in branches:
        ends = smooth[[start, min(stop, y.size - 1)]]
        path[start:stop] = np.clip(path[start:stop], ends.min(), ends.max())
    path.flags.writeable = False
    return replace(piece, displacement=path)


def _counted_branches(piece: Record) -> list[tuple[int, int, bool | None]]:
    """Return the branches of `_branches` within what counts."""
    parts = (
        (max(a, start), min(b, stop), rising) for a, b, rising in _branches(piece) for start, stop in _stretches(piece)
    )
    return [(start, stop, rising) for start, stop, rising in parts if start < stop]


def _stretches(piece: Record) -> list[tuple[int, int]]:
    """Return the first and one after the last sample of each stretch that counts."""
    if (counted := counting(piece)) is None:
        return [(0, len(piece))]
    edges = np.flatnonzero(np.diff(np.concatenate([[0], counted.astype(np.int8), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def monotone(piece: Record) -> Record:
    """Return a piece whose displacement rises where the voltage rises and falls where it falls, by least squares.

    Where the voltage is held, the displacement moves in one direction, as creep does. The delay must be removed first.
    """
    from scipy.optimize import isotonic_regression

    y = piece.displacement.copy()
    for start, stop, rising in _counted_branches(piece):
        part, quarter = y[start:stop], max((stop - start) // 4, 1)
        upward = bool(part[-quarter:].mean() >= part[:quarter].mean()) if rising is None else rising
        y[start:stop] = isotonic_regression(part, increasing=upward).x
    y.flags.writeable = False
    return replace(piece, displacement=y)


def _branches(piece: Record) -> list[tuple[int, int, bool | None]]:
    """Return the first and last sample of each branch, and whether it rises; None for holds."""
    v = piece.voltage
    least = max(_TURN * float(np.ptp(v)), 6 * white_noise(v))
    cuts = np.unique(np.concatenate([[0, v.size], turning_points(v, least), _holds(v, least)]))
    branches: list[tuple[int, int, bool | None]] = []
    for a, b in zip(cuts[:-1].tolist(), cuts[1:].tolist(), strict=True):
        change = float(v[min(b, v.size - 1)] - v[a])
        branches.append((a, b, None if abs(change) < least else change > 0))
    return branches


def _holds(v: Array, least: float) -> NDArray[np.intp]:
    """Return the samples where the voltage comes to rest and leaves it."""
    if v.size <= _HOLD:
        return np.zeros(0, dtype=np.intp)
    # The range of a window, because its ends are equal at a turn; within noise nothing moves.
    still_range = max(0.1 * least, 6 * white_noise(v))
    windows = np.lib.stride_tricks.sliding_window_view(v, _HOLD + 1)
    ahead = np.ptp(windows, axis=1) < still_range
    still = np.concatenate([ahead, np.full(_HOLD, ahead[-1])]) | np.concatenate([np.full(_HOLD, ahead[0]), ahead])
    return np.flatnonzero(still[1:] != still[:-1]) + 1
