"""Identification: from records to an actuator."""

from dehyst.identification.coupling.identify import StageFit, identify_stage
from dehyst.identification.coupling.matrix import (
    BARELY,
    INSEPARABLE,
    AxisTraces,
    PlayColumns,
    coupling_by_plays,
    refuse_still,
    separate_motion,
)
from dehyst.identification.diagnostics.branches import Branch, families, voltage_at
from dehyst.identification.diagnostics.identifiability import Identifiability, identifiability, probed
from dehyst.identification.expectation import Readiness
from dehyst.identification.fit import Fit, label
from dehyst.identification.identify import identify
from dehyst.identification.preprocessing import cleaning
from dehyst.identification.preprocessing.cleaning import cycle_time
from dehyst.identification.preprocessing.preparation import Prepared, as_list, prepare
from dehyst.identification.preprocessing.regressors import epochs
from dehyst.identification.regression.nuisances import searched_delay, worthwhile
from dehyst.identification.results import Check, RecordErrors, Trace, Verdict, write_traces
from dehyst.identification.settings import Deadline
from dehyst.identification.solvers.program import Norm, Solution, solve
from dehyst.identification.structure import Grid, Structure
from dehyst.identification.validation import (
    RecordComparison,
    compare,
    compare_all,
    errors_of,
    initial_state,
    prepare_for,
    state_after,
    without_offset,
)
from dehyst.model import Outcome

__all__ = [
    "Check",
    "Deadline",
    "Fit",
    "Outcome",
    "Readiness",
    "RecordErrors",
    "StageFit",
    "Structure",
    "Trace",
    "Verdict",
    "identify",
    "identify_stage",
    "initial_state",
    "state_after",
]
