"""Voltages that show the coupling of a stage: its axes one after the other, then together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dehyst._errors import RecordError
from dehyst._types import Array
from dehyst._validation import DEFAULT_AXES, axis_names
from dehyst.waveforms.excitation import Excitation, Sampling
from dehyst.waveforms.standard import descending_tops, homing

# Periods of the axes moving together, in those of the first one: powers of the plastic number repeat never.
RATIO = 1.3247179572447460


def stage_excitation(
    highest: Sequence[float],
    *,
    drive: Sequence[Sampling] | Sampling | None = None,
    steps: int = 10,
    majors: int = 2,
    cycles: int = 12,
    axes: Sequence[str] | None = None,
    seed: int = 0,
) -> Excitation:
    """Return descending tops on each axis in turn, the others at their base, then turns of all axes together.

    Moving together, the axes turn at levels of their own, and their periods are powers of an irrational ratio: no
    combination of states repeats. The excitation has the `axes`, and as its `parts` "x alone", ... and "together".

    Parameters
    ----------
    highest : (axes,) sequence of float
        Highest voltage [V] of each axis.
    drive : Sampling or sequence of Sampling, optional
        How each axis is sampled: base, frequency, limits and slew rate; one sample rate for all.
    steps, majors : int
        Of `descending_tops`, for each axis alone.
    cycles : int
        Cycles of the first axis together with the others; 0: axes one after the other only.
    axes : sequence of str, optional
        Names of the axes; default: x, y, z.
    seed : int
        Of the levels at which the axes turn together.

    Raises
    ------
    RecordError
        As `descending_tops`, or if the axes have different sample rates.
    """
    count = len(highest)
    names = axis_names(DEFAULT_AXES[:count] if axes is None else axes, count, "excitation", RecordError)
    drives = [drive or Sampling()] * count if drive is None or isinstance(drive, Sampling) else list(drive)
    if len(drives) != count or len({one.rate for one in drives}) > 1:
        raise RecordError(f"drive: need one Sampling an axis, {count}, and one sample rate for all")
    alone = [
        descending_tops(top, steps=steps, majors=majors, drive=one) for top, one in zip(highest, drives, strict=True)
    ]
    together = [
        # From the base, with another period and the same samples.
        _turns(
            top,
            replace(one, present=None, sample_rate=one.rate, frequency=one.frequency / RATIO**j),
            max(3, round(cycles / RATIO**j)),
            seed + j,
        )
        if cycles
        else np.zeros(0)
        for j, (top, one) in enumerate(zip(highest, drives, strict=True))
    ]
    most = max(map(len, together)) if cycles else 0
    sizes = [len(one) for one in alone]
    voltage = np.empty((sum(sizes) + most, count))
    first, parts = 0, []
    for j, one in enumerate(alone):
        rest = [other.base if k < j else other.start for k, other in enumerate(drives)]
        voltage[first : first + len(one)] = rest
        voltage[first : first + len(one), j] = one.voltage
        parts.append((f"{names[j]} alone", first, first + len(one)))
        first += len(one)
    if cycles:
        for j, row in enumerate(together):
            voltage[first:, j] = np.concatenate([row, np.full(most - len(row), row[-1])])
        parts.append(("together", first, first + most))
    return Excitation("stage", voltage, drives[0].rate, axes=names, parts=tuple(parts))


def _turns(highest: float, drive: Sampling, cycles: int, seed: int) -> Array:
    """Return voltages between levels that fill the range, each half cycle of one duration."""
    rng = np.random.default_rng([18, seed])
    span = highest - drive.base
    tops = drive.base + span * rng.permuted((np.arange(cycles) + 1.0) / cycles * 0.55 + 0.45)
    lows = drive.base + span * rng.permuted((np.arange(cycles) + 0.5) / cycles * 0.4)
    levels = [drive.base, *np.column_stack([tops, lows]).ravel()[:-1].tolist(), drive.base]
    return homing(turns=levels, drive=drive).voltage
