"""The loop of a compensator in the C core: its numbers, its preview, and its memory."""

from __future__ import annotations

import math
from typing import NoReturn

import numpy as np

from dehyst._errors import ModelError
from dehyst._native import CoreState, Loop
from dehyst._types import Array
from dehyst.control.limits import VoltageLimits, warn_of_sample
from dehyst.model import Actuator, evaluator_of

# A delay this close to a whole number of steps is that number.
_WHOLE = 1e-9
# Most steps of a delay, or of a radian of the resonance.
_FARTHEST = 1e6


class ReadOnly:
    """An object whose attributes only its own methods set, with `keep`."""

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise AttributeError(f"{name} cannot be set; make another {type(self).__name__}")


def make_loop(
    actuator: Actuator,
    limits: VoltageLimits,
    period: float | None,
    taps: Array,
    start: CoreState,
    *,
    warns: bool = True,
    assumed: bool = False,
) -> Loop:
    """Return a loop that starts in a state, which may be only `assumed`.

    Raise `ModelError` if a period is missing, too long for a resonance, or too short for the slew rate.
    """
    model, slew, seconds = evaluator_of(actuator), limits.slew_rate, period or 0.0
    if period is None and (model.needs_time or slew is not None):
        words = "creep, inertia, a lag or a slew rate need the time between steps"
        raise ModelError(words, hint="give the period [s]", change=("period",))
    coefficients = model.step_coefficients(np.array([0, 1]), np.array([seconds]))
    most = float(np.finfo(np.float64).max)
    change = most if slew is None else min(slew * seconds, most)
    if change <= 0:
        words = f"{slew:g} V/s allow no change in {seconds:g} s"
        raise ModelError(words, argument="slew_rate", hint="give more, or a longer period")
    numbers = np.array([limits.low, limits.high, change, *model.amplifier(seconds)])

    def warn(slewed: bool, displacement: float, voltage: float, before: float) -> None:
        guess = before if assumed and before == begin else None
        warn_of_sample(actuator, limits, slewed, displacement, voltage, guess)

    loop = model.core.loop(coefficients, taps, numbers, warn if warns else lambda *_: None, start)
    begin = loop.sent()
    return loop


def memory_of(loop: Loop) -> tuple[CoreState, Array, tuple[int, int, int]]:
    """Return the whole memory of a loop: state, the rest and counts."""
    return CoreState(*loop.state()), loop.rest(), loop.counts()


def set_memory(loop: Loop, state: CoreState, rest: Array, counts: tuple[int, int, int]) -> None:
    """Set the whole memory of a loop."""
    loop.begin(*state)
    loop.go_on(rest, *counts)


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
