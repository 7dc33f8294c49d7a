"""Figures of merit, one short function each; displacements in metres, percentages of a stroke."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike


def largest(error: ArrayLike) -> float:
    """Largest absolute error; 0 of none."""
    return float(np.abs(error).max(initial=0.0))


def rms(error: ArrayLike) -> float:
    """Root of the mean square error; 0 of none."""
    values = np.asarray(error, dtype=np.float64)
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0


def percent(error: float, stroke: float) -> float:
    """An error in % of the stroke."""
    return 100 * error / stroke


def loop_area(voltage: ArrayLike, displacement: ArrayLike) -> float:
    """Area enclosed by a closed loop [V m]: the integral of v dy, positive where energy is lost (kappa_i >= 0)."""
    v, y = np.asarray(voltage, dtype=np.float64), np.asarray(displacement, dtype=np.float64)
    steps = np.diff(y, append=y[:1])
    return float(np.sum(0.5 * (v + np.roll(v, -1)) * steps))
