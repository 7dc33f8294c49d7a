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

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from dehyst._types import Array, Mask
from dehyst.records.signals import resolution, runs, white_noise

# Most samples of a glitch, and neighbours on each side that show the slew.
_WIDEST, _NEAR = 5, 8
# Least size: share of the range, and multiples of noise deviation, resolution step and usual excursion.
_LEAST, _SIGMAS, _DIGITS, _TIMES = 0.02, 8.0, 1.5, 1.5
# A glitch exceeds the steps nearby by this factor.
_STEPS = 1.5
# The same at an end of the record, where the voltage cannot come back, for the largest steps.
_STEPS_AT_END = 3.0
# Least share of its mean gain with which the displacement follows: a small excursion moves an actuator by half of the
# mean slope, and half of that can fall between two samples. Multiple of the noise deviation below which it is hidden.
_FOLLOWS, _SEEN = 0.2, 2.0
# Gain of an actuator next to a turn, over its mean gain.
_STEEP = 2.0
# Largest lag of the displacement: share of a cycle, and its bounds in samples.
_LAG, _LAGS = 0.05, (8, 64)
_SHORTEST = 20
# Digits of a signal are this part of its range at most.
_COARSEST = 0.1
_PASSES = 20
_SHOWN = 5
# Longer excursions, such as a channel that drops out: most samples, share of a cycle, least share of the range.
_LONGEST, _LONGEST_PART, _LEAST_LONG = 200, 0.25, 0.2
# Candidates processed at a time.
_BLOCK = 1 << 14

Indices = NDArray[np.intp]


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
    def words(self) -> str:
        """Position and voltage of the glitch as text."""
        last = f"s {self.start} to {self.stop - 1}" if self.stop - self.start > 1 else f" {self.start}"
        ends = " and ".join(f"{volts:.6g}" for volts in self.neighbours)
        beside = f"between {ends} V" if len(self.neighbours) > 1 else f"beside {ends} V"
        return f"voltage glitch at sample{last} ({self.time:.6g} s): {self.voltage:.6g} V {beside}"


def glitches(time: Array, voltage: Array, displacement: Array) -> tuple[Glitch, ...]:
    """Find the isolated glitches of a voltage, in order; none below 20 samples.

    `time`, `voltage`, `displacement` (n,) [s], [V] and any unit; sampled about evenly.
    """
    bad, clean = np.zeros(len(voltage), dtype=bool), voltage
    for _ in range(_PASSES if len(voltage) >= _SHORTEST else 0):
        scale = _Scale.of(clean, displacement)
        if scale is None:
            break
        found = scale.inner(clean, displacement) or scale.long(clean, displacement) or scale.outer(clean, displacement)
        if not found:
            break
        for start, stop in found:
            bad[start:stop] = True
        # A straight line in place of the glitches, so that the next pass finds hidden ones.
        clean = _bridged(voltage, bad)
    items = []
    for start, stop in runs(bad):
        far = start + int(np.argmax(np.abs(voltage[start:stop] - clean[start:stop])))
        beside = tuple(float(voltage[i]) for i in (start - 1, stop) if 0 <= i < len(voltage))
        items.append(Glitch(start, stop, float(voltage[far]), beside, float(time[start])))
    return tuple(items)


def _bridged(values: Array, bad: Mask) -> Array:
    """Return values with straight lines in place of the bad ones."""
    places = np.arange(values.size)
    return np.where(bad, np.interp(places, places[~bad], values[~bad]), values)


def glitch_sentences(items: tuple[Glitch, ...]) -> tuple[str, ...]:
    """Return a sentence for each glitch; beyond five, for four of them and for the range of the rest."""
    shown, rest = (items, ()) if len(items) <= _SHOWN else (items[: _SHOWN - 1], items[_SHOWN - 1 :])
    sentences = [f"{glitch.words}; the displacement does not follow: left out." for glitch in shown]
    if rest:
        volts = [glitch.voltage for glitch in rest]
        sentences.append(f"{len(rest)} more voltage glitches, of {min(volts):.6g} to {max(volts):.6g} V: left out.")
    return tuple(sentences)


