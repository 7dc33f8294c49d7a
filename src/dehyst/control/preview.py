"""The preview of a compensator: delay and inertia compensated from samples of the path that are known ahead."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst.model import Actuator

# A delay this close to a whole number of steps is that number.
_WHOLE = 1e-9
# Most steps of a delay, or of a radian of the resonance.
_FARTHEST = 1e6


@dataclass(frozen=True, eq=False)
class Preview:
    """An FIR filter from the wanted displacement y to w, the displacement that the elements follow.

    ``w(t) = Y(t + delay)``, with inertia ``Y = y + 2 zeta/omega y' + y''/omega^2``; between samples y is the polynomial
    through the nearest samples.

    `taps` (M,): w is the sum of taps[m] times the displacement fed m samples ago. `ahead`: number of samples by which
    the fed displacement is ahead.
    """

    taps: Array
    ahead: int

    @classmethod
    def none(cls) -> Preview:
        """Return the filter that leaves the displacement unchanged."""
        return cls(np.ones(1), 0)

    @classmethod
    def of(cls, actuator: Actuator, period: float) -> Preview:
        """Return the filter for the delay and the dynamics of an actuator, with a step every `period` [s].

        Raise `ModelError` if the delay, or a radian of the resonance, takes more than a million steps.
        """
        delay, dynamics = actuator.delay / period, actuator.dynamics
        if delay > _FARTHEST or (dynamics is not None and dynamics.frequency * period < 1 / _FARTHEST):
            raise ModelError(
                f"period: got {period:g} s, which is too short to look ahead by a delay of {actuator.delay:g} s or a "
                "period of the resonance; give a longer one, or leave preview out"
            )
        # Remove the rounding of a whole number of periods.
        delay = round(delay) if abs(delay - round(delay)) < _WHOLE else delay
        whole = math.floor(delay)
        if dynamics is None and delay == whole:
            return cls(np.ones(1), whole)
        # Symmetric about the delay: the error of a derivative is then one order smaller.
        near = (1 if dynamics is None else 2) + (delay != whole)
        offsets = np.arange(whole + (delay != whole) - near, whole + near + 1, dtype=np.float64)
        weights = np.array([_weights(np.subtract(offsets, delay), order) for order in range(3)])
        taps = weights[0]
        if dynamics is not None:
            steps = dynamics.frequency * period
            taps = taps + (2 * dynamics.damping * weights[1] + weights[2] / steps) / steps
        return cls(np.ascontiguousarray(taps[::-1]), int(offsets[-1]))


def _weights(offsets: Array, order: int) -> Array:
    """Return the weights of values at offsets [samples] in a derivative at 0 of the polynomial through them."""
    powers = np.vander(offsets, increasing=True).T
    return np.linalg.solve(powers, math.factorial(order) * np.eye(offsets.size)[order])
