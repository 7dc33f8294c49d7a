"""Rigs, each with a fault, and the rehearsal of each. pytest runs them, and every class must fail."""

from contextlib import contextmanager

import numpy as np
import pytest
from fake_rig import FakeRig

from dehyst.testing import RigCandidate, RigContract


def in_wave(change):
    """Return a `_wave` that changes the samples of each batch."""

    def wave(self, voltage, rate):
        for samples in FakeRig._wave(self, voltage, rate):
            yield samples._replace(**change(samples))

    return wave


class Fault:
    """Methods of rigs whose fault needs more than one line."""

    def lie(self, voltage):
        """Saturate at 50 V, and report the requested voltage."""
        FakeRig._put(self, min(voltage, 50.0))
        self.asked = voltage

    def spike(self, voltage, rate):
        """Send one voltage of a wave 5 V too high, and record the requested voltage."""
        spiked, start = np.where(np.arange(voltage.size) == 12, voltage + 5, voltage), 0
        for lot in FakeRig._wave(self, spiked, rate):
            asked = voltage[start : start + lot.voltage.size]
            start += asked.size
            yield lot._replace(voltage=asked, displacement=self.instrument.displacement(asked))

    def swing(self, voltage):
        """Swing 20 V past each voltage."""
        for volts in (voltage, min(100.0, voltage + 20.0), voltage):
            self.instrument.put(volts)

    def end_early(self, voltage, rate):
        """Send no more samples after 30."""
        for k, samples in enumerate(FakeRig._wave(self, voltage, rate)):
            if k < 3:
                yield samples

    def boast(self, device=(-20.0, 100.0), **options):
        """Report wider limits than the device has."""
        FakeRig.__init__(self, (-200.0, 1000.0), **options)
        self.instrument.limits = device


def reading(**changed):
    """Return a `_read` with some other numbers: values, or functions of the rig."""
    return lambda self: FakeRig._read(self)._replace(
        **{name: value(self) if callable(value) else value for name, value in changed.items()}
    )


FAULTS = {
    "StuckReadback": {"_read": reading(voltage=0.0)},
    "WrongFactorInWaves": {"_wave": in_wave(lambda record: {"displacement": 1e3 * record.displacement})},
    "WrongFactorInReadings": {"_read": reading(displacement=lambda rig: 1.1e-7 * rig.instrument.voltage)},
    "ZeroBeside": {"_wave": in_wave(lambda record: {"displacement": record.displacement + 3e-7})},
    "Lying": {"_put": Fault.lie, "_read": reading(voltage=lambda rig: getattr(rig, "asked", 0.0))},
    "Late": {"_wave": in_wave(lambda record: {"displacement": np.roll(record.displacement, 1)})},
    "ClockStands": {"_read": reading(time=0.0)},
    "ClockFast": {
        "_read": reading(time=lambda rig: 2 * rig.instrument.now),
        "_wave": in_wave(lambda record: {"time": 2 * record.time}),
    },
    "Silent": {"_wave": Fault.end_early},
    "WiderLimits": {"__init__": Fault.boast},
    "TwiceAsFast": {"_wave": lambda self, voltage, rate: FakeRig._wave(self, voltage, 2 * rate)},
    "NeverStopped": {"_halt": lambda self: None},
    "Swinging": {"_put": Fault.swing},
    "Spiked": {"_wave": Fault.spike},
}


def rehearsal(name, methods):
    """Return the class of tests of a rig with some replaced methods."""
    rig_class = type(name, (FakeRig,), methods)

    @contextmanager
    def opened(longest=None, **options):
        with rig_class((-20.0, 100.0), longest=longest, **options) as rig:
            yield rig, rig.instrument

    class Rehearsal(RigContract):
        @pytest.fixture
        def candidate(self):
            return RigCandidate(name, opened, 1e-7)

    return Rehearsal


globals().update({f"Test{name}": rehearsal(name, methods) for name, methods in FAULTS.items()})
