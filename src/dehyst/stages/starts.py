"""The states in which the axes of a stage start: reachable within the voltages that are allowed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dehyst._native import EMPTY
from dehyst.control.reachable import slow_actuator
from dehyst.model import Actuator, State

# Of the limits' range: a state whose voltage lies outside by less is that of the limit, but for the model's error.
NEAR = 0.01
# After so many loops every element repeats; and so many of the longest times of creep are a rest.
_LOOPS, _REST = 30, 1e9


def start_within(actuator: Actuator, state: State, limits: tuple[float, float]) -> State:
    """Return a state, or if its voltage lies outside the limits [V], the state after major loops between them.

    The loops end at the limit next to the state. Of a state beyond the limits, the elements have slid farther than any
    voltage between them makes them slide: no play within the limits leads to it.
    """
    low, high = limits
    held, near = actuator.voltage(state), NEAR * (high - low)
    if low - near <= held <= high + near:
        return state
    return looped(actuator, limits, rising=held > high)


def looped(actuator: Actuator, limits: tuple[float, float], *, rising: bool) -> State:
    """Return the state after slow major loops between limits [V], at the upper one if `rising`, creep at rest."""
    slow = replace(slow_actuator(actuator), limits=None)
    voltage = np.tile(limits if rising else limits[::-1], _LOOPS)
    rest = 1.0 if slow.creep is None else _REST * float(slow.creep.time_constants.max(initial=0.0))
    time = np.arange(voltage.size) * rest if slow.needs_time else None
    reached = slow.simulate(voltage, time=time, extrapolate=True).state
    # The state of a slow motion has none of a mass.
    return actuator.model.complete_state(replace(reached, motion=EMPTY))
