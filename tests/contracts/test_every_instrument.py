"""What every rig must do. To enter a rig, add one line to `RIGS`. The tests are those of `dehyst.testing`."""

from contextlib import contextmanager

import epics_on_ioc
import fake_nidaqmx
import pi_on_emulator
import pytest
from fake_rig import FakeRig

from dehyst.instruments.nidaqmx import NiRig
from dehyst.instruments.simulated import SimulatedRig
from dehyst.testing import RigCandidate, RigContract
from dehyst.virtual import PlayActuator

LOW, HIGH = -20.0, 100.0


@contextmanager
def simulated(longest=65536, **options):
    """Open a rig in a time of its own."""
    truth = PlayActuator(highest=HIGH, noise=1e-10)
    with SimulatedRig(truth, device_limits=(LOW, HIGH), wave_points=longest, **options) as rig:
        yield rig, rig.instrument.axis


@contextmanager
def fake(longest=None, **options):
    """Open the least rig there can be."""
    with FakeRig((LOW, HIGH), longest=longest, **options) as rig:
        yield rig, rig.instrument


@contextmanager
def daq_card(**options):
    """Open a rig on a fake card in a time of its own."""
    with (
        fake_nidaqmx.installed((LOW / fake_nidaqmx.GAIN, HIGH / fake_nidaqmx.GAIN)) as card,
        NiRig(
            "Dev1/ao0",
            "Dev1/ai0",
            gain=fake_nidaqmx.GAIN,
            scale=1e6 * fake_nidaqmx.SCALE,
            clock=lambda: card.now,
            **options,
        ) as rig,
    ):
        rig._wait = card.wait
        yield rig, card


RIGS = [
    RigCandidate("fake", fake),
    RigCandidate("simulated", simulated),
    RigCandidate("National Instruments card, fake", daq_card),
    # Microvolts are sent.
    RigCandidate("pi", pi_on_emulator.by_pipe, volts=1e-6),
    RigCandidate("pi by tcp", pi_on_emulator.by_tcp, volts=1e-6),
    RigCandidate("epics", epics_on_ioc.by_channel_access, real_time=True),
]


class TestEveryInstrument(RigContract):
    @pytest.fixture(params=RIGS, ids=lambda candidate: candidate.name)
    def candidate(self, request):
        return request.param
