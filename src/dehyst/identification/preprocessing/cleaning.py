"""What is put right before a fit, and said: a start-up transient, gaps, the delay, datums and drifts of records."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise

import numpy as np

from dehyst._types import Array
from dehyst.records import Record
from dehyst.records.glitches import Glitch, glitch_sentences, glitches

_BINS = 64
# Displacements in a hole that lie beyond those beside it by this part of the stroke show a reversal.
_TURN = 0.02


def remove_glitches(record: Record) -> tuple[Record, Mapping[float, bool], tuple[str, ...]]:
    """Leave out the samples of isolated voltage glitches, see `dehyst.records.glitches`.

    Returns
    -------
    Record
        The same object if there are none.
    Mapping
        Time [s] of the sample before each hole -> whether a reversal may lie in it, by the displacements left out.
    tuple of str
        A sentence for each glitch, of many glitches for some.
    """
    found = glitches(record.time, record.voltage, record.displacement)
    if not found:
        return record, {}, ()
    keep = np.ones(len(record), dtype=bool)
    for one in found:
        keep[one.start : one.stop] = False
    kept = replace(record, time=record.time[keep], voltage=record.voltage[keep], displacement=record.displacement[keep])
    holes = dict(_hole(record, one) for one in found if len(one.neighbours) == 2)
    return kept, holes, tuple(f"{record.name}: {said}" for said in glitch_sentences(found))


def _hole(record: Record, glitch: Glitch) -> tuple[float, bool]:
    """Time of the sample before, and whether the displacement turns back within a glitch."""
    before, after = glitch.start - 1, glitch.stop
    ends = sorted(record.displacement[[before, after]].tolist())
    inside = record.displacement[glitch.start : glitch.stop]
    beyond = max(ends[0] - float(inside.min()), float(inside.max()) - ends[1])
    long = record.time[after] - record.time[before] > 1.5 * (after - before) * record.sample_time
    hidden = bool(long) or beyond > max(_TURN * record.stroke, 6 * record.noise)
    return float(record.time[before]), hidden


def transient(record: Record) -> int:
    """Samples at the start of a record that lie outside the loops that follow, 0 if none.

    The first cycle (at most) is compared with the band of displacements that later cycles cover at the same voltage,
    widened by 1.5 % of the stroke or 4 standard deviations of the noise; later cycles must go as far. The transient
    begins with the record and ends where a twentieth of a cycle lies inside. A first rise from an unknown state is left
    out with it: no state is known there.
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
    return int(ends[calm[0]]) + 1


def split_at_gaps(record: Record, holes: Mapping[float, bool] | None = None) -> tuple[list[Record], list[str]]:
    """Cut a record where a gap may hide a reversal; shorter gaps stay, for the model has no time. With sentences.

    Parameters
    ----------
    record : Record
    holes : Mapping, optional
        Of glitches that were left out, see `remove_glitches`: what lies in them was measured.
    """
    cuts, said = [0], []
    cycle, known = cycle_time(record), holes or {}
    for i, length in record.gaps():
        jump = abs(float(record.voltage[i + 1] - record.voltage[i]))
        hidden = known.get(float(record.time[i]))
        if hidden is False:
            continue
        hidden = hidden or length > 0.2 * cycle or jump > 0.05 * float(np.ptp(record.voltage))
        where = f"{record.name}: a gap of {length:.4g} s after {record.time[i]:.4g} s"
        if hidden:
            cuts.append(i + 1)
            said.append(f"{where} may hide a reversal; the record was cut there.")
        else:
            said.append(f"{where} was bridged.")
    if len(said) > 5:
        said = [*said[:4], f"{record.name}: {len(said) - 4} more gaps, {len(cuts) - 1} cuts in all."]
    cuts.append(len(record))
    return [record.slice(a, b) for a, b in pairwise(cuts) if b - a >= 20], said


def cycle_time(record: Record) -> float:
    """Median time of a cycle of the excitation [s]; the record's length if it has none."""
    cycles = record.cycles()
    ends = [float(record.time[min(c.stop, len(record) - 1)] - record.time[c.start]) for c in cycles]
    return float(np.median(ends)) if ends else float(record.time[-1] - record.time[0])


def drift_curve(record: Record, start: float) -> Array:
    """Creep since the record's start: log10 of time, mean zero (n,)."""
    scale = 0.1 * cycle_time(record)
    curve = np.log10(1 + (record.time - start) / scale)
    return np.asarray(curve - curve.mean())
