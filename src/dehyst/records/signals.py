"""Sampled signals: errors between them, noise, turning points, resolution, interpolation and slew rate."""

from __future__ import annotations

from collections.abc import Iterable
from math import comb, erf, log, sqrt
from typing import TYPE_CHECKING

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray

from dehyst._types import Array, Mask

if TYPE_CHECKING:
    from dehyst.records.record import Record

# Largest value of white noise, in standard deviations.
NOISE_PEAK = 4.0
# Widths of running means. How noise raises a largest error: steps per deviation, number of steps, probability.
_WIDTHS, _FINE, _LEVELS, _PROBABILITY = (1, 4, 16, 64, 256), 8, 64, 0.9
# A sine of 50 points a cycle leaves 7e-8 of its stroke in differences of order 6, and 3e-3 in those of order 2.
_ORDER = 6
# Number and length of the stretches from which the noise of a long signal is estimated; rows that `sensor_noise` reads.
_STRETCHES, _STRETCH, _ROWS = 16, 1 << 14, 1 << 17
# Quartile of normal noise, in standard deviations.
QUARTILE = 0.6744897501960817
# The noise is also estimated by the sample times if time steps vary by this part, or the voltage turns more often than
# once in this number of samples; fewest windows for that; the second estimate counts if it is smaller by this factor.
_UNEVEN, _TURN_SAMPLES, _WINDOWS, _NOISE_RATIO = 0.01, 25, 16, 1.5
# A repeated signal: largest part of new samples, and least motion of the displacement, in digits.
_NEW, _DIGITS = 0.75, 3.0


def largest(error: ArrayLike) -> float:
    """Return the largest absolute error; 0 without errors."""
    return float(np.abs(error).max(initial=0.0))


def rms(error: ArrayLike) -> float:
    """Return the root mean square error; 0 without errors."""
    return float(np.sqrt(np.mean(np.square(error, dtype=np.float64)))) if np.size(error) else 0.0


def beyond_noise(error: Array, noise: float) -> tuple[float, float]:
    """Return the largest and the RMS of an error (n,) without what white noise explains; `noise`: its deviation.

    The largest error is less the most that noise adds to it in nine of ten cases, by the error that running means show.
    The RMS error is the largest RMS of these means without their noise.
    """
    if not noise:
        return largest(error), rms(error)
    means = {width: _running_mean(error, width) for width in _WIDTHS if width <= max(error.size, 1)}
    mean = max(max(rms(values) ** 2 - noise**2 / width, 0.0) for width, values in means.items()) ** 0.5
    # A shorter mean counts where noise does not explain how far it is from the longer one.
    bound, shown = noise * (sqrt(2 * log(max(error.size, 2))) + 1), np.zeros(error.size)
    for width in reversed(means):
        shown = np.where(np.abs(means[width] - shown) > bound / sqrt(width), means[width], shown)
    return max(largest(error) - _raised(np.abs(shown), noise), mean), mean


