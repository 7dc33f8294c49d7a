"""Rigs: where a voltage meets an actuator. Each leaf speaks to one kind of instrument, and knows no other leaf."""

from dehyst._errors import DeviceError, LinkError, RigError, SensorError
from dehyst.instruments.addresses import open_rig
from dehyst.instruments.base import AbstractRig, Listener, Reading, Samples

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
