"""The virtual bench of an actuator or a stage, and its rig: limits, samples at their times, and the right motion."""

import math
import time

import numpy as np
import pytest
from hand_clock import Hand
from hypothesis import given, settings
from hypothesis import strategies as st
from truths import VIRTUAL, BoucWenActuator, PreisachActuator

from dehyst import DehystError, ModelError
from dehyst.instruments import DeviceError, open_rig
from dehyst.instruments.simulated import SimulatedRig
from dehyst.virtual import PlayActuator, VirtualBench, VirtualStage
from dehyst.waveforms import Excitation, Sampling, standard
from examples import at_night

PERIOD = 5e-5
TRUTHS = {
    "play": lambda: PlayActuator(plays=40),
    "creep": lambda: PlayActuator(plays=40, creep=0.01),
    "preisach": PreisachActuator,
    "boucwen": BoucWenActuator,
}


def cosine(low=0.0, high=200.0, cycles=2, samples=400):
    turn = np.arange(samples * cycles + 1) * 2 * np.pi / samples
    return low + 0.5 * (high - low) * (1 - np.cos(turn))


COUPLING = np.array([[1.0, 0.04], [-0.03, 1.0]])


def pair(**options):
    return PlayActuator(plays=30, highest=100.0, **options), PreisachActuator(highest=120.0)


def waves(samples=400):
    turn = np.arange(samples) * 2 * np.pi / samples
    return np.column_stack([50 * (1 - np.cos(turn)), 60 * (1 - np.cos(1.7 * turn))])


@pytest.fixture
def hand():
    return Hand()


@pytest.mark.parametrize(
    ("kind", "pause"), [*((kind, 0.0131) for kind in TRUTHS), ("stage", 0.0131), ("stage", 0.003), ("stage", 10.0)]
)
def test_a_recorded_wave_is_the_motion_of_the_actuator_or_stage(kind, pause, hand):
    wave = cosine()[:, None] if kind != "stage" else waves()
    make = TRUTHS.get(kind, lambda: VirtualStage(pair(), COUPLING, noise=0))
    bench, truth = VirtualBench(make(), clock=hand, noise=0), make()
    bench.start(dict(enumerate(wave.T)), divider=7)
    while bench.playing:
        hand.wait(pause)
        bench.advance()
    time = 7 * PERIOD * np.arange(len(wave))
    expected = truth.play(wave if kind == "stage" else wave[:, 0], time=time, measured=False).reshape(wave.shape)
    # A jump takes a thousandth of a servo period, of which only what swings and creeps knows; sums of relays depend on
    # the number of samples in their last digits.
    slack = {"play": 0.0, "stage": 1e-13}.get(kind, 1e-6) * np.ptp(expected)
    for j, axis in enumerate(bench.axes):
        at, voltage, displacement = bench.samples(axis=j)
        np.testing.assert_allclose(at, time, rtol=1e-12, atol=1e-15)
        np.testing.assert_array_equal(voltage, wave[:, j])
        np.testing.assert_allclose(displacement, expected[:, j], rtol=0, atol=slack)
        # A later reading is the last sample.
        assert kind != "stage" or axis.displacement() == displacement[-1]


def test_the_noise_is_that_of_the_actuator_unless_it_is_given():
    def record(**options):
        clock = Hand()
        bench = VirtualBench(PlayActuator(plays=10), clock=clock, **options)
        bench.start(cosine())
        clock.wait(1.0)
        return bench.samples()[2]

    clean = record(noise=0.0)
    assert np.std(record() - clean) == pytest.approx(2e-9, rel=0.1)
    assert np.std(record(noise=1e-8, seed=2) - clean) == pytest.approx(1e-8, rel=0.1)
    np.testing.assert_array_equal(record(seed=5), record(seed=5))


STEPS = st.one_of(
    st.tuples(st.just("set"), st.floats(allow_nan=True, allow_infinity=True) | st.floats(-60, 260)),
    st.tuples(st.just("wave"), st.lists(st.floats(-60, 260), min_size=1, max_size=8)),
    st.tuples(st.just("servo"), st.booleans()),
    st.tuples(st.just("stop"), st.just(None)),
    st.tuples(st.just("wait"), st.floats(0, 2)),
)


