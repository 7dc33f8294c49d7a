"""Cleaning of records before a fit: voltage glitches, start-up transients, gaps and drift."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise

import numpy as np

from dehyst._types import Array
from dehyst.records import Record
from dehyst.records.glitches import Glitch, glitch_sentences, glitches
from dehyst.records.spikes import spikes

_BINS = 64
# Displacements in a hole that exceed those beside it by this part of the stroke show a reversal.
_TURN = 0.02
# Least rate of the voltage beside a gap, as a part of its mean rate in the gap: a reversal in it would be faster.
_ALIKE = 0.5


def remove_glitches(record: Record) -> tuple[Record, Mapping[float, bool], tuple[str, ...]]:
    """Leave out the samples of isolated voltage glitches, see `dehyst.records.glitches`.

    Returns
    -------
    Record
        The same object if there are none.
    Mapping
        Time [s] of the sample before each hole -> whether a reversal may lie in it, by the displacements left out.
    tuple of str
        A sentence for each glitch; of many glitches for some.
    """
    removed = glitches(record.time, record.voltage, record.displacement)
    if not removed:
        return record, {}, ()
    keep = np.ones(len(record), dtype=bool)
    for glitch in removed:
        keep[glitch.start : glitch.stop] = False
    kept = replace(record, time=record.time[keep], voltage=record.voltage[keep], displacement=record.displacement[keep])
    holes = dict(_hole(record, glitch) for glitch in removed if len(glitch.neighbours) == 2)
    return kept, holes, tuple(f"{record.name}: {sentence}" for sentence in glitch_sentences(removed))


def remove_spikes(record: Record) -> tuple[Record, tuple[str, ...]]:
    """Replace spikes of the displacement by straight lines, see `dehyst.records.spikes`.

    Returns
    -------
    Record
        The same object if there are none.
    tuple of str
        A sentence about them.
    """
    bad = spikes(record.voltage, record.displacement)
    if not bad.any():
        return record, ()
    y = record.displacement
    clean = np.where(bad, np.interp(record.time, record.time[~bad], y[~bad]), y)
    largest = float(np.abs(y - clean).max())
    runs = int(np.count_nonzero(np.diff(np.concatenate([[0], bad.astype(np.int8)])) == 1))
    times = f"the first at {record.time[int(np.argmax(bad))]:.6g} s" if runs > 1 else f"at {record.time[bad][0]:.6g} s"
    sentence = (
        f"{record.name}: {runs} spike{'s' * (runs > 1)} of the displacement, {times}, up to {largest * 1e6:.4g} um, "
        "which no voltage explains: replaced by straight lines."
    )
    return replace(record, displacement=clean), (sentence,)


def _hole(record: Record, glitch: Glitch) -> tuple[float, bool]:
    """Return the time of the sample before a glitch, and whether the displacement may reverse in it."""
    before, after = glitch.start - 1, glitch.stop
    ends = sorted(record.displacement[[before, after]].tolist())
    inside = record.displacement[glitch.start : glitch.stop]
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
    """Cut a record where a gap may hide a reversal; other gaps stay, because plain models do not depend on time.

    Parameters
    ----------
    record : Record
    holes : Mapping, optional
        Holes of removed glitches, see `remove_glitches`: displacements in them are known.

    Returns
    -------
    list of Record, list of str
        The pieces, and a sentence for each gap.
    """
    cuts, sentences = [0], []
    cycle, known_holes = cycle_time(record), holes or {}
    for i, length in record.gaps():
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
        else:
            sentences.append(f"{where} was bridged.")
    if len(sentences) > 5:
        sentences = [*sentences[:4], f"{record.name}: {len(sentences) - 4} more gaps, {len(cuts) - 1} cuts in all."]
    cuts.append(len(record))
    return [record.slice(a, b) for a, b in pairwise(cuts) if b - a >= 20], sentences


def _goes_on(record: Record, i: int, length: float) -> bool:
    """Whether the voltage moves through the gap of this length [s] after sample i as it does before and after it."""
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


def drift_curve(record: Record, start: float) -> Array:
    """Return the creep curve since the record's start: log10 of time, mean zero (n,)."""
    scale = 0.1 * cycle_time(record)
    curve = np.log10(1 + (record.time - start) / scale)
    return np.asarray(curve - curve.mean())
