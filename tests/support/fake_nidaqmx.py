"""A card with its own clock behind a module `nidaqmx`, which behaves as the documentation of NI-DAQmx says.

Tasks reserve their channels, a clock edge reads the inputs before it changes the output, a finite generation leaves the
output at its last sample, also if it is stopped.
"""

import sys
from contextlib import contextmanager
from types import ModuleType, SimpleNamespace
from unittest import mock

import numpy as np
import places

from dehyst.instruments import open_rig
from dehyst.virtual.bench import Extremes

TIMEBASE = 1e8
# Gains of the amplifier [V/V] and of the sensor [m/V].
GAIN, SCALE = 10.0, 2e-6


class Card:
    """One output, an amplifier, an actuator of 0.1 um a volt, its sensor on ai0, a monitor on ai1."""

    def __init__(self, ranges):
        self.ranges, self.limits = ranges, (GAIN * min(ranges), GAIN * max(ranges))
        self.now, self.output, self.log = 0.0, 0.0, Extremes(0.0, 0.0)
        self.tasks = []

    @property
    def voltage(self):
        return GAIN * self.output

    @property
    def playing(self):
        return any(task.running and task.outputs for task in self.tasks)

    def put(self, volts):
        assert min(self.ranges) - 1e-12 <= volts <= max(self.ranges) + 1e-12
        self.log.update(GAIN * np.array([self.output, volts]), np.array([1e-3]))
        self.output = float(volts)

    def seen(self, channel):
        return {"Dev1/ai0": 1e-7 * GAIN * self.output / SCALE, "Dev1/ai1": self.output}[channel]

    def wait(self, seconds):
        self.now += seconds
        self.advance()

    def advance(self):
        """Process all clock edges that are due."""
        for task in [task for task in self.tasks if task.running and task.outputs and task.buffer is not None]:
            due = min(task.count, int((self.now - task.began) * task.rate + 1e-6) + 1)
            for k in range(task.edges, due):
                for reader in self.tasks:
                    if reader.running and reader.source == "/Dev1/ao/SampleClock":
                        reader.take()
                self.put(task.buffer[k])
            task.edges = max(task.edges, due)
            task.running = task.edges < task.count


class Task:
    """The used part of `nidaqmx.Task`; `card` is set for each card."""

    card = None

    def __init__(self):
        self.inputs, self.outputs, self.rate, self.count, self.source = [], [], None, None, ""
        self.buffer, self.running, self.reserved, self.closed, self.edges, self.began = None, False, False, False, 0, 0
        self.taken, self.given, self.low, self.high = [], 0, -10.0, 10.0
        self.card.tasks.append(self)
        self.ai_channels = self.ao_channels = self.timing = self.in_stream = self.out_stream = self

    def __enter__(self):
        return self

    def __exit__(self, kind, error, trace):
        self.close()

    def demand(self, kind):
        """Refuse a task that is closed, or whose channels another task has reserved."""
        assert not self.closed
        for other in self.card.tasks:
            assert other is self or not other.reserved or not getattr(other, kind), "The resource is reserved."

    def add_ao_voltage_chan(self, physical_channel, min_val, max_val):
        assert physical_channel == "Dev1/ao0"
        assert min(self.card.ranges) <= min_val < max_val <= max(self.card.ranges)
        self.outputs.append(physical_channel)
        self.low, self.high = min_val, max_val

    def add_ai_voltage_chan(self, physical_channel, min_val, max_val):
        self.inputs.append(physical_channel)

    def cfg_samp_clk_timing(self, rate, sample_mode, samps_per_chan, source=""):
        assert sample_mode == "finite" and samps_per_chan >= 2
        # Others are not supported.
        if not 1 <= rate <= 250_000:
            raise ValueError(f"rate: {rate} Hz")
        self.rate, self.source, self.count = TIMEBASE / round(TIMEBASE / rate), source, samps_per_chan

    @property
    def samp_clk_rate(self):
        return self.rate

    @property
    def avail_samp_per_chan(self):
        return len(self.taken) - self.given

    def write(self, data, auto_start):
        self.demand("outputs")
        values = np.atleast_1d(np.asarray(data, dtype=np.float64))
        assert (values >= self.low).all() and (values <= self.high).all()
        assert auto_start == (self.rate is None)
        if self.rate is None:
            self.card.put(values[-1])
        else:
            assert values.size == self.count
            self.buffer, self.reserved = values.copy(), True

    def start(self):
        self.demand("outputs" if self.outputs else "inputs")
        assert not self.outputs or self.regen_mode == "not again"
        self.running = self.reserved = True
        self.began = self.card.now
        self.card.advance()

    def take(self):
        self.taken.append([self.card.seen(channel) for channel in self.inputs])
        self.running = len(self.taken) < self.count

    def read(self, number_of_samples_per_channel=None):
        if self.rate is None:
            self.demand("inputs")
            return [self.card.seen(channel) for channel in self.inputs]
        lot = self.taken[self.given : self.given + number_of_samples_per_channel]
        assert len(lot) == number_of_samples_per_channel
        self.given += len(lot)
        return [list(column) for column in zip(*lot, strict=True)]

    def close(self):
        self.running, self.reserved, self.closed = False, False, True
        self.card.tasks.remove(self)


@contextmanager
def opened(ranges, **options):
    """Open the rig in `examples/instruments` on a card with its own clock behind a module `nidaqmx`."""
    card = Card(ranges)
    device = SimpleNamespace(product_type="PCIe-6323", ao_voltage_rngs=[0.0, 5.0, *ranges])
    parts = {
        "nidaqmx": {"Task": type("Task", (Task,), {"card": card})},
        "nidaqmx.system": {"Device": {"Dev1": device}.__getitem__},
        "nidaqmx.constants": {
            "AcquisitionType": SimpleNamespace(FINITE="finite"),
            "RegenerationMode": SimpleNamespace(DONT_ALLOW_REGENERATION="not again"),
        },
    }
    modules = {name: ModuleType(name) for name in parts}
    for name, content in parts.items():
        vars(modules[name]).update(content)
        if "." in name:
            setattr(modules["nidaqmx"], name.rpartition(".")[2], modules[name])
    file = places.EXAMPLES / "instruments" / "ni.py"
    with mock.patch.dict(sys.modules, modules), open_rig(f"{file}:NiRig", **options) as rig:
        rig._clock, rig._wait = lambda: card.now, card.wait
        yield rig, card
