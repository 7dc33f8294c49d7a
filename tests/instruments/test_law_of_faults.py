"""One law for all rigs: after any fault the output ends at the safe voltage, or the note says where it is."""

import math
import os
import signal
import time
from contextlib import contextmanager

import numpy as np
import pytest
from epics_on_ioc import by_channel_access
from fake_rig import FakeRig
from pi_on_emulator import by_pipe

from dehyst.instruments import AbstractRig, DeviceError, LinkError, Reading, SensorError
from dehyst.instruments.interrupts import Terminated
from dehyst.instruments.output import VoltageNote
from dehyst.instruments.simulated import SimulatedRig
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Excitation
from examples import at_night

SLEW, TICK, ROUNDED = 400.0, 0.01, 1e-3
# Seconds that a retreat takes beside its ramp; where the link is dead.
EXTRA, DEAD = 2.0, 15.0


@contextmanager
def own(**options):
    rig = FakeRig(**options)
    yield rig, rig.instrument


@contextmanager
def simulated(**options):
    rig = SimulatedRig(PlayActuator(highest=100.0), device_limits=(-20.0, 100.0), **options)
    yield rig, rig.instrument.axis


RIGS = {"sim": simulated, "pi": by_pipe, "epics": by_channel_access, "own": own}


class Faulty:
    """A rig whose driver has one fault from the moment that it is switched on; notes what is sent."""

    def __init__(self, rig):
        self.rig, self.on, self.sent, self.waited, self.raised = rig, False, [], 0.0, 0
        self.methods = {name: getattr(rig, name) for name in ("_read", "_put", "_wave", "_halt", "_wait")}
        rig._put, rig._wait, rig._halt, self.halted = self.put, self.wait, self.halt, math.inf

    def put(self, voltage):
        self.sent.append((time.monotonic() + self.waited, voltage))
        return self.methods["_put"](voltage)

    def halt(self):
        self.halted = time.monotonic() + self.waited
        self.methods["_halt"]()

    def wait(self, seconds):
        began = time.monotonic()
        self.methods["_wait"](seconds)
        # A virtual rig waits in no time.
        self.waited += seconds - (time.monotonic() - began)

    def replace(self, name, change):
        """Let a method return what `change` makes of the honest method, once the fault is on."""
        honest = getattr(self.rig, name)
        setattr(self.rig, name, lambda *values: change(self, honest, *values) if self.on else honest(*values))
        alone = self.rig._read_voltage
        if name == "_read" and type(self.rig)._read_voltage is not AbstractRig._read_voltage:

            def voltage():
                return change(self, lambda: Reading(0.0, alone(), 0.0)).voltage if self.on else alone()

            self.rig._read_voltage = voltage

    def replace_wave(self, change):
        """Let each batch of samples be replaced by those that `change` returns, once the fault is on."""
        honest = self.rig._wave

        def wave(voltage, rate):
            for samples in honest(voltage, rate):
                yield from change(samples) if self.on else [samples]

        self.rig._wave = wave


def raises(error, times=math.inf):
    """A method that raises an error so many times in each test, and then works."""

    def change(faulty, honest, *values):
        faulty.raised += 1
        if faulty.raised <= times:
            raise type(error)(*error.args)
        return honest(*values)

    return change


def reads(**change):
    """A reading with other values."""
    return lambda _, honest: (found := honest())._replace(
        **{name: make(getattr(found, name)) for name, make in change.items()}
    )


def late(faulty, honest, *values):
    time.sleep(0.05)
    return honest(*values)


def swallowed(faulty, _, *__):
    faulty.swallows = True


def silent(samples):
    raise LinkError("no new sample")


def ended(samples):
    return []


def ctrl_c(samples):
    os.kill(os.getpid(), signal.SIGINT)
    return [samples]


def terminate(samples):
    os.kill(os.getpid(), signal.SIGTERM)
    return [samples]


def refilled(samples):
    yield samples
    for column in samples[:3]:
        column[:] = 7.0


def spoilt(**change):
    return lambda samples: [samples._replace(**{name: make(getattr(samples, name)) for name, make in change.items()})]


def nan(values):
    return np.full_like(values, np.nan)


