"""A virtual actuator that warms up while it is in use, and a simulated rig that records its temperature."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dehyst._types import Array
from dehyst.instruments.simulated import SimulatedRig
from dehyst.virtual.plays import PlayActuator

# Temperature of a new actuator [degC].
_ROOM = 20.0


class WarmingActuator(PlayActuator):
    """Plays whose gain changes by `gain` [%] while they warm by `kelvins` [K], evenly within `seconds` [s]."""

    def __init__(self, gain: float, kelvins: float, seconds: float, **options: Any) -> None:
        super().__init__(**options)
        self.gain, self.kelvins, self.seconds = gain, kelvins, seconds

    def temperature(self, time: ArrayLike) -> Array:
        """Return the temperature (n,) [degC] at `time` (n,) [s]."""
        return np.asarray(_ROOM + self.kelvins * np.clip(np.asarray(time) / self.seconds, 0.0, 1.0))

    def _moved(self, v: Array, time: ArrayLike | None) -> Array:
        assert time is not None
        warmed = (self.temperature(time) - _ROOM) / self.kelvins
        return np.asarray((1 + 0.01 * self.gain * warmed) * super()._moved(v, time))


class WarmRig(SimulatedRig):
    """A rig of a warming actuator."""

    def __init__(self, truth: WarmingActuator, **options: Any) -> None:
        super().__init__(truth, **options)
        self.truth, self.others = truth, ("temperature_C",)

    def _wave(self, voltage: Array, rate: float) -> Any:
        for samples in super()._wave(voltage, rate):
            yield samples._replace(others={"temperature_C": self.truth.temperature(samples.time)})
