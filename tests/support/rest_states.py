"""Actuators at rest in any state."""

import numpy as np
import plain_records

from dehyst import State
from dehyst.model import evaluator_of

PLANT = plain_records.plant(10, seed=4)


def equilibrium(actuator, voltage, rng):
    """Any elongations at all; the spring holds the rest of the voltage."""
    rho = actuator.slip.breakaway
    s = rng.uniform(-1, 1, rho.size) * rho * rng.choice([0.1, 1.0])
    at_ends = rng.random(rho.size) < rng.choice([0.0, 0.0, 0.5, 1.0])
    s = np.where(at_ends, np.where(rng.random(rho.size) < 0.5, -rho, rho), s)
    y = evaluator_of(actuator).core.spring_inverse(voltage - float(actuator.slip.stiffness @ s))
    return State(y, y - s)
