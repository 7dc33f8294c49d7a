"""The model: an actuator, its parts and its state."""

from dehyst.model.actuator import Actuator
from dehyst.model.base import AbstractModel, Motion, State
from dehyst.model.dynamics import Creep, Dynamics
from dehyst.model.elements import GradedSlip, MaxwellSlip, SmoothSlip, Spring, Transformer
from dehyst.model.identification import Identification
from dehyst.model.physical import Physical
from dehyst.model.stage import Stage
from dehyst.model.states import simulated

__all__ = [
    "AbstractModel",
    "Actuator",
    "Creep",
    "Dynamics",
    "GradedSlip",
    "Identification",
    "MaxwellSlip",
    "Motion",
    "Physical",
    "SmoothSlip",
    "Spring",
    "Stage",
    "State",
    "Transformer",
    "simulated",
]
