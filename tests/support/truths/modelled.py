"""A model as a virtual actuator, and the virtual actuators by name."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from dehyst._types import Array
from dehyst.model import Actuator, State
from dehyst.virtual.base import Sensor, VirtualActuator
from dehyst.virtual.plays import PlayActuator
from truths.bouc_wen import BoucWenActuator
from truths.preisach import PreisachActuator

# Share of a step that the actuator "creep" adds in each decade of time.
_CREEP = 0.01


class ModelledActuator(VirtualActuator):
    """An `actuator` without time as a virtual one, without noise, up to the `highest` voltage [V]."""

    def __init__(self, actuator: Actuator, highest: float) -> None:
        self.actuator, self.highest = actuator, highest
        self.stroke, self._sensor = float(np.ptp(actuator.spring.displacement)), Sensor(0.0, 0)
        self.relax()

    def relax(self) -> None:
        """Reset to rest at 0 V, without residual strain."""
        self._state: State = self.actuator.relaxed()

    def _moved(self, v: Array, time: ArrayLike | None) -> Array:
        motion = self.actuator.simulate(v, state=self._state, extrapolate=True)
        self._state = motion.state
        return motion.displacement


VIRTUAL: dict[str, Callable[[], VirtualActuator]] = {
    "play": PlayActuator,
    "creep": lambda: PlayActuator(creep=_CREEP),
    "preisach": PreisachActuator,
    "boucwen": BoucWenActuator,
}
