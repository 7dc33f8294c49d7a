"""Resonance, damping, delay and lag from simulation: found where they are, and a lag only where there is one."""

from dataclasses import replace

import numpy as np
import pytest
import structured_records as wide

import dehyst
from dehyst import Dynamics
from dehyst.identification.preprocessing.preparation import prepare
from dehyst.identification.structured_fit import SimulationError, tune_resonance
from dehyst.records import Record
from dehyst.records.signals import interpolate, rms
from dehyst.waveforms import Sampling, descending_tops, staircase

RATE, OMEGA = 5000.0, 2 * np.pi * 250
NOISE = 3e-9
TRUE = replace(wide.plant(wide.STRUCTURES["plain"]).actuator, dynamics=Dynamics(OMEGA, 0.04))


def records(actuator, delay=0.0):
    """Fast loops and steps that let it ring, measured late and with noise."""
    rng, found, drive = np.random.default_rng(4), [], Sampling(frequency=40.0, sample_rate=RATE)
    for one in (descending_tops(150.0, drive=drive), staircase(150.0, steps=6, hold=0.05, back=True, drive=drive)):
        acting = interpolate(one.time, one.voltage, np.maximum(one.time - delay, 0.0), "pchip")
        y = actuator.simulate(acting, time=one.time, state=actuator.relaxed()).displacement
        found.append(Record(one.time, one.voltage, y + NOISE * rng.standard_normal(y.size), "rings"))
    return found


def off(actuator, **changes):
    return replace(actuator, dynamics=Dynamics(1.06 * OMEGA, 0.01), **changes)


def played(actuator, given):
    stroke = float(np.ptp(actuator.spring.displacement))
    return SimulationError.of(actuator, [prepare(one) for one in given], np.zeros(len(given)), stroke)


def tuned(actuator, given):
    return tune_resonance(actuator, played(actuator, given))


@pytest.mark.parametrize("delay", [0.0, 3.3e-4])
def test_numbers_that_are_off_are_found(delay):
    given = records(TRUE, delay)
    found = tuned(off(TRUE), given)
    assert found.dynamics.frequency == pytest.approx(OMEGA, rel=2e-3)
    assert found.dynamics.damping == pytest.approx(0.04, abs=3e-3)
    assert found.delay == pytest.approx(delay, abs=1e-5)
    assert found.delay == 0 or found.delay * RATE > 0.01
    assert found.lag == 0
    # The state in which a record begins is read off it by the dynamics that are known so far.
    assert rms(played(found, given).errors(found)) < 2 * NOISE
    assert rms(played(off(TRUE), given).errors(off(TRUE))) > 20 * NOISE


def test_a_lag_is_found_where_there_is_one():
    found = tuned(off(TRUE), records(replace(TRUE, lag=4e-4)))
    assert found.lag == pytest.approx(4e-4, rel=0.05)
    assert found.dynamics.frequency == pytest.approx(OMEGA, rel=2e-3)


def test_without_dynamics_there_is_nothing_to_tune():
    still = replace(TRUE, dynamics=None)
    assert tuned(still, records(still)) == still


@pytest.mark.nightly
@pytest.mark.slow
def test_noisy_derivatives_do_not_make_a_mass_too_small():
    """The equation's least squares alone is off by several percent here; the whole identification is not."""
    fit = dehyst.identify(records(TRUE), structure="auto", norm="l2", shared_datum=True)
    assert fit.actuator.dynamics.frequency == pytest.approx(OMEGA, rel=5e-3)
    assert fit.actuator.dynamics.damping == pytest.approx(0.04, abs=5e-3)
    assert fit.errors[0].rms < 3 * NOISE
