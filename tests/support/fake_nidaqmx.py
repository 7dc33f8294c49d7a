"""A card in a time of its own behind a module `nidaqmx`, as the documentation of NI-DAQmx says that it behaves.

Tasks reserve their channels, a clock edge reads the inputs before it changes the output, a finite generation leaves the
output at its last sample, and so does one that is stopped.
"""

import enum
import sys
from contextlib import contextmanager
from types import ModuleType
from unittest import mock

import numpy as np
import places

from dehyst.instruments import open_rig
from dehyst.virtual.bench import Extremes

TIMEBASE = 1e8
# Gains of the amplifier [V/V] and of the sensor [m/V].
GAIN, SCALE = 10.0, 2e-6


class Error(Exception):
    pass


class DaqError(Error):
    def __init__(self, message, error_code, task_name=""):
        super().__init__(f"{message}\n\nStatus Code: {error_code}")
        self.error_code = error_code


class AcquisitionType(enum.Enum):
    FINITE = 10178


class RegenerationMode(enum.Enum):
    ALLOW_REGENERATION = 10097
    DONT_ALLOW_REGENERATION = 10158


class Card:
    """One output, an amplifier, an actuator of 0.1 um a volt, its sensor on ai0, a monitor on ai1."""

    def __init__(self, ranges, internal=True):
        self.ranges, self.internal = ranges, internal
        self.limits = (GAIN * min(ranges), GAIN * max(ranges))
        self.now, self.output, self.amplifies = 0.0, 0.0, True
        self.log, self.tasks, self.clockless, self.broken = Extremes(0.0, 0.0), [], False, ""
        self.regeneration = []

    @property
    def voltage(self):
        self.advance()
        return GAIN * self.output * self.amplifies

    @property
    def playing(self):
        self.advance()
        return any(task.running and task.outputs for task in self.tasks)

    def put(self, volts):
        assert min(self.ranges) - 1e-12 <= volts <= max(self.ranges) + 1e-12
        self.log.update(GAIN * np.array([self.output, volts]), np.array([1e-3]))
        self.output = float(volts)

    def seen(self, channel):
        if channel == "Dev1/ai0":
            return 1e-7 * GAIN * self.output * self.amplifies / SCALE
        if channel == "Dev1/ai1":
            return self.output * self.amplifies
        return self.output

    def wait(self, seconds):
        self.now += seconds
        self.advance()

    def advance(self):
        """Let all edges pass that are due."""
        for task in [task for task in self.tasks if task.running and task.outputs and task.buffer is not None]:
            due = min(task.count, int((self.now - task.began) * task.rate + 1e-6) + 1)
            for k in range(task.edges, due):
                for reader in self.tasks:
                    if reader.running and reader.source == "/Dev1/ao/SampleClock" and not self.clockless:
                        reader.take()
                self.put(task.buffer[k])
            task.edges = max(task.edges, due)
            task.running = task.edges < task.count

    def demand(self, task, kind):
        """Refuse a task whose channels another one has reserved."""
        for other in self.tasks:
            if other is not task and other.reserved and getattr(other, kind):
                raise DaqError("The specified resource is reserved. The operation could not be completed.", -50103)


