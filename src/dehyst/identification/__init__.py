"""Identification: from records to an actuator."""

from dehyst.identification.coupling.identify import StageFit, identify_stage
from dehyst.identification.expectation import Expectation, Readiness
from dehyst.identification.fit import Fit
from dehyst.identification.identify import identify
from dehyst.identification.results import Check, RecordErrors, RemainingError, Trace, Verdict
from dehyst.identification.settings import Deadline, Method
from dehyst.identification.solvers.program import Norm
from dehyst.identification.structure import Structure
from dehyst.identification.validation import initial_state, state_after
from dehyst.model.identification import Outcome

__all__ = [
    "Check",
    "Deadline",
    "Expectation",
    "Fit",
    "Method",
    "Norm",
    "Outcome",
    "Readiness",
    "RecordErrors",
    "RemainingError",
    "StageFit",
    "Structure",
    "Trace",
    "Verdict",
    "identify",
    "identify_stage",
    "initial_state",
    "state_after",
]
