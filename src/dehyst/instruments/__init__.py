"""Rigs: instruments that drive an actuator. Each driver serves one kind of instrument and imports no other driver."""

from dehyst._errors import DeviceError, LinkError, RigError, SensorError
from dehyst.instruments.addresses import open_rig
from dehyst.instruments.base import AbstractRig
from dehyst.instruments.waves import HIGHEST_RATE, Reading, Samples, StepFunction, played_rate

__all__ = [
    "AbstractRig",
    "DeviceError",
    "LinkError",
    "Reading",
    "RigError",
    "Samples",
    "SensorError",
    "open_rig",
]
