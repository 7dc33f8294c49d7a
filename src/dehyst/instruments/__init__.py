"""Rigs: where a voltage meets an actuator. Each driver serves one kind of instrument and imports no other driver."""

from dehyst._errors import DeviceError, LinkError, RigError, SensorError
from dehyst.instruments.addresses import open_rig, open_stage_rig
from dehyst.instruments.base import AbstractRig
from dehyst.instruments.host_timed import HIGHEST_RATE, host_timed
from dehyst.instruments.samples import Listener, Reading, Samples
from dehyst.instruments.stage import AbstractStageRig, StageListener, StageSamples

__all__ = [
    "HIGHEST_RATE",
    "AbstractRig",
    "AbstractStageRig",
    "DeviceError",
    "LinkError",
    "Listener",
    "Reading",
    "RigError",
    "Samples",
    "SensorError",
    "StageListener",
    "StageSamples",
    "host_timed",
    "open_rig",
    "open_stage_rig",
]