@settings(max_examples=60, deadline=None)
@given(st.lists(STEPS, max_size=25), st.sampled_from(["play", "boucwen"]), st.sampled_from([None, 500.0]))
def test_no_voltage_leaves_the_limits(steps, kind, slew):
    hand = Hand()
    bench = VirtualBench(TRUTHS[kind](), clock=hand, limits=(-10, 130), slew_rate=slew)
    for what, value in steps:
        try:
            if what == "set":
                bench.axis.set_voltage(value)
            elif what == "wave":
                bench.start(value, 3)
            elif what == "servo":
                bench.axis.servo = value
            elif what == "stop":
                bench.stop()
            else:
                hand.wait(value)
        except DehystError:
            pass
        assert -10 <= bench.axis.voltage <= 130
        assert math.isfinite(bench.axis.displacement())
    hand.wait(10)
    bench.advance()
    assert -10 <= bench.axis.log.lowest <= bench.axis.log.highest <= 130
    if slew is not None:
        assert bench.axis.log.steepest <= slew * (1 + 1e-6)


def test_steps_and_waves_keep_the_slew_rate_of_the_amplifier(hand):
    bench = VirtualBench(PlayActuator(plays=10), clock=hand, slew_rate=100.0)
    bench.axis.set_voltage(50)
    for passed in (0.1, 0.2, 0.3):
        hand.time = passed
        assert bench.axis.voltage == pytest.approx(100 * passed)
    hand.time = 0.5001
    assert bench.axis.voltage == 50
    bench.start([50, 100, 100, 100], divider=round(0.2 / PERIOD))
    hand.wait(1.0)
    np.testing.assert_allclose(bench.samples()[1], [50, 70, 90, 100])
    assert bench.axis.log.steepest <= 100 * (1 + 1e-6)


def test_the_recorder_fills_during_the_wave_and_reports_its_end(hand):
    bench = VirtualBench(PlayActuator(plays=10), clock=hand)
    hand.time = 3.0
    bench.start(np.linspace(0, 100, 11), divider=200)
    assert (bench.recorded, bench.planned, bench.playing) == (1, 11, True)
    hand.wait(0.035)
    assert bench.recorded == 4
    assert bench.axis.voltage == pytest.approx(30)
    hand.wait(1)
    at, voltage, _ = bench.samples(2, 3)
    np.testing.assert_allclose(at, 3.0 + 0.01 * np.arange(2, 5))
    np.testing.assert_allclose(voltage, [20, 30, 40])
    assert not bench.playing
    assert bench.samples(20)[0].size == 0


def test_a_full_recorder_stops_and_a_long_wave_is_refused(hand):
    bench = VirtualBench(PlayActuator(plays=10), clock=hand, wave_points=20, record_points=7)
    bench.start(np.ones(20))
    hand.wait(1)
    assert bench.recorded == 7
    with pytest.raises(DeviceError, match="and divider 1"):
        bench.start(np.ones(21))
    with pytest.raises(DeviceError, match="got 0 samples"):
        bench.start([])
    with pytest.raises(ModelError, match="1 of 2 values"):
        bench.start([1, math.nan])


def test_closed_loop_commands_are_refused_in_open_loop(hand):
    bench = VirtualBench(PlayActuator(plays=10), clock=hand)
    bench.axis.servo = True
    for asked in (lambda: bench.axis.set_voltage(1), lambda: bench.start([0, 1])):
        with pytest.raises(DeviceError, match="the servo"):
            asked()
    bench.axis.servo = False
    bench.start(np.zeros(100))
    with pytest.raises(DeviceError, match="wave is being"):
        bench.axis.set_voltage(1)


