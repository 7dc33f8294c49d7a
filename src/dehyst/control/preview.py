"""What a path known some samples ahead is good for: the delay and the inertia of an actuator made up for."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst.model import Actuator

_WHOLE = 1e-9
# Steps of a delay, or of a radian of the resonance.
_FARTHEST = 1e6


@dataclass(frozen=True, eq=False)
class Preview:
    """The sum of samples that w is asked to be.

    ``w(t) = Y(t + delay)``, with inertia ``Y = y + 2 zeta/omega y' + y''/omega^2``; y between samples is the polynomial
    through the samples nearest to it.

    Attributes
    ----------
    taps : (M,) array
        w is sum of taps[m] times the displacement fed m samples ago.
    ahead : int
        By how many samples that which is fed runs ahead.
    """

    taps: Array
    ahead: int

    @classmethod
    def none(cls) -> Preview:
        """The displacement as it is."""
        return cls(np.ones(1), 0)

    @classmethod
    def of(cls, actuator: Actuator, period: float) -> Preview:
        """For the delay and dynamics of an actuator that is stepped every `period` [s].

        Raises
        ------
        ModelError
            If delay or swing take more than a million steps.
        """
        late, dynamics = actuator.delay / period, actuator.dynamics
        if late > _FARTHEST or (dynamics is not None and dynamics.frequency * period < 1 / _FARTHEST):
            raise ModelError(
                f"period: got {period:g} s, which is too short to look ahead by a delay of {actuator.delay:g} s or a "
                "swing of the mass; give a longer one, or leave preview out"
            )
        # What rounding leaves of a whole number of periods.
        late = round(late) if abs(late - round(late)) < _WHOLE else late
        whole = math.floor(late)
        if dynamics is None and late == whole:
            return cls(np.ones(1), whole)
        # Sides alike: a derivative's error then has one order less.
        near = (1 if dynamics is None else 2) + (late != whole)
        offsets = np.arange(whole + (late != whole) - near, whole + near + 1, dtype=np.float64)
        weights = np.array([_weights(np.subtract(offsets, late), order) for order in range(3)])
        taps = weights[0]
        if dynamics is not None:
            steps = dynamics.frequency * period
            taps = taps + (2 * dynamics.damping * weights[1] + weights[2] / steps) / steps
        return cls(np.ascontiguousarray(taps[::-1]), int(offsets[-1]))


def _weights(offsets: Array, order: int) -> Array:
    """Of values at these offsets [samples], for a derivative at 0 of the polynomial through them."""
    powers = np.vander(offsets, increasing=True).T
    return np.linalg.solve(powers, math.factorial(order) * np.eye(offsets.size)[order])
