"""Isolated glitches of a measured voltage: short excursions that neither its slew rate nor the displacement explains.

A glitch goes away and comes back at once, within five samples. It is larger than the voltage's steps nearby, its noise,
its resolution and most excursions of the record; and the displacement does not follow, now or somewhat later. If the
sensor is too noisy to show that, the voltage is not changed. A large excursion may last longer, up to a quarter of a
cycle.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import comb, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array, Mask
from dehyst.records.signals import QUARTILE, resolution, runs, white_noise

# Fewest samples of a record, most of a glitch, and neighbours on each side that show the voltage's steps.
_SHORTEST, _WIDEST, _NEAR = 20, 5, 8
# Least size: share of the range, and multiples of noise deviation, resolution step and usual excursion.
_LEAST, _SIGMAS, _DIGITS, _TIMES = 0.02, 8.0, 1.5, 1.5
# A glitch exceeds the steps nearby by the first factor; at an end, where the voltage cannot come back, the largest
# steps by the second.
_STEPS, _STEPS_AT_END = 1.5, 3.0
# Least share of its mean gain with which the displacement follows: a small excursion moves an actuator by half of the
# mean slope, and half of that can fall between two samples. Multiple of the noise deviation below which it is hidden,
# and gain next to a turn over the mean gain.
_FOLLOWS, _SEEN, _STEEP = 0.2, 2.0, 2.0
# Largest lag of the displacement: share of a cycle, and its bounds in samples.
_LAG, _LAGS = 0.05, (8, 64)
# Longer excursions, such as a channel that drops out: most samples, share of a cycle, least share of the range.
_LONGEST, _LONGEST_PART, _LEAST_LONG = 200, 0.25, 0.2
# Digits of a signal are this part of its range at most.
_COARSEST = 0.1
# Passes in which glitches behind others are found, and candidates processed at a time.
_PASSES, _BLOCK = 20, 1 << 14

# Spikes of the displacement: least size, most samples of one, and largest part of the record.
_LEAST_SPIKE, _WIDEST_SPIKE, _MOST_SPIKES = 0.005, 3, 0.05

Indices = NDArray[np.intp]
Stretches = list[tuple[int, int]]


@dataclass(frozen=True)
class Glitch:
    """Samples `start` to `stop` - 1 of a record, counted from 0.

    `voltage`: the voltage farthest away [V]. `neighbours`: voltages [V] of the samples before and after; only one at an
    end of the record. `time`: time of its first sample [s].
    """

    start: int
    stop: int
    voltage: float
    neighbours: tuple[float, ...]
    time: float

    @property
    def sentence(self) -> str:
        """Position and voltage of the glitch."""
        last = f"s {self.start} to {self.stop - 1}" if self.stop - self.start > 1 else f" {self.start}"
        ends = " and ".join(f"{volts:.6g}" for volts in self.neighbours)
        beside = f"between {ends} V" if len(self.neighbours) > 1 else f"beside {ends} V"
        where = f"voltage glitch at sample{last} ({self.time:.6g} s): {self.voltage:.6g} V {beside}"
        return f"{where}; the displacement does not follow: left out."


def glitches(time: Array, voltage: Array, displacement: Array) -> tuple[Glitch, ...]:
    """Find the isolated glitches of a voltage, in order; none below 20 samples.

    `time`, `voltage`, `displacement` (n,) [s], [V] and any unit; sampled about evenly.
    """
    bad, clean = np.zeros(len(voltage), dtype=bool), voltage
    for _ in range(_PASSES if len(voltage) >= _SHORTEST else 0):
        signals = _Signals.of(clean, displacement)
        if signals is None or not (found := signals.inner() or signals.at_ends()):
            break
        for start, stop in found:
            bad[start:stop] = True
        # A straight line in place of the glitches, so that the next pass finds hidden ones.
        clean = bridged(voltage, bad)
    items = []
    for start, stop in runs(bad):
        far = start + int(np.argmax(np.abs(voltage[start:stop] - clean[start:stop])))
        beside = tuple(float(voltage[i]) for i in (start - 1, stop) if 0 <= i < len(voltage))
        items.append(Glitch(start, stop, float(voltage[far]), beside, float(time[start])))
    return tuple(items)


class _Signals(NamedTuple):
    """Voltage and displacement (n,), and what counts as large in them.

    `least`: excursion [V] that noise, resolution or usual excursions explain. `gain`: displacement per volt, over the
    range. `sensor`: displacement that noise or resolution of the sensor explains. `lag`: samples by which the
    displacement may lag. `span`: range of the voltage [V]. `longest`: samples that an excursion may last.
    """

    v: Array
    y: Array
    least: float
    gain: float
    sensor: float
    lag: int
    span: float
    longest: int
    widest: int = _WIDEST
    way: int = 1

    @classmethod
    def of(cls, v: Array, y: Array, least: float = _LEAST) -> _Signals | None:
        """Return the scales from quantiles, which glitches do not move; None for a constant voltage."""
        low, middle, high = np.quantile(v, [0.01, 0.5, 0.99]).tolist()
        if not low < high:
            return None
        stroke = float(np.subtract(*np.quantile(y, [0.99, 0.01])))
        cycle = 2 * len(v) / max(int(np.count_nonzero(np.diff(v > middle))), 1)
        least = max(least * (high - low), _SIGMAS * _noise(v), _DIGITS * _digit(v))
        lag, longest = int(np.clip(_LAG * cycle, *_LAGS)), int(min(_LONGEST, _LONGEST_PART * cycle))
        return cls(v, y, least, stroke / (high - low), max(_SEEN * _noise(y), _digit(y)), lag, high - low, longest)

    def jumps(self, least: float) -> Indices:
        """Return the samples from which the voltage steps by more than `least`."""
        return np.flatnonzero(np.abs(np.diff(self.v)) > least)

    def seen(self, size: Array | float) -> Array:
        """Return the displacement that an excursion of this size moves at least, or 0 if the sensor does not see it."""
        moved = _FOLLOWS * self.gain * size
        return np.where(moved > self.sensor, moved, 0.0)

    def inner(self) -> Stretches:
        """Return start and stop of excursions with neighbours on both sides that the other signal does not follow."""
        from scipy.ndimage import median_filter

        candidates: list[tuple[float, int, int]] = []
        jumps, steps = self.jumps(self.least), np.diff(self.v)
        for width in range(1, self.widest + 1):
            # The 98th percentile of the excursion over windows of this width.
            there, back = steps[:-width], steps[width:]
            far = np.where(there * back < 0, np.minimum(np.abs(there), np.abs(back)), 0.0)
            before = np.intersect1d(jumps, jumps - width, assume_unique=True)
            size = np.abs(_from_chord(self.v, before, width)).min(axis=1)
            before = before[size > max(self.least, _TIMES * float(np.quantile(far, 1 - 0.02 / width)))]
            for begin in range(0, before.size, _BLOCK):
                candidates += self._isolated(before[begin : begin + _BLOCK], width)
        # Longer ones, from one large jump to the next.
        for before, last in pairwise(self.jumps(max(self.least, _LEAST_LONG * self.span)).tolist()):
            if self.widest < last - before <= self.longest:
                long = self._isolated(np.array([before]), last - before)
                candidates += [one for one in long if one[0] > _LEAST_LONG * self.span]
        if not candidates:
            return []
        # Without excursions as short as a glitch, but with steps.
        without_pulses = np.asarray(median_filter(self.v, 2 * self.widest + 1, mode="nearest"), dtype=np.float64)
        return _separate([one for one in candidates if not self._follows(one[1], one[2], without_pulses)])

    def _isolated(self, before: Indices, width: int) -> list[tuple[float, int, int]]:
        """Return size, start and stop of excursions after samples that come back and exceed the steps nearby."""
        after, ends = before + width + 1, np.arange(_NEAR + 1)
        beside = [np.clip(places, 0, self.v.size - 1) for places in (before[:, None] - ends, after[:, None] + ends)]
        steps = np.abs(np.hstack([np.diff(self.v[places]) for places in beside]))
        slew = (width + 1) * np.quantile(steps, 0.75, axis=1)
        away = _from_chord(self.v, before, width)
        size = np.abs(away).min(axis=1)
        # At an edge of the voltage, within half of the excursion.
        back = np.abs(self.v[after] - self.v[before]) <= np.maximum(self.least + _STEPS * slew, 0.5 * size)
        # The top of a staircase is wide and as high as the neighbouring steps; a single sample is not.
        stair = _STEPS * steps.max(axis=1) if width > 1 else 0.0
        kept = back & (size > self.least + np.maximum(_STEPS / 2 * slew, stair)) & (self.seen(size) > 0)
        # Of two equal candidates, the one farther from its surroundings.
        level = np.median(self.v[np.hstack(beside)], axis=1)
        inside = self.v[before[:, None] + np.arange(1, width + 1)]
        far = size + 0.1 * np.abs(inside - level[:, None]).min(axis=1)
        return [(d, a + 1, a + 1 + width) for d, a in zip(far[kept].tolist(), before[kept].tolist(), strict=True)]

    def _follows(self, start: int, stop: int, without_pulses: Array) -> bool:
        """Return whether the displacement follows an excursion, now or later, beyond the effect of a corner nearby."""
        width, late = stop - start, np.arange(self.lag + 1) * self.way
        away = _from_chord(self.v, np.array([start - 1]), width)[0]
        size = float(np.sqrt(np.mean(away**2)))
        along = _from_chord(self.y, start - 1 + late, width, beside=1) @ away / (width * size)
        near = start - 1 + np.arange(-self.lag, self.lag + 1)
        corner = float(np.abs(_from_chord(without_pulses, near, width, beside=1)).max())
        # A long excursion is a pulse that is left.
        allowed = _FOLLOWS * size + _STEEP * corner * (width <= self.widest)
        return bool(along.max() > self.gain * allowed)

    def at_ends(self) -> Stretches:
        """Return start and stop of glitches at the record's first or last samples, with neighbours on one side only.

        They exceed all other steps of the record: a step at its end may be one that the displacement, which lags, has
        not followed yet.
        """
        start, stop = self._at_start(), self._replace(v=self.v[::-1], y=self.y[::-1])._at_start()
        return [(0, start)] * bool(start) + [(len(self.v) - stop, len(self.v))] * bool(stop)

    def _at_start(self) -> int:
        """Return the number of samples of a glitch at the start; 0 if there is none."""
        v, y, steps = self.v, self.y, np.abs(np.diff(self.v))
        for width in (np.flatnonzero(steps[:_WIDEST] > self.least) + 1)[::-1].tolist():
            usual = float(steps[width + 1 : -_WIDEST].max())
            size = float(np.abs(v[:width] - v[width]).min())
            isolated = size > self.least + _STEPS_AT_END * usual and steps[width] <= _STEPS * usual
            # Motion of the displacement over as many samples without an excursion.
            span, near = width + 1, y[1 : 4 * _NEAR]
            moves = _STEPS * float(np.quantile(np.abs(near[span:] - near[:-span]), 0.75))
            moved = float((np.sign(v[width] - v[0]) * (y[span] - y[:width])).max())
            if isolated and self.seen(size) > 0 and moved <= self.seen(size) + moves:
                return int(width)
        return 0


def bridged(values: Array, bad: Mask) -> Array:
    """Return values with straight lines in place of the bad ones."""
    places = np.arange(values.size)
    return np.where(bad, np.interp(places, places[~bad], values[~bad]), values)


def _noise(values: Array) -> float:
    """Return the white noise, in the unit of the values: the least of three estimates (slopes, corners, steps)."""
    spreads = ((float(np.median(np.abs(np.diff(values, k)))), comb(2 * k, k)) for k in (1, 2))
    return min(white_noise(values), *(spread / QUARTILE / sqrt(parts) for spread, parts in spreads))


def _digit(values: Array) -> float:
    """Return the resolution, in the unit of the values; 0 for a signal of few large steps, which does not show it."""
    step, part = resolution(values)
    return step if part <= _COARSEST else 0.0


def _from_chord(values: Array, before: Indices, width: int, beside: int = 0) -> Array:
    """Return deviations (k, width) of samples after `before` from a chord over them and `beside` more on each side."""
    last, span = len(values) - 1, width + 1 + 2 * beside
    # The minimum of the maximum is `numpy.clip` in a third of its time.
    left, right = (values[np.minimum(np.maximum(i, 0), last)] for i in (before - beside, before + width + 1 + beside))
    inside = np.arange(1, width + 1)
    chord = left[:, None] + (right - left)[:, None] * ((inside + beside) / span)
    return np.asarray(values[np.minimum(np.maximum(before[:, None] + inside, 0), last)] - chord)


def _separate(candidates: list[tuple[float, int, int]]) -> list[tuple[int, int]]:
    """Return the largest candidates, no two of which touch: the gap between two glitches looks like a glitch."""
    taken: set[int] = set()
    kept = []
    for _, start, stop in sorted(candidates, reverse=True):
        if taken.isdisjoint(range(start - 1, stop + 1)):
            taken.update(range(start, stop))
            kept.append((start, stop))
    return kept


def spikes(voltage: Array, displacement: Array) -> Mask:
    """Return the samples (n,) in spikes of a displacement; both are in any unit, and sampled about evenly."""
    found, clean = np.zeros(len(displacement), dtype=bool), displacement
    for _ in range(_PASSES if len(displacement) >= _SHORTEST else 0):
        signals = _Signals.of(clean, voltage, _LEAST_SPIKE)
        if signals is None:
            break
        more = signals._replace(sensor=0.0, longest=0, widest=_WIDEST_SPIKE, way=-1).inner()
        if not more:
            break
        for start, stop in more:
            found[start:stop] = True
        clean = bridged(displacement, found)
    return found if np.count_nonzero(found) <= _MOST_SPIKES * found.size else np.zeros_like(found)
