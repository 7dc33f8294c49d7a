"""How far voltage limits let an actuator go, and where they let it begin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dehyst._native import EMPTY
from dehyst.model import Actuator, State

_ROUNDING = 1e-12


def reachable_range(actuator: Actuator, limits: tuple[float, float]) -> tuple[float, float]:
    """Displacements [m] at the lower and the upper limit [V] of slow loops between them, creep at rest at either."""
    return actuator.major_loop(limits)


def state_within_limits(actuator: Actuator, state: State, limits: tuple[float, float]) -> State:
    """The state, complete; if its voltage lies outside the limits [V], after a motion to the nearest of them, at rest.

    Raises
    ------
    ModelError
        If it is no state of this actuator.
    """
    start = actuator.model.complete_state(state)
    held = actuator.voltage(start)
    nearest = min(max(held, limits[0]), limits[1])
    if abs(held - nearest) <= _ROUNDING * (limits[1] - limits[0]):
        return start
    slow = _slow(actuator)
    time = np.zeros(1) if slow.needs_time else None
    reached = slow.simulate([nearest], time=time, state=replace(start, motion=EMPTY), extrapolate=True).state
    return actuator.model.complete_state(reached)


def state_at(actuator: Actuator, state: State, displacement: float) -> State:
    """The state after a motion to a displacement [m] of which mass and amplifier feel nothing; creep is given no time.

    Raises
    ------
    ModelError
        If it is no state of this actuator.
    """
    slow, start = _slow(actuator), actuator.model.complete_state(state)
    time = np.zeros(1) if slow.needs_time else None
    still = replace(start, motion=EMPTY)
    return actuator.model.complete_state(
        slow.compensate([displacement], time=time, state=still, extrapolate=True).state
    )


def _slow(actuator: Actuator) -> Actuator:
    """The same without what slow motions do not feel."""
    still = replace(actuator.state, motion=EMPTY)
    return replace(actuator, dynamics=None, lag=0.0, state=still, limits=None)
