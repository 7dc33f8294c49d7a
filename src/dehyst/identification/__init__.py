"""Identification: from records to an actuator."""

from dehyst.identification.checks import RemainingError
from dehyst.identification.cleaning import cycle_time
from dehyst.identification.comparison import (
    RecordComparison,
    coefficients,
    compare,
    compare_all,
    errors_of,
    initial_state,
    prepare_for,
    state_after,
    zero_by_voltages,
)
from dehyst.identification.coupling import SEPARATE, Plays, StageFit, refuse_still
from dehyst.identification.events import filled
from dehyst.identification.expectation import Expectation, Readiness
from dehyst.identification.fit import Fit
from dehyst.identification.frame import FOLDS, part_of, without_offset
from dehyst.identification.identifiability import Identifiability, identifiability, probed
from dehyst.identification.identify import identify
from dehyst.identification.motion import Parts
from dehyst.identification.preparation import Prepared, as_list, distinct, prepare
from dehyst.identification.program import Program, Solution
from dehyst.identification.regressors import epochs
from dehyst.identification.results import Check, RecordErrors, Trace, Verdict
from dehyst.identification.settings import Deadline
from dehyst.identification.structure import Grid, Structure

__all__ = ["Deadline", "Fit", "Structure", "identify", "initial_state", "state_after"]
