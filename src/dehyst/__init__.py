"""dehyst takes the hysteresis out of piezoelectric actuators.

Measured loops in, a physical model and the cancelling voltage out::

    record = dehyst.read("loops.csv")
    fit = dehyst.identify(record)
    command = dehyst.Compensator(fit.actuator, period=1e-3).trajectory(wanted_displacement)
"""

from __future__ import annotations

from sys import modules
from typing import TYPE_CHECKING, Any

from dehyst._errors import (
    DehystError,
    FileFormatError,
    IdentifyError,
    MissingExtraError,
    ModelError,
    RecordError,
    RigError,
)
from dehyst._version import __version__
from dehyst.control import (
    ClampWarning,
    Command,
    Compensator,
    Snapshot,
    VoltageLimits,
    shortest_homing,
    wave_table,
)
from dehyst.identification import check, identify
from dehyst.model import (
    Actuator,
    Creep,
    Dynamics,
    Fit,
    GradedSlip,
    MaxwellSlip,
    Motion,
    Outcome,
    Physical,
    RecordErrors,
    SmoothSlip,
    Spring,
    State,
    Structure,
    Trace,
    Transformer,
)
from dehyst.records import Record, read, write_record

if TYPE_CHECKING:
    from dehyst.banks import Bank
    from dehyst.baselines import compare
    from dehyst.exports import export, export_fmu, export_wasm
    from dehyst.instruments.calibration import calibrate
    from dehyst.stages import Stage, StageCompensator, StageFit, StageRecord, identify_stage, read_stage
    from dehyst.uncertainty import insight

__all__ = [
    "Actuator",
    "Bank",
    "ClampWarning",
    "Command",
    "Compensator",
    "Creep",
    "DehystError",
    "Dynamics",
    "FileFormatError",
    "Fit",
    "GradedSlip",
    "IdentifyError",
    "MaxwellSlip",
    "MissingExtraError",
    "ModelError",
    "Motion",
    "Outcome",
    "Physical",
    "Record",
    "RecordError",
    "RecordErrors",
    "RigError",
    "SmoothSlip",
    "Snapshot",
    "Spring",
    "Stage",
    "StageCompensator",
    "StageFit",
    "StageRecord",
    "State",
    "Structure",
    "Trace",
    "Transformer",
    "VoltageLimits",
    "__version__",
    "calibrate",
    "check",
    "compare",
    "export",
    "export_fmu",
    "export_wasm",
    "identify",
    "identify_stage",
    "insight",
    "read",
    "read_stage",
    "shortest_homing",
    "wave_table",
    "write_record",
]

# Imported when they are used first: a control loop needs none of them.
_LATE = {
    "Bank": "dehyst.banks",
    "calibrate": "dehyst.instruments.calibration",
    "compare": "dehyst.baselines",
    "export": "dehyst.exports",
    "export_fmu": "dehyst.exports",
    "export_wasm": "dehyst.exports",
    "Stage": "dehyst.stages",
    "StageCompensator": "dehyst.stages",
    "StageFit": "dehyst.stages",
    "StageRecord": "dehyst.stages",
    "identify_stage": "dehyst.stages",
    "insight": "dehyst.uncertainty",
    "read_stage": "dehyst.stages",
}


def __getattr__(name: str) -> Any:
    if name not in _LATE:
        # With both, Python suggests the nearest name.
        raise AttributeError(f"module 'dehyst' has no attribute '{name}'", name=name, obj=modules[__name__])
    from importlib import import_module

    return getattr(import_module(_LATE[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
