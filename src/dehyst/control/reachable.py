"""The displacements that an actuator can reach within voltage limits, and the states in which it can start."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dehyst._native import EMPTY
from dehyst.model import Actuator, State

_ROUNDING = 1e-12


def state_within_limits(actuator: Actuator, state: State, limits: tuple[float, float]) -> State:
    """Return the complete state; if its voltage lies outside the limits [V], after a motion to the nearest, at rest.

    Raise `ModelError` if it is not a state of this actuator.
    """
    start = actuator.model.complete_state(state)
    held = actuator.voltage(start)
    nearest = min(max(held, limits[0]), limits[1])
    if abs(held - nearest) <= _ROUNDING * (limits[1] - limits[0]):
        return start
    slow = _unlimited(actuator)
    time = np.zeros(1) if slow.needs_time else None
    reached = slow.simulate([nearest], time=time, state=replace(start, motion=EMPTY), extrapolate=True).state
    return actuator.model.complete_state(reached)


def state_at(actuator: Actuator, state: State, displacement: float) -> State:
    """Return the state after a motion to a displacement [m], too slow for mass and amplifier, too fast for creep.

    Raise `ModelError` if it is not a state of this actuator.
    """
    slow, start = _unlimited(actuator), actuator.model.complete_state(state)
    time = np.zeros(1) if slow.needs_time else None
    still = replace(start, motion=EMPTY)
    return actuator.model.complete_state(
        slow.compensate([displacement], time=time, state=still, extrapolate=True).state
    )


def slow_actuator(actuator: Actuator) -> Actuator:
    """Return the actuator without inertia and lag, which slow motions do not excite."""
    return replace(actuator, dynamics=None, lag=0.0, state=replace(actuator.state, motion=EMPTY))


def _unlimited(actuator: Actuator) -> Actuator:
    return replace(slow_actuator(actuator), limits=None)