class Task:
    """`nidaqmx.Task`, as far as it is used; `card` is set for each card."""

    card = None

    def __init__(self, new_task_name="", *, grpc_options=None):
        self.inputs, self.outputs, self.rate, self.count, self.source = [], [], None, None, ""
        self.buffer, self.running, self.reserved, self.closed, self.edges, self.began = None, False, False, False, 0, 0
        self.taken, self.given, self.low, self.high = [], 0, -10.0, 10.0
        self.card.tasks.append(self)
        self.ai_channels = self.ao_channels = self.timing = self.in_stream = self.out_stream = self

    def __enter__(self):
        return self

    def __exit__(self, kind, error, trace):
        self.close()

    def _demand(self):
        if self.closed:
            raise DaqError("Specified task is invalid: it was cleared", -200088)
        if self.card.broken:
            raise DaqError(self.card.broken, -88705)
        self.card.advance()

    def add_ao_voltage_chan(self, physical_channel, name_to_assign_to_channel="", min_val=-10.0, max_val=10.0):
        self._demand()
        if physical_channel != "Dev1/ao0":
            raise DaqError("Physical channel specified does not exist on this device.", -200170)
        if min_val < min(self.card.ranges) or max_val > max(self.card.ranges):
            raise DaqError("Requested value is not a supported value for this property.", -200077)
        self.outputs.append(physical_channel)
        self.low, self.high = min_val, max_val

    def add_ai_voltage_chan(
        self, physical_channel, name_to_assign_to_channel="", terminal_config=None, min_val=-5.0, max_val=5.0
    ):
        self._demand()
        known = ["Dev1/ai0", "Dev1/ai1", *(["Dev1/_ao0_vs_aognd"] if self.card.internal else [])]
        if physical_channel not in known:
            raise DaqError("Physical channel specified does not exist on this device.", -200170)
        self.inputs.append(physical_channel)

    def cfg_samp_clk_timing(
        self, rate, source="", active_edge=None, sample_mode=AcquisitionType.FINITE, samps_per_chan=1000
    ):
        self._demand()
        assert sample_mode is AcquisitionType.FINITE
        if not 1 <= rate <= 250_000 or samps_per_chan < 2:
            raise DaqError("Requested value is not a supported value for this property.", -200077)
        self.rate, self.source, self.count = TIMEBASE / round(TIMEBASE / rate), source, samps_per_chan

    @property
    def samp_clk_rate(self):
        return self.rate

    @property
    def regen_mode(self):
        return self.card.regeneration[-1]

    @regen_mode.setter
    def regen_mode(self, mode):
        self.card.regeneration.append(mode)

    @property
    def avail_samp_per_chan(self):
        self._demand()
        return len(self.taken) - self.given

    def write(self, data, auto_start=False, timeout=10.0):
        self._demand()
        self.card.demand(self, "outputs")
        values = np.atleast_1d(np.asarray(data, dtype=np.float64))
        if (values < self.low).any() or (values > self.high).any():
            raise DaqError("Attempted to write an invalid combination of position and offset.", -200561)
        if self.rate is None:
            assert auto_start
            self.card.put(values[-1])
        else:
            assert not auto_start
            assert values.size == self.count
            self.buffer, self.reserved = values.copy(), True
        return values.size

    def start(self):
        self._demand()
        self.card.demand(self, "outputs" if self.outputs else "inputs")
        self.running = self.reserved = True
        self.began = self.card.now
        self.card.advance()

    def take(self):
        self.taken.append([self.card.seen(channel) for channel in self.inputs])
        self.running = len(self.taken) < self.count

    def read(self, number_of_samples_per_channel=None, timeout=10.0):
        self._demand()
        if self.rate is None:
            self.card.demand(self, "inputs")
            values = [self.card.seen(channel) for channel in self.inputs]
            return values if len(values) > 1 else values[0]
        lot = self.taken[self.given : self.given + number_of_samples_per_channel]
        if len(lot) < number_of_samples_per_channel:
            raise DaqError("Some or all of the samples requested have not yet been acquired.", -200284)
        self.given += len(lot)
        return [list(column) for column in zip(*lot, strict=True)]

    def stop(self):
        self._demand()
        self.running = False

    def close(self):
        if not self.closed:
            self.card.advance()
            self.running, self.reserved, self.closed = False, False, True
            self.card.tasks.remove(self)


class Device:
    card = None
    product_type, ao_samp_clk_supported = "PCIe-6323", True
    ao_min_rate, ao_max_rate, ai_min_rate, ai_max_multi_chan_rate = 0.1, 900_000.0, 0.1, 250_000.0

    def __init__(self, name, *, grpc_options=None):
        if name != "Dev1":
            raise DaqError("Device identifier is invalid.", -200220)

    @property
    def ao_voltage_rngs(self):
        return [0.0, 5.0, *self.card.ranges]


@contextmanager
def installed(ranges=(-2.0, 10.0), **options):
    """Have a module `nidaqmx` for the time being, and the card behind it."""
    card = Card(ranges, **options)
    parts = {
        "nidaqmx": {"Task": type("Task", (Task,), {"card": card})},
        "nidaqmx.system": {"Device": type("Device", (Device,), {"card": card})},
        "nidaqmx.constants": {"AcquisitionType": AcquisitionType, "RegenerationMode": RegenerationMode},
        "nidaqmx.errors": {"Error": Error, "DaqError": DaqError},
    }
    modules = {name: ModuleType(name) for name in parts}
    for name, content in parts.items():
        vars(modules[name]).update(content)
        if "." in name:
            setattr(modules["nidaqmx"], name.rpartition(".")[2], modules[name])
    with mock.patch.dict(sys.modules, modules):
        yield card


@contextmanager
def opened(ranges, **options):
    """Open the rig in `examples/instruments` on a card, in a time of its own."""
    with installed(ranges) as card, open_rig(f"{places.EXAMPLES / 'instruments' / 'ni.py'}:NiRig", **options) as rig:
        rig._clock, rig._wait = lambda: card.now, card.wait
        yield rig, card
