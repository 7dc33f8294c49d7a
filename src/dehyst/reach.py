"""How far voltage limits let an actuator go."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dehyst._native import NOTHING
from dehyst.actuator import Actuator

# A step in creep's longest time constants: w moves evenly in it, and leaves strains of one part in so many.
_REST = 1e9
# Smooth elements forget slowly where they were.
_VISITS = 60


def reach_of(actuator: Actuator, limits: tuple[float, float]) -> tuple[float, float]:
    """Displacements [m] at the lower and the upper limit [V] of slow loops between them, creep at rest at either."""
    slow = replace(actuator, dynamics=None, lag=0.0, state=replace(actuator.state, motion=NOTHING), limits=None)
    voltage = np.tile(limits, _VISITS)
    rest = 1.0 if slow.creep is None else _REST * float(slow.creep.time_constants.max(initial=0.0))
    y = slow.simulate(voltage, time=np.arange(voltage.size) * rest if slow.needs_time else None).displacement
    return float(y[-2]), float(y[-1])
