"""Cleaning of records before a fit: rest, start-up transients, gaps, drift, noise and the motion of the mass."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array
from dehyst.identification.rules import RULES
from dehyst.model import Dynamics
from dehyst.records import Record, cleaned, counting, gaps, noise_span, reversals, turning_points, usable, white_noise

_BINS = 64
# Displacements in a hole show a reversal if they exceed the displacements at its ends by this part of the stroke.
_TURN = 0.02
# Least rate of the voltage on both sides of a gap, as a part of its mean rate in the gap, that excludes a reversal.
_ALIKE = 0.5
# A gap loses no part of a path if it is shorter than this [cycles] and the voltage moves by fewer median steps in it.
_BRIEF, _STEP = 0.02, 1.5
# A voltage rests within this part of its range; this number of samples of a rest is kept. Shorter rests [cycles] stay.
_STILL, _KEPT, _LEAST_REST = 2e-3, 20, 0.5
# Displacements at rest that move by less than this part of the stroke show no creep.
_FLAT = 1e-3


def clean(record: Record, *, ringing: bool = False) -> tuple[Record, Mapping[float, bool], tuple[str, ...]]:
    """Return a record without the samples that `dehyst.records.cleaning` leaves out, its holes, and sentences.

    `ringing`: whether the displacement stays in the transients that are left out. The holes map the time [s] of the
    sample before each hole to whether the displacements left out show a reversal in it.
    """
    found = cleaned(record, ringing=ringing)
    holes = dict(_hole(record, start - 1, stop) for start, stop in found.glitches if start and stop < len(record))
    return found.record, holes, tuple(f"{record.name}: {sentence}" for sentence in found.sentences)


def rest_at_ends(record: Record) -> tuple[int, int]:
    """Return the first and one after the last sample of a record without the rest before and after its motion.

    Rest at the end is kept if the displacement moves in it: it shows creep. A rest shorter than half a cycle is kept.
    """
    v, y, size = record.voltage, record.displacement, len(record)
    still = max(_STILL * float(np.ptp(v)), noise_span(v))
    begin, end = (_leading(values, still) for values in (v, v[::-1]))
    if begin + end >= size - _KEPT:
        return 0, size
    start, stop = max(begin - _KEPT, 0), size - max(end - _KEPT, 0)
    least = _LEAST_REST * cycle_time(record[start:stop])
    if record.time[start] - record.time[0] < least:
        start = 0
    counted = counting(record)
    rest = y[stop:] if counted is None else y[stop:][counted[stop:]]
    if record.time[-1] - record.time[stop - 1] < least or _creeps(rest, record):
        stop = size
    if record.set_aside:
        # The step at either end of a rest belongs to the rest.
        aside = np.flatnonzero(~usable(record))
        start = _beyond(aside, start) if start else start
        stop = size - _beyond(size - 1 - aside[::-1], size - stop) if stop < size else stop
    return start, stop


def _beyond(aside: NDArray[np.intp], start: int) -> int:
    """Return the sample after a run of samples that begins soon after `start`; without such a run, `start`."""
    first = int(np.searchsorted(aside, start))
    if first == aside.size or aside[first] > start + 2 * _KEPT:
        return start
    run = aside[first:] - np.arange(aside.size - first)
    return int(aside[first:][run == run[0]][-1]) + 1


def without_way_out(record: Record) -> tuple[Record, tuple[str, ...]]:
    """Leave out the samples before the first turn of the voltage if a record begins while ringing decays; say so.

    Ringing can leave hysteresis in a state that no voltage leads to; the loops after the first turn forget it.
    """
    turn = int(np.append(reversals(record), 0)[0])
    begin, end = float(record.time[0]), float(record.time[turn])
    sentence = (
        f"{record.name}: from {begin:.4g} to {end:.4g} s, up to the first turn of the voltage, the state depends on "
        f"earlier ringing; these {turn} samples are left out."
    )
    return replace(record, set_aside=(*record.set_aside, (begin, end))), (sentence,) if turn else ()


def _leading(values: Array, still: float) -> int:
    """Return the number of samples before the first one that differs from the first samples."""
    moved = np.abs(values - np.median(values[:_KEPT])) > still
    return int(np.argmax(moved)) if moved.any() else values.size


def _creeps(y: Array, record: Record) -> bool:
    """Whether displacements (n,) at a constant voltage move by more than noise."""
    quarter = len(y) // 4
    if not quarter:
        return False
    moved = abs(float(y[-quarter:].mean() - y[:quarter].mean()))
    return bool(moved > max(_FLAT * record.stroke, 6 * record.noise * (2 / quarter) ** 0.5))


def _hole(record: Record, before: int, after: int) -> tuple[float, bool]:
    """Return the time of the sample before a hole, and whether the displacement may reverse in it."""
    ends = sorted(record.displacement[[before, after]].tolist())
    inside = record.displacement[before + 1 : after]
    beyond = max(ends[0] - float(inside.min()), float(inside.max()) - ends[1])
    long = record.time[after] - record.time[before] > 1.5 * (after - before) * record.sample_time
    hidden = bool(long) or beyond > max(_TURN * record.stroke, 6 * record.noise)
    return float(record.time[before]), hidden


def transient(record: Record) -> int:
    """Count the samples at the start of a record that lie outside the loops that follow.

    The first cycle (at most) is compared with the band of displacements that later cycles cover at the same voltage,
    widened by 1.5 % of the stroke or 4 standard deviations of the noise; later cycles must be as wide. The transient
    begins with the record and ends where a twentieth of a cycle lies inside. It includes a first rise from an unknown
    state.
    """
    cycles = record.cycles()
    if len(cycles) < 3:
        return 0
    begin = cycles[0].stop
    v, y = record.voltage, record.displacement
    tolerance = 0.02 * float(np.ptp(v))
    if v[begin:].max() < v.max() - tolerance or v[begin:].min() > v.min() + tolerance:
        return 0
    edges = np.linspace(v[begin:].min(), v[begin:].max(), _BINS + 1)
    bins = np.clip(np.searchsorted(edges, v) - 1, 0, _BINS - 1)
    low, high = np.full(_BINS, np.inf), np.full(_BINS, -np.inf)
    np.minimum.at(low, bins[begin:], y[begin:])
    np.maximum.at(high, bins[begin:], y[begin:])
    margin = max(0.015 * float(np.ptp(y[begin:])), 4 * record.noise)
    early = slice(0, begin)
    outside = (y[early] < low[bins[early]] - margin) | (y[early] > high[bins[early]] + margin)
    ends = np.concatenate([[-1], np.flatnonzero(outside), [begin + begin]])
    calm = np.flatnonzero(np.diff(ends) > max(5, begin // 20))
    return int(ends[calm[0]]) + 1 if calm.size else 0


def split_at_gaps(record: Record, holes: Mapping[float, bool] | None = None) -> tuple[list[Record], list[str]]:
    """Cut a record where a gap may hide a reversal; return the pieces, and a sentence for each gap.

    Maxwell-slip does not depend on time, so that other gaps stay. Brief gaps in which the voltage hardly moved, such as
    between two repetitions of a wave, get no sentence. `holes`: holes from `clean`, with known displacements.
    """
    cuts, sentences = [0], []
    cycle, known_holes = cycle_time(record), holes or {}
    step = _STEP * float(np.median(np.abs(np.diff(record.voltage))))
    for i, length in gaps(record.time):
        # Steps of one length in a row are a slower rate.
        beside = np.diff(record.time[max(i - 1, 0) : i + 3])
        jump = abs(float(record.voltage[i + 1] - record.voltage[i]))
        hidden = known_holes.get(float(record.time[i]))
        if hidden is False:
            continue
        far = jump > 0.05 * float(np.ptp(record.voltage)) and not _goes_on(record, i, length)
        hidden = hidden or length > 0.2 * cycle or far
        where = f"{record.name}: a gap of {length:.4g} s after {record.time[i]:.4g} s"
        if hidden:
            cuts.append(i + 1)
            sentences.append(f"{where} may hide a reversal; the record was cut there.")
        elif (jump > step or length > _BRIEF * cycle) and np.sum(np.isclose(beside, length, rtol=1e-3)) < 2:
            sentences.append(f"{where} was bridged.")
    if len(sentences) > 5:
        sentences = [*sentences[:4], f"{record.name}: {len(sentences) - 4} more gaps, {len(cuts) - 1} cuts in all."]
    cuts.append(len(record))
    return [record[a:b] for a, b in pairwise(cuts) if b - a >= 20], sentences


def _goes_on(record: Record, i: int, length: float) -> bool:
    """Whether the voltage moves through the gap of this length [s] after sample i like before and after the gap."""
    if not 0 < i < len(record) - 2:
        return False
    rate = (record.voltage[i + 1] - record.voltage[i]) / length
    before, after = (
        (record.voltage[k + 1] - record.voltage[k]) / (record.time[k + 1] - record.time[k]) for k in (i - 1, i + 1)
    )
    return bool(_ALIKE * abs(rate) < min(before * np.sign(rate), after * np.sign(rate)))


def cycle_time(record: Record) -> float:
    """Return the median duration of a cycle of the excitation [s]; the record's duration if it has none."""
    cycles = record.cycles()
    ends = [float(record.time[min(c.stop, len(record) - 1)] - record.time[c.start]) for c in cycles]
    return float(np.median(ends)) if ends else float(record.time[-1] - record.time[0])


