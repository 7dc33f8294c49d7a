"""The steady state of a cycle of displacement: creep and smooth elements end each cycle as they began it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dehyst._types import Array
from dehyst.control.lead_in import timed
from dehyst.model import Actuator, State
from dehyst.model.evaluator import PathData
from dehyst.waveforms import ScanPath

# Enough for a contracting, piecewise smooth map; the linear one of Dahl's elements needs one.
_ROUNDS = 100
_EPS = float(np.finfo(np.float64).eps)


def steady_state(actuator: Actuator, path: ScanPath, state: State) -> State:
    """Return the state at the first sample of a periodic path after infinitely many cycles.

    Creep and smooth elements are driven by w alone, which follows from the path, so both are independent of each other
    and of the carts. A branch of creep is linear: if a cycle from zero strain ends at D, its steady strain is
    ``d = exp(-T/tau) d + D``. A smooth element's end rises with its beginning, with slope below 1: its only fixed point
    lies between the two extremes. Raise `ModelError` if the state does not fit the actuator.

    `path`: periodic. `state`: at the path's first sample, after two cycles at least, which erase the history of the
    carts.
    """
    if actuator.creep is not None:
        state = replace(state, creep=_strains(actuator, path))
    return state if actuator.smooth is None else replace(state, smooth=_elongations(actuator, path, state))


def _strains(actuator: Actuator, path: ScanPath) -> Array:
    """Return the steady strains d_j (J,) [m] of a cycle."""
    creep, cycle = actuator.creep, path.repeated(1)
    data = PathData(**timed(cycle))
    w = cycle.displacement + actuator.model.lead(cycle.displacement, data)
    if creep is None:
        return np.zeros(0)
    gained = creep.strains(cycle.time, w)[-1]
    return np.asarray(gained / -np.expm1(-float(cycle.time[-1]) / creep.time_constants))


def _elongations(actuator: Actuator, path: ScanPath, state: State) -> Array:
    """Return the steady elongations q_l (L,) [m] of a cycle, by the Illinois method of false position."""
    cycle, length = path.repeated(1), np.zeros(0) if actuator.smooth is None else actuator.smooth.length

    def gained(elongation: Array) -> Array:
        begin = replace(state, smooth=elongation)
        motion = actuator.compensate(cycle.displacement, **timed(cycle), state=begin, extrapolate=True)
        return np.asarray(motion.state.smooth - elongation)

    low, high = -length, length.copy()
    left, right = gained(low), gained(high)
    middle, side = 0.5 * (low + high), np.zeros(length.size)
    for _ in range(_ROUNDS):
        with np.errstate(invalid="ignore", divide="ignore"):
            middle = np.where(left == right, 0.5 * (low + high), (low * right - high * left) / (right - left))
        middle = np.clip(middle, low, high)
        gain = gained(middle)
        if np.all(np.abs(gain) <= 4 * _EPS * length) or np.all(high - low <= 4 * _EPS * length):
            break
        up = gain > 0
        right = np.where(up & (side > 0), 0.5 * right, np.where(up, right, gain))
        left = np.where(~up & (side < 0), 0.5 * left, np.where(up, gain, left))
        low, high, side = np.where(up, middle, low), np.where(up, high, middle), np.where(up, 1.0, -1.0)
    return middle
