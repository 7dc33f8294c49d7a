"""The smallest possible rig: its device is a list of voltages with its own clock."""

import numpy as np

from dehyst.control import VoltageLimits
from dehyst.instruments import AbstractRig, Reading, Samples
from dehyst.testing import FakeInstrument
from dehyst.waveforms import Excitation

UP = Excitation("up", np.linspace(0, 50, 101), 1000.0)
BROUGHT = "The voltage was brought to 0 V."


def raises(error):
    """A method that raises an error."""

    def fail(*_):
        raise error

    return fail


def beyond(volts, act):
    """A listener that acts at the first samples beyond a voltage."""
    return lambda samples: act() if samples.voltage[-1] > volts else None


def playing(*voltage, rate=1000.0):
    """Play voltages on a rig."""
    return lambda rig: rig.play(Excitation("odd", np.array(voltage, dtype=float), rate))


class FakeRig(AbstractRig):
    """A rig that yields samples in batches of ten; tests replace its methods, and look at `done`."""

    def __init__(self, device=(-20.0, 100.0), *, device_slew=None, gain=1e-7, **options):
        self.instrument = FakeInstrument(device, gain)
        # The device's clock is ahead of the host's by this time [s].
        self.done, self.ahead = [], 0.0
        super().__init__("fake", VoltageLimits(*device, device_slew), **options)

    def _read(self):
        v = self.instrument.voltage
        return Reading(self.instrument.now + self.ahead, v, float(self.instrument.displacement(np.array(v))))

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
                yield Samples(time + self.ahead, lot.copy(), self.instrument.displacement(lot))
            self.instrument.playing = False
        finally:
            self.done.append("wave ended")

    def _halt(self):
        self.done.append("halt")
        self.instrument.playing = False

    def _close(self):
        self.done.append("close")

    def _now(self):
        return self.instrument.now

    def _wait(self, seconds):
        self.instrument.wait(seconds)
