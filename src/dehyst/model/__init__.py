"""The model: an actuator, its parts and its state."""

from dehyst.model.actuator import Actuator, evaluator_of
from dehyst.model.base import AbstractModel, Motion, State
from dehyst.model.branches import CELLS, ExciteCommand, Untested, branches_of, distances, paces_of, tested_loops
from dehyst.model.dynamics import DisplacementCreep, Dynamics, Thermal, mechanical_response
from dehyst.model.elements import (
    GradedSlip,
    MaxwellSlip,
    SmoothSlip,
    Spring,
    Transformer,
    on_curve,
    parts_in_segments,
    segment_of,
)
from dehyst.model.evaluator import PathData
from dehyst.model.identification import Identification, Outcome, with_identification
from dehyst.model.physical import Physical
from dehyst.model.promise import USELESS, Promise, Validity, untested
from dehyst.model.stage import Stage, apply, by_axis, dot, inverse, matrix_lines
from dehyst.model.states import (
    NEAR,
    Range,
    at_reference,
    beginning,
    creep_times,
    knots_of,
    looped,
    major_loop,
    needs_time,
    quasistatic,
    simulated,
    slow_motion,
    standing,
    state_after_loops,
    state_at,
    state_within_limits,
    stroke_of,
    timed,
    turned,
    voltage_error,
    voltages_of,
)
from dehyst.model.summary import parts_of, step_response
from dehyst.model.temperatures import demand_thermal, temperature_columns, temperature_range

__all__ = [
    "Actuator",
    "DisplacementCreep",
    "Dynamics",
    "GradedSlip",
    "MaxwellSlip",
    "Physical",
    "SmoothSlip",
    "Spring",
    "Stage",
    "State",
    "Thermal",
    "Transformer",
]
