"""States in which a simulation may start: relaxed, after a long motion, or given and completed."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from dehyst._errors import ModelError
from dehyst._native import EMPTY
from dehyst.model.base import State

if TYPE_CHECKING:
    from dehyst.model.actuator import Actuator
    from dehyst.model.evaluator import Evaluator


def relaxed_state(actuator: Actuator, voltage: float) -> State:
    """Return the state in which no element is strained and the spring alone holds `voltage` [V]."""
    transformer = actuator.transformer
    y = actuator.core.spring_inverse(voltage if transformer is None else float(transformer(voltage)))
    return State(y, np.full(len(actuator.slip), y))


def turned_state(actuator: Actuator, displacement: float, *, rising: bool) -> State:
    """Return the state after a long motion up or down to `displacement` [m], creep at rest."""
    side = 1 if rising else -1
    smooth = () if actuator.smooth is None else side * actuator.smooth.length
    return State(displacement, displacement - side * actuator.slip.breakaway, smooth=smooth)


def complete_state(parts: Evaluator, start: State) -> State:
    """Return the state with missing strains, elongations and motion at rest, and with rounding removed.

    Raise `ModelError` if it is not a state of these parts.
    """
    if not isinstance(start, State):
        raise ModelError(f"state: got {type(start).__name__}, need a State, such as that of a Motion")
    if start.carts.size != len(parts.slip):
        raise ModelError(f"state: got {start.carts.size} carts, this actuator has {len(parts.slip)} elements")
    start = _with_motion(parts, start)
    rho = parts.slip.breakaway
    excess = np.abs(start.displacement - start.carts) - rho
    worst = int(np.argmax(excess)) if excess.size else 0
    if excess.size and excess[worst] > 1e-9 * (rho[worst] + abs(start.displacement)):
        raise ModelError(
            f"state: cart {worst} is {excess[worst]:.3g} m farther from the displacement than its breakaway "
            f"elongation {rho[worst]:.3g} m"
        )
    if not excess.size or excess[worst] <= 0:
        return start
    return replace(start, carts=np.clip(start.carts, start.displacement - rho, start.displacement + rho))


def _with_motion(parts: Evaluator, state: State) -> State:
    """Return the state with creep strains, smooth elongations and motion, at rest where they were left out."""
    branches, moving = 0 if parts.creep is None else len(parts.creep), 0 if parts.dynamics is None else 2
    if state.creep.size not in (0, branches):
        raise ModelError(f"state: got {state.creep.size} creep strains, this actuator has {branches} creep branches")
    if state.motion.size > moving:
        raise ModelError("state: got a motion, this actuator has no dynamics")
    if state.creep.size < branches:
        state = replace(state, creep=np.zeros(branches))
    state = _with_elongations(parts, state)
    return replace(state, motion=np.array([state.displacement, 0.0])) if state.motion.size < moving else state


def _with_elongations(parts: Evaluator, state: State) -> State:
    length = EMPTY if parts.smooth is None else parts.smooth.length
    if state.smooth.size not in (0, length.size):
        raise ModelError(
            f"state: got {state.smooth.size} smooth elongations, this actuator has {length.size} smooth elements"
        )
    if state.smooth.size < length.size:
        return replace(state, smooth=np.zeros(length.size))
    excess = np.abs(state.smooth) - length
    worst = int(np.argmax(excess / length)) if excess.size else 0
    if excess.size and excess[worst] > 1e-9 * length[worst]:
        raise ModelError(
            f"state: smooth element {worst} is elongated by {state.smooth[worst]:.3g} m, its length is "
            f"{length[worst]:.3g} m"
        )
    return replace(state, smooth=np.clip(state.smooth, -length, length)) if np.any(excess > 0) else state
