"""The preview of a loop: a filter that makes up for delay and inertia."""

from __future__ import annotations

import math

import numpy as np

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst.model import Actuator

# A delay this close to a whole number of steps is that number.
_WHOLE = 1e-9
# Most steps of a delay, or of a radian of the resonance.
_FARTHEST = 1e6


def preview_filter(actuator: Actuator, period: float) -> tuple[Array, int]:
    """Return an FIR filter from the wanted displacement y to w, the displacement that the elements follow.

    ``w(t) = Y(t + delay)``, with inertia ``Y = y + 2 zeta/omega y' + y''/omega^2``; between samples, y is the
    polynomial through the nearest samples. Raise `ModelError` if the delay, or one radian of the resonance, takes more
    than a million steps of `period` [s].

    Returns
    -------
    taps : (M,) array
        w is the sum of taps[m] times the input displacement m samples ago.
    ahead : int
        Number of samples by which the input displacement is ahead.
    """
    delay, dynamics = actuator.delay / period, actuator.dynamics
    if delay > _FARTHEST or (dynamics is not None and dynamics.omega * period < 1 / _FARTHEST):
        raise ModelError(
            f"got {period:g} s, which is too short to look ahead by a delay of {actuator.delay:g} "
            "s or a period of the resonance",
            argument="period",
            hint="give a longer one, or leave preview out",
        )
    # Remove the rounding of a whole number of periods.
    delay = round(delay) if abs(delay - round(delay)) < _WHOLE else delay
    whole = math.floor(delay)
    if dynamics is None and delay == whole:
        return np.ones(1), whole
    # Symmetric about the delay: the error of a derivative is then one order smaller.
    near = (1 if dynamics is None else 2) + (delay != whole)
    offsets = np.arange(whole + (delay != whole) - near, whole + near + 1, dtype=np.float64)
    # Weights of the samples in value and derivatives, at the delay, of the polynomial through them: a column an order.
    powers = np.vander(np.subtract(offsets, delay), increasing=True).T
    taps, first, second = (np.linalg.solve(powers, math.factorial(n) * np.eye(offsets.size)[n]) for n in range(3))
    if dynamics is not None:
        steps = dynamics.omega * period
        taps = taps + (2 * dynamics.damping * first + second / steps) / steps
    return np.ascontiguousarray(taps[::-1]), int(offsets[-1])