def _running_mean(values: Array, width: int) -> Array:
    """Return means (n,) of values (n,) over `width` samples around each; the end values continue."""
    around = np.pad(values, (width // 2, width - 1 - width // 2), mode="edge")
    sums = np.append(0.0, np.cumsum(around, dtype=np.float64))
    return np.asarray((sums[width:] - sums[:-width]) / width)


def _raised(sizes: Array, noise: float) -> float:
    """Return the most by which white noise of this deviation raises the largest of sizes (n,) in nine of ten cases."""
    most = float(sizes.max(initial=0.0))
    below = (_FINE * (most - sizes) / noise).astype(np.int64)
    counts, steps = np.bincount(below[below < _LEVELS], minlength=_LEVELS), np.arange(_LEVELS) / _FINE
    # The probability that a sample stays within a level this number of steps above the largest size.
    apart, across = steps[:, None] + steps, 2 * most / noise + steps[:, None] - steps
    all_stay = np.log((_normal(apart) + _normal(across) - 1).clip(1e-300)) @ counts
    return noise * float(np.interp(log(_PROBABILITY), all_stay, steps))


def _normal(values: Array) -> Array:
    """Return the probabilities (...) of white noise of deviation 1 below values (...)."""
    return np.asarray(np.vectorize(erf, otypes=[float])(values / sqrt(2)) / 2 + 0.5)


def percent(error: float, stroke: float) -> float:
    """Return an error in % of the stroke."""
    return 100 * error / stroke


def white_noise(values: Array) -> float:
    """Estimate the white noise on a smooth even signal (n,), by its differences of order 6; 0 below 8 samples."""
    if len(values) < _ORDER + 2:
        return 0.0
    if len(values) > _STRETCHES * _STRETCH:
        values = sliding_window_view(values, _STRETCH)[:: len(values) // _STRETCHES]
    return float(np.median(np.abs(np.diff(values, _ORDER)))) / QUARTILE / sqrt(comb(2 * _ORDER, _ORDER))


def sensor_noise(time: Array, voltage: Array, displacement: Array, known: Mask | None = None) -> float:
    """Estimate the white noise of a displacement (n,) as `white_noise` does, or by the sample times.

    The second estimate counts for events (`known`), or if it is far smaller (uneven steps, repeated or few samples): it
    is the distance of new samples from the cubic through two neighbours on each side, where the voltage does not turn.
    """
    noise, steps = 0.0 if known is not None else white_noise(displacement), np.diff(time[:_ROWS])
    new = new_samples(voltage, displacement) if known is None else known
    turns = np.count_nonzero(np.diff(np.sign(np.diff(voltage[:_ROWS]))))
    if new is None and np.std(steps) < _UNEVEN * np.median(steps) and turns < steps.size / _TURN_SAMPLES:
        return noise
    rows = np.arange(displacement.size)[slice(None) if new is None else new][:_ROWS]
    if rows.size < 5:
        return noise
    clock = time if known is None else voltage
    t, v, y = (sliding_window_view(signal[rows], 5) for signal in (clock, voltage, displacement))
    straight = np.abs(np.sign(np.diff(v, axis=1)).sum(axis=1)) == 4
    if np.count_nonzero(straight) < _WINDOWS:
        return noise
    t, y, beside = t[straight], y[straight], [0, 1, 3, 4]
    # Lagrange's weights of the neighbours.
    weights = [np.prod([(t[:, 2] - t[:, k]) / (t[:, j] - t[:, k]) for k in beside if k != j], axis=0) for j in beside]
    away = y[:, 2] - sum(weight * y[:, j] for weight, j in zip(weights, beside, strict=True))
    found = float(np.median(np.abs(away) / np.sqrt(1 + np.square(weights).sum(axis=0)))) / QUARTILE
    return found if new is not None or _NOISE_RATIO * found < noise else noise


def new_samples(voltage: Array, displacement: Array) -> Mask | None:
    """Return which displacements (n,) are new if others repeat while the voltage moves on; or None."""
    new = np.append(True, np.diff(displacement) != 0.0)
    if np.count_nonzero(new) > _NEW * new.size or np.count_nonzero(new) < _ORDER:
        return None
    first = np.flatnonzero(new)
    last = np.append(first[1:], new.size) - 1
    spans = np.diff(np.unique(displacement))
    digit = float(spans[spans > 1e-9 * spans.sum()].min())
    gain, moved = spans.sum() / max(float(np.ptp(voltage)), 1e-300), np.abs(voltage[last] - voltage[first])
    # If a servo or friction holds the displacement at times, few values repeat.
    if np.count_nonzero(last > first) < 0.5 * first.size:
        return None
    held = moved > noise_span(voltage)
    late = held & (gain * moved > _DIGITS * digit + gain * noise_span(voltage))
    # A dead zone and a clipped sensor repeat values too, but seldom.
    return new if np.count_nonzero(late) > max(_ORDER, 0.5 * np.count_nonzero(held & (last > first))) else None


def noise_span(values: Array) -> float:
    """Return the peak-to-peak range of the white noise on a signal, with some margin; in its unit."""
    # White noise spans 2 sqrt(2 ln n) deviations: a long record exceeds 6 of them repeatedly.
    return max(6.0, 2.2 * sqrt(2.0 * log(len(values)))) * white_noise(values)


def resolution(values: Array) -> tuple[float, float]:
    """Return the smallest step between samples and its share of the range; 0 and 0 unless many samples repeat."""
    steps, span = np.abs(np.diff(values)), float(np.ptp(values))
    moving = steps[steps > 1e-12 * span]
    if not len(moving) or len(moving) > 0.8 * len(steps):
        return 0.0, 0.0
    return float(moving.min()), float(moving.min()) / span


def interpolate(x: Array, y: Array, places: Array) -> Array:
    """Return the signal y(x) at places (m,), with the shape of its samples (PCHIP)."""
    from scipy.interpolate import PchipInterpolator

    return np.asarray(PchipInterpolator(x, y)(places), dtype=np.float64)


def runs(mask: Mask) -> list[tuple[int, int]]:
    """Return the first index, and the index after the last one, of each run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def turning_points(values: Array, band: float) -> NDArray[np.intp]:
    """Find the extremes from which the signal goes back by more than `band`, see `dehyst.records.reversals`."""
    # Only inner local extremes and ends of plateaus can be turning points, or complete a way back.
    steps = np.sign(np.diff(values))
    kept = np.concatenate(([0], np.flatnonzero(steps[:-1] != steps[1:]) + 1, [len(values) - 1]))
    turns: list[int] = []
    low = high = float(values[0])
    at_low = at_high = direction = 0
    for i, level in enumerate(values[kept].tolist()):
        if level >= high and direction >= 0:
            high, at_high = level, i
        if level <= low and direction <= 0:
            low, at_low = level, i
        if direction >= 0 and high - level > band:
            if direction:
                turns.append(at_high)
            direction, low, at_low = -1, level, i
        elif direction <= 0 and level - low > band:
            if direction:
                turns.append(at_low)
            direction, high, at_high = 1, level, i
    return kept[turns]


def turns_of(voltage: Array) -> NDArray[np.intp]:
    """Return the turning points of a voltage, see `dehyst.records.reversals`."""
    return turning_points(voltage, max(0.02 * float(np.ptp(voltage)), noise_span(voltage)))


def gaps(time: Array) -> list[tuple[int, float]]:
    """Return the places of missing samples: index i and time[i + 1] - time[i] [s], if above 1.5 sample times."""
    steps = np.diff(time)
    return [(int(i), float(steps[i])) for i in np.flatnonzero(steps > 1.5 * np.median(steps))]


def bandwidth(signal: Array, sample_time: float, share: float) -> float:
    """Return the frequency [Hz] above which a signal has this share of its AC energy, without white noise."""
    from_line = (signal - np.linspace(signal[0], signal[-1], signal.size)) * np.hanning(signal.size)
    # A transform takes ten times as long if its length has large prime factors.
    unit = 1 << max(signal.size.bit_length() - 7, 0)
    power = np.abs(np.fft.rfft(from_line, size := -(-signal.size // unit) * unit)[1:]) ** 2
    # The power of noise in a line of the spectrum is distributed exponentially: its mean is the median / ln 2.
    power -= float(np.median(power[power.size // 2 :])) / log(2)
    above = np.cumsum(power[::-1])[::-1]
    within = np.flatnonzero(above > share * above[0])
    return float((within[-1] + 1 if within.size else 1) / (size * sample_time))


# A speed is the mean over a window of at least this many intervals, in which the voltage changes by at least this many
# standard deviations of its noise, and steps of its converter.
_INTERVALS, _DEVIATIONS, _CODES = 4, 50.0, 20.0
# Largest part of this change in one interval: a larger one is a step or a glitch, whose speed is not known.
_AT_ONCE = 0.4
# Part of all travel that is not faster than the recorded speed; margin for the averaging in windows.
_TRAVEL, _MARGIN = 0.95, 1.05
# A record with more samples is read in longer intervals.
_MOST = 1 << 18


def recorded_slew_rate(parts: Iterable[tuple[Array, Array]]) -> float | None:
    """Return the largest abs(dv/dt) [V/s] at which voltages were recorded; None if they hold only steps and rests.

    It is the speed that 95 % of the travel does not exceed, plus a margin of 5 %, so that a rare glitch or step has no
    effect. `parts`: time (n,) [s] and voltage (n,) [V] of each record.
    """
    found = [_speeds(time, voltage) for time, voltage in parts]
    if not any(speed.size for speed, _ in found):
        return None
    speed, travel = (np.concatenate(column) for column in zip(*found, strict=True))
    order = np.argsort(speed)
    within = np.searchsorted(np.cumsum(travel[order]), _TRAVEL * float(travel.sum()))
    return _MARGIN * float(speed[order[min(int(within), speed.size - 1)]])


def _speeds(time: Array, voltage: Array) -> tuple[Array, Array]:
    """Return the speeds [V/s] of the shortest windows that show one, and the travel of the voltage a sample [V]."""
    noise = max(_DEVIATIONS * white_noise(voltage), _CODES * resolution(voltage)[0])
    rows = slice(None, None, 1 + voltage.size // _MOST)
    time, voltage = time[rows], voltage[rows]
    steps = np.abs(np.diff(voltage))
    least = max(noise, 1e-9 * float(np.ptp(voltage)))
    # The largest step of each window.
    window, size = _INTERVALS, max(steps.size - _INTERVALS + 1, 0)
    largest = np.max([steps[k : k + size] for k in range(window)], axis=0) if size else np.zeros(0)
    waiting, speeds, travel = np.arange(largest.size), [np.zeros(0)], [np.zeros(0)]
    while waiting.size:
        change = np.abs(voltage[waiting + window] - voltage[waiting])
        shown = (change > least) & (largest[waiting] <= _AT_ONCE * change)
        at = waiting[shown]
        speeds.append(change[shown] / (time[at + window] - time[at]))
        travel.append(change[shown] / window)
        largest = np.maximum(largest[:-window], largest[window:])
        window *= 2
        waiting = waiting[~shown]
        waiting = waiting[waiting < largest.size]
    return np.concatenate(speeds), np.concatenate(travel)


def counting(record: Record) -> Mask | None:
    """Return whether each sample counts in a fit or an error (n,): measured and not left out; None if all do."""
    known = record.measured
    return known if not record.set_aside else usable(record) & (True if known is None else known)


def usable(record: Record) -> Mask:
    """Return whether each sample is outside of the stretches that are left out (n,)."""
    kept = np.ones(len(record), dtype=bool)
    for first, last in record.set_aside:
        kept[np.searchsorted(record.time, first) : np.searchsorted(record.time, last, side="right")] = False
    return kept
