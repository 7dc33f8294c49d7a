"""A data acquisition card of National Instruments as a rig.

Tested only with a fake library. Check the output by an oscilloscope without an actuator, edit the constants, then::

    dehyst calibrate examples/instruments/ni.py:NiRig --limits 0 100
"""

import time
from contextlib import ExitStack

import nidaqmx.system
import numpy as np
from nidaqmx.constants import AcquisitionType, RegenerationMode

from dehyst.control import VoltageLimits
from dehyst.instruments import AbstractRig, Reading, Samples

# The monitor is an input that reads the amplifier's monitor output, the voltage of the actuator.
CARD, OUTPUT, SENSOR, MONITOR = "Dev1", "Dev1/ao0", "Dev1/ai0", "Dev1/ai1"
# Gains of the amplifier [V/V], the monitor [V of the actuator per volt] and the sensor [m/V].
GAIN, MONITOR_GAIN, SCALE = 10.0, 10.0, 2e-6


class NiRig(AbstractRig):
    """A rig whose output plays a wave once with its own clock; the inputs are read at the edges of this clock."""

    def __init__(self, *, limits=None, slew_rate=None):
        device = nidaqmx.system.Device(CARD)
        volts = [GAIN * volt for volt in device.ao_voltage_rngs]
        self._tasks, self._clock = ExitStack(), time.monotonic
        name, bounds = f"{device.product_type} {OUTPUT}", VoltageLimits(min(volts), max(volts))
        super().__init__(name, bounds, limits=limits, slew_rate=slew_rate, longest=2**24 - 2)

    def nearest_rate(self, sample_rate):
        """Return the rate [Hz] to which the card rounds `rate`."""
        with nidaqmx.Task() as task:
            self._add_output(task)
            task.timing.cfg_samp_clk_timing(sample_rate, sample_mode=AcquisitionType.FINITE, samps_per_chan=2)
            return task.timing.samp_clk_rate

    def _read(self):
        with nidaqmx.Task() as task:
            self._add_inputs(task)
            sensor, monitor = task.read()
        return Reading(self._clock(), MONITOR_GAIN * monitor, SCALE * sensor)

    def _put(self, voltage):
        with nidaqmx.Task() as task:
            self._add_output(task)
            task.write(voltage / GAIN, auto_start=True)

    def _wave(self, voltage, rate):
        # An edge reads the inputs before it changes the output: therefore the last voltage needs one more edge.
        sent = np.append(voltage, voltage[-1]) / GAIN
        clock = {"sample_mode": AcquisitionType.FINITE, "samps_per_chan": sent.size}
        output, inputs = (self._tasks.enter_context(nidaqmx.Task()) for _ in range(2))
        self._add_output(output)
        output.timing.cfg_samp_clk_timing(rate, **clock)
        output.out_stream.regen_mode = RegenerationMode.DONT_ALLOW_REGENERATION
        self._add_inputs(inputs)
        inputs.timing.cfg_samp_clk_timing(rate, source=f"/{CARD}/ao/SampleClock", **clock)
        output.write(sent, auto_start=False)
        inputs.start()
        begin, got = self._clock(), 0
        output.start()
        while got < sent.size:
            self._wait(0.05)
            ready = min(inputs.in_stream.avail_samp_per_chan, sent.size - got)
            found = inputs.read(number_of_samples_per_channel=ready) if ready else [[], []]
            sensor, monitor = np.array(found, dtype=float)
            # The first edge is before the wave. AbstractRig raises an error if batches stay empty.
            times, first = begin + np.arange(got, got + ready) / rate, int(got == 0)
            got += ready
            yield Samples(times[first:], MONITOR_GAIN * monitor[first:], SCALE * sensor[first:])
        self._halt()

    def _halt(self):
        # The output keeps its voltage when its task ends.
        self._tasks.close()

    _close = _halt

    def _add_output(self, task):
        low, high = self.limits.low / GAIN, self.limits.high / GAIN
        task.ao_channels.add_ao_voltage_chan(OUTPUT, min_val=low, max_val=high)

    def _add_inputs(self, task):
        for channel in (SENSOR, MONITOR):
            task.ai_channels.add_ai_voltage_chan(channel, min_val=-10.0, max_val=10.0)