@dataclass(frozen=True)
class _Scale:
    """The scales of a record: what counts as large.

    `least`: excursion [V] that noise, resolution or usual excursions explain. `gain`: displacement per volt, over the
    range. `sensor`: displacement that noise or resolution of the sensor explains. `lag`: samples by which the
    displacement may lag. `span`: range of the voltage [V]. `longest`: samples that an excursion may last.
    """

    least: float
    gain: float
    sensor: float
    lag: int
    span: float
    longest: int

    @classmethod
    def of(cls, v: Array, y: Array) -> _Scale | None:
        """Return the scales from quantiles, which glitches do not move; None for a constant voltage."""
        low, middle, high = np.quantile(v, [0.01, 0.5, 0.99]).tolist()
        if not low < high:
            return None
        stroke = float(np.subtract(*np.quantile(y, [0.99, 0.01])))
        crossings = int(np.count_nonzero(np.diff(v > middle)))
        cycle = 2 * len(v) / max(crossings, 1)
        least = max(_LEAST * (high - low), _SIGMAS * _noise(v), _DIGITS * _digit(v))
        sensor = max(_SEEN * _noise(y), _digit(y))
        lag = int(np.clip(_LAG * cycle, *_LAGS))
        longest = int(min(_LONGEST, _LONGEST_PART * cycle))
        return cls(least, stroke / (high - low), sensor, lag, high - low, longest)

    def inner(self, v: Array, y: Array) -> list[tuple[int, int]]:
        """Return start and stop of glitches with neighbours on both sides."""
        jumps = _jumps(v, self.least)
        if jumps.size < 2:
            return []
        candidates: list[tuple[float, int, int]] = []
        for width in range(1, _WIDEST + 1):
            # The 98th percentile of the excursion over windows of this width.
            steps = np.diff(v)
            there, back = steps[:-width], steps[width:]
            far = np.where(there * back < 0, np.minimum(np.abs(there), np.abs(back)), 0.0)
            usual = _TIMES * float(np.quantile(far, 1 - 0.02 / width))
            before = np.intersect1d(jumps, jumps - width, assume_unique=True)
            for begin in range(0, before.size, _BLOCK):
                candidates += self._not_followed(v, y, before[begin : begin + _BLOCK], width, usual)
        return _separate(candidates)

    def _not_followed(
        self, v: Array, y: Array, before: Indices, width: int, usual: float
    ) -> list[tuple[float, int, int]]:
        """Return size, start and stop of glitches of this width, among the excursions after samples `before`."""
        after = before + width + 1
        around = _around(before, after, len(v))
        slew = _slew(v, around, 0.75)
        away = _from_chord(v, before, width)
        size = np.abs(away).min(axis=1)
        # At an edge of the voltage, within half of the excursion.
        comes_back = np.abs(v[after] - v[before]) <= np.maximum(self.least + _STEPS * (width + 1) * slew, 0.5 * size)
        # The top of a staircase is wide and as high as the neighbouring steps; a single sample is not.
        stair = _STEPS * _slew(v, around, 1.0) if width > 1 else 0.0
        large = comes_back & (size > np.maximum(usual, self.least + np.maximum(_STEPS / 2 * (width + 1) * slew, stair)))
        large &= _FOLLOWS * self.gain * size > self.sensor
        before, away, slew, around = before[large], away[large], slew[large], around[large]
        still = ~self._follows(v, y, before, away, slew)
        before, size, level = before[still], size[large][still], np.median(v[around[still]], axis=1)
        inside = v[before[:, None] + np.arange(1, width + 1)]
        # Of two equal candidates, the one farther from its surroundings.
        far = size + 0.1 * np.abs(inside - level[:, None]).min(axis=1)
        return [(d, a + 1, a + 1 + width) for d, a in zip(far.tolist(), before.tolist(), strict=True)]

    def _follows(self, v: Array, y: Array, before: Indices, away: Array, slew: Array) -> Mask:
        """Return whether the displacement follows excursions (k, width) that start after the samples `before`.

        It follows if its part along the excursion, now or later, exceeds the effect of a nearby corner of the voltage.
        """
        from scipy.ndimage import median_filter

        width, follows = away.shape[1], np.full(before.size, -np.inf)
        power = np.square(away).sum(axis=1)
        for late in range(self.lag + 1):
            along = _from_chord(y, before + late, width, beside=1)
            follows = np.maximum(follows, np.einsum("ij,ij->i", along, away) / power)
        size = np.sqrt(power / width)
        corner = np.minimum(self._corner(v, before, width, beyond=width + 1), 0.5 * (width + 3) * slew)
        # Without excursions as short as a glitch, but with steps.
        without_pulses = np.asarray(median_filter(v, 2 * _WIDEST + 1, mode="nearest"), dtype=np.float64)
        corner = np.maximum(corner, self._corner(without_pulses, before, width))
        return np.asarray(follows * size > self.gain * (_FOLLOWS * size + _STEEP * corner), dtype=np.bool_)

    def _corner(self, v: Array, before: Indices, width: int, beyond: int = -1) -> Array:
        """Return the largest deviation of the voltage from chords (k,) [V] more than `beyond` samples away."""
        corner = np.zeros(before.size)
        for shift in range(-self.lag, self.lag + 1):
            if abs(shift) > beyond:
                bent = np.abs(_from_chord(v, before + shift, width, beside=1)).max(axis=1)
                corner = np.maximum(corner, bent)
        return corner

    def long(self, v: Array, y: Array) -> list[tuple[int, int]]:
        """Return start and stop of longer excursions, from one large jump to the next."""
        jumps = _jumps(v, max(self.least, _LEAST_LONG * self.span)).tolist()
        candidates = []
        for before, last in pairwise(jumps):
            if _WIDEST < last - before <= self.longest and self._stays(v, y, before, last):
                around = v[max(before - self.longest, 0) : last + self.longest]
                far = abs(float(np.median(v[before + 1 : last + 1])) - float(np.median(around)))
                candidates.append((far, before + 1, last + 1))
        return _separate(candidates)

    def _stays(self, v: Array, y: Array, before: int, last: int) -> bool:
        """Return whether the displacement moves far less than a real excursion of the voltage would move it."""
        width, where = last - before, np.array([before])
        away = _from_chord(v, where, width)[0]
        side, size = float(np.sign(away[0])), float(np.abs(away).min())
        slew = _STEPS * (width + 1) * float(_slew(v, _around(where, where + width + 1, len(v)), 0.75)[0])
        comes_back = abs(float(v[last + 1] - v[before])) <= self.least + slew
        large = size > max(_LEAST_LONG * self.span, slew) and bool(np.all(side * away > 0))
        seen = _FOLLOWS * self.gain * size > self.sensor
        along = float((side * _from_chord(y, where, width + self.lag)).max())
        return comes_back and large and seen and along <= _FOLLOWS * self.gain * size

    def outer(self, v: Array, y: Array) -> list[tuple[int, int]]:
        """Return start and stop of glitches at the record's first or last samples, with neighbours on one side only.

        They exceed all other steps of the record: a step at its end may be one that the displacement, which lags, has
        not followed yet.
        """
        if not _jumps(v, self.least).size:
            return []
        at_start, at_end = self._at_start(v, y), self._at_start(v[::-1], y[::-1])
        return [(0, at_start)] * bool(at_start) + [(len(v) - at_end, len(v))] * bool(at_end)

    def _at_start(self, v: Array, y: Array) -> int:
        """Return the number of samples of a glitch at the start; 0 if there is none."""
        steps = np.abs(np.diff(v))
        for width in (_jumps(v[: _WIDEST + 1], self.least) + 1)[::-1].tolist():
            usual = float(steps[width + 1 : -_WIDEST].max())
            size = float(np.abs(v[:width] - v[width]).min())
            isolated = size > self.least + _STEPS_AT_END * usual and steps[width] <= _STEPS * usual
            large = isolated and _FOLLOWS * self.gain * size > self.sensor
            # Motion of the displacement over as many samples without an excursion.
            span, near = width + 1, y[1 : 4 * _NEAR]
            moves = np.quantile(np.abs(near[span:] - near[:-span]), 0.75)
            moved = float((np.sign(v[width] - v[0]) * (y[span] - y[:width])).max())
            if large and moved <= _FOLLOWS * self.gain * size + _STEPS * float(moves):
                return int(width)
        return 0


