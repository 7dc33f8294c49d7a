"""dehyst takes the hysteresis out of piezoelectric actuators.

It makes a physical model from measured loops, and voltages for a wanted path::

    record = dehyst.read("loops.csv")
    fit = dehyst.identify(record)
    plan = dehyst.plan_path(fit.actuator, wanted_displacement, time=time)
"""

from __future__ import annotations

from importlib import import_module
from sys import modules

from dehyst._version import __version__

TYPE_CHECKING = False  # type checkers take it for True; `typing` is not loaded
if TYPE_CHECKING:
    from dehyst._errors import (
        DehystError,
        FileFormatError,
        IdentifyError,
        ModelError,
        RecordError,
        RigError,
    )
    from dehyst.calibration import calibrate
    from dehyst.control import (
        Bank,
        ClampWarning,
        Compensator,
        Feedback,
        PathPlan,
        Repetition,
        VoltageLimits,
        plan_path,
        wave_table,
    )
    from dehyst.exports import export

    # mypy takes a module and a function of the same name for two definitions.
    from dehyst.identification import (  # type: ignore[no-redef]
        Fit,
        Structure,
        identify,
    )
    from dehyst.model import (
        Actuator,
        DisplacementCreep,
        Dynamics,
        MaxwellSlip,
        Spring,
        Stage,
        State,
        Thermal,
    )
    from dehyst.records import Columns, Record, read, write_record
    from dehyst.trust import check, compare, insight, update  # type: ignore[no-redef]

# The room of each public name. A room is imported at the first use: a control loop does not load identification.
_ROOM_OF = {
    name: room
    for room, names in {
        "_errors": "DehystError FileFormatError IdentifyError ModelError RecordError RigError",
        "control": "Bank ClampWarning Compensator Feedback PathPlan Repetition VoltageLimits plan_path wave_table",
        "exports": "export",
        "identification": "Fit Structure identify",
        "calibration": "calibrate",
        "model": "Actuator DisplacementCreep Dynamics MaxwellSlip Spring Stage State Thermal",
        "records": "Columns Record read write_record",
        "trust": "check compare insight update",
    }.items()
    for name in names.split()
}
# Rooms that are attributes of the package without a separate import.
_ROOMS = {room.split(".")[0] for room in _ROOM_OF.values()} | {"fleet", "paper", "report", "virtual", "waveforms"}

__all__ = ["Actuator", "Bank", "ClampWarning", "Columns", "Compensator", "DehystError"]
__all__ += ["DisplacementCreep", "Dynamics", "Feedback", "FileFormatError", "Fit", "IdentifyError", "MaxwellSlip"]
__all__ += ["ModelError", "PathPlan", "Record", "RecordError", "Repetition", "RigError", "Spring"]
__all__ += ["Stage", "State", "Structure", "Thermal", "VoltageLimits", "__version__"]
__all__ += ["calibrate", "check", "compare", "export", "identify", "insight"]
__all__ += ["plan_path", "read", "update", "wave_table", "write_record"]


def __getattr__(name: str) -> object:
    if name in _ROOM_OF:
        value = getattr(import_module(f"dehyst.{_ROOM_OF[name]}"), name)
        globals()[name] = value
        return value
    if name in _ROOMS:
        return import_module(f"dehyst.{name}")
    # From these two fields Python suggests the nearest name.
    raise AttributeError(f"module 'dehyst' has no attribute '{name}'", name=name, obj=modules[__name__])


def __dir__() -> list[str]:
    return sorted(__all__)
