"""Excitation: voltages that make an actuator show its loops."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import RecordError
from dehyst._native import Array


def raised_cosine(peaks: ArrayLike, *, base: float = 0.0, samples: int = 400) -> Array:
    """One cycle base -> peak -> base for each peak [V], ``samples`` a cycle (the paper's excitation, Sec. 3).

    Starts one sample after `base` and ends at it, so that protocols can be put one after another.

    Raises
    ------
    RecordError
        If a peak is not a number above the base, or there are fewer than 8 samples a cycle.
    """
    if samples < 8:
        raise RecordError(f"samples: got {samples} a cycle, need 8 at least")
    tops = np.asarray(peaks, dtype=np.float64)
    if tops.ndim != 1 or not tops.size or not np.isfinite(tops).all() or np.any(tops <= base):
        raise RecordError(f"peaks: got {tops}, need voltages above the base {base:g} V")
    shape = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(1, samples + 1) / samples)
    return np.concatenate([base + (top - base) * shape for top in tops])


def descending_tops(highest: float, *, steps: int = 10, base: float = 0.0, samples: int = 400) -> Array:
    """Raised cosines with tops falling from `highest` in equal steps, all back to the base; determines every stiffness.

    Raises
    ------
    RecordError
        As `raised_cosine`.
    """
    return raised_cosine(base + (highest - base) * np.linspace(1, 1 / steps, steps), base=base, samples=samples)
