"""Resonance, damping, delay and lag that simulate records best.

Least squares of an equation takes too small a mass where the second derivative is noisy, for noise counts as motion; a
simulation derives nothing.
"""

from __future__ import annotations

from dataclasses import replace
from math import exp

import numpy as np

from dehyst._types import Array
from dehyst.identification.dynamics_search import significant_delay
from dehyst.identification.simulation_error import SimulationError
from dehyst.model import Actuator, Dynamics
from dehyst.records.metrics import rms

# An amplifier's lag must lower the RMS error to this part, or it is left out: it looks much like a delay.
_WORTH_OF_LAG = 0.9
# What the search starts the lag from [of 1/omega], and steps by.
_FIRST_LAG = 0.05
_STEP = 1e-3


def tune_resonance(actuator: Actuator, playback: SimulationError) -> Actuator:
    """The same actuator with the dynamics, delay and lag of least RMS simulation error, by least squares.

    Parameters
    ----------
    actuator : Actuator
        With dynamics.
    playback : SimulationError
        Of records in which it rings.
    """
    if actuator.dynamics is None:
        return actuator
    without = _felt(_nearest(actuator, playback, lagging=False), playback)
    lagging = _felt(_nearest(without, playback, lagging=True), playback)
    worth = rms(playback.errors(lagging)) < _WORTH_OF_LAG * rms(playback.errors(without))
    return lagging if worth else without


def _felt(actuator: Actuator, playback: SimulationError) -> Actuator:
    """The same without a delay or lag that the records cannot show."""
    sample = min((one.record.record.sample_time for one in playback.stretches), default=0.0)
    return replace(
        actuator, delay=significant_delay(actuator.delay, sample), lag=significant_delay(actuator.lag, sample)
    )


def _nearest(actuator: Actuator, playback: SimulationError, *, lagging: bool) -> Actuator:
    from scipy.optimize import least_squares

    start = actuator.dynamics
    if start is None:
        return actuator
    unit = 1 / start.frequency

    def with_numbers(x: Array) -> Actuator:
        # All near 1, for steps of differences are parts of them.
        frequency, damping, delay, *lag = (x - 1).tolist()
        return replace(
            actuator,
            dynamics=Dynamics(start.frequency * exp(frequency), max(start.damping + damping, 0), start.series),
            delay=max(actuator.delay + delay * unit, 0),
            lag=max(_FIRST_LAG + lag[0], 0) * unit if lag else actuator.lag,
        )

    stroke = float(np.ptp(actuator.spring.displacement))

    def error(x: Array) -> Array:
        return playback.errors(with_numbers(x)) / stroke

    # Nothing comes early, or is pushed on; a step of a difference inside, where there are still slopes.
    least = 1 - np.array([np.inf, start.damping, actuator.delay / unit, *([_FIRST_LAG] if lagging else [])])
    first = np.maximum(np.ones(least.size), least + 2 * _STEP)
    steps = np.full(first.size, _STEP)
    return with_numbers(least_squares(error, first, x_scale=0.1, diff_step=steps, bounds=(least, np.inf)).x)
