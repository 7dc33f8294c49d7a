"""Where the largest loop between two voltages ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dehyst._native import NOTHING
from dehyst.model import State
from dehyst.wide import Course, WideModel

# A step in creep's longest time constants: w moves evenly in it, and leaves strains of one part in so many.
_REST = 1e9
# Smooth elements forget slowly where they were.
_VISITS = 60


def major_loop_ends(model: WideModel, limits: tuple[float, float], state: State) -> tuple[float, float]:
    """Displacements [m] at the lower and the upper limit [V] of slow loops between them, creep at rest at either.

    Parameters
    ----------
    model : WideModel
    limits : (float, float)
    state : State
        Where the loops begin, complete; they end at the same place wherever that is.
    """
    slow = replace(model, dynamics=None, lag=0.0)
    voltage = np.tile(limits, _VISITS)
    rest = 1.0 if slow.creep is None else _REST * float(slow.creep.time_constants.max(initial=0.0))
    time = np.arange(voltage.size) * rest if slow.needs_time else None
    y, _ = slow.simulate(voltage, Course(time), slow.fitted(replace(state, motion=NOTHING)), stack=True)
    return float(y[-2]), float(y[-1])
