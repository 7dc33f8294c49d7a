"""A virtual actuator that ages, warms up or drifts while it is in use."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst.virtual.base import VirtualActuator
from dehyst.virtual.plays import PlayActuator

# Width of the loop that is added or taken away, and seconds of a slow cycle by which widths are measured.
_WIDE, _SLOWLY = 0.95, 1e4
# Temperature of a new actuator [degC].
_ROOM = 20.0


@dataclass(frozen=True)
class AgeingCourse:
    """The course of ageing: changes that grow evenly with time, until `seconds` [s] have passed.

    `gain`: of the displacement [%]. `width`: of the loop, relative to its own width [%]. `offset`: of the sensor's zero
    [% of the stroke]. `kelvins`: rise of the temperature from 20 degC, which may cause all this [K].
    """

    gain: float = 0.0
    width: float = 0.0
    offset: float = 0.0
    seconds: float = 600.0
    kelvins: float = 0.0


class AgeingActuator(VirtualActuator):
    """A virtual actuator of which gain, loop width and zero change with time: ``(1 + g) (y + w h) + o``.

    h is a closed loop of the voltage, 0 at the lowest voltage. Its share w makes the loop wider as requested. `relax`
    makes the actuator new. `play` needs the time.

    `new`: the actuator before it ages. `ageing`: its changes. `temperature`: function of the time (n,) [s] that returns
    the temperature (n,) [degC].
    """

    def __init__(self, new: VirtualActuator, ageing: AgeingCourse) -> None:
        self.new, self.ageing = new, ageing
        self.stroke, self.highest = new.stroke, new.highest
        self.noise, self.seed = getattr(new, "noise", 0.0), getattr(new, "seed", 0)
        self._sensor = deepcopy(new._sensor)
        self._loop = PlayActuator(stroke=new.stroke, highest=new.highest, width=_WIDE, noise=0.0)
        self._share = 0.01 * ageing.width * _width(new) / _width(self._loop)

    def relax(self) -> None:
        """Reset to a new actuator at rest at 0 V, without residual strain."""
        self.new.relax()
        self._loop.relax()

    @property
    def kind(self) -> str:
        """The kind of actuator."""
        return self.new.kind

    def parameters(self) -> dict[str, Any]:
        """Return the parameters of the new actuator: it is the same one."""
        return self.new.parameters()

    def temperature(self, time: ArrayLike) -> Array:
        """Return the temperature (n,) [degC] at `time` (n,) [s]."""
        return np.asarray(_ROOM + self.ageing.kelvins * self._age(time))

    def _age(self, time: ArrayLike) -> Array:
        return np.asarray(np.clip(np.asarray(time, dtype=np.float64) / self.ageing.seconds, 0.0, 1.0))

    def _moved(self, v: Array, time: ArrayLike | None) -> Array:
        """Move, and age until the `time` of each sample."""
        if time is None:
            raise ModelError("this actuator ages: it needs the time of each sample; give the time [s]")
        y, line = self.new.play(v, time=time, measured=False), self.stroke * v / self.highest
        loop = self._loop.play(v, measured=False) - line
        age = self._age(time)
        aged = (1 + 0.01 * self.ageing.gain * age) * (y + self._share * age * loop)
        return np.asarray(aged + 0.01 * self.ageing.offset * age * self.stroke)


def _width(actuator: VirtualActuator) -> float:
    """Return the width of the major loop [m] at half the highest voltage."""
    tested = deepcopy(actuator)
    tested.relax()
    swing = np.array([0.0, 1.0, 0.0, 1.0, 0.0, 0.5, 1.0, 0.5]) * actuator.highest
    y = tested.play(swing, time=_SLOWLY * np.arange(swing.size), measured=False)
    return float(y[7] - y[5])
