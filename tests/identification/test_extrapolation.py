"""Only what the voltage causes: drift, noise and vibration make no part; creep that is there stays."""

import itertools
from dataclasses import replace
from functools import cache

import numpy as np
import plain_records
import pytest

import dehyst
from dehyst import DisplacementCreep, Record
from examples import at_night

RATE = 50.0
PLANT = plain_records.plant(10)


def two_speeds(actuator):
    """Loops of falling size, fast, then slow, and a hold, in one record; relaxed at the start."""
    tops = (1.0, 0.7, 0.85, 0.5, 0.65, 0.35, 0.9)
    branches = [0.0]
    for top in tops:
        branches += [top, 0.0]
    corners = plain_records.VOLTS * np.array(branches)
    parts = [np.linspace(a, b, n + 1)[1:] for n in (40, 100) for a, b in itertools.pairwise(corners)]
    voltage = np.concatenate([corners[:1], *parts, np.full(round(20 * RATE), corners[-1])])
    time = np.arange(voltage.size) / RATE
    given = {"time": time}
    return time, voltage, actuator.simulate(voltage, state=actuator.relaxed(), **given).displacement


def recorded(actuator, disturb):
    time, voltage, y = two_speeds(actuator)
    stroke = np.ptp(y)
    jitter = 5e-4 * stroke * np.random.default_rng(1).normal(size=y.size)
    return Record(time, voltage, y + jitter + stroke * disturb(time), "disturbed")


DISTURBANCES = {
    "drift": lambda time: 0.03 * time / time[-1],
    "vibration": lambda time: 0.005 * np.sin(2 * np.pi * 3.1 * time),
    "noise": lambda time: 5e-3 * np.random.default_rng(2).normal(size=time.size),
}


@cache
def disturbed(name):
    return dehyst.identify(recorded(PLANT, DISTURBANCES[name]))


@pytest.mark.parametrize("name", [at_night("drift"), "vibration", at_night("noise")])
def test_what_the_voltage_does_not_cause_makes_no_part(name):
    fit = disturbed(name)
    assert fit.actuator.dynamics is None
    assert fit.actuator.displacement_creep is None
    # Part of a sample; a vibration of half a percent moves turns by more.
    assert RATE * fit.actuator.delay < 0.2


def test_creep_that_is_there_stays():
    creeping = replace(PLANT, displacement_creep=DisplacementCreep([0.5, 20.0], [0.05, 0.05]))
    record = recorded(creeping, lambda time: 0 * time)
    fit = dehyst.identify(record)
    assert fit.actuator.displacement_creep is not None
    # Only what follows a full loop is compared, apart from a constant: the stages begin in states of their own.
    turns = np.concatenate([[0, 1, 0], np.random.default_rng(3).uniform(size=30)])
    time = np.arange(80 * 32) / RATE
    voltage = plain_records.VOLTS * np.interp(RATE * time / 80, np.arange(33), turns)
    reached, expected = (actuator.simulate(voltage, time=time).displacement for actuator in (creeping, fit.actuator))
    assert np.ptp((expected - reached)[160:]) / 2 < fit.promise.largest


def test_a_vibration_is_reported_with_its_frequency():
    (remaining,) = disturbed("vibration").remaining
    assert remaining.frequency == pytest.approx(3.1, abs=0.1)
    assert remaining.vibration_amplitude == pytest.approx(0.005 * np.ptp(two_speeds(PLANT)[2]), rel=0.1)
