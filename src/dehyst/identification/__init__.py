"""Identification: from records to an actuator."""

from dehyst.identification.deadline import Deadline
from dehyst.identification.identify import identify
from dehyst.identification.settings import Method
from dehyst.identification.solvers.program import Norm
from dehyst.identification.validation import state_after

__all__ = ["Deadline", "Method", "Norm", "identify", "state_after"]
