"""The virtual bench: limits never left, samples at their times, an actuator that moves as its truth does."""

import math
import time
from itertools import pairwise

import numpy as np
import pytest
from bench import plant
from hypothesis import given, settings
from hypothesis import strategies as st

from dehyst import Actuator, DehystError, ModelError, State
from dehyst._errors import DeviceError
from dehyst.amplifier import Extremes
from dehyst.creep import Creep
from dehyst.dynamics import Dynamics
from dehyst.instrument import Instrument
from dehyst.truths import BoucWenActuator, PlayActuator, PreisachActuator
from dehyst.virtual import ModelledActuator, virtual_actuator

PERIOD = 5e-5
TRUTHS = {
    "play": lambda: PlayActuator(plays=40),
    "creep": lambda: PlayActuator(plays=40, creep=0.01),
    "preisach": PreisachActuator,
    "boucwen": BoucWenActuator,
    "model": lambda: ModelledActuator(plant()),
}


class Hand:
    """A clock that is set by hand."""

    def __init__(self):
        self.time = 0.0

    def __call__(self):
        return self.time

    def wait(self, seconds):
        self.time += seconds


def cosine(low=0.0, high=200.0, cycles=2, samples=400):
    turn = np.arange(samples * cycles + 1) * 2 * np.pi / samples
    return low + 0.5 * (high - low) * (1 - np.cos(turn))


@pytest.fixture
def hand():
    return Hand()


@pytest.mark.parametrize("kind", TRUTHS)
def test_a_recorded_wave_is_what_the_truth_does_with_its_voltages_and_times(kind, hand):
    wave = cosine()
    bench = Instrument(TRUTHS[kind](), clock=hand, noise=0)
    bench.start(wave, divider=7)
    while bench.playing:
        hand.wait(0.0131)
    at, voltage, displacement = bench.samples()
    truth = TRUTHS[kind]()
    expected = truth.drive(wave, time=at, measured=False)
    np.testing.assert_allclose(at, 7 * PERIOD * np.arange(wave.size), rtol=1e-12, atol=1e-15)
    np.testing.assert_array_equal(voltage, wave)
    # A jump takes a thousandth of a servo period, of which only what swings and creeps knows.
    np.testing.assert_allclose(displacement, expected, atol=1e-6 * truth.stroke)
    if kind == "play":
        np.testing.assert_array_equal(displacement, expected)


def test_noise_is_the_truths_own_unless_told():
    def record(**options):
        clock = Hand()
        bench = Instrument(PlayActuator(plays=10), clock=clock, **options)
        bench.start(cosine())
        clock.wait(1.0)
        return bench.samples()[2]

    clean = record(noise=0.0)
    assert np.std(record() - clean) == pytest.approx(2e-9, rel=0.1)
    assert np.std(record(noise=1e-8, seed=2) - clean) == pytest.approx(1e-8, rel=0.1)
    np.testing.assert_array_equal(record(seed=5), record(seed=5))
