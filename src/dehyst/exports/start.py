"""Where a compensator begins, and how its actuator is brought there."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dehyst.control import Compensator
from dehyst.model import Actuator, State

# Of the limits' range.
_NEAR = 0.01


class ExportedStart(NamedTuple):
    """Displacement [m] and voltage [V] of the memory at the beginning, and the way there in words."""

    displacement: float
    voltage: float
    way: str

    @classmethod
    def of(cls, compensator: Compensator) -> ExportedStart:
        """Of a loop like this one, as it was made or last reset."""
        loop, actuator = compensator.afresh(), compensator.actuator
        state, (low, high), asked = loop.state, loop.limits, loop.asked_start
        place = float(state.motion[0]) if state.motion.size else state.displacement
        # A little beyond the limits, the state that was asked for tells the way as well.
        near = abs(actuator.voltage(asked) - loop.voltage) <= _NEAR * (high - low)
        return cls(place, loop.voltage, _way(actuator, asked if near else state, loop.voltage))

    @property
    def words(self) -> str:
        """Displacement and voltage."""
        return f"{self.displacement * 1e6:.6g} um, {self.voltage:.6g} V"


def _way(actuator: Actuator, state: State, voltage: float) -> str:
    """What to do with the voltage; slow, since time is not in it."""
    strain, most = state.displacement - state.carts, actuator.slip.breakaway
    end = f"{voltage:.6g} V"
    rest = " and wait until creep has come to rest" if actuator.creep is not None else ""
    if np.allclose(strain, most, rtol=1e-9, atol=0):
        return f"raise the voltage slowly from its lowest, never back, to {end}{rest}"
    if np.allclose(strain, -most, rtol=1e-9, atol=0):
        return f"lower the voltage slowly from its highest, never back, to {end}{rest}"
    if not strain.any():
        return f"swing the voltage about {end}, each swing smaller than the one before, until it rests there{rest}"
    return f"play the voltages after which the actuator was in this state, a homing say, down to the last one, {end}"
