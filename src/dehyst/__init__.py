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
from dehyst.control.compensator import ClampWarning, Compensator
from dehyst.control.snapshot import Snapshot
from dehyst.control.trajectory import Command
from dehyst.identification.identify import identify
from dehyst.model.actuator import Actuator
from dehyst.model.base import Motion, State
from dehyst.model.creep import Creep
from dehyst.model.dynamics import Dynamics
from dehyst.model.elements import GradedSlip, MaxwellSlip, Spring, Transformer
from dehyst.model.fit import Fit, Outcome, RecordErrors, Trace
from dehyst.model.physical import Physical
from dehyst.model.smooth_slip import SmoothSlip
from dehyst.records.files import read, write_record
from dehyst.records.record import Record

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
