"""The possible states of an actuator at a voltage.

If the order of voltages alone determines the state, every voltage keeps the order of states. Then the two extreme
equilibria, on either branch of the major loop, bound every state at rest, and two simulations propagate the bounds
exactly (theory section 11). A transformer and graded elements keep the order too.

With creep the order of states holds too: of two voltage histories, the one that is never lower leaves no part of the
actuator lower. Hence two states bound all histories within the limits, at any speed and of any duration: the states
after resting infinitely long at either limit. Smooth elements and a mass that acts on the voltage do not keep the
order. For them, the bounding states are the extremes with smooth elements strained either way, and states after random
histories.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np
from numpy.typing import ArrayLike

from dehyst._types import Array
from dehyst._validation import interval, number
from dehyst.model import Actuator, State, creep_times, evaluator_of, knots_of, quasistatic, turned, voltages_of
from dehyst.waveforms import Sampling

# Random histories, and turns in each.
_HISTORIES, _TURNS = 12, 8


def _on_major_loop(actuator: Actuator, voltage: float, side: int) -> State:
    """Return the state at a voltage [V] on the major loop: side 1 is the rising branch, -1 the falling one.

    Its displacement is the lowest, or the highest, of any state; smooth elements hold their largest voltage.
    """
    plain = quasistatic(replace(actuator, displacement_creep=None, state=None))  # type: ignore[arg-type]
    low, high = knots_of(plain)
    # It comes from so far that every element slides.
    way = high - low + 2 * float(plain.slip.breakaway.max(initial=0.0))
    while side * (voltage - plain.voltage(turned(plain, low - side * way, rising=side > 0))) < 0:
        way *= 2
    far = turned(plain, low - side * 3 * way, rising=side > 0)
    reached: State = plain.simulate([voltage], state=far, extrapolate=True).state
    return reached


def middle_of(states: Sequence[State]) -> State:
    """Return the state in the middle of `states` of one actuator, with an error of at most half their range."""

    def middle(name: str) -> Array:
        values = np.array([getattr(state, name) for state in states])
        return np.asarray(0.5 * (values.min(axis=0) + values.max(axis=0)))

    return State(float(middle("deformation")), *(middle(entry.name) for entry in fields(State)[1:]))


def time_dependence(actuator: Actuator) -> str:
    """Return as text why the order of voltages does not determine the state; empty if it does."""
    parts = {
        "creeps": creep_times(actuator).size > 0,
        "has inertia": actuator.dynamics is not None,
        "lags": actuator.lag > 0,
        "has smooth elements": actuator.smooth is not None,
    }
    return " and ".join(words for words, there in parts.items() if there)


def keeps_order(actuator: Actuator) -> bool:
    """Return whether the two extreme states provably bound all states."""
    dynamics = actuator.dynamics
    return actuator.smooth is None and (dynamics is None or not dynamics.series)


def possible_states(
    actuator: Actuator,
    voltage: float,
    limits: tuple[float, float] | None = None,
    half: float = Sampling().half,
) -> tuple[State, ...]:
    """Return states at a voltage that bound all states in which an actuator of unknown history may rest there.

    There are two states, the lower one first, if these provably bound all others. There are more for an actuator with
    smooth elements or a mass that acts on the voltage. `limits` [V]: range of all earlier voltages, widened to include
    the `voltage` [V], for an actuator that depends on time; default: the actuator's limits. `half` [s]:
    approximate duration of the legs of random histories. Raise `ModelError` if the voltage is not finite, or the limits
    are no interval.
    """
    v = number(voltage, "voltage")
    length = np.zeros(0) if actuator.smooth is None else actuator.smooth.length
    if not time_dependence(actuator):
        return tuple(_on_major_loop(actuator, v, side) for side in (1, -1))
    low, high = voltages_of(actuator) if limits is None else interval(limits)
    low, high = min(low, v), max(high, v)
    still = quasistatic(actuator)

    def played(state: State, voltages: ArrayLike, seconds: Array) -> State:
        reached: State = still.simulate(voltages, time=seconds, state=state, extrapolate=True).state
        return reached

    # After resting for ever at either limit.
    rested = [
        evaluator_of(still).complete_state(State(end.deformation, end.carts, smooth=share * length))
        for end in (_on_major_loop(actuator, low, 1), _on_major_loop(actuator, high, -1))
        for share in ((1.0, 0.0, -1.0) if length.size else (1.0,))
    ]
    # The last leg takes no time.
    now = np.zeros(1)
    states = [played(state, [v], now) for state in rested]
    if not keeps_order(actuator):
        random, seconds = np.random.default_rng(0), np.cumsum(np.geomspace(0.01, 10, _TURNS) * half)
        turns = [random.uniform(low, high, _TURNS) for _ in range(_HISTORIES)]
        begun = list(states)
        states += [played(played(begun[k % len(begun)], visited, seconds), [v], now) for k, visited in enumerate(turns)]
    if actuator.dynamics is None:
        return tuple(states)
    return tuple(replace(state, motion=np.array([state.deformation, 0.0])) for state in states)
