"""The model: an actuator, its parts, and what an identification returns."""

from dehyst.model.actuator import Actuator
from dehyst.model.base import AbstractModel, Motion, State
from dehyst.model.creep import Creep
from dehyst.model.dynamics import Dynamics
from dehyst.model.elements import GradedSlip, MaxwellSlip, Spring, Transformer
from dehyst.model.fit import Check, Fit, Outcome, RecordErrors, RemainingError, Trace, Verdict
from dehyst.model.physical import Physical
from dehyst.model.readiness import Expectation, Readiness
from dehyst.model.replay import simulated
from dehyst.model.smooth_slip import SmoothSlip
from dehyst.model.structure import Structure

__all__ = [
    "AbstractModel",
    "Actuator",
    "Check",
    "Creep",
    "Dynamics",
    "Expectation",
    "Fit",
    "GradedSlip",
    "MaxwellSlip",
    "Motion",
    "Outcome",
    "Physical",
    "Readiness",
    "RecordErrors",
    "RemainingError",
    "SmoothSlip",
    "Spring",
    "State",
    "Structure",
    "Trace",
    "Transformer",
    "Verdict",
    "simulated",
]
