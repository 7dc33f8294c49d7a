"""The state in which a cycle of displacement ends as it began, and ever after: creep and smooth elements settled."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dehyst._types import Array
from dehyst.model import Actuator, State
from dehyst.model.evaluator import PathData
from dehyst.waveforms import ScanPath

# Enough for a piecewise smooth map that contracts; the straight one of Dahl's elements takes one.
_ROUNDS = 100
_EPS = float(np.finfo(np.float64).eps)


def steady_state(actuator: Actuator, path: ScanPath, state: State) -> State:
    """The state at the first sample of a periodic path that has been followed for ever.

    What creeps and what lets go gradually is driven by w alone, which the path tells, so neither knows of the other
    or of the carts. A branch of creep is linear: if a cycle from no strain ends at D, the strain to which it comes back
    is ``d = exp(-T/tau) d + D``. A smooth element's end rises with its beginning, by less: the one point that comes
    back is found between its two extremes.

    Parameters
    ----------
    actuator : Actuator
    path : ScanPath
        Periodic.
    state : State
        At the path's first sample, after two cycles at least: its carts have forgotten what they can forget.

    Raises
    ------
    ModelError
        If the state does not fit the actuator.
    """
    if actuator.creep is not None:
        state = replace(state, creep=_strains(actuator, path))
    return state if actuator.smooth is None else replace(state, smooth=_elongations(actuator, path, state))


def _strains(actuator: Actuator, path: ScanPath) -> Array:
    """The strains d_j (J,) [m] to which a cycle comes back."""
    creep, one = actuator.creep, path.repeated(1)
    course = PathData(one.time, velocity=one.velocity, acceleration=one.acceleration)
    w = one.displacement + actuator.model.lead(one.displacement, course)
    if creep is None:
        return np.zeros(0)
    gained = creep.strains(one.time, w)[-1]
    return np.asarray(gained / -np.expm1(-float(one.time[-1]) / creep.time_constants))


def _elongations(actuator: Actuator, path: ScanPath, state: State) -> Array:
    """The elongations q_l (L,) [m] to which a cycle comes back, by false position after Illinois."""
    one, length = path.repeated(1), np.zeros(0) if actuator.smooth is None else actuator.smooth.length

    def gained(elongation: Array) -> Array:
        motion = actuator.compensate(
            one.displacement,
            time=one.time,
            velocity=one.velocity,
            acceleration=one.acceleration,
            state=replace(state, smooth=elongation),
            extrapolate=True,
        )
        return np.asarray(motion.state.smooth - elongation)

    low, high = -length, length.copy()
    left, right = gained(low), gained(high)
    middle, side = 0.5 * (low + high), np.zeros(length.size)
    for _ in range(_ROUNDS):
        with np.errstate(invalid="ignore", divide="ignore"):
            middle = np.where(left == right, 0.5 * (low + high), (low * right - high * left) / (right - left))
        middle = np.clip(middle, low, high)
        found = gained(middle)
        if np.all(np.abs(found) <= 4 * _EPS * length) or np.all(high - low <= 4 * _EPS * length):
            break
        up = found > 0
        right = np.where(up & (side > 0), 0.5 * right, np.where(up, right, found))
        left = np.where(~up & (side < 0), 0.5 * left, np.where(up, found, left))
        low, high, side = np.where(up, middle, low), np.where(up, high, middle), np.where(up, 1.0, -1.0)
    return middle
