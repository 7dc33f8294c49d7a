"""A virtual stage and its bench: coupling by a matrix, waves of all axes from one instant."""

import numpy as np
import pytest
from hand_clock import Hand
from truths import PreisachActuator

from dehyst import ModelError
from dehyst.virtual import PlayActuator, VirtualBench, VirtualStage

COUPLING = np.array([[1.0, 0.04], [-0.03, 1.0]])
PERIOD = 5e-5


def pair(**options):
    return PlayActuator(plays=30, highest=100.0, **options), PreisachActuator(highest=120.0)


def waves(samples=400):
    turn = np.arange(samples) * 2 * np.pi / samples
    return np.column_stack([50 * (1 - np.cos(turn)), 60 * (1 - np.cos(1.7 * turn))])


def test_displacements_are_the_matrix_times_the_actuators_displacements():
    v = waves()
    alone = np.column_stack([actuator.play(v[:, j], measured=False) for j, actuator in enumerate(pair())])
    y = VirtualStage(pair(), COUPLING).play(v, measured=False)
    np.testing.assert_allclose(y, alone @ COUPLING.T, rtol=0, atol=1e-18)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"coupling": np.eye(3)}, "coupling: got 3 x 3 numbers for 2 axes"),
        ({"coupling": 2 * np.eye(2)}, "need 1 for each axis"),
    ],
)
def test_a_matrix_or_actuators_of_another_size_are_refused(change, words):
    with pytest.raises(ModelError, match=words):
        VirtualStage(pair(), **change)


def test_equal_stages_have_equal_serial_numbers():
    stage, same = VirtualStage(pair(), COUPLING), VirtualStage(pair(), COUPLING, noise=0, seed=3)
    assert stage.serial == same.serial
    assert stage.serial != VirtualStage(pair(), np.eye(2)).serial


def bench(hand, **options):
    return VirtualBench(VirtualStage(pair(), COUPLING, noise=0), clock=hand, **options)


@pytest.mark.parametrize("pause", [0.0131, 0.003, 10.0])
def test_a_recorded_wave_is_the_motion_of_the_stage(pause):
    hand, v = Hand(), waves()
    stage = bench(hand)
    stage.start({0: v[:, 0], 1: v[:, 1]}, divider=7)
    while stage.playing:
        hand.wait(pause)
        stage.advance()
    expected = VirtualStage(pair(), COUPLING, noise=0).play(v, measured=False)
    for j in range(2):
        time, voltage, displacement = stage.samples(axis=j)
        np.testing.assert_allclose(time, 7 * PERIOD * np.arange(len(v)), rtol=1e-12, atol=1e-15)
        np.testing.assert_array_equal(voltage, v[:, j])
        # The sums of an actuator's own relays depend on the number of samples in their last digits.
        np.testing.assert_allclose(displacement, expected[:, j], rtol=1e-14, atol=1e-19)
    # A later reading is the last sample.
    assert [axis.displacement() for axis in stage.axes] == [stage.samples(axis=j)[2][-1] for j in range(2)]


def test_an_axis_at_rest_is_recorded_too():
    hand, v = Hand(), waves()
    stage = bench(hand)
    stage.axes[1].set_voltage(30.0)
    stage.start({0: v[:, 0]})
    hand.wait(1.0)
    stage.advance()
    _, voltage, displacement = stage.samples(axis=1)
    assert set(voltage) == {30.0}
    assert np.ptp(displacement) == pytest.approx(0.03 * np.ptp(stage.samples(axis=0)[2]), rel=1e-3)
