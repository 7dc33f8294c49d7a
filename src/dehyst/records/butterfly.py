"""Butterfly loops, in which the displacement both falls and rises with rising voltage: a switching ferroelectric."""

from __future__ import annotations

from itertools import pairwise
from math import sqrt
from typing import NamedTuple

import numpy as np

from dehyst._types import Array
from dehyst.records.signals import turning_points, white_noise

# Only legs over this share of the range of the voltage count, in so many bins of it.
_WHOLE = 0.9
_BINS = 32
# A fall or a rise counts from this share of the stroke on, and from so many times the noise of a bin's mean on.
_LEAST, _LOUD = 0.1, 8.0


class Butterfly(NamedTuple):
    """Fall and rise of the displacement with rising voltage [m], and the voltages between which it rises [V]."""

    fall: float
    rise: float
    low: float
    high: float


def butterfly_of(voltage: Array, displacement: Array) -> Butterfly | None:
    """Find a fall and a rise on the line midway between the rising and the falling legs; return None without both.

    On that line hysteresis, a delay, creep and a drift from leg to leg take opposite signs and cancel.
    """
    span = float(np.ptp(voltage))
    turns = turning_points(voltage, _WHOLE * span)
    legs = [slice(begin, end + 1) for begin, end in pairwise([0, *turns.tolist(), len(voltage) - 1])]
    rises = [float(voltage[leg.stop - 1] - voltage[leg.start]) for leg in legs]
    edges = np.linspace(voltage.min(), voltage.max(), _BINS + 1)
    (up, up_counts), (down, down_counts) = (
        _means(
            voltage,
            displacement,
            edges,
            [leg for leg, rise in zip(legs, rises, strict=True) if sign * rise >= _WHOLE * span],
        )
        for sign in (1, -1)
    )
    filled = (up_counts > 0) & (down_counts > 0)
    if np.count_nonzero(filled) < _BINS // 2:
        return None
    up, down, places = up[filled], down[filled], (0.5 * (edges[1:] + edges[:-1]))[filled]
    middle = 0.5 * (up + down)
    noise = white_noise(displacement) / sqrt(min(up_counts[filled].min(), down_counts[filled].min()))
    least = max(_LEAST * float(np.ptp(displacement)), _LOUD * noise)
    fall = float(np.max(np.maximum.accumulate(middle) - middle))
    climbed = middle - np.minimum.accumulate(middle)
    if min(fall, float(climbed.max())) < least:
        return None
    top = int(np.argmax(climbed))
    bottom = int(np.argmin(middle[: top + 1]))
    # Before the rise the falling legs turn last, after it the rising ones do.
    low = float(places[int(np.argmin(down[: top + 1]))]) if bottom else float(voltage.min())
    last = places.size - 1
    high = float(places[bottom + int(np.argmax(up[bottom:]))]) if top < last else float(voltage.max())
    return Butterfly(fall, float(climbed.max()), low, high)


def _means(voltage: Array, displacement: Array, edges: Array, legs: list[slice]) -> tuple[Array, Array]:
    """Return the mean displacement [m] of legs in bins of the voltage, and the number of samples in each bin."""
    if not legs:
        return np.zeros(_BINS), np.zeros(_BINS)
    bins = np.concatenate([np.clip(np.searchsorted(edges, voltage[leg]) - 1, 0, _BINS - 1) for leg in legs])
    counts = np.bincount(bins, minlength=_BINS).astype(np.float64)
    sums = np.bincount(bins, np.concatenate([displacement[leg] for leg in legs]), _BINS)
    return np.divide(sums, counts, out=np.zeros(_BINS), where=counts > 0), counts
