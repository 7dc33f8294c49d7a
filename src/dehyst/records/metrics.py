"""Figures of merit, one short function each; displacements in metres, percentages of a stroke."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

# Largest value of white noise, in standard deviations.
NOISE_PEAK = 4.0


def largest(error: ArrayLike) -> float:
    """Return the largest absolute error; 0 without any."""
    return float(np.abs(error).max(initial=0.0))


def rms(error: ArrayLike) -> float:
    """Return the root of the mean square error; 0 without any."""
    values = np.asarray(error, dtype=np.float64)
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0


def percent(error: float, stroke: float) -> float:
    """Return an error in % of the stroke."""
    return 100 * error / stroke


def loop_area(voltage: ArrayLike, displacement: ArrayLike) -> float:
    """Return the area of a closed loop [V m]: the integral of v dy, positive if energy is lost (kappa_i >= 0)."""
    v, y = np.asarray(voltage, dtype=np.float64), np.asarray(displacement, dtype=np.float64)
    steps = np.diff(y, append=y[:1])
    return float(np.sum(0.5 * (v + np.roll(v, -1)) * steps))
