"""The EPICS rig on real IOC processes, for the contract of rigs."""

import time
from contextlib import contextmanager

import pytest
from ioc_process import IocProcess

from dehyst.instruments.epics import EpicsRig
from dehyst.virtual.bench import Extremes

LOW, HIGH = -20.0, 100.0
_IOCS = []


class RemoteInstrument:
    """The instrument of an IOC process, as tests of rigs need it: at 0 V, with an empty log."""

    def __init__(self, ioc):
        self.__dict__["ioc"] = ioc
        ioc.do("instrument.axis.unplugged = False; instrument.stop(); instrument.axis.set_voltage(0.0)")
        ioc.do("vars(instrument.axis.log).update(lowest=0.0, highest=0.0, largest_step=0.0, steepest=0.0, refused=0)")
        # Wait until the IOC has read the instrument again.
        time.sleep(0.1)

    @property
    def log(self):
        return Extremes(**self.ioc.log())

    def __getattr__(self, name):
        return self.ioc.do(f"answer = instrument.axis.{name}")[0]

    def __setattr__(self, name, value):
        self.ioc.do(f"instrument.axis.{name} = {value!r}")


@contextmanager
def by_channel_access(longest=None, **options):
    """Open an IOC over Channel Access, at twice the speed: one process for all tests, with waves of any length."""
    for library in ("softioc", "aioca"):
        pytest.importorskip(library, reason=f"{library} is not installed: EPICS cannot be served, or not be used")
    if not _IOCS:
        _IOCS.append(IocProcess(actuator={"highest": HIGH, "noise": 1e-10}, limits=(LOW, HIGH), speed=2.0))
    instrument = RemoteInstrument(_IOCS[0])
    with EpicsRig.connect(_IOCS[0].prefix, **options) as rig:
        rig._now = lambda: 2.0 * time.monotonic()
        yield rig, instrument