def test_the_sensor_saturates_at_its_range_and_is_constant_when_unplugged(hand):
    bench = VirtualBench(PlayActuator(plays=10), clock=hand, sensor_range=(0.0, 4e-6))
    bench.axis.set_voltage(150)
    assert bench.axis.displacement() == 4e-6
    bench.axis.unplugged = True
    assert {bench.axis.displacement() for _ in range(5)} == {0.0}


def test_the_actuator_creeps_in_idle_time_which_is_computed_fast():
    def at_the_end(looks):
        hand = Hand()
        bench = VirtualBench(PlayActuator(plays=40, creep=0.01, noise=0), clock=hand)
        bench.axis.set_voltage(100)
        early = bench.axis.displacement()
        for _ in range(looks):
            hand.wait(3600 / looks)
            last = bench.axis.displacement()
        return early, last

    began = time.process_time()
    early, once = at_the_end(1)
    assert time.process_time() - began < 1
    assert once > early * 1.02
    assert at_the_end(500)[1] == pytest.approx(once, rel=1e-9)


@pytest.mark.parametrize("kind", [kind if kind == "play" else at_night(kind) for kind in VIRTUAL])
def test_a_long_record_comes_in_batches_within_seconds(kind):
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


def test_a_sample_takes_a_whole_number_of_servo_periods():
    rig = SimulatedRig(PlayActuator(), servo_period=1e-3)
    assert rig.nearest_rate(300.0) == pytest.approx(1000 / 3)
    assert rig.nearest_rate(1e6) == pytest.approx(1000)


class WarmRig(SimulatedRig):
    def _wave(self, voltage, rate):
        for samples in super()._wave(voltage, rate):
            yield samples._replace(others={"temperature_C": 20 + 15 * np.clip(samples.time, 0, 2)})


def test_records_have_the_declared_further_channels_of_a_rig():
    rig = WarmRig(PlayActuator(), limits=(0, 100))
    rig.others = ("temperature_C",)
    wave = Excitation("wave", np.linspace(0, 100, 400), 100.0)
    batches = []
    record = rig.play(wave, batches.append)
    np.testing.assert_allclose(record.temperature, 20 + 30 * np.clip(record.time / 2, 0, 1))
    assert sum(batch.others["temperature_C"].size for batch in batches) == len(record)
    assert batches[0].axis(0).others.keys() == {"temperature_C"}
    rig.others = ("load_N",)
    with pytest.raises(DeviceError, match="temperature_C"):
        rig.play(wave)
    assert open_rig("sim://", limits=(0, 100)).play(wave).temperature is None


def test_displacements_are_the_matrix_times_the_actuators_displacements():
    v = waves()
    alone = np.column_stack([actuator.play(v[:, j], measured=False) for j, actuator in enumerate(pair())])
    y = VirtualStage(pair(), COUPLING).play(v, measured=False)
    np.testing.assert_allclose(y, alone @ COUPLING.T, rtol=0, atol=1e-18)


@pytest.mark.parametrize(("coupling", "got"), [(np.eye(3), "3 x 3 numbers"), (2 * np.eye(2), "diagonal [2.0, 2.0]")])
def test_a_coupling_of_another_size_or_scale_is_refused(coupling, got):
    with pytest.raises(ModelError) as caught:
        VirtualStage(pair(), coupling)
    assert caught.value.argument == "coupling" and got in caught.value.got


def test_equal_stages_have_equal_serial_numbers():
    stage, same = VirtualStage(pair(), COUPLING), VirtualStage(pair(), COUPLING, noise=0, seed=3)
    assert stage.serial == same.serial
    assert stage.serial != VirtualStage(pair(), np.eye(2)).serial


def test_an_axis_at_rest_is_recorded_too(hand):
    v = waves()
    stage = VirtualBench(VirtualStage(pair(), COUPLING, noise=0), clock=hand)
    stage.axes[1].set_voltage(30.0)
    stage.start({0: v[:, 0]})
    hand.wait(1.0)
    stage.advance()
    _, voltage, displacement = stage.samples(axis=1)
    assert set(voltage) == {30.0}
    assert np.ptp(displacement) == pytest.approx(0.03 * np.ptp(stage.samples(axis=0)[2]), rel=1e-3)
