"""The start state of an exported compensator, and the way to bring the actuator there."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dehyst.control import Compensator
from dehyst.model import Actuator, State

# Of the limits' range.
_NEAR = 0.01


class ExportedStart(NamedTuple):
    """Displacement [m] and voltage [V] of the memory at the start, and the way there as a sentence."""

    displacement: float
    voltage: float
    way: str

    @classmethod
    def of(cls, compensator: Compensator) -> ExportedStart:
        """Return the start of a loop like this one, as it was made or last reset."""
        loop, actuator = compensator.afresh(), compensator.actuator
        state, (low, high), asked = loop.state, loop.limits, loop.asked_start
        place = float(state.motion[0]) if state.motion.size else state.displacement
        # A little beyond the limits, the requested state has the same way.
        near = abs(actuator.voltage(asked) - loop.voltage) <= _NEAR * (high - low)
        return cls(place, loop.voltage, _way(actuator, asked if near else state, loop.voltage))

    @property
    def words(self) -> str:
        """Displacement and voltage."""
        return f"{self.displacement * 1e6:.6g} um, {self.voltage:.6g} V"


def _way(actuator: Actuator, state: State, voltage: float) -> str:
    """Describe how the voltage leads to the state; slowly, because the words have no time in them."""
    strain, most = state.displacement - state.carts, actuator.slip.breakaway
    end = f"{voltage:.6g} V"
    rest = " and wait until creep has come to rest" if actuator.creep is not None else ""
    if np.allclose(strain, most, rtol=1e-9, atol=0):
        return f"raise the voltage slowly from its lowest, never back, to {end}{rest}"
    if np.allclose(strain, -most, rtol=1e-9, atol=0):
        return f"lower the voltage slowly from its highest, never back, to {end}{rest}"
    if not strain.any():
        return f"swing the voltage about {end}, each swing smaller than the one before, until it rests there{rest}"
    return f"play the voltages that lead to this state, for instance a homing, down to the last one, {end}"
