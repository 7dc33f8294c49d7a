"""Lower bounds of the error of any model of a class, read off a true loop."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dehyst._types import Array
from dehyst.records.metrics import percent
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, raised_cosine

# Fine enough that the sampling adds less than 1e-4 % of the range.
_DRIVE = Sampling(sample_rate=40.0)
_PLACES = 801


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """The closed major loop of an actuator without noise.

    `rising`, `falling` (2, n): displacement [m] and voltage [V] of the two branches, both with increasing displacement.
    """

    rising: Array
    falling: Array

    @classmethod
    def of(cls, truth: PlayActuator) -> ClosedLoop:
        """Play two major cycles into a relaxed copy."""
        twin = replace(truth, noise=0.0)
        voltage = raised_cosine(truth.highest, cycles=2, drive=_DRIVE).voltage
        both = np.vstack([twin.play(voltage), voltage])
        n = (voltage.size - 1) // 4
        return cls(both[:, 2 * n : 3 * n + 1], both[:, 4 * n : 3 * n - 1 : -1])

    @property
    def range(self) -> float:
        """From the lower to the upper turning point [m]."""
        return float(np.ptp(self.falling[0]))

    def width(self, places: Array, apart: float) -> Array:
        """Return the voltage between the branches, the rising one moved down, the falling one up by `apart`."""
        up, down = (places + apart, places - apart)
        return np.asarray(np.interp(up, *self.rising) - np.interp(down, *self.falling))


def symmetric_width_floor(loop: ClosedLoop) -> float:
    """Return the least largest error [% of the range] of any model whose loop is equally wide at mirrored places.

    At one y the branches of a plain Maxwell-slip model lie ``sum_i 2 kappa_i min(...)`` apart, which is the same at the
    mirror image of y about the loop's centre (theory, section 6), whatever N and the spring. If the error of the model
    is at most e on both branches, its width at y lies between that of the true loop with the branches moved together by
    e and that with them moved apart. The bound is the least e for which these intervals overlap at every mirrored pair;
    the centre of the model's loop is free within e.
    """
    places = np.linspace(float(loop.falling[0, 0]), float(loop.falling[0, -1]), _PLACES)

    def possible(e: float) -> bool:
        least, most = loop.width(places, -e), loop.width(places, e)
        return any(_overlap(places, least, most, moved) for moved in np.linspace(-e, e, 21))

    low, high = 0.0, loop.range
    while high - low > 1e-6 * loop.range:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if possible(middle) else (middle, high)
    return percent(high, loop.range)


def chord_error(loop: ClosedLoop, elements: int) -> float:
    """Return the largest error [% of the range] of straight segments through the break points of N = `elements`.

    A model that passes through every break point has it; most of it lies in the first segment after a turning point.
    """
    errors = []
    for displacement, voltage in (loop.rising, loop.falling):
        knots = np.linspace(displacement[0], displacement[-1], elements + 1)
        chord = np.interp(voltage, np.interp(knots, displacement, voltage), knots)
        errors.append(np.abs(chord - displacement).max())
    return percent(float(max(errors)), loop.range)


def parabola_chord_error(nominal: float, elements: int) -> float:
    """Return `chord_error` [%] of a parabola (Rayleigh's law) that leaves the straight line by `nominal` [%].

    With y = s u + (1 - s) u^2, u the share of the voltage, y that of the displacement, the branch leaves the line by
    (1 - s)/4; the first chord ends where y = 1/N, and leaves the branch by (1 - s) u^2 / 4.
    """
    bend = 4 * nominal / 100
    start = 1 - bend
    u = (-start + np.sqrt(start**2 + 4 * bend / elements)) / (2 * bend)
    return float(100 * bend * u**2 / 4)


def _overlap(places: Array, least: Array, most: Array, moved: float) -> bool:
    """Return whether one width fits at each place and at its mirror image about the centre moved by `moved`."""
    mirrored = places[0] + places[-1] + 2 * moved - places
    inside = (mirrored >= places[0]) & (mirrored <= places[-1])
    rounding = 1e-9 * float(most.max())
    there = np.interp(mirrored, places, least), np.interp(mirrored, places, most)
    return bool(np.all((least <= there[1] + rounding)[inside] & (there[0] <= most + rounding)[inside]))
