"""Initial states of a motion: moved within limits, at a displacement, or before the voltage of a record."""

from __future__ import annotations

import inspect
from dataclasses import replace
from typing import Any

import numpy as np

from dehyst._native import EMPTY
from dehyst._types import Array
from dehyst.model.actuator import Actuator, evaluator_of
from dehyst.model.base import AbstractModel, Motion, State
from dehyst.model.checks import creep_times, quasistatic, slow_loops

_ROUNDING = 1e-12
# Of the limits' range: a state whose voltage lies outside by less is that of the limit, but for the model's error.
NEAR = 0.01


def state_within_limits(actuator: Actuator, state: State, limits: tuple[float, float]) -> State:
    """Return the complete state, moved to the nearest limit [V] and at rest if its voltage lies outside the limits.

    Raise `ModelError` if it is not a state of this actuator.
    """
    start = evaluator_of(actuator).complete_state(state)
    held = actuator.voltage(start)
    nearest = min(max(held, limits[0]), limits[1])
    if abs(held - nearest) <= _ROUNDING * (limits[1] - limits[0]):
        return start
    slow = quasistatic(actuator)
    reached = slow.simulate([nearest], time=np.zeros(1), state=replace(start, motion=EMPTY), extrapolate=True).state
    return evaluator_of(actuator).complete_state(reached)


def state_after_loops(actuator: Actuator, state: State, limits: tuple[float, float]) -> State:
    """Return a state; if its voltage lies outside the limits [V], the state after slow major loops between them.

    The loops end at the limit next to the state. In a state beyond the limits, elements have slid farther than voltages
    within the limits can move them, so the actuator cannot reach this state.
    """
    low, high = limits
    held, near = actuator.voltage(state), NEAR * (high - low)
    return state if low - near <= held <= high + near else looped(actuator, limits, rising=held > high)


def looped(actuator: Actuator, limits: tuple[float, float], *, rising: bool) -> State:
    """Return the state after slow major loops between limits [V], at the upper one if `rising`, with creep at rest."""
    reached = slow_loops(actuator, limits if rising else (limits[1], limits[0])).state
    # The state of a slow motion has none of a mass.
    return evaluator_of(actuator).complete_state(replace(reached, motion=EMPTY))


def standing(actuator: Actuator, voltage: float, limits: tuple[float, float]) -> State:
    """Return the state at rest at a voltage [V], after slow major loops between limits [V] that end at the nearer one.

    It stands for an unknown state where a displacement is shown: the middle of the possible states may lie far outside
    of what voltages within the limits reach.
    """
    state = looped(actuator, limits, rising=voltage > 0.5 * sum(limits))
    return state_within_limits(actuator, state, (voltage, voltage))


def state_at(actuator: Actuator, state: State, displacement: float) -> State:
    """Return the state after a motion to a displacement [m] that is slow for mass and amplifier but fast for creep.

    Raise `ModelError` if it is not a state of this actuator.
    """
    slow, start = quasistatic(actuator), evaluator_of(actuator).complete_state(state)
    still = replace(start, motion=EMPTY)
    return evaluator_of(actuator).complete_state(
        slow.compensate([displacement], time=np.zeros(1), state=still, extrapolate=True).state
    )


def timed(model: AbstractModel, time: Array) -> dict[str, Any]:
    """Return the keywords `time` and `extrapolate` if a model has them; records may exceed its training range."""
    given = {"time": time, "extrapolate": True}
    return {name: value for name, value in given.items() if name in inspect.signature(model.simulate).parameters}


def beginning(model: AbstractModel, voltage: Array) -> Any:
    """Return the initial state before a voltage (n,) [V]: of an actuator the nearest loop end, else None (default).

    A distant start would set a mass swinging. An actuator with creep starts relaxed, as before the records, because its
    later motion depends on the initial strain.
    """
    if not isinstance(model, Actuator) or not voltage.size:
        return None
    if creep_times(model).size:
        return model.relaxed(float(voltage[0]), extrapolate=True)
    low, high = (float(end) for end in model.spring.displacement[[0, -1]])
    ends = [model.turned(high), model.turned(low, rising=False)]
    return min(ends, key=lambda state: abs(model.voltage(state) - float(voltage[0])))


def simulated(model: AbstractModel, voltage: Array, time: Array) -> Motion:
    """Return the motion of any `model` for a `voltage` (n,) [V] at `time` (n,) [s], from its `beginning`."""
    return model.simulate(voltage, state=beginning(model, voltage), **timed(model, time))
