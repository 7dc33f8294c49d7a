"""An actuator of each kind of model that an identification may choose, with the same stroke and voltage range."""

import numpy as np

from dehyst import Actuator, DisplacementCreep, Dynamics, MaxwellSlip, Spring
from dehyst.model import GradedSlip, SmoothSlip, Transformer

STROKE, VOLTS = 16e-6, 200.0
_RHO = STROKE / 20 * np.arange(1, 6)
_SLOPE = VOLTS / STROKE
_GRADES = STROKE * np.array([0.0, 0.5, 1.0])
_BASE = {
    "slip": MaxwellSlip(_RHO, np.full(5, 0.06 * _SLOPE)),
    "spring": Spring([0.0, 0.5 * STROKE, STROKE], [0.0, 0.45 * VOLTS, 0.8 * VOLTS]),
    "limits": (0.0, VOLTS),
}
PARTS = {
    "plain": {},
    "transformer": {"transformer": Transformer([0.0, 0.5 * VOLTS, VOLTS], [0.0, 0.4 * VOLTS, VOLTS])},
    "graded": {"slip": GradedSlip(_RHO, _GRADES, np.full((5, 2), 0.06 * _SLOPE) * [1.0, 0.9])},
    "creep": {"displacement_creep": DisplacementCreep([0.02, 0.5], [0.03, 0.03])},
    "smooth": {"smooth": SmoothSlip([0.1 * STROKE], [0.5], [0.05 * _SLOPE])},
    "inertia": {"dynamics": Dynamics(1000.0 / np.pi, 0.05)},
    "lag": {"lag": 1e-4},
    "delay": {"delay": 1e-3},
}
PARTS["all"] = {name: value for parts in PARTS.values() for name, value in parts.items()}
NEEDING_TIME = ("creep", "inertia", "lag", "all")


def anatomy(kind):
    """An actuator of the given kind."""
    return Actuator(**{**_BASE, **PARTS[kind]})
