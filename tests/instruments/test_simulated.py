"""The simulated rig: a virtual bench in a time of its own."""

import time

import numpy as np
import pytest
from truths import VIRTUAL, AgeingActuator, AgeingCourse
from truths.warm_rig import WarmRig

from dehyst.instruments import DeviceError, open_rig
from dehyst.instruments.simulated import SimulatedRig
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Excitation, Sampling, standard


@pytest.mark.parametrize("kind", VIRTUAL)
def test_a_long_record_takes_seconds_at_most_and_comes_in_lots(kind):
    protocol = standard.descending_tops(150.0, drive=Sampling(sample_rate=200, frequency=0.1, limits=(0, 200)))
    rig, lots = SimulatedRig(VIRTUAL[kind](), wave_points=5000), []
    began = time.process_time()
    record = rig.play(protocol, lots.append)
    assert time.process_time() - began < 5 < protocol.duration
    assert sum(lot.time.size for lot in lots) == len(record) > 20000
    assert len(lots) > 300
    np.testing.assert_allclose(np.diff(record.time), 1 / 200, rtol=1e-6)
    np.testing.assert_array_equal(record.voltage, protocol.voltage[rig.rows(len(protocol))])
    assert (rig.instrument.axis.log.lowest, rig.instrument.axis.log.highest) == (0, 150)
    assert rig.instrument.axis.log.steepest <= rig.slew_rate * (1 + 1e-6)


def test_the_displacement_is_the_truths_own():
    protocol = standard.raised_cosine(120.0, cycles=2, drive=Sampling(sample_rate=100, frequency=0.5))
    record = SimulatedRig(PlayActuator(noise=0)).play(protocol)
    np.testing.assert_array_equal(record.displacement, PlayActuator(noise=0).play(protocol.voltage))


def test_the_rate_is_one_of_whole_servo_periods():
    rig = SimulatedRig(PlayActuator(), servo_period=1e-3)
    assert rig.nearest_rate(300.0) == pytest.approx(1000 / 3)
    assert rig.nearest_rate(1e6) == pytest.approx(1000)


def test_further_channels_of_a_rig_are_in_its_records_and_must_be_those_it_declares():
    course = AgeingCourse(gain=-6, kelvins=30, seconds=2)
    rig = WarmRig(AgeingActuator(PlayActuator(), course), limits=(0, 100))
    wave = Excitation("wave", np.linspace(0, 100, 400), 100.0)
    batches = []
    record = rig.play(wave, batches.append)
    assert rig.others == ("temperature_C",)
    np.testing.assert_allclose(record.temperature, 20 + 30 * np.clip(record.time / 2, 0, 1))
    assert sum(batch.others["temperature_C"].size for batch in batches) == len(record)
    assert batches[0].axis(0).others.keys() == {"temperature_C"}
    rig.others = ("load_N",)
    with pytest.raises(DeviceError, match="temperature_C"):
        rig.play(wave)
    assert open_rig("sim://", limits=(0, 100)).play(wave).temperature is None
