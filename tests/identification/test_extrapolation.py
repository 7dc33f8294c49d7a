"""Only what the voltage causes: drift, noise and vibration make no part; creep that is there stays."""

import itertools
from dataclasses import replace
from functools import cache

import numpy as np
import plain_records
import pytest
import structured_records as wide

import dehyst
from dehyst import Creep, Record
from dehyst.identification import Readiness
from examples import at_night

RATE = 50.0
PLANT = plain_records.plant(10)


def two_speeds(actuator):
    """Loops of falling size, fast, then slow, in one record; relaxed at the start."""
    tops = (1.0, 0.7, 0.85, 0.5, 0.65, 0.35, 0.9)
    legs = [0.0]
    for top in tops:
        legs += [top, 0.02]
    corners = plain_records.VOLTS * np.array(legs)
    parts = [np.linspace(a, b, n + 1)[1:] for n in (40, 200) for a, b in itertools.pairwise(corners)]
    voltage = np.concatenate([corners[:1], *parts])
    time = np.arange(voltage.size) / RATE
    given = {"time": time} if actuator.needs_time else {}
    return time, voltage, actuator.simulate(voltage, state=actuator.relaxed(), **given).displacement


def recorded(actuator, disturb, noise=5e-4):
    time, voltage, y = two_speeds(actuator)
    stroke = np.ptp(y)
    jitter = noise * stroke * np.random.default_rng(1).normal(size=y.size)
    return Record(time, voltage, y + jitter + stroke * disturb(time), "disturbed")


DISTURBANCES = {
    "drift": lambda time: 0.03 * time / time[-1],
    "vibration": lambda time: 0.005 * np.sin(2 * np.pi * 3.1 * time),
}


@cache
def disturbed(name):
    return dehyst.identify(recorded(PLANT, DISTURBANCES[name]))


@pytest.mark.slow
@pytest.mark.parametrize("name", [at_night("drift"), "vibration"])
def test_what_the_voltage_does_not_cause_makes_no_part(name):
    fit = disturbed(name)
    assert fit.actuator.dynamics is None
    assert fit.actuator.creep is None
    assert fit.actuator.delay == 0


@pytest.mark.nightly
def test_noise_makes_no_resonance():
    fit = dehyst.identify(recorded(PLANT, lambda time: 0 * time, 5e-3))
    assert fit.actuator.dynamics is None
    assert fit.actuator.delay == 0


@pytest.mark.slow
def test_creep_that_is_there_stays():
    creeping = replace(PLANT, creep=Creep([0.5, 20.0], [0.1 * wide.SLOPE, 0.1 * wide.SLOPE]))
    fit = dehyst.identify(recorded(creeping, lambda time: 0 * time))
    assert fit.actuator.creep is not None
    assert fit.expectation.readiness is not Readiness.NOT_USABLE


@pytest.mark.slow
def test_a_vibration_is_reported_with_its_frequency():
    (remaining,) = disturbed("vibration").remaining
    assert remaining.frequency == pytest.approx(3.1, abs=0.1)
    assert remaining.vibration_amplitude == pytest.approx(0.005 * np.ptp(two_speeds(PLANT)[2]), rel=0.1)
