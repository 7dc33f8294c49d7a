"""Spikes of a sensor: few samples of a displacement, far beside their neighbours, which no voltage explains.

A spike goes away at once, within three samples, and the displacement goes on where it was. It is larger than the steps
nearby, the sensor's noise and what the voltage moves at that time: a resonance that rings, a turn or a step is none.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from dehyst._types import Array, Mask
from dehyst.records.signals import white_noise

# Most samples of a spike, neighbours on each side that show the steps, and samples by which the displacement may lag.
_WIDEST, _NEAR, _LAG = 3, 8, 64
# Least part of the range, of standard deviations of the noise, and of the steps nearby.
_LEAST, _SIGMAS, _STEPS = 0.005, 8.0, 3.0
# What is left of a spike after it, and what the voltage may explain of it, as parts of its height.
_LEFT, _EXPLAINED = 0.3, 0.3
# A spike's samples have this part of its height; more of the record than this part are no spikes.
_CORE, _MOST = 0.5, 0.05
# Spikes next to others appear when those are gone.
_PASSES = 6
_BLOCK = 1 << 19


def spikes(voltage: Array, displacement: Array) -> Mask:
    """Return the samples of a record in spikes of the displacement (n,).

    Parameters
    ----------
    voltage, displacement : (n,) array
        In any unit, sampled about evenly.
    """
    found = np.zeros(len(displacement), dtype=bool)
    if len(displacement) <= 2 * _NEAR or not float(np.ptp(displacement)):
        return found
    inner = np.quantile(displacement, [0.01, 0.99])
    usual_range = float(inner[1] - inner[0])
    least = max(_LEAST * usual_range, _SIGMAS * white_noise(displacement))
    # A corner of the voltage lies two or three of its steps beside its neighbours.
    corner = _STEPS * float(np.quantile(np.abs(np.diff(voltage)), 0.95))
    gain = usual_range / max(float(np.ptp(voltage)), 1e-300)
    moved = np.maximum(np.abs(_beside_median(voltage)) - corner, 0.0) * gain
    places, clean = np.arange(len(displacement)), displacement
    for _ in range(_PASSES):
        more = _highest(clean, moved, least)
        if not more.any():
            break
        found |= more
        clean = np.where(found, np.interp(places, places[~found], displacement[~found]), displacement)
    return found if np.count_nonzero(found) <= _MOST * found.size else np.zeros_like(found)


def _highest(y: Array, moved: Array, least: float) -> Mask:
    """Return the highest spike of each group of samples beside their neighbours (n,)."""
    found, beside = np.zeros(len(y), dtype=bool), np.abs(_beside_median(y))
    if np.count_nonzero(beside > least) > 2 * _MOST * y.size:
        return found
    for first, last in _runs(beside > least):
        start = stop = first + int(np.argmax(beside[first:last]))
        height = float(beside[start])
        while start > first and beside[start - 1] > _CORE * height:
            start -= 1
        while stop < last and beside[stop] > _CORE * height:
            stop += 1
        explained = moved[max(start - _LAG, 0) : stop + _NEAR].max(initial=0.0) > _EXPLAINED * height
        if not explained and _stands_alone(y, start, stop, height):
            found[start:stop] = True
    return found


def _stands_alone(y: Array, start: int, stop: int, height: float) -> bool:
    """Whether the displacement goes on where it was before a run of samples, and moves by far smaller steps nearby."""
    if start < 1 or stop >= len(y) or stop - start > _WIDEST:
        return False
    before, after = y[max(start - _NEAR, 0) : start], y[stop : stop + _NEAR]
    steps = np.abs(np.concatenate([np.diff(before), np.diff(after)]))
    # Another spike nearby must not hide this one: the largest steps come in pairs.
    usual = float(np.sort(steps)[: max(steps.size - 2, 1)].max(initial=0.0))
    return abs(float(y[stop] - y[start - 1])) < _LEFT * height and _STEPS * usual < height


def _beside_median(values: Array) -> Array:
    """Return each value less the median of the seven around it (n,)."""
    width = 2 * _WIDEST + 1
    windows = sliding_window_view(np.pad(values, _WIDEST, mode="edge"), width)
    parts = [np.median(windows[first : first + _BLOCK], axis=1) for first in range(0, len(windows), _BLOCK)]
    return np.asarray(values - np.concatenate(parts))


def _runs(mask: Mask) -> Iterator[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
