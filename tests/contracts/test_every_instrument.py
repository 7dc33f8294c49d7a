"""What every rig must do. To enter a rig, add one line to `RIGS`. The tests are those of `dehyst.testing`."""

import os
import re
import subprocess
import sys
from contextlib import contextmanager

import epics_on_ioc
import fake_nidaqmx
import numpy as np
import nv200_on_emulator
import pi_on_emulator
import planted_faults
import pytest
from fake_rig import FakeRig

from dehyst.instruments import Samples
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


def fakes(kind=FakeRig, **device):
    """Return a function that opens a kind of fake `device`."""

    @contextmanager
    def opened(**options):
        with kind((LOW, HIGH), **options | device) as rig:
            yield rig, rig.instrument

    return opened


class BlockRig(FakeRig):
    """A device that plays tables, and gives the samples of each when it has been played."""

    def _wave(self, voltage, rate):
        lots = list(super()._wave(voltage, rate))
        yield Samples(*(np.concatenate([lot[k] for lot in lots]) for k in range(3)))


class Reusing(FakeRig):
    """It fills the same buffers again for each lot."""

    def _wave(self, voltage, rate):
        buffers = np.zeros((3, 10))
        for lot in super()._wave(voltage, rate):
            size = lot.time.size
            buffers[:, :size] = lot[:3]
            yield Samples(*buffers[:, :size])


class SlowRig(FakeRig):
    """A device of at most 200 Hz."""

    def nearest_rate(self, sample_rate):
        return min(sample_rate, 200.0)


@contextmanager
def daq_card(longest=None, **options):
    """Open a rig on a fake card, whose waves are short enough for any test."""
    with fake_nidaqmx.opened((LOW / fake_nidaqmx.GAIN, HIGH / fake_nidaqmx.GAIN), **options) as (rig, card):
        rig.longest = longest or rig.longest
        yield rig, card


# Mean slope [m/V] of the loop of the virtual actuators.
GAIN = -float(np.diff(PlayActuator(highest=HIGH, noise=0.0).play(np.array([80.0, 0.0])))[0]) / 80.0
RIGS = [
    RigCandidate("fake", fakes(), 1e-7),
    RigCandidate("fake, fast and in blocks", fakes(BlockRig, device_slew=20e3, longest=2048), 1e-7),
    RigCandidate("fake, slow", fakes(SlowRig, device_slew=40.0), 1e-7),
    RigCandidate("fake, with buffers of its own", fakes(Reusing), 1e-7),
    # It takes two minutes for its range.
    RigCandidate("fake, slowest", fakes(device_slew=1.0), 1e-7),
    # 1 MV/s; the displacement is large, and falls.
    RigCandidate("fake, inverted", fakes(device_slew=1e6, gain=-5e-6), -5e-6),
    RigCandidate("simulated", simulated, GAIN),
    RigCandidate("National Instruments card, fake", daq_card, 1e-7),
    # Microvolts are sent.
    RigCandidate("pi", pi_on_emulator.by_pipe, GAIN, volts=1e-6),
    RigCandidate("pi by tcp", pi_on_emulator.by_tcp, GAIN, volts=1e-6),
    # A busy host keeps the time, of a device in time twice as fast for EPICS; jena records millivolts.
    RigCandidate("jena", nv200_on_emulator.by_library, GAIN, volts=1e-3, rate=2.0),
    RigCandidate("epics", epics_on_ioc.by_channel_access, GAIN, rate=8.0),
]


class TestEveryInstrument(RigContract):
    @pytest.fixture(params=RIGS, ids=lambda candidate: candidate.name)
    def candidate(self, request):
        return request.param


def test_the_suite_for_rigs_finds_every_planted_fault():
    command = [sys.executable, "-m", "pytest", "-q", "--tb=no", "-n", "0", "-p", "no:cacheprovider", "-c", os.devnull]
    place = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run([*command, planted_faults.__file__], capture_output=True, text=True, check=False, env=place)
    found = set(re.findall(r"FAILED .*::Test(\w+)::", done.stdout))
    assert found == set(planted_faults.FAULTS), done.stdout[-2000:]