def _noise(values: Array) -> float:
    """Return the white noise, in the unit of the values: the least of three estimates (slopes, corners, steps)."""
    spreads = ((float(np.median(np.abs(np.diff(values, k)))), comb(2 * k, k)) for k in (1, 2))
    return min(white_noise(values), *(spread / 0.6745 / sqrt(parts) for spread, parts in spreads))


def _digit(values: Array) -> float:
    """Return the resolution, in the unit of the values; 0 for a signal of few large steps, which does not show it."""
    step, part = resolution(values)
    return step if part <= _COARSEST else 0.0


def _jumps(v: Array, least: float) -> Indices:
    """Return the samples from which the voltage steps by more than `least`."""
    return np.flatnonzero(np.abs(np.diff(v)) > least)


def _around(before: Indices, after: Indices, size: int) -> Indices:
    """Return the samples next to excursions, on both sides (k, 2 _NEAR + 2); the ends of a record are repeated."""
    offsets = np.arange(_NEAR + 1)
    return np.clip(np.hstack([before[:, None] - offsets[::-1], after[:, None] + offsets]), 0, size - 1)


def _slew(v: Array, around: Indices, share: float) -> Array:
    """Return the step of the voltage next to excursions (k,) [V] that this share of the steps does not exceed."""
    steps = np.abs(np.diff(v[around], axis=1))
    # Neither the step across the excursion, nor repeated samples at the ends of the record.
    valid = np.diff(around, axis=1) == 1
    valid[:, _NEAR] = False
    # As `numpy.nanquantile` interpolates, which goes row by row and takes most of an identification's time.
    ordered, count = np.sort(np.where(valid, steps, np.nan), axis=1), valid.sum(axis=1)
    at = (count - 1) * share
    first = np.floor(at).astype(np.intp)
    nearest = np.column_stack([first, np.minimum(first + 1, count - 1)])
    low, high = np.take_along_axis(ordered, nearest, axis=1).T
    part, rise = at - first, high - low
    return np.asarray(np.where(part < 0.5, low + rise * part, high - rise * (1 - part)))


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