# Noise below this part of the range has no effect on elements.
_QUIET = 3e-4
# Derivatives come from a polynomial of this order through this number of neighbours.
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
    y, step = piece.displacement, piece.sample_time
    return local_polynomials(y, _WINDOW, _ORDER, 1, step), local_polynomials(y, _WINDOW, _ORDER, 2, step)


def local_polynomials(y: Array, window: int, order: int, derivative: int = 0, step: float = 1.0) -> Array:
    """Return y (n,), or a derivative, by a polynomial through the neighbours of each sample (Savitzky and Golay).

    `window`: an odd number of samples, n at most. The first and the last polynomial continue to the ends.
    """
    # The import of SciPy's filter takes longer than most identifications.
    half = window // 2
    values = np.vander(np.arange(-half, half + 1) / half, order + 1, increasing=True)
    fit = np.linalg.pinv(values)
    for _ in range(derivative):
        values = np.pad(values[:, :-1] * np.arange(1, order + 1), ((0, 0), (1, 0))) / (half * step)
    inside = np.convolve(y, (values[half] @ fit)[::-1], "valid")
    return np.concatenate([values[:half] @ (fit @ y[:window]), inside, values[half + 1 :] @ (fit @ y[-window:])])


# Least turn of the voltage as a part of its range, if above its noise; a hold moves by less than a tenth of this turn
# in this number of samples.
_LEAST_TURN = 2e-3
_HOLD = 8
# Window of a parabola: a cycle over this number; its largest number of samples.
_PART_OF_CYCLE, _WIDEST = 16, 12


