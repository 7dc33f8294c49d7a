"""The voltage limits and the slew rate of a compensator."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst._validation import interval, keep, number, untimely, vector

# The hint in errors about a missing time of the samples.
TIME_NEEDED = "give time= [s], one a sample, or make the Compensator with period= [s]"


@dataclass(frozen=True)
class VoltageLimits:
    """Limits of a voltage and of its slew rate.

    `low`, `high`: lowest and highest voltage [V]. `slew_rate`: largest abs(dv/dt) [V/s] between samples; default: not
    limited. Raise `ModelError` if they are not an interval, or the slew rate is not positive.
    """

    low: float
    high: float
    slew_rate: float | None = None

    def __post_init__(self) -> None:
        low, high = interval((self.low, self.high))
        keep(self, low=low, high=high)
        if self.slew_rate is not None:
            slew_rate = number(self.slew_rate, "slew_rate")
            if slew_rate <= 0:
                raise ModelError(f"slew_rate: got {self.slew_rate}, need a positive number of volts a second")
            keep(self, slew_rate=slew_rate)

    @property
    def words(self) -> str:
        """The limits as text, for a sentence."""
        return f"{self.low:.6g} to {self.high:.6g} V"

    def nearest(self, voltage: float) -> float:
        """Return the `voltage` [V], or the limit that it exceeds."""
        return min(max(voltage, self.low), self.high)

    def steps(self, size: int, time: ArrayLike | None) -> Array:
        """Return the largest voltage step [V] before each of `size` samples at `time` (n,) [s]."""
        if self.slew_rate is None:
            return np.full(size, np.inf)
        if time is None:
            raise ModelError(f"a slew rate needs the time of each sample; {TIME_NEEDED}")
        t = vector(time, "time")
        if t.size != size or np.any(np.diff(t) <= 0):
            raise ModelError(untimely(t, size))
        return np.concatenate([[np.inf], self.slew_rate * np.diff(t)])[:size]

    def allowed(self, voltage: Array, before: float, steps: Array) -> Array:
        """Return a wanted `voltage` (n,) [V], clipped; correct up to and including the first sample that is changed.

        `before` is the voltage [V] sent before, `steps` (n,) [V] the largest step before each sample.
        """
        previous = np.concatenate([[before], voltage[:-1]])
        # Limits come last: the slew rate must not push a voltage out of them.
        return np.clip(np.clip(voltage, previous - steps, previous + steps), self.low, self.high)
