"""dehyst takes the hysteresis out of piezoelectric actuators.

Measured loops in, a physical model and the cancelling voltage out::

    record = dehyst.read("loops.csv")
    fit = dehyst.identify(record)
    command = dehyst.Compensator(fit.actuator, period=1e-3).trajectory(wanted_displacement)
"""

from dehyst._errors import (
    DehystError,
    FileFormatError,
    IdentifyError,
    MissingExtraError,
    ModelError,
    RecordError,
)
from dehyst._version import __version__
from dehyst.control import ClampWarning, Command, Compensator, Snapshot
from dehyst.identification import identify
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
    Trace,
    Transformer,
)
from dehyst.records import Record, read, write_record

__all__ = [
    "Actuator",
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
    "SmoothSlip",
    "Snapshot",
    "Spring",
    "State",
    "Trace",
    "Transformer",
    "__version__",
    "identify",
    "read",
    "write_record",
]
