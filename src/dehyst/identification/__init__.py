"""Identification: from records to an actuator."""

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
    "Structure",
    "Trace",
    "Verdict",
    "identify",
    "initial_state",
    "state_after",
]
