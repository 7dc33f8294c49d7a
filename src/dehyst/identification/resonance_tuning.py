"""Tuning of resonance, damping, delay and lag by the simulation error.

Least squares of an equation underestimates the mass where the second derivative is noisy, because noise acts as motion;
a simulation needs no derivative.
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

# An amplifier's lag must reduce the RMS error to this share, or it is left out: its effect is much like a delay's.
_WORTH_OF_LAG = 0.9
# Start of the search for the lag [1/omega], and its finite differences.
_FIRST_LAG = 0.05
_STEP = 1e-3


def tune_resonance(actuator: Actuator, simulation: SimulationError) -> Actuator:
    """Return the actuator with the dynamics, delay and lag of least RMS simulation error, by least squares.

    Parameters
    ----------
    actuator : Actuator
        With dynamics.
    simulation : SimulationError
        Of records in which the actuator rings.
    """
    if actuator.dynamics is None:
        return actuator
    without = _significant(_best(actuator, simulation, lagging=False), simulation)
    lagging = _significant(_best(without, simulation, lagging=True), simulation)
    worth = rms(simulation.errors(lagging)) < _WORTH_OF_LAG * rms(simulation.errors(without))
    return lagging if worth else without


def _significant(actuator: Actuator, simulation: SimulationError) -> Actuator:
    """Return the actuator without a delay or lag that has no effect in the records."""
    sample = min((epoch.record.record.sample_time for epoch in simulation.epochs), default=0.0)
    return replace(
        actuator, delay=significant_delay(actuator.delay, sample), lag=significant_delay(actuator.lag, sample)
    )


def _best(actuator: Actuator, simulation: SimulationError, *, lagging: bool) -> Actuator:
    from scipy.optimize import least_squares

    start = actuator.dynamics
    if start is None:
        return actuator
    unit = 1 / start.frequency

    def with_numbers(x: Array) -> Actuator:
        # Numbers near 1, because finite differences are relative to them.
        frequency, damping, delay, *lag = (x - 1).tolist()
        return replace(
            actuator,
            dynamics=Dynamics(start.frequency * exp(frequency), max(start.damping + damping, 0), start.series),
            delay=max(actuator.delay + delay * unit, 0),
            lag=max(_FIRST_LAG + lag[0], 0) * unit if lag else actuator.lag,
        )

    stroke = float(np.ptp(actuator.spring.displacement))

    def error(x: Array) -> Array:
        return simulation.errors(with_numbers(x)) / stroke

    # Delay, lag and damping are not negative; the start lies a finite difference inside, where slopes exist.
    least = 1 - np.array([np.inf, start.damping, actuator.delay / unit, *([_FIRST_LAG] if lagging else [])])
    first = np.maximum(np.ones(least.size), least + 2 * _STEP)
    steps = np.full(first.size, _STEP)
    return with_numbers(least_squares(error, first, x_scale=0.1, diff_step=steps, bounds=(least, np.inf)).x)
