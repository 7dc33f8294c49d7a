"""The base class of virtual actuators, with their clock and their sensor."""

from __future__ import annotations

import hashlib
import json
from abc import ABC, abstractmethod
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst._validation import vector

# Number of digits of a fingerprint.
_DIGITS = 12


class VirtualActuator(ABC):
    """A simulated actuator that keeps its state from one voltage to the next.

    `stroke` [m] is its displacement at the `highest` voltage [V] on the major loop, `noise` [m] the standard deviation
    of its sensor, with a `seed`.
    """

    stroke: float
    highest: float
    _sensor: Sensor

    @abstractmethod
    def relax(self) -> None:
        """Reset to rest at 0 V, without residual strain."""

    def play(self, voltage: ArrayLike, *, time: ArrayLike | None = None, measured: bool = True) -> Array:
        """Play a `voltage` (n,) [V] at the times (n,) [s]; return the displacement (n,) [m].

        `time` (n,) [s], increasing, is needed by actuators that depend on time. If it begins after the end of the last
        call, the actuator creeps during the pause. Other times start a new clock: the first sample comes one interval
        (that of the first two samples) after the last call. With `measured`, the sensor's noise is added. Raise
        `ModelError` if the voltage is not finite, or a needed time is missing or does not increase.
        """
        v = vector(voltage, "voltage")
        y = self._moved(v, time) if v.size else v
        return self._sensor.read(y) if measured else y

    @property
    def kind(self) -> str:
        """Kind of actuator, for the fingerprint."""
        return type(self).__name__.removesuffix("Actuator").lower()

    def parameters(self) -> dict[str, Any]:
        """Return the parameters by name."""
        if is_dataclass(self):
            return {field.name: getattr(self, field.name) for field in fields(self) if field.init}
        return {"stroke": self.stroke, "highest": self.highest}

    def fingerprint(self) -> str:
        """Return kind and hash: equal for equal parameters."""
        text = json.dumps(self.parameters(), sort_keys=True, default=float)
        return f"{self.kind}-{hashlib.sha256(text.encode()).hexdigest()[:_DIGITS]}"

    @abstractmethod
    def _moved(self, v: Array, time: ArrayLike | None) -> Array:
        """Move by a voltage (n,) [V], n > 0, and return the displacement (n,) [m]."""


class Clock:
    """Converter of the times of successive calls into time steps.

    `times` (n + 1,) [s]: the time one step before the last call, then the n times of that call.
    """

    def __init__(self) -> None:
        self.times: Array = np.zeros(1)
        self._last: float | None = None

    def steps(self, time: ArrayLike | None, count: int, why: str) -> Array:
        """Return the seconds (n,) that pass before each of `count` samples.

        Times that begin after the end of the last call continue from it. Other times start a new clock: the first
        sample comes one interval (that of the first two samples) after the last call, or after the rest at 0 V. Raise
        `ModelError` if the time is missing, has another length, does not increase, or has no such interval.
        """
        if time is None:
            raise ModelError(f"this actuator {why}: it needs the time of each sample; give the time [s]")
        at = vector(time, "time")
        if at.size != count:
            raise ModelError(
                f"got {at.size} samples, the voltage has {count}", argument="time", hint="need one time for each"
            )
        gaps = np.diff(at)
        if np.any(gaps <= 0):
            raise ModelError(
                f"time: does not increase at sample {int(np.argmax(gaps <= 0)) + 1}; need seconds, in order"
            )
        last, self._last = self._last, float(at[-1])
        if last is not None and at[0] > last:
            self.times = np.concatenate([[last], at])
            return np.concatenate([[at[0] - last], gaps])
        if count < 2:
            raise ModelError(
                "got one sample that does not continue an earlier call", argument="time", hint="need two at least"
            )
        self.times = np.concatenate([[2 * at[0] - at[1]], at])
        return np.concatenate([gaps[:1], gaps])


class Sensor:
    """A sensor with seeded white noise; raise `ModelError` if the standard deviation is negative."""

    def __init__(self, noise: float, seed: int) -> None:
        if not 0 <= noise < np.inf:
            raise ModelError(argument="noise", got=noise, need="a standard deviation in metres, 0 or more")
        self._noise = noise
        self._random = np.random.default_rng(seed)

    def read(self, y: Array) -> Array:
        """Return the displacement (n,) [m] as measured."""
        return y + self._random.normal(0.0, self._noise, y.size) if self._noise else y


def cubic_map(w: Array, asymmetry: float, bend: float) -> Array:
    """Return ``w + asymmetry w (w - 1) + bend w (w - 1)(w - 1/2)``, which maps 0 to 0 and 1 to 1."""
    return w + asymmetry * w * (w - 1) + bend * w * (w - 1) * (w - 0.5)


def refuse_falling_map(asymmetry: float, bend: float) -> None:
    """Raise ModelError unless the cubic map increases from -0.1 to 1.1."""
    if np.any(np.diff(cubic_map(np.linspace(-0.1, 1.1, 400), asymmetry, bend)) <= 0):
        raise ModelError(f"asymmetry {asymmetry} and bend {bend}: the map must increase; try less")
