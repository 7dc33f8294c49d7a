"""The former name of `dehyst.instruments`, kept for one release for users' own rigs."""

import warnings

from dehyst.instruments import (
    AbstractRig,
    DeviceError,
    LinkError,
    Listener,
    Reading,
    RigError,
    Samples,
    SensorError,
    open_rig,
)

__all__ = [
    "AbstractRig",
    "DeviceError",
    "LinkError",
    "Listener",
    "Reading",
    "RigError",
    "Samples",
    "SensorError",
    "open_rig",
]

warnings.warn("dehyst.rigs is now dehyst.instruments; import from there", DeprecationWarning, stacklevel=2)