# Most samples of a spike, neighbours on each side that show the steps, and samples by which the displacement may lag.
_SPIKE_WIDEST, _SPIKE_NEAR, _SPIKE_LAG = 3, 8, 64
# Least part of the range, of standard deviations of the noise, and of the steps nearby.
_SPIKE_LEAST, _SPIKE_SIGMAS, _SPIKE_STEPS = 0.005, 8.0, 3.0
# What is left of a spike after it, and what the voltage may explain of it, as parts of its height.
_LEFT, _EXPLAINED = 0.3, 0.3
# A spike's samples have this part of its height; more of the record than this part are no spikes.
_CORE, _MOST = 0.5, 0.05
# Spikes next to others appear when those are gone.
_SPIKE_PASSES = 6
_SPIKE_BLOCK = 1 << 19


def spikes(voltage: Array, displacement: Array) -> Mask:
    """Return the samples (n,) in spikes of a displacement; both are in any unit, and sampled about evenly."""
    found = np.zeros(len(displacement), dtype=bool)
    if len(displacement) <= 2 * _SPIKE_NEAR or not float(np.ptp(displacement)):
        return found
    inner = np.quantile(displacement, [0.01, 0.99])
    usual_range = float(inner[1] - inner[0])
    least = max(_SPIKE_LEAST * usual_range, _SPIKE_SIGMAS * white_noise(displacement))
    # A corner of the voltage lies two or three of its steps beside its neighbours.
    corner = _SPIKE_STEPS * float(np.quantile(np.abs(np.diff(voltage)), 0.95))
    gain = usual_range / max(float(np.ptp(voltage)), 1e-300)
    moved = np.maximum(np.abs(_beside_median(voltage)) - corner, 0.0) * gain
    clean = displacement
    for _ in range(_SPIKE_PASSES):
        more = _highest(clean, moved, least)
        if not more.any():
            break
        found |= more
        clean = _bridged(displacement, found)
    return found if np.count_nonzero(found) <= _MOST * found.size else np.zeros_like(found)


def _highest(y: Array, moved: Array, least: float) -> Mask:
    """Return the highest spike of each group of samples beside their neighbours (n,)."""
    found, beside = np.zeros(len(y), dtype=bool), np.abs(_beside_median(y))
    if np.count_nonzero(beside > least) > 2 * _MOST * y.size:
        return found
    for first, last in runs(beside > least):
        start = stop = first + int(np.argmax(beside[first:last]))
        height = float(beside[start])
        while start > first and beside[start - 1] > _CORE * height:
            start -= 1
        while stop < last and beside[stop] > _CORE * height:
            stop += 1
        explained = moved[max(start - _SPIKE_LAG, 0) : stop + _SPIKE_NEAR].max(initial=0.0) > _EXPLAINED * height
        if not explained and _stands_alone(y, start, stop, height):
            found[start:stop] = True
    return found


def _stands_alone(y: Array, start: int, stop: int, height: float) -> bool:
    """Whether the displacement goes on where it was before a run of samples, and moves by far smaller steps nearby."""
    if start < 1 or stop >= len(y) or stop - start > _SPIKE_WIDEST:
        return False
    before, after = y[max(start - _SPIKE_NEAR, 0) : start], y[stop : stop + _SPIKE_NEAR]
    steps = np.abs(np.concatenate([np.diff(before), np.diff(after)]))
    # Another spike nearby must not hide this one: the largest steps come in pairs.
    usual = float(np.sort(steps)[: max(steps.size - 2, 1)].max(initial=0.0))
    return abs(float(y[stop] - y[start - 1])) < _LEFT * height and _SPIKE_STEPS * usual < height


def _beside_median(values: Array) -> Array:
    """Return each value less the median of the seven around it (n,)."""
    width = 2 * _SPIKE_WIDEST + 1
    windows = sliding_window_view(np.pad(values, _SPIKE_WIDEST, mode="edge"), width)
    parts = [np.median(windows[first : first + _SPIKE_BLOCK], axis=1) for first in range(0, len(windows), _SPIKE_BLOCK)]
    return np.asarray(values - np.concatenate(parts))
