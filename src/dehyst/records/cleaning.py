"""Cleaning of a record: it leaves out what would mislead a fit, and states each finding in one sentence.

Glitches of the voltage and spikes of the displacement are short excursions: the signal leaves its course and returns at
once. They exceed the signal's steps nearby, its noise, its resolution and most of its excursions, and the other signal
does not follow them, at once or later. If the sensor is too noisy to show that, the voltage is not changed. With
hysteresis alone, the displacement turns back only where the voltage does. After a step of the voltage it also turns by
itself if a mass swings or an amplifier overshoots: such a transient is real, but no model without inertia follows it.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from math import log
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from dehyst._text import counted
from dehyst._types import Array, Mask
from dehyst.records import signals
from dehyst.records.signals import new_samples, noise_span, resolution, runs, turning_points, white_noise

if TYPE_CHECKING:
    from collections.abc import Sequence

    from dehyst.records.record import Record

# Number of neighbouring samples that show the usual steps; least size of an excursion, as a part of the range, and in
# standard deviations of the noise.
_NEAR, _LEAST, _SIGMAS = 8, 0.02, 8.0
# A step: largest number of samples, least ratio to the steps nearby, least change in one sample, in least sizes.
_WIDEST_STEP, _STEP_RATIO, _SAMPLE_PART = 8, 8.0, 0.05
# Least swing that the voltage does not cause, as a part of the displacement's step and of its range.
_SWING, _VISIBLE = 0.02, 0.002
# Largest gain after a turn that the voltage can cause, as a multiple of the mean gain.
_STEEP = 3.0
# Samples after a step within which the displacement must turn back; samples that are searched after a step.
_TURN_WITHIN, _SEARCHED = 400, 4096
# Longest time to the next turn of a ring, in usual half periods; the first two turns have no such bound.
_NEXT_TURN = 2.5
# A ring ends below this part of the range, or below the noise; at most, it lasts this multiple of its visible part.
_FADED, _LONGEST_RING = 5e-4, 3.0
# An overshoot without swings ends after this number of half-lives; samples averaged for a level beside it.
_HALF_LIVES, _AVERAGED = 8, 8
# Least number of samples of a record that shows excursions; largest numbers of samples of a glitch and of a spike;
# least size of a spike; largest part of a record that can be spikes.
_SHORTEST, _WIDEST, _WIDEST_SPIKE, _LEAST_SPIKE, _MOST_SPIKES = 20, 5, 3, 0.005, 0.05
# Least size of an excursion, as a multiple of a step of the resolution, of the usual excursion, and of the steps
# nearby; at an end of the record, as a multiple of the largest step.
_DIGITS, _USUAL, _STEPS, _STEPS_AT_END = 1.5, 1.5, 1.5, 3.0
# Least share of its mean gain with which the displacement follows: a small excursion moves an actuator with half of the
# mean gain, and half of this motion can fall between two samples. Noise hides a motion below this multiple of its
# deviation. Largest gain next to a turn and at an end, relative to the mean gain.
_FOLLOWS, _HIDDEN, _STEEP_AT_TURN, _STEEP_AT_END = 0.2, 2.0, 2.0, 5.0
# Largest lag of the displacement, as a part of a cycle, and the bounds of this lag in samples.
_LAG, _LAGS = 0.05, (8, 64)
# Longer excursions, such as a channel that drops out: most samples, largest part of a cycle, least part of the range.
_LONGEST, _LONGEST_PART, _LEAST_LONG = 200, 0.25, 0.2
# Fewest new samples a cycle. Jumps of a zero: samples on each side to which a cubic is fitted; least jump, in noise and
# in residuals of that cubic; most jumps in a record, because a zero jumps rarely.
FEWEST_NEW, _SIDE_SAMPLES, _NOISES, _RESIDUALS, _MOST_JUMPS = 12, 12, 3.3, 4.0, 3
# Number of passes (later passes find excursions hidden by others), and of candidates processed at a time.
_PASSES, _BLOCK = 20, 1 << 14

Indices = NDArray[np.intp]
Stretches = list[tuple[int, int]]


class Cleaned(NamedTuple):
    """A record without its glitches, transients, spikes and repeats; the stretches of glitches; sentences."""

    record: Record
    glitches: Stretches
    sentences: tuple[str, ...]


def cleaned(record: Record, *, ringing: bool = False) -> Cleaned:
    """Leave out glitches, repeats and transients, which a path replaces unless `ringing`; put lines for spikes."""
    bad, sentences = glitches(record.voltage, record.displacement), list[str]()
    if stray := runs(bad):
        a, b = stray[0]
        sentences.append(
            f"voltage glitch at sample{f's {a} to {b - 1}' if b - a > 1 else f' {a}'} ({record.time[a]:.6g} s): "
            f"{record.voltage[a]:.6g} V{_more(stray)}; the displacement does not follow: left out."
        )
        record = record[~bad]
    if found := transients(record):
        time, (start, jump, stop) = record.time, found[0]
        sentences.append(
            f"step to {record.voltage[jump]:.4g} V at {time[jump]:.4g} s swings for "
            f"{1e3 * (time[stop - 1] - time[jump]):.3g} ms; these {stop - start} samples are left out{_more(found)}."
        )
        aside = tuple((float(time[start]), float(time[stop - 1])) for start, _, stop in found)
        path = record.displacement if ringing else settled(record, found)
        record = replace(record, displacement=path, set_aside=(*record.set_aside, *aside))
    new = new_samples(record.voltage, record.displacement)
    if new is not None and np.count_nonzero(new) >= FEWEST_NEW * max(len(record.cycles()), 2):
        rate = np.count_nonzero(new) / float(np.ptp(record.time))
        sentences.append(
            f"the displacement is new only at about every {round(1 / float(new.mean()))}th sample ({rate:.3g} Hz): "
            "samples that repeat the one before are left out."
        )
        record = record[new]
    for after, height in zero_jumps(record):
        record = replace(record, displacement=record.displacement - height * (np.arange(len(record)) >= after))
        words = f"the zero of the sensor jumps by {1e6 * height:.4g} um at {record.time[after]:.6g} s"
        sentences.append(f"{words}, which no voltage explains: the later samples are moved back.")
    known = signals.counting(record)
    bad = spikes(record.voltage, record.displacement) & (True if known is None else known)
    if bad.any():
        y, places = record.displacement, runs(bad)
        straight = np.where(bad, np.interp(record.time, record.time[~bad], y[~bad]), y)
        sentences.append(
            f"{counted(len(places), 'spike')} of the displacement, the first at {record.time[places[0][0]]:.6g} s, up "
            f"to {1e6 * np.abs(y - straight).max():.4g} um, which no voltage explains: replaced by straight lines."
        )
        record = replace(record, displacement=straight)
    return Cleaned(record, stray, tuple(sentences))


def _more(places: Sequence[object]) -> str:
    """Return words on further places, after the first one."""
    return f", and {counted(len(places) - 1, 'more place')}" if len(places) > 1 else ""


def zero_jumps(record: Record) -> list[tuple[int, float]]:
    """Return jumps of the displacement where the voltage does not jump: the sample after each, and its height [m]."""
    v, y, counted = record.voltage, record.displacement, signals.counting(record)
    scales, place = _Signals.of(v, y, 0.0), np.arange(2 * _SIDE_SAMPLES) - _SIDE_SAMPLES + 0.5
    if scales is None or not scales.gain or len(record) < place.size:
        return []
    columns = np.column_stack([np.vander(place / _SIDE_SAMPLES, 4), place > 0])
    solve = np.linalg.pinv(columns)
    heights, moved = np.correlate(y, solve[-1], "valid"), np.abs(np.correlate(v, solve[-1], "valid"))
    # The voltage in a gap or before the record is not known.
    hidden = np.zeros(len(record), dtype=bool) if counted is None else ~counted
    hidden[:-1] |= np.diff(record.time) > 1.5 * record.sample_time
    moved[sliding_window_view(hidden, place.size).any(axis=1)] = np.inf
    latest = sliding_window_view(np.append(np.full(scales.lag, np.inf), moved), scales.lag + 1).max(axis=1)
    least = max(_VISIBLE * record.stroke, _NOISES * scales.sensor)
    found = np.abs(heights) > np.maximum(least, _STEEP_AT_END * scales.gain * latest)
    beside = sliding_window_view(y, place.size)[found]
    left = _RESIDUALS * np.abs(beside - beside @ (columns @ solve).T).max(axis=1)
    # A bend of a moving displacement is no jump.
    found[found] = np.abs(heights[found]) > np.maximum(left, np.median(np.abs(np.diff(beside)), axis=1))
    tops = [start + int(np.argmax(np.abs(heights[start:stop]))) for start, stop in runs(found)]
    return [(top + _SIDE_SAMPLES, float(heights[top])) for top in tops] if len(tops) <= _MOST_JUMPS else []


def voltage_steps(voltage: Array) -> Stretches:
    """Return the sample before and the one after each large and short step of a voltage (n,) [V]."""
    change, span = np.abs(np.diff(voltage)), float(np.ptp(voltage))
    noise = _SIGMAS * white_noise(voltage)
    steps = []
    for start, stop in runs(change > max(_SAMPLE_PART * _LEAST * span, noise)):
        height = abs(float(voltage[stop] - voltage[start]))
        beside = np.concatenate([change[max(start - _NEAR, 0) : start], change[stop : stop + _NEAR]])
        large = height > max(_LEAST * span, noise, _STEP_RATIO * float(beside.max(initial=0.0)))
        if large and stop - start <= _WIDEST_STEP:
            steps.append((start, stop))
    return steps


def transients(record: Record) -> list[tuple[int, int, int]]:
    """Find steps after which the displacement rings: the samples before and after it, and after the ring."""
    steps, counted = voltage_steps(record.voltage), signals.counting(record)
    if counted is not None:
        steps = [(start, jump) for start, jump in steps if counted[start]]
    ends = [*(start for start, _ in steps), len(record)][1:]
    stops = [_rings_until(record, *step, end) for step, end in zip(steps, ends, strict=False)]
    return [(*step, stop) for step, stop in zip(steps, stops, strict=True) if stop]


def settled(record: Record, found: Sequence[tuple[int, int, int]]) -> Array:
    """Return the displacement (n,) [m] with a path that follows the voltage in the place of each transient."""
    v, y = record.voltage, record.displacement.copy()
    gain = float(np.ptp(record.displacement)) / max(float(np.ptp(v)), 1e-300)

    def level(part: slice, at: int) -> float:
        """Mean displacement of samples, each moved by the gain to the voltage of sample `at`."""
        return float(np.mean(y[part] - gain * (v[part] - v[at])))

    for start, jump, stop in found:
        low = level(slice(max(start + 1 - _AVERAGED, 0), start + 1), start)
        last = min(stop, len(record) - 1)
        after = slice(stop, stop + _AVERAGED) if stop < len(record) else slice(max(stop - 2 * _AVERAGED, jump), stop)
        end = level(after, last)
        high = end - gain * float(v[last] - v[jump])
        way = (v[start : jump + 1] - v[start]) / (v[jump] - v[start])
        y[start : jump + 1] = low + (high - low) * way
        y[jump:stop] = np.linspace(high, end, last - jump + 1)[: stop - jump]
    y.flags.writeable = False
    return y


def _rings_until(record: Record, start: int, jump: int, end: int) -> int:
    """Return where a ring or overshoot after a step is over, before sample `end`; 0 if there is none."""
    window = slice(start, min(jump + _SEARCHED, end))
    v, y = record.voltage[window], record.displacement[window]
    if y.size < _AVERAGED:
        return 0
    noise, stroke = white_noise(record.displacement), record.stroke
    soon = _TURN_WITHIN + jump - start
    least = max(_SWING * float(np.ptp(y[:soon])), _VISIBLE * stroke, noise_span(y) if noise else 0.0)
    gain = stroke / float(np.ptp(record.voltage))
    turns = _own_turns(v, y, jump - start, least, gain)
    if not turns or turns[0] > soon:
        return 0
    over = float(turns[-1])
    if len(turns) < 3:
        # Count the samples from the peak until half of the overshoot is gone.
        rest = (y - gain * v)[turns[-1] : turns[-1] + _TURN_WITHIN]
        away = np.abs(rest - np.median(rest[rest.size // 2 :]))
        over += _HALF_LIVES * (int(np.argmax(away < 0.5 * away[0])) + 1 if away[0] else 1)
    else:
        half, swings = (turns[-1] - turns[0]) / (len(turns) - 1), np.abs(np.diff(y[turns]))
        # The swings decay by the same factor each half period.
        fall = -float(np.polyfit(np.arange(swings.size), np.log(swings), 1)[0])
        left = log(max(0.5 * float(swings[-1]) / max(_FADED * stroke, noise), 1.0))
        over += half * min(2 + left / max(fall, 1e-3), _LONGEST_RING * len(turns))
    return min(start + int(over) + 1, end)


def _own_turns(v: Array, y: Array, jump: int, least: float, gain: float) -> list[int]:
    """Return the turns of the displacement after a step that the voltage does not cause, up to the first long pause."""
    turns = [int(turn) for turn in turning_points(y, least) if turn >= jump]
    own: list[int] = []
    for last, turn in pairwise([jump, *turns]):
        half = float(np.median(np.diff(own))) if len(own) > 1 else float("inf")
        if turn - last > _NEXT_TURN * max(half, 2):
            break
        # The displacement must leave the turn by far more than the voltage explains, over some of the samples.
        away, moved = (np.maximum.accumulate(np.abs(signal[turn:] - signal[turn])) for signal in (y, v))
        if not np.any((away > least) & (away > _STEEP * gain * moved)):
            break
        own.append(turn)
    return own


def glitches(voltage: Array, displacement: Array) -> Mask:
    """Return the samples (n,) in glitches of a voltage; both are in any unit, and sampled about evenly."""
    return _excursions(voltage, displacement, _LEAST, ends=True)


def spikes(voltage: Array, displacement: Array) -> Mask:
    """Return the samples (n,) in spikes of a displacement; both are in any unit, and sampled about evenly."""
    found = _excursions(displacement, voltage, _LEAST_SPIKE, sensor=0.0, longest=0, widest=_WIDEST_SPIKE, way=-1)
    return found if np.count_nonzero(found) <= _MOST_SPIKES * found.size else np.zeros_like(found)


def _excursions(values: Array, other: Array, least: float, *, ends: bool = False, **options: Any) -> Mask:
    """Return the samples (n,) in excursions that the other signal does not show; with `ends`, also at the ends."""
    bad, clean, places = np.zeros(len(values), dtype=bool), values, np.arange(len(values))
    for _ in range(_PASSES if len(values) >= _SHORTEST else 0):
        signals = _Signals.of(clean, other, least, **options)
        found = [] if signals is None else signals.inner() or (signals.at_ends() if ends else [])
        if not found:
            break
        for start, stop in found:
            bad[start:stop] = True
        # A straight line in place of the excursions, so that the next pass finds hidden ones.
        clean = np.where(bad, np.interp(places, places[~bad], values[~bad]), values)
    return bad


class _Signals(NamedTuple):
    """Voltage and displacement (n,), and the sizes that count as large in them.

    `least`, `sensor`: largest voltage and displacement that noise explains; `gain`: displacement per volt; `lag`:
    longest lag in samples; `span`: range of `v`; `longest`, `widest`: most samples of an excursion; `way`: 1 if `y`
    follows, -1 if it leads; `steep`: gain of `y` next to a turn, relative to the mean.
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
    steep: float = _STEEP_AT_TURN

    @classmethod
    def of(cls, v: Array, y: Array, least: float, **options: Any) -> _Signals | None:
        """Return the scales from quantiles, which excursions do not move; None for a constant voltage."""
        low, middle, high = np.quantile(v, [0.01, 0.5, 0.99]).tolist()
        if not low < high:
            return None
        stroke = float(np.subtract(*np.quantile(y, [0.99, 0.01])))
        cycle = 2 * len(v) / max(int(np.count_nonzero(np.diff(v > middle))), 1)
        least = max(least * (high - low), _SIGMAS * white_noise(v), _DIGITS * resolution(v)[0])
        lag, longest = int(np.clip(_LAG * cycle, *_LAGS)), int(min(_LONGEST, _LONGEST_PART * cycle))
        sensor = max(_HIDDEN * white_noise(y), resolution(y)[0])
        scales = {"gain": stroke / (high - low), "sensor": sensor, "lag": lag, "span": high - low, "longest": longest}
        return cls(v, y, least, **(scales | options))

    def inner(self) -> Stretches:
        """Return start and stop of excursions inside the record that the other signal does not follow."""
        candidates: list[tuple[float, int, int]] = []
        steps = np.diff(self.v)
        levels = self.least, max(self.least, _LEAST_LONG * self.span)
        jumps, far_jumps = (np.flatnonzero(np.abs(steps) > least) for least in levels)
        for width in range(1, self.widest + 1):
            # The 98th percentile of the excursion over windows of this width.
            there, back = steps[:-width], steps[width:]
            far = np.where(there * back < 0, np.minimum(np.abs(there), np.abs(back)), 0.0)
            before = np.intersect1d(jumps, jumps - width, assume_unique=True)
            size = np.abs(_from_chord(self.v, before, width)).min(axis=1)
            before = before[size > max(self.least, _USUAL * float(np.quantile(far, 1 - 0.02 / width)))]
            for begin in range(0, before.size, _BLOCK):
                candidates += self._isolated(before[begin : begin + _BLOCK], width)
        # Longer excursions go from one large jump to the next.
        for first, last in pairwise(far_jumps.tolist()):
            if self.widest < last - first <= self.longest:
                long = self._isolated(np.array([first]), last - first)
                candidates += [found for found in long if found[0] > _LEAST_LONG * self.span]
        if not candidates:
            return []
        from scipy.ndimage import median_filter

        # This filter removes excursions as short as a glitch, and keeps steps.
        without_pulses = np.asarray(median_filter(self.v, 2 * self.widest + 1, mode="nearest"), dtype=np.float64)
        return _separate([found for found in candidates if not self._follows(found[1], found[2], without_pulses)])

    def _isolated(self, before: Indices, width: int) -> list[tuple[float, int, int]]:
        """Return size, start and stop of excursions after `before` that return and exceed the steps nearby."""
        after, ends = before + width + 1, np.arange(_NEAR + 1)
        beside = [np.clip(places, 0, self.v.size - 1) for places in (before[:, None] - ends, after[:, None] + ends)]
        steps = np.abs(np.hstack([np.diff(self.v[places]) for places in beside]))
        slew = (width + 1) * np.quantile(steps, 0.75, axis=1)
        away = _from_chord(self.v, before, width)
        size = np.abs(away).min(axis=1)
        # At an edge of the voltage, it returns to within half of the excursion only.
        back = np.abs(self.v[after] - self.v[before]) <= np.maximum(self.least + _STEPS * slew, 0.5 * size)
        kept = back & (size > self.least + _STEPS / 2 * slew) & (_FOLLOWS * self.gain * size > self.sensor)
        return [(d, a + 1, a + 1 + width) for d, a in zip(size[kept].tolist(), before[kept].tolist(), strict=True)]

    def _follows(self, start: int, stop: int, without_pulses: Array) -> bool:
        """Return whether the displacement follows an excursion, now or later, beyond the effect of a corner nearby."""
        width, late = stop - start, np.arange(self.lag + 1) * self.way
        away = _from_chord(self.v, np.array([start - 1]), width)[0]
        size = float(np.sqrt(np.mean(away**2)))
        along = _from_chord(self.y, start - 1 + late, width, beside=1) @ away / (width * size)
        near = start - 1 + np.arange(-self.lag, self.lag + 1)
        corner = float(np.abs(_from_chord(without_pulses, near, width, beside=1)).max())
        # The filter keeps a long excursion, which is not a corner.
        allowed = _FOLLOWS * size + self.steep * corner * (width <= self.widest)
        return bool(along.max() > self.gain * allowed)

    def at_ends(self) -> Stretches:
        """Return excursions at the mirrored ends of the record that are larger than a late displacement explains."""
        size, beside = len(self.v), 4 * _NEAR
        usual = float(np.abs(np.diff(self.v[_WIDEST:-_WIDEST])).max())
        v, y = (np.pad(signal, beside, "reflect") for signal in (self.v, self.y))
        found = self._replace(v=v, y=y, least=self.least + _STEPS_AT_END * usual, steep=_STEEP_AT_END).inner()
        within = [(max(a - beside, 0), min(b - beside, size)) for a, b in found]
        return [(a, b) for a, b in within if a == 0 < b or a < b == size]


def _from_chord(values: Array, before: Indices, width: int, beside: int = 0) -> Array:
    """Return deviations (k, width) of samples after `before` from a chord over them and `beside` more on each side."""
    last, span = len(values) - 1, width + 1 + 2 * beside
    # This does what `numpy.clip` does, in a third of the time.
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