LOST, GONE, MISTAKE = LinkError("lost"), OSError("gone"), ZeroDivisionError("a mistake")
# The method with the fault, what it does instead, and whether the link is dead.
FAULTS = {
    "reading lost": ("_read", raises(LOST)),
    "reading lost once": ("_read", raises(LOST, 1)),
    "reading raises": ("_read", raises(GONE)),
    "reading is a mistake": ("_read", raises(MISTAKE)),
    "sensor dead": ("_read", raises(SensorError("dead"))),
    "reading ends the program": ("_read", raises(SystemExit(3))),
    "readback stays": ("_read", reads(voltage=lambda _: 25.0)),
    "readback at 0": ("_read", reads(voltage=lambda _: 0.0)),
    "readback + 50": ("_read", reads(voltage=lambda v: v + 50.0)),
    "readback inverted": ("_read", reads(voltage=lambda v: -v)),
    "readback in mV": ("_read", reads(voltage=lambda v: 1e3 * v)),
    "readback is no number": ("_read", reads(voltage=lambda _: math.nan)),
    "readback is infinite": ("_read", reads(voltage=lambda _: math.inf)),
    "reading without displacement": ("_read", reads(displacement=lambda _: math.nan)),
    "clock jumps by a day": ("_read", reads(time=lambda t: t + 86400.0)),
    "reading late": ("_read", late),
    "put lost": ("_put", raises(LOST)),
    "put lost once": ("_put", raises(LOST, 1)),
    "put refused": ("_put", raises(DeviceError("refused"))),
    "put raises": ("_put", raises(GONE)),
    "put late": ("_put", late),
    "put swallowed": ("_put", swallowed),
    "stop lost": ("_halt", raises(LOST)),
    "stop lost once": ("_halt", raises(LOST, 1)),
    "stop is a mistake": ("_halt", raises(MISTAKE)),
    "wait raises": ("_wait", raises(GONE)),
    "wave silent": ("_wave", silent),
    "wave ends early": ("_wave", ended),
    "wave falls back in time": ("_wave", spoilt(time=lambda t: t - 1.0)),
    "wave jumps in time": ("_wave", spoilt(time=lambda t: t + 86400.0)),
    "wave without numbers": ("_wave", spoilt(displacement=nan)),
    "wave of other voltages": ("_wave", spoilt(voltage=lambda v: v + 30.0)),
    "sensor stuck": ("_wave", spoilt(displacement=lambda y: np.full_like(y, 3e-6))),
    "buffer filled again": ("_wave", refilled),
    "Ctrl-C": ("_wave", ctrl_c),
    "SIGTERM": ("_wave", terminate),
}
# These are tried with the IOC, in real time, on a push too.
OVER_A_NETWORK = ("reading lost", "readback stays", "reading late", "put lost", "stop lost", "wave silent", "Ctrl-C")


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("kind", "fault"),
    [
        (kind, fault) if kind != "epics" or fault in OVER_A_NETWORK else at_night(kind, fault)
        for kind in RIGS
        for fault in FAULTS
    ],
)
def test_after_a_fault_the_voltage_is_safe_or_stated(kind, fault):
    name, change = FAULTS[fault]
    # In time of its own, a wave comes at once: its pieces come one by one.
    with RIGS[kind](slew_rate=SLEW, **({"longest": 100} if kind == "pi" else {})) as (rig, instrument):
        faulty = Faulty(rig)
        faulty.replace_wave(change) if name == "_wave" else faulty.replace(name, change)
        rate = rig.nearest_rate(500.0)
        wave = Excitation("up and down", 30 - 30 * np.cos(np.linspace(0, 2 * np.pi, 500)), rate)
        note, raised, begin = None, None, 0.0

        def listen(samples):
            nonlocal begin
            if samples.voltage.max() > 20 and not faulty.on:
                faulty.on, begin = True, time.monotonic() + faulty.waited
                faulty.sent.clear()

        try:
            rig.play(wave, listen)
            rig.set_voltage(35.0)
            begin = time.monotonic() + faulty.waited
            rig.retreat()
        except (Exception, KeyboardInterrupt, Terminated) as error:
            raised = error
            (note,) = [note for note in error.__notes__ if isinstance(note, VoltageNote)]
        seconds = time.monotonic() + faulty.waited - begin
        assert faulty.on and seconds < DEAD, raised
        log, stands = instrument.log, instrument.voltage
        assert -20.0 <= log.lowest <= log.highest <= 100.0 and log.refused == 0
        times, volts = np.array(faulty.sent or [(0.0, 0.0)]).T
        assert (np.abs(np.diff(volts)) <= SLEW * np.maximum(np.diff(times), TICK) + ROUNDED).all()
        # From 60 V at most, by the range of 120 V a second.
        # Real time, of the IOC, counts until the last voltage: the computer may be busy.
        assert (times[-1] if kind == "epics" else begin + seconds) - faulty.halted < 0.5 + EXTRA
        if note is None or note.safe:
            assert stands == pytest.approx(0.0, abs=ROUNDED) or (note is None and hasattr(faulty, "swallows"))
        elif not hasattr(faulty, "swallows") and not instrument.playing:
            assert stands == pytest.approx(note.voltages[0], abs=SLEW * TICK + ROUNDED)
