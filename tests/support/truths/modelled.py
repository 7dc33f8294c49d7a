"""A model as a virtual actuator, and the virtual actuators by name."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from dehyst._types import Array
from dehyst.model import Actuator, State, needs_time, turned
from dehyst.virtual.base import Clock, Sensor, VirtualActuator
from dehyst.virtual.plays import PlayActuator
from truths.bouc_wen import BoucWenActuator
from truths.preisach import PreisachActuator

# Share of a step that the actuator "creep" adds in each decade of time.
_CREEP = 0.01


class ModelledActuator(VirtualActuator):
    """An identified `actuator` as a virtual one, without noise.

    Its `highest` voltage [V] is the upper limit of the actuator, or the voltage at the end of its spring.
    """

    def __init__(self, actuator: Actuator) -> None:
        self.actuator = actuator
        end = actuator.voltage(turned(actuator, float(actuator.spring.displacement[-1])))
        self.highest = float(end if actuator.limits is None else actuator.limits[1])
        swing = np.array([0.0, self.highest, 0.0, self.highest, 0.0])
        slowly = 1e3 * np.arange(swing.size)
        y = actuator.simulate(swing, time=slowly, state=actuator.relaxed(), extrapolate=True).displacement
        self.stroke, self._sensor = float(y[3] - y[4]), Sensor(0.0, 0)
        self.relax()

    def relax(self) -> None:
        """Reset to rest at 0 V, without residual strain."""
        self._state: State = self.actuator.relaxed()
        self._voltage, self._clock = 0.0, Clock()

    def _moved(self, v: Array, time: ArrayLike | None) -> Array:
        """Move; only an actuator that moves in time needs the `time`."""
        path, at = v, None
        if needs_time(self.actuator):
            self._clock.steps(time, v.size, "moves in time")
            path, at = np.concatenate([[self._voltage], v]), self._clock.times
        motion = self.actuator.simulate(path, time=at, state=self._state, extrapolate=True)
        self._state, self._voltage = motion.state, float(v[-1])
        return motion.displacement[-v.size :]


VIRTUAL: dict[str, Callable[[], VirtualActuator]] = {
    "play": PlayActuator,
    "creep": lambda: PlayActuator(creep=_CREEP),
    "preisach": PreisachActuator,
    "boucwen": BoucWenActuator,
}
