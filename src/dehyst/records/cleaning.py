"""Cleaning of a record: what a fit leaves out, each with one sentence.

Glitches of the voltage and spikes of the displacement are excursions that the other signal does not have, see
`dehyst.records.glitches`. With hysteresis alone, the displacement turns back only where the voltage does. After a step
of the voltage it turns back by itself if a mass swings or an amplifier overshoots: such a transient is real, but no
model without inertia follows it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from math import isfinite, log, pi, sqrt
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from dehyst._text import counted
from dehyst._types import Array, Mask
from dehyst.records.glitches import Glitch, glitches, spikes
from dehyst.records.signals import new_samples, noise_span, runs, turning_points, white_noise

if TYPE_CHECKING:
    from collections.abc import Sequence

    from dehyst.records.record import Record

# Most samples of a step, neighbours on each side that show the drive, and how often it exceeds their steps.
_WIDEST, _NEAR, _TIMES = 8, 8, 8.0
# Least step as a part of the voltage's range, least part of it in a sample, and standard deviations of its noise.
_LEAST, _PART, _SIGMAS = 0.02, 0.05, 8.0
# Least motion against the voltage, as parts of the displacement's step and range.
_SWING, _VISIBLE = 0.02, 0.002
# Times the mean gain by which a displacement may follow the voltage away from a turn.
_STEEP = 3.0
# Samples after a step in which it must turn back, and samples that are searched at a time.
_SOON, _AHEAD = 400, 4096
# Latest next turn of a ring, in usual half periods, which the first ones may exceed.
_LATE = 2.5
# A ring counts until it is below this share of the range, or the noise; at most this multiple of its visible part.
_FADED, _LONGEST = 5e-4, 3.0
# Half-lives until an overshoot that does not swing is over.
_HALVES = 8
# Displacements from which the levels beside a transient are taken.
_LEVEL = 8
# Most glitches or transients that are named one by one, and fewest new samples a cycle.
_SHOWN, FEWEST_NEW = 5, 12


class Cleaned(NamedTuple):
    """A record without its glitches, transients, spikes and repeated samples.

    `record`: the same object if there are none. `glitches`, `transients`, `spikes`: what was left out; the spikes as
    samples of the record without glitches. `sentences`: one for each glitch and transient, of many for some, and one on
    the spikes and on the repeated samples.
    """

    record: Record
    glitches: tuple[Glitch, ...]
    transients: tuple[Transient, ...]
    spikes: Mask
    sentences: tuple[str, ...]


def cleaned(record: Record, *, ringing: bool = False) -> Cleaned:
    """Leave glitches of the voltage out, and samples that repeat; set transients aside, put lines in place of spikes.

    The displacement in transients is replaced by a path that follows the voltage, unless `ringing`. Known positions
    are no sensor's: a record of events stays as it is.
    """
    if record.measured is not None:
        return Cleaned(record, (), (), np.zeros(len(record), dtype=bool), ())
    stray = glitches(record.time, record.voltage, record.displacement)
    if stray:
        keep = np.ones(len(record), dtype=bool)
        for glitch in stray:
            keep[glitch.start : glitch.stop] = False
        record = record.take(keep)
    found = transients(record)
    sentences = [*_shortened(stray, "voltage glitches"), *_shortened(found, "steps after which it swings")]
    if found:
        aside = tuple((float(record.time[one.start]), float(record.time[one.stop - 1])) for one in found)
        path = record.displacement if ringing else settled(record, found)
        record = replace(record, displacement=path, set_aside=(*record.set_aside, *aside))
    bad = spikes(record.voltage, record.displacement)
    if record.counted is not None:
        bad &= record.counted
    if bad.any():
        y, places = record.displacement, runs(bad)
        straight = np.where(bad, np.interp(record.time, record.time[~bad], y[~bad]), y)
        sentences.append(
            f"{counted(len(places), 'spike')} of the displacement, the first at {record.time[places[0][0]]:.6g} s, up "
            f"to {1e6 * np.abs(y - straight).max():.4g} um, which no voltage explains: replaced by straight lines."
        )
        record = replace(record, displacement=straight)
    new = new_samples(record.voltage, record.displacement)
    if new is not None and np.count_nonzero(new) >= FEWEST_NEW * max(len(record.cycles()), 2):
        rate = np.count_nonzero(new) / float(np.ptp(record.time))
        sentences.append(
            f"the displacement is new only at every {round(1 / float(new.mean()))}th sample ({rate:.3g} Hz): those "
            "that repeat it are left out."
        )
        record = record.take(new)
    return Cleaned(record, stray, found, bad, tuple(sentences))


def _shortened(items: Sequence[Glitch | Transient], name: str) -> list[str]:
    """Return the sentences of all items; beyond five, those of four and how many more there are."""
    shown = items if len(items) <= _SHOWN else items[: _SHOWN - 1]
    more = len(items) - len(shown)
    return [item.sentence for item in shown] + [f"{more} more {name}: left out."] * bool(more)


@dataclass(frozen=True)
class Transient:
    """A step of the voltage, and the ringing or overshoot of the displacement after it.

    Samples `start` to `stop` - 1 of a record, counted from 0: the first one is the last before the step. `jump`: first
    sample after the step. `time`: time of the step [s]. `duration`: time until the ringing is over [s]. `voltages`:
    voltages before and after the step [V]. `frequency` [Hz] and `damping` (of critical) of the ring; 0 if it overshoots
    once.
    """

    start: int
    jump: int
    stop: int
    time: float
    duration: float
    voltages: tuple[float, float]
    frequency: float = 0.0
    damping: float = 0.0

    @property
    def sentence(self) -> str:
        """A description with step, time and duration."""
        rings = f"rings at {self.frequency:.3g} Hz, damping {self.damping:.2g}," if self.frequency else "overshoots"
        step = f"step to {self.voltages[1]:.4g} V at {self.time:.4g} s"
        return f"{step} {rings} for {1e3 * self.duration:.3g} ms; these {self.stop - self.start} samples are set aside."


def voltage_steps(voltage: Array) -> list[tuple[int, int]]:
    """Return the last sample before and the first one after each step of a voltage (n,) [V].

    A step takes few samples, and is large compared with the range, the noise and neighbouring changes.
    """
    change, span = np.abs(np.diff(voltage)), float(np.ptp(voltage))
    noise = _SIGMAS * white_noise(voltage)
    fast = change > max(_PART * _LEAST * span, noise)
    if not span or not fast.any():
        return []
    steps = []
    for start, stop in runs(fast):
        if stop - start > _WIDEST:
            continue
        height = abs(float(voltage[stop] - voltage[start]))
        beside = np.concatenate([change[max(start - _NEAR, 0) : start], change[stop : stop + _NEAR]])
        if height > max(_LEAST * span, noise, _TIMES * float(beside.max(initial=0.0))):
            steps.append((start, stop))
    return steps


def transients(record: Record) -> tuple[Transient, ...]:
    """Find the steps of the voltage after which the displacement rings or overshoots, in order.

    Transients that were already replaced are not found again.
    """
    steps, counted = voltage_steps(record.voltage), record.counted
    if counted is not None:
        steps = [(start, jump) for start, jump in steps if counted[start]]
    ends = [*(start for start, _ in steps), len(record)][1:]
    found = [_after(record, start, jump, end) for (start, jump), end in zip(steps, ends, strict=False)]
    return tuple(one for one in found if one is not None)


def settled(record: Record, found: tuple[Transient, ...]) -> Array:
    """Return the displacement (n,) [m] with each transient replaced by a path that follows the voltage.

    Ringing after the hysteresis does not affect it, so the path follows the voltage from one level to the other.
    """
    v, y = record.voltage, record.displacement.copy()
    gain = float(np.ptp(record.displacement)) / max(float(np.ptp(v)), 1e-300)
    for one in found:
        before = slice(max(one.start + 1 - _LEVEL, 0), one.start + 1)
        low = float(np.mean(y[before] - gain * (v[before] - v[one.start])))
        after = slice(one.stop, min(one.stop + _LEVEL, len(record)))
        if after.start >= after.stop:
            after = slice(max(one.stop - 2 * _LEVEL, one.jump), one.stop)
        last = min(one.stop, len(record) - 1)
        end = float(np.mean(y[after] - gain * (v[after] - v[last])))
        high = end - gain * float(v[last] - v[one.jump])
        way = (v[one.start : one.jump + 1] - v[one.start]) / (v[one.jump] - v[one.start])
        y[one.start : one.jump + 1] = low + (high - low) * way
        y[one.jump : one.stop] = np.linspace(high, end, last - one.jump + 1)[: one.stop - one.jump]
    y.flags.writeable = False
    return y


def _after(record: Record, start: int, jump: int, end: int) -> Transient | None:
    """Return the transient after a step, before sample `end`; None if the displacement follows the voltage."""
    window = slice(start, min(jump + _AHEAD, end))
    v, y = record.voltage[window], record.displacement[window]
    if y.size < _LEVEL:
        return None
    noise = white_noise(record.displacement)
    height, stroke = float(np.ptp(y[: _SOON + jump - start])), record.stroke
    least = max(_SWING * height, _VISIBLE * stroke, noise_span(y) if noise else 0.0)
    gain = stroke / float(np.ptp(record.voltage))
    turns = _own_turns(v, y, jump - start, least, gain)
    if not turns or turns[0] > _SOON + jump - start:
        return None
    step, at = record.sample_time, turns[-1]
    frequency = damping = 0.0
    if len(turns) >= 3:
        half = (turns[-1] - turns[0]) / (len(turns) - 1)
        swings = np.abs(np.diff(y[turns]))
        # The size falls by the same factor each half period.
        fall = -float(np.polyfit(np.arange(swings.size), np.log(swings), 1)[0]) if swings.size > 1 else log(2)
        fall = fall if isfinite(fall) and fall > 0 else 0.0
        frequency, damping = 0.5 / (half * step), fall / sqrt(pi**2 + fall**2)
        left = log(max(0.5 * float(swings[-1]) / max(_FADED * stroke, noise), 1.0))
        over = at + half * min(2 + left / max(fall, 1e-3), _LONGEST * len(turns))
    else:
        over = at + _HALVES * _half_life(y - gain * v, at)
    stop = min(start + int(over) + 1, end)
    volts = float(record.voltage[start]), float(record.voltage[jump])
    began = float(record.time[jump])
    duration = float(record.time[min(stop, len(record)) - 1]) - began
    return Transient(start, jump, stop, began, duration, volts, frequency, damping)


def _own_turns(v: Array, y: Array, jump: int, least: float, gain: float) -> list[int]:
    """Return the turns of the displacement after a step that the voltage does not have, while they follow closely."""
    turns = [int(one) for one in turning_points(y, least) if one >= jump]
    own: list[int] = []
    for last, one in pairwise([jump, *turns]):
        half = float(np.median(np.diff(own))) if len(own) > 1 else float("inf")
        if one - last > _LATE * max(half, 2):
            break
        # The displacement must leave the turn by far more than the voltage explains, over some of the samples.
        away, moved = (np.maximum.accumulate(np.abs(signal[one:] - signal[one])) for signal in (y, v))
        if not np.any((away > least) & (away > _STEEP * gain * moved)):
            break
        own.append(one)
    return own


def _half_life(y: Array, first: int) -> int:
    """Return the samples in which half of an overshoot (n,) is gone; its peak is sample `first`."""
    rest = y[first : first + _SOON]
    away = np.abs(rest - np.median(rest[rest.size // 2 :]))
    return int(np.argmax(away < 0.5 * away[0])) + 1 if away[0] else 1