def disturbs(noise: float, stroke: float) -> bool:
    """Whether the noise of a sensor [m] biases Maxwell-slip elements; `stroke`: range of the widest loop [m]."""
    return noise > RULES.loud * stroke


def remove_jitter(piece: Record, noise: float, stroke: float) -> Record:
    """Return a piece with a displacement that noise does not reverse: monotone on each branch.

    `piece`: piece without delay. `noise`: standard deviation of the sensor [m]. `stroke`: range of the widest loop [m].
    Significant noise is first smoothed by parabolas over a part of a cycle. For loud noise the parts are wider, and
    each branch is smoothed alone: otherwise the noise would move turns beyond the reach of the actuator.
    """
    part = int(cycle_time(piece) / piece.sample_time / _PART_OF_CYCLE)
    if disturbs(noise, stroke):
        return _between_turns(piece, 2 * (part // 2) + 1)
    window = 2 * (min(part, _WIDEST) // 2) + 1 if noise > _QUIET * stroke else 1
    y = piece.displacement.copy()
    for start, stop in _stretches(piece):
        if 5 <= window <= stop - start:
            y[start:stop] = local_polynomials(y[start:stop], window, 2)
    return monotone(replace(piece, displacement=y))


def _between_turns(piece: Record, window: int) -> Record:
    """Return a piece whose displacement is smooth and monotone from turn to turn.

    An error at a turn stays in the elements for the whole branch after it. Therefore a turn is the mean of the values
    of both branches, and samples beyond the turns, as at the ends of a monotone fit to noise, are clipped.
    """
    y, branches = piece.displacement.copy(), _counted_branches(piece)
    sums, counts = np.zeros(y.size), np.zeros(y.size)
    for start, stop, _ in branches:
        # The turn is the first sample of the next branch.
        own = slice(start, min(stop + 1, y.size))
        values = piece.displacement[own]
        width = min(window, 2 * ((values.size - 1) // 2) + 1)
        sums[own] += local_polynomials(values, width, 2) if width >= 5 else values
        counts[own] += 1
    smooth = np.divide(sums, counts, out=y, where=counts > 0)
    path = monotone(replace(piece, displacement=smooth)).displacement.copy()
    for start, stop, _ in branches:
        ends = smooth[[start, min(stop, y.size - 1)]]
        path[start:stop] = np.clip(path[start:stop], ends.min(), ends.max())
    path.flags.writeable = False
    return replace(piece, displacement=path)


def _counted_branches(piece: Record) -> list[tuple[int, int, bool | None]]:
    """Return the branches of `_branches` within the samples that count."""
    parts = (
        (max(a, start), min(b, stop), rising) for a, b, rising in _branches(piece) for start, stop in _stretches(piece)
    )
    return [(start, stop, rising) for start, stop, rising in parts if start < stop]


def _stretches(piece: Record) -> list[tuple[int, int]]:
    """Return the first and one after the last sample of each run of samples that count."""
    if (counted := counting(piece)) is None:
        return [(0, len(piece))]
    edges = np.flatnonzero(np.diff(np.concatenate([[0], counted.astype(np.int8), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def monotone(piece: Record) -> Record:
    """Return a piece whose displacement moves in the direction of its voltage, by least squares.

    While the voltage is held, the displacement moves in one direction, like creep. The delay must be removed before.
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
    least = max(_LEAST_TURN * float(np.ptp(v)), 6 * white_noise(v))
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
    # The range of a window decides, because its ends are equal at a turn; motion within the noise does not count.
    still_range = max(0.1 * least, 6 * white_noise(v))
    windows = np.lib.stride_tricks.sliding_window_view(v, _HOLD + 1)
    ahead = np.ptp(windows, axis=1) < still_range
    still = np.concatenate([ahead, np.full(_HOLD, ahead[-1])]) | np.concatenate([np.full(_HOLD, ahead[0]), ahead])
    return np.flatnonzero(still[1:] != still[:-1]) + 1
