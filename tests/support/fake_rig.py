"""The least rig that there can be: a device that is a list of voltages, in a time of its own."""

import numpy as np

from dehyst.control import VoltageLimits
from dehyst.instruments import AbstractRig, Reading, Samples
from dehyst.virtual.bench import Extremes


class FakeInstrument:
    """Puts out what it is told, and reads a displacement of 0.1 um a volt."""

    def __init__(self, limits):
        self.limits, self.sent, self.now = limits, [0.0], 0.0
        self.log, self.unplugged, self.playing = Extremes(0.0, 0.0), False, False

    @property
    def voltage(self):
        return self.sent[-1]

    def put(self, voltage):
        assert self.limits[0] <= voltage <= self.limits[1]
        self.log.update(np.array([self.voltage, voltage]), np.array([1e-3]))
        self.sent.append(float(voltage))

    def displacement(self, voltage):
        return np.full_like(voltage, 3e-6) if self.unplugged else 1e-7 * voltage


class FakeRig(AbstractRig):
    """Yields samples in lots of ten; tests replace its methods, and look at `done`."""

    def __init__(self, device=(-20.0, 100.0), *, device_slew=None, **options):
        self.instrument = FakeInstrument(device)
        self.done = []
        super().__init__("fake", VoltageLimits(*device, device_slew), **options)

    def _read(self):
        v = self.instrument.voltage
        return Reading(self.instrument.now, v, float(self.instrument.displacement(np.array(v))))

    def _put(self, voltage):
        self.done.append("put")
        self.instrument.put(voltage)

    def _wave(self, voltage, rate):
        self.done.append("wave")
        self.instrument.playing = True
        try:
            for first in range(0, voltage.size, 10):
                lot = voltage[first : first + 10]
                for v in lot:
                    self.instrument.put(v)
                time = self.instrument.now + (1 + np.arange(lot.size)) / rate
                self.instrument.now = float(time[-1])
                yield Samples(time, lot.copy(), self.instrument.displacement(lot))
            self.instrument.playing = False
        finally:
            self.done.append("wave ended")

    def _halt(self):
        self.done.append("halt")
        self.instrument.playing = False

    def _close(self):
        self.done.append("close")

    def _wait(self, seconds):
        self.instrument.now += seconds
