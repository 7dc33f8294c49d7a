"""Isolated glitches of a measured voltage: short excursions that neither its slew nor the displacement explains.

A glitch goes away and comes back at once, within five samples. It is larger than the voltage's own steps nearby, than
its noise, than its resolution and than what most excursions of the record are; and the displacement, now or somewhat
later, does not go along. Where the sensor is too noisy to show that, the voltage is taken as it is. A large excursion
may last longer, up to a quarter of a cycle.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from math import comb, sqrt

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array, Mask
from dehyst.records.signals import resolution, white_noise

# Most samples of a glitch, and neighbours on each side that show the slew.
_WIDEST, _NEAR = 5, 8
# Least part of the range, and so many standard deviations of noise, steps of resolution and usual excursions.
_LEAST, _SIGMAS, _DIGITS, _TIMES = 0.02, 8.0, 1.5, 1.5
# A glitch is larger than so many steps nearby.
_STEPS = 1.5
# At an end of the record, where nothing comes back, than so many of the largest steps elsewhere.
_STEPS_AT_END = 3.0
# The displacement follows with this part of its mean gain at least: a small excursion moves an actuator by half of
# what the mean slope gives, and half of that can fall between two samples. A noise of which so many standard
# deviations are larger hides it.
_FOLLOWS, _SEEN = 0.2, 2.0
# Beside a turn an actuator moves by so many times what its mean gain gives.
_STEEP = 2.0
# The displacement may lag by this part of a cycle, and by so many samples.
_LAG, _LAGS = 0.05, (8, 64)
_SHORTEST = 20
# Digits of a signal are this part of its range at most.
_COARSEST = 0.1
_PASSES = 20
_SHOWN = 5
# Longer excursions, of a channel that drops out for one: most samples, part of a cycle, least part of the range.
_LONGEST, _LONGEST_PART, _LEAST_LONG = 200, 0.25, 0.2
# Candidates looked at a time.
_BLOCK = 1 << 14

Indices = NDArray[np.intp]


@dataclass(frozen=True)
class Glitch:
    """Samples `start` to `stop` - 1 of a record, counted from 0.

    Attributes
    ----------
    voltage : float
        The farthest away [V].
    neighbours : tuple of float
        Voltages [V] of the samples before and after; one of them at an end of the record.
    time : float
        Of its first sample [s].
    """

    start: int
    stop: int
    voltage: float
    neighbours: tuple[float, ...]
    time: float

    @property
    def words(self) -> str:
        """Where it is, and how far away."""
        last = f"s {self.start} to {self.stop - 1}" if self.stop - self.start > 1 else f" {self.start}"
        ends = " and ".join(f"{volts:.6g}" for volts in self.neighbours)
        beside = f"between {ends} V" if len(self.neighbours) > 1 else f"beside {ends} V"
        return f"voltage glitch at sample{last} ({self.time:.6g} s): {self.voltage:.6g} V {beside}"


def glitches(time: Array, voltage: Array, displacement: Array) -> tuple[Glitch, ...]:
    """Find the isolated glitches of a voltage.

    Parameters
    ----------
    time, voltage, displacement : (n,) array
        [s], [V] and any unit; sampled about evenly.

    Returns
    -------
    tuple of Glitch
        In order; none below 20 samples.
    """
    bad = np.zeros(len(voltage), dtype=bool)
    if len(voltage) < _SHORTEST:
        return ()
    clean = voltage
    for _ in range(_PASSES):
        scale = _Scale.of(clean, displacement)
        if scale is None:
            break
        runs = scale.inner(clean, displacement) or scale.long(clean, displacement)
        runs = runs or list(scale.outer(clean, displacement))
        if not runs:
            break
        for start, stop in runs:
            bad[start:stop] = True
        # In between a straight line, so that the next pass sees what was hidden.
        places = np.arange(len(voltage))
        clean = np.where(bad, np.interp(places, places[~bad], voltage[~bad]), voltage)
    return tuple(_described(time, voltage, clean, bad))


def glitch_sentences(found: tuple[Glitch, ...]) -> tuple[str, ...]:
    """A sentence for each glitch; beyond five, for four of them and the range of the rest."""
    shown, rest = (found, ()) if len(found) <= _SHOWN else (found[: _SHOWN - 1], found[_SHOWN - 1 :])
    said = [f"{one.words}; the displacement does not follow: left out." for one in shown]
    if rest:
        volts = [one.voltage for one in rest]
        said.append(f"{len(rest)} more voltage glitches, of {min(volts):.6g} to {max(volts):.6g} V: left out.")
    return tuple(said)


def _described(time: Array, voltage: Array, clean: Array, bad: Mask) -> Iterator[Glitch]:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], bad.astype(np.int8), [0]])))
    for start, stop in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        far = start + int(np.argmax(np.abs(voltage[start:stop] - clean[start:stop])))
        beside = tuple(float(voltage[i]) for i in (start - 1, stop) if 0 <= i < len(voltage))
        yield Glitch(start, stop, float(voltage[far]), beside, float(time[start]))


@dataclass(frozen=True)
class _Scale:
    """What is large in a record.

    Attributes
    ----------
    least : float
        Excursion [V] that noise, resolution or usual excursions explain.
    gain : float
        Displacement for a volt, over the range.
    sensor : float
        Displacement that noise or resolution of the sensor explains.
    lag : int
        Samples by which the displacement may come late.
    span : float
        Range of the voltage [V].
    longest : int
        Samples that an excursion may last.
    """

    least: float
    gain: float
    sensor: float
    lag: int
    span: float
    longest: int

    @classmethod
    def of(cls, v: Array, y: Array) -> _Scale | None:
        """By what glitches do not move: quantiles; None of a voltage that stands still."""
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
        """First sample, and the one after the last, of glitches with neighbours on both sides."""
        jumps = _jumps(v, self.least)
        if jumps.size < 2:
            return []
        found: list[tuple[float, int, int]] = []
        for width in range(1, _WIDEST + 1):
            usual = _TIMES * _usual_excursion(v, width)
            before = np.intersect1d(jumps, jumps - width, assume_unique=True)
            for begin in range(0, before.size, _BLOCK):
                found += self._followed_not(v, y, before[begin : begin + _BLOCK], width, usual)
        return _apart(found)

    def _followed_not(
        self, v: Array, y: Array, before: Indices, width: int, usual: float
    ) -> list[tuple[float, int, int]]:
        """How far away they go, start and stop of glitches so wide, among the excursions after samples `before`."""
        after = before + width + 1
        around = _around(before, after, len(v))
        slew = _slew(v, around, 0.75)
        away = _from_chord(v, before, width)
        size = np.abs(away).min(axis=1)
        # At an edge of the voltage, by half of it.
        comes_back = np.abs(v[after] - v[before]) <= np.maximum(self.least + _STEPS * (width + 1) * slew, 0.5 * size)
        # The top of a staircase is wide and as high as the stairs beside it; a lone sample is not.
        stair = _STEPS * _slew(v, around, 1.0) if width > 1 else 0.0
        large = comes_back & (size > np.maximum(usual, self.least + np.maximum(_STEPS / 2 * (width + 1) * slew, stair)))
        large &= _FOLLOWS * self.gain * size > self.sensor
        before, away, slew, around = before[large], away[large], slew[large], around[large]
        still = ~self._follows(v, y, before, away, slew)
        before, size, level = before[still], size[large][still], np.median(v[around[still]], axis=1)
        inside = v[before[:, None] + np.arange(1, width + 1)]
        # Of two that differ in nothing else, the one farther from what is around.
        far = size + 0.1 * np.abs(inside - level[:, None]).min(axis=1)
        return [(d, a + 1, a + 1 + width) for d, a in zip(far.tolist(), before.tolist(), strict=True)]

    def _follows(self, v: Array, y: Array, before: Indices, away: Array, slew: Array) -> Mask:
        """Whether the displacement goes along with excursions (k, width) that start after the samples `before`.

        The part of the excursion in it, now or later, beyond what a corner of the voltage nearby makes.
        """
        width, follows = away.shape[1], np.full(before.size, -np.inf)
        power = np.square(away).sum(axis=1)
        for late in range(self.lag + 1):
            along = _from_chord(y, before + late, width, beside=1)
            follows = np.maximum(follows, np.einsum("ij,ij->i", along, away) / power)
        size = np.sqrt(power / width)
        corner = np.minimum(self._corner(v, before, width, beyond=width + 1), 0.5 * (width + 3) * slew)
        corner = np.maximum(corner, self._corner(_without_pulses(v), before, width))
        return np.asarray(follows * size > self.gain * (_FOLLOWS * size + _STEEP * corner), dtype=np.bool_)

    def _corner(self, v: Array, before: Indices, width: int, beyond: int = -1) -> Array:
        """What the voltage lies off chords (k,) [V], more than so many samples away."""
        corner = np.zeros(before.size)
        for shift in range(-self.lag, self.lag + 1):
            if abs(shift) > beyond:
                bent = np.abs(_from_chord(v, before + shift, width, beside=1)).max(axis=1)
                corner = np.maximum(corner, bent)
        return corner

    def long(self, v: Array, y: Array) -> list[tuple[int, int]]:
        """First sample, and the one after the last, of longer excursions: from one large jump to the next."""
        jumps = _jumps(v, max(self.least, _LEAST_LONG * self.span)).tolist()
        found = []
        for before, last in pairwise(jumps):
            if _WIDEST < last - before <= self.longest and self._stands(v, y, before, last):
                around = v[max(before - self.longest, 0) : last + self.longest]
                far = abs(float(np.median(v[before + 1 : last + 1])) - float(np.median(around)))
                found.append((far, before + 1, last + 1))
        return _apart(found)

    def _stands(self, v: Array, y: Array, before: int, last: int) -> bool:
        """Whether the displacement moves far less than a voltage would have it move that goes away and comes back."""
        width, where = last - before, np.array([before])
        away = _from_chord(v, where, width)[0]
        side, size = float(np.sign(away[0])), float(np.abs(away).min())
        slew = _STEPS * (width + 1) * float(_slew(v, _around(where, where + width + 1, len(v)), 0.75)[0])
        comes_back = abs(float(v[last + 1] - v[before])) <= self.least + slew
        large = size > max(_LEAST_LONG * self.span, slew) and bool(np.all(side * away > 0))
        seen = _FOLLOWS * self.gain * size > self.sensor
        along = float((side * _from_chord(y, where, width + self.lag)).max())
        return comes_back and large and seen and along <= _FOLLOWS * self.gain * size

    def outer(self, v: Array, y: Array) -> Iterator[tuple[int, int]]:
        """The same of glitches at the record's first or last samples, which come from nowhere or go nowhere.

        They are beyond all other steps of the record: a step at its end may be one that the displacement, a little
        late, has not followed yet.
        """
        if _jumps(v, self.least).size:
            yield from ((0, width) for width in self._at_start(v, y))
            yield from ((len(v) - width, len(v)) for width in self._at_start(v[::-1], y[::-1]))

    def _at_start(self, v: Array, y: Array) -> list[int]:
        """How many samples at the start are a glitch, if any are."""
        steps = np.abs(np.diff(v))
        first = [int(k) + 1 for k in _jumps(v[: _WIDEST + 1], self.least)]
        for width in reversed(first):
            usual = float(steps[width + 1 : -_WIDEST].max())
            size = float(np.abs(v[:width] - v[width]).min())
            alone = size > self.least + _STEPS_AT_END * usual and steps[width] <= _STEPS * usual
            large = alone and _FOLLOWS * self.gain * size > self.sensor
            # Over so many samples the displacement moves by this without an excursion.
            span, near = width + 1, y[1 : 4 * _NEAR]
            moves = np.quantile(np.abs(near[span:] - near[:-span]), 0.75)
            moved = float((np.sign(v[width] - v[0]) * (y[span] - y[:width])).max())
            if large and moved <= _FOLLOWS * self.gain * size + _STEPS * float(moves):
                return [width]
        return []


def _noise(values: Array) -> float:
    """White noise [in their unit]; where slopes, corners or steps are many, by what feels least of them."""
    spreads = ((float(np.median(np.abs(np.diff(values, k)))), comb(2 * k, k)) for k in (1, 2))
    return min(white_noise(values), *(spread / 0.6745 / sqrt(parts) for spread, parts in spreads))


def _digit(values: Array) -> float:
    """The resolution, in the unit of the values; a signal that moves in few large steps is not told by its digits."""
    step, part = resolution(values)
    return step if part <= _COARSEST else 0.0


def _jumps(v: Array, least: float) -> Indices:
    """Samples from which the voltage steps by more than that."""
    return np.flatnonzero(np.abs(np.diff(v)) > least)


def _usual_excursion(v: Array, width: int) -> float:
    """How far runs of so many samples go away and come back; one of fifty goes farther."""
    steps = np.diff(v)
    there, back = steps[:-width], steps[width:]
    far: Array = np.where(there * back < 0, np.minimum(np.abs(there), np.abs(back)), 0.0)
    return float(np.quantile(far, 1 - 0.02 / width))


def _without_pulses(v: Array) -> Array:
    """The voltage with its steps, but without what comes back within the width of a glitch."""
    from scipy.ndimage import median_filter

    return np.asarray(median_filter(v, 2 * _WIDEST + 1, mode="nearest"), dtype=np.float64)


def _around(before: Indices, after: Indices, size: int) -> Indices:
    """Samples next to excursions, on both sides (k, 2 _NEAR + 2); the first and last of a record again and again."""
    offsets = np.arange(_NEAR + 1)
    return np.clip(np.hstack([before[:, None] - offsets[::-1], after[:, None] + offsets]), 0, size - 1)


def _slew(v: Array, around: Indices, share: float) -> Array:
    """Step of the voltage beside excursions (k,) [V] that this share of the steps does not surpass."""
    steps = np.abs(np.diff(v[around], axis=1))
    # Not the step across, nor those that the ends of the record repeat.
    own = np.diff(around, axis=1) == 1
    own[:, _NEAR] = False
    # As `numpy.nanquantile` interpolates, which goes row by row and takes most of an identification's time.
    ordered, count = np.sort(np.where(own, steps, np.nan), axis=1), own.sum(axis=1)
    at = (count - 1) * share
    first = np.floor(at).astype(np.intp)
    nearest = np.column_stack([first, np.minimum(first + 1, count - 1)])
    low, high = np.take_along_axis(ordered, nearest, axis=1).T
    part, rise = at - first, high - low
    return np.asarray(np.where(part < 0.5, low + rise * part, high - rise * (1 - part)))


def _from_chord(values: Array, before: Indices, width: int, beside: int = 0) -> Array:
    """What samples (k, width) after those `before` lie off the chord over them, or over so many more on each side."""
    last, span = len(values) - 1, width + 1 + 2 * beside
    # The minimum of the maximum is `numpy.clip` in a third of its time.
    left, right = (values[np.minimum(np.maximum(i, 0), last)] for i in (before - beside, before + width + 1 + beside))
    inside = np.arange(1, width + 1)
    chord = left[:, None] + (right - left)[:, None] * ((inside + beside) / span)
    return np.asarray(values[np.minimum(np.maximum(before[:, None] + inside, 0), last)] - chord)


def _apart(found: list[tuple[float, int, int]]) -> list[tuple[int, int]]:
    """The farthest ones, no two of which touch: what lies between two glitches looks like one until they are gone."""
    taken: set[int] = set()
    kept = []
    for _, start, stop in sorted(found, reverse=True):
        if taken.isdisjoint(range(start - 1, stop + 1)):
            taken.update(range(start, stop))
            kept.append((start, stop))
    return kept
