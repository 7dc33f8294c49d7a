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
from dehyst.actuator import Actuator
from dehyst.compensator import ClampWarning, Compensator
from dehyst.creep import Creep
from dehyst.dynamics import Dynamics
from dehyst.elements import GradedSlip, MaxwellSlip, Spring, Transformer
from dehyst.files import read, write_record
from dehyst.fit import Fit, Outcome, RecordErrors, Trace
from dehyst.identify import identify
from dehyst.model import Motion, State
from dehyst.physical import Physical
from dehyst.record import Record
from dehyst.smooth import SmoothSlip
from dehyst.snapshot import Snapshot
from dehyst.trajectory import Command
from dehyst.version import __version__

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
