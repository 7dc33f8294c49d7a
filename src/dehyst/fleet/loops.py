"""The major loop of a model, played: its width, and the path on which two models are compared."""

from __future__ import annotations

import numpy as np

from dehyst._types import Array
from dehyst.model import Actuator

# Samples of a rise or a fall.
_SAMPLES = 200
# Parts of the voltages' range at which the width of the loop is taken, and tops of the falling loops of the path.
PLACES, _TOPS = (0.25, 0.5, 0.75), (1.0, 1.0, 0.75, 0.5, 0.25)


def played(actuator: Actuator, limits: tuple[float, float], seconds: float) -> Array:
    """Return the displacement [m] along `path` after one cycle through the limits, 0 at the path's first sample.

    A cycle of a model that moves in time takes `seconds`.
    """
    voltage = path(limits)
    time = seconds / (2 * _SAMPLES) * np.arange(voltage.size) if actuator.needs_time else None
    start = actuator.turned(float(actuator.spring.displacement[0]), rising=False, extrapolate=True)
    y = actuator.simulate(voltage, time=time, state=start, extrapolate=True).displacement[2 * _SAMPLES :]
    return np.asarray(y - y[0])


def path(limits: tuple[float, float]) -> Array:
    """Return cycles from the lower limit [V]: two through both limits, then three smaller ones."""
    low, high = limits
    rise = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, _SAMPLES + 1) / _SAMPLES)
    parts = [np.zeros(1), *(part for top in _TOPS for part in (top * rise, top * (1 - rise)))]
    return np.asarray(low + (high - low) * np.concatenate(parts))


def widths(actuator: Actuator, limits: tuple[float, float], seconds: float) -> list[float]:
    """Return how far falling and rising displacement differ [m] on the major loop at the voltages `PLACES`."""
    y, v = played(actuator, limits, seconds)[: 2 * _SAMPLES + 1], path(limits)[: 2 * _SAMPLES + 1]
    rising, falling = slice(0, _SAMPLES + 1), slice(2 * _SAMPLES, _SAMPLES - 1, -1)
    at = limits[0] + (limits[1] - limits[0]) * np.array(PLACES)
    return list((np.interp(at, v[falling], y[falling]) - np.interp(at, v[rising], y[rising])).tolist())
