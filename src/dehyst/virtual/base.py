"""What every virtual actuator shares: its interface, its clock, its sensor."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst._validation import vector


class VirtualActuator(Protocol):
    """A virtual actuator."""

    stroke: float
    highest: float

    def relax(self) -> None:
        """Forget: at rest at 0 V, without residual strain."""

    def drive(self, voltage: ArrayLike, *, time: ArrayLike | None = None, measured: bool = True) -> Array:
        """Play a voltage (n,) [V] at the times (n,) [s]; returns the displacement (n,) [m]."""
        ...


class Clock:
    """Turns the times of one drive after another into time steps."""

    def __init__(self) -> None:
        self._last: float | None = None

    def steps(self, time: ArrayLike | None, count: int, why: str) -> Array:
        """Seconds (n,) that pass before each of `count` samples.

        A time that begins after the last drive's end goes on from there. One that begins anew follows it, or the rest
        at 0 V, by its own first interval.

        Raises
        ------
        ModelError
            If there is no time, it has another length or does not increase, or it tells no first interval.
        """
        if time is None:
            raise ModelError(f"this actuator {why}: it needs the time of each sample; give time=, in seconds")
        at = vector(time, "time")
        if at.size != count:
            raise ModelError(f"time: got {at.size} samples, the voltage has {count}; need one time for each")
        gaps = np.diff(at)
        if np.any(gaps <= 0):
            raise ModelError(
                f"time: does not increase at sample {int(np.argmax(gaps <= 0)) + 1}; need seconds, in order"
            )
        if not count:
            return at
        last, self._last = self._last, float(at[-1])
        if last is not None and at[0] > last:
            return np.concatenate([[at[0] - last], gaps])
        if count < 2:
            raise ModelError("time: got one sample that does not go on from an earlier one; need two at least")
        return np.concatenate([gaps[:1], gaps])


class Sensor:
    """White noise on a displacement, seeded.

    Raises
    ------
    ModelError
        If the standard deviation is negative.
    """

    def __init__(self, noise: float, seed: int) -> None:
        if not 0 <= noise < np.inf:
            raise ModelError(f"noise: got {noise}, need a standard deviation in metres, 0 or more")
        self._noise = noise
        self._random = np.random.default_rng(seed)

    def read(self, y: Array) -> Array:
        """The displacement (n,) [m] as measured."""
        return y + self._random.normal(0.0, self._noise, y.size) if self._noise else y
