"""What every rig must do. To enter a rig, add one line to `RIGS`. The tests are those of `dehyst.testing`."""

from contextlib import contextmanager, nullcontext

import epics_on_ioc
import fake_nidaqmx
import numpy as np
import nv200_on_emulator
import pi_on_emulator
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


@contextmanager
def fake(longest=None, **options):
    """Open the least rig there can be."""
    with FakeRig((LOW, HIGH), longest=longest, **options) as rig:
        yield rig, rig.instrument


@contextmanager
def inverted(longest=None, **options):
    """Open a rig of 1 MV/s, whose displacement is large, and falls."""
    with FakeRig((LOW, HIGH), longest=longest, device_slew=1e6, gain=-5e-6, **options) as rig:
        yield rig, rig.instrument


class BlockRig(FakeRig):
    """A device of 20 kV/s that plays tables of 2048 samples, and gives each when it has been played."""

    def _wave(self, voltage, rate):
        lots = list(super()._wave(voltage, rate))
        yield Samples(*(np.concatenate([lot[k] for lot in lots]) for k in range(3)))


class SlowRig(FakeRig):
    """A device of 40 V/s and at most 200 Hz."""

    def nearest_rate(self, sample_rate):
        return min(sample_rate, 200.0)


@contextmanager
def blocks(longest=None, **options):
    with BlockRig((LOW, HIGH), device_slew=20e3, longest=2048, **options) as rig:
        yield rig, rig.instrument


@contextmanager
def slow(**options):
    with SlowRig((LOW, HIGH), device_slew=40.0, **options) as rig:
        yield rig, rig.instrument


@contextmanager
def slowest(longest=None, **options):
    """Open a rig that takes two minutes for its range."""
    with FakeRig((LOW, HIGH), longest=longest, device_slew=1.0, **options) as rig:
        yield rig, rig.instrument


@contextmanager
def daq_card(longest=None, **options):
    """Open a rig on a fake card, whose waves are short enough for any test."""
    with fake_nidaqmx.opened((LOW / fake_nidaqmx.GAIN, HIGH / fake_nidaqmx.GAIN), **options) as (rig, card):
        rig.longest = longest or rig.longest
        yield rig, card


# Mean slope [m/V] of the loop of the virtual actuators.
GAIN = -float(np.diff(PlayActuator(highest=HIGH, noise=0.0).play(np.array([80.0, 0.0])))[0]) / 80.0
RIGS = [
    RigCandidate("fake", fake, 1e-7),
    RigCandidate("fake, fast and in blocks", blocks, 1e-7),
    RigCandidate("fake, slow", slow, 1e-7),
    RigCandidate("fake, slowest", slowest, 1e-7),
    RigCandidate("fake, inverted", inverted, -5e-6),
    RigCandidate("simulated", simulated, GAIN),
    RigCandidate("National Instruments card, fake", daq_card, 1e-7),
    # Microvolts are sent.
    RigCandidate("pi", pi_on_emulator.by_pipe, GAIN, volts=1e-6),
    RigCandidate("pi by tcp", pi_on_emulator.by_tcp, GAIN, volts=1e-6, real_time=True),
    # Millivolts are recorded, and a busy host keeps the time.
    RigCandidate("jena", nv200_on_emulator.by_library, GAIN, volts=1e-3, rate=2.0),
    RigCandidate("epics", epics_on_ioc.by_channel_access, GAIN, real_time=True),
]


class TestEveryInstrument(RigContract):
    @pytest.fixture(params=RIGS, ids=lambda candidate: candidate.name)
    def candidate(self, request):
        return request.param


@pytest.mark.parametrize("method", ["_read", "_wave"])
@pytest.mark.parametrize("factor", [1e3, 1.1, -1.0])
def test_a_wrong_displacement_is_noticed(method, factor):
    def wrong(answer):
        return answer._replace(displacement=factor * answer.displacement)

    def bench():
        rig = FakeRig((LOW, HIGH))
        read, wave = rig._read, rig._wave
        changed = {"_read": lambda: wrong(read()), "_wave": lambda *given: map(wrong, wave(*given))}
        setattr(rig, method, changed[method])
        return rig, rig.instrument

    with pytest.raises(AssertionError):
        RigContract().test_displacements_are_the_instruments(bench, RIGS[0])


class Late(FakeRig):
    """Its displacements are those of the sample before."""

    def _wave(self, voltage, rate):
        for lot in super()._wave(voltage, rate):
            yield lot._replace(displacement=np.roll(lot.displacement, 1))


class Beside(FakeRig):
    """The zero of its recorder is 0.3 um beside that of its readings."""

    def _wave(self, voltage, rate):
        for lot in super()._wave(voltage, rate):
            yield lot._replace(displacement=lot.displacement + 3e-7)


class Spiked(FakeRig):
    """One voltage of a wave is 5 V too high, and is not recorded so."""

    def _wave(self, voltage, rate):
        spiked, start = np.where(np.arange(voltage.size) == 12, voltage + 5, voltage), 0
        for lot in super()._wave(spiked, rate):
            asked = voltage[start : start + lot.voltage.size]
            start += asked.size
            yield lot._replace(voltage=asked, displacement=self.instrument.displacement(asked))


class Fast(FakeRig):
    """It plays twice as fast, by a clock that is twice as fast."""

    def _read(self):
        return super()._read()._replace(time=2 * self.instrument.now)

    def _wave(self, voltage, rate):
        for lot in super()._wave(voltage, 2 * rate):
            yield lot._replace(time=2 * lot.time)


@pytest.mark.parametrize("kind", [FakeRig, Late, Beside, Spiked, Fast])
@pytest.mark.parametrize("longest", [None, 17])
def test_a_rig_that_differs_from_its_instrument_is_noticed(kind, longest):
    def bench(**options):
        rig = kind((LOW, HIGH), **options)
        return rig, rig.instrument

    with nullcontext() if kind is FakeRig else pytest.raises(AssertionError):
        RigContract().test_a_fake_instrument_got_and_gave_what_is_recorded(bench, RIGS[0], longest)
