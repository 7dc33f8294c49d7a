"""Identification: from records to an actuator."""

from dehyst.identification.checking.changes import Change
from dehyst.identification.checking.comparison import check
from dehyst.identification.checking.history import CheckHistory
from dehyst.identification.checking.recheck import Recheck, Standing
from dehyst.identification.deadline import Deadline
from dehyst.identification.identify import identify
from dehyst.identification.settings import Method
from dehyst.identification.solvers.program import Norm
from dehyst.identification.validation import state_after

__all__ = [
    "Change",
    "CheckHistory",
    "Deadline",
    "Method",
    "Norm",
    "Recheck",
    "Standing",
    "check",
    "identify",
    "state_after",
]
