"""The states in which an actuator of unknown history may stand at a voltage: those that bound all others.

If the order of voltages determines the state, the two extreme equilibria bound every state at rest (`StateBounds`).

With creep the order of states holds too: a voltage that was never lower leaves no part of the actuator lower. So of all
histories within the limits, at any speed and of any duration, two states are the extremes: after resting for ever at
either limit. Smooth elements and a mass that acts on the voltage keep no order: for them the extremes are taken with
smooth elements pulled either way, and random histories besides.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from dehyst._types import Array
from dehyst._validation import interval, number
from dehyst.control.major_loop import MajorLoop
from dehyst.control.state_bounds import StateBounds, moves_on
from dehyst.model import Actuator, State
from dehyst.waveforms import Sampling

# Random histories, and turns in each.
_HISTORIES, _TURNS = 12, 8


def possible_states(actuator: Actuator, voltage: float, limits: tuple[float, float] | None = None) -> tuple[State, ...]:
    """Return states at a voltage that bound all those in which an actuator of unknown history may stand there.

    Two states if they are proven to be the extremes, the lower one first; more for an actuator with smooth elements or
    a mass that acts on the voltage.

    Parameters
    ----------
    actuator : Actuator
    voltage : float
        [V].
    limits : (float, float), optional
        Range of all earlier voltages [V], for an actuator that moves in time; default the actuator's `voltage_range`.
        It is widened to the voltage.

    Raises
    ------
    ModelError
        If the voltage is not finite, or the limits are no interval.
    """
    v = number(voltage, "voltage")
    if not moves_on(actuator):
        bounds = StateBounds.at_rest(actuator, v)
        return bounds.lower, bounds.upper
    low, high = actuator.voltage_range if limits is None else interval(limits)
    return timed_states(actuator, (min(low, v), max(high, v)), v, Sampling().half)


def middle_of(states: Sequence[State]) -> State:
    """Return the state halfway between the extremes of some states of one actuator."""
    return states[0] if len(states) == 1 else bounds_of(states).middle


def bounds_of(states: Sequence[State]) -> StateBounds:
    """Return the tightest bounds of states."""
    names = ("carts", "creep", "motion", "smooth")
    ends = []
    for order in (np.min, np.max):
        arrays = (order([getattr(state, name) for state in states], axis=0) for name in names)
        ends.append(State(float(order([state.displacement for state in states])), *arrays))
    return StateBounds(*ends)


def keeps_order(actuator: Actuator) -> bool:
    """Return whether the two extreme states are proven to be the extremes."""
    dynamics = actuator.dynamics
    return actuator.smooth is None and (dynamics is None or not dynamics.series)


def timed_states(actuator: Actuator, limits: tuple[float, float], present: float, half: float) -> tuple[State, ...]:
    """Return the extreme states at the `present` voltage [V] of an actuator that moves in time.

    If states keep no order, those after random histories too, with legs of `half` seconds and about.
    """
    still = replace(actuator, dynamics=None, lag=0.0, state=None)  # type: ignore[arg-type]
    states = [_moved(still, state, present) for state in _rested(actuator, limits)]
    if not keeps_order(actuator):
        random, seconds = np.random.default_rng(0), np.cumsum(np.geomspace(0.01, 10, _TURNS) * half)
        states += [
            _moved(still, states[k % len(states)], present, random.uniform(*limits, _TURNS), seconds)
            for k in range(_HISTORIES)
        ]
    if actuator.dynamics is None:
        return tuple(states)
    return tuple(replace(state, motion=np.array([state.displacement, 0.0])) for state in states)


def _rested(actuator: Actuator, limits: tuple[float, float]) -> Iterator[State]:
    """Yield the states after resting for ever at either limit."""
    branch, rho, smooth = MajorLoop(actuator), actuator.slip.breakaway, actuator.smooth
    length = np.zeros(0) if smooth is None else smooth.length
    for side, limit in ((1, limits[0]), (-1, limits[1])):
        y = branch.displacement(limit, side)
        for share in (1.0, 0.0, -1.0) if length.size else (1.0,):
            yield State(y, y - side * rho, smooth=share * length)


def _moved(
    still: Actuator, state: State, present: float, turns: Array | None = None, seconds: Array | None = None
) -> State:
    """Return the state at the present voltage, from a state through turns [V]; the last leg takes no time."""
    reached = still.model.complete_state(state)
    if turns is not None:
        when = seconds if still.needs_time else None
        reached = still.simulate(turns, time=when, state=reached, extrapolate=True).state
    now = np.zeros(1) if still.needs_time else None
    last: State = still.simulate([present], time=now, state=reached, extrapolate=True).state
    return last
