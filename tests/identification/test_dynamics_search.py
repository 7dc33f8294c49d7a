"""Delay, damping and inertia of actuators that are known, and of those that have none."""

from dataclasses import replace

import numpy as np
import plain_records
import pytest
import structured_records as wide
import tracking_trials
from hypothesis import given
from hypothesis import strategies as st

from dehyst import Dynamics, Record
from dehyst.identification.preprocessing.denoising import derivatives, remove_dynamics
from dehyst.identification.training_data import find_dynamics

PLANT = plain_records.plant(20, seed=2)
STEP, PERIOD = 1e-4, 0.02


def driven(actuator, *, delay=0, noise=0.0, step=STEP):
    """Descending tops, the displacement so many samples late."""
    v = tracking_trials.tops(12, round(PERIOD / STEP / 2))
    time = np.arange(v.size) * step
    late = np.concatenate([np.full(delay, v[0]), v])[: v.size]
    state = actuator.relaxed()
    if actuator.dynamics is not None:
        state = replace(state, motion=[state.deformation, 0.0])
    y = actuator.simulate(late, time=time, state=state).displacement
    return Record(time, v, y + noise * np.random.default_rng(1).normal(size=y.size), "driven")


def with_dynamics(resonance, damping):
    return replace(PLANT, dynamics=Dynamics(2 * np.pi * resonance, damping))


def test_without_mass_there_are_no_dynamics():
    record = plain_records.loops(PLANT, plain_records.MAJOR)
    assert remove_dynamics(record, None) is record


@given(seed=st.integers(0, 2**32 - 1))
def test_derivatives_of_a_quartic_are_exact(seed):
    curve = np.polynomial.Polynomial(1e-5 * np.random.default_rng(seed).normal(size=5))
    time = np.linspace(-1, 1, 60)
    found = derivatives(Record(time, time, curve(time)))
    for order, values in enumerate(found, start=1):
        np.testing.assert_allclose(values, curve.deriv(order)(time), rtol=0, atol=1e-9 * 1e-5 * 60**order)


def test_what_the_resonance_had_to_follow_comes_back():
    """A second way: the same actuator without its mass moves so. Corners of its motion are rounded a little."""
    actuator = with_dynamics(300.0, 0.05)
    made = driven(actuator)
    expected = driven(replace(actuator, dynamics=None)).displacement
    seen, left = (
        np.abs(y - expected)[10:-10].max() / np.ptp(expected)
        for y in (made.displacement, remove_dynamics(made, actuator.dynamics).displacement)
    )
    assert seen > 0.04
    assert left < 1e-3


@pytest.mark.parametrize(("resonance", "damping", "delay"), [(300.0, 0.03, 2), (300.0, 0.1, 0), (200.0, 0.05, 1)])
def test_delay_damping_and_mass_come_back(resonance, damping, delay):
    """Excited at 50 Hz, far below the resonance: a lag by delay is hard to tell from one by damping."""
    record = driven(with_dynamics(resonance, damping), delay=delay, noise=1e-4 * plain_records.STROKE)
    found = wide.frame([record], delay=delay * STEP).with_inertia().lagging
    omega = 2 * np.pi * resonance
    assert found.dynamics.frequency == pytest.approx(omega, rel=0.05)
    assert found.delay == pytest.approx(delay * STEP, abs=0.5 * STEP)
    lag = 2 * found.dynamics.damping / found.dynamics.frequency
    assert found.delay + lag == pytest.approx(delay * STEP + 2 * damping / omega, abs=0.1 * STEP)


@pytest.mark.parametrize("delay", [0.0, 2e-3 * STEP, 0.3 * STEP])
def test_a_delay_below_a_hundredth_of_a_sample_is_none(delay):
    """The search itself, on a cost that is least there."""

    def error(lagging):
        if lagging.dynamics is None:
            return 1e-2 + abs(lagging.delay - delay) / STEP + 1
        omega, zeta = lagging.dynamics.frequency, lagging.dynamics.damping
        off = abs(lagging.delay - delay) + 2 * zeta / omega
        return 1e-2 + off / STEP + abs(1 / (omega * STEP) ** 2 - 1)

    found = find_dynamics(error, 0.0, STEP, PERIOD)
    assert found.dynamics is not None
    assert found.delay == (pytest.approx(delay, abs=0.02 * STEP) if delay > 0.1 * STEP else 0)


@pytest.mark.parametrize("delay", [0, 3])
def test_none_is_found_where_there_is_none(delay):
    frame = wide.frame([driven(PLANT, delay=delay, noise=1e-4 * plain_records.STROKE)], delay=delay * STEP)
    assert frame.with_inertia() is frame


def test_cycles_of_many_samples_are_not_searched():
    """A thousand samples a cycle: what has a mass then is the sensor's noise."""
    v = tracking_trials.tops(3, 600)
    y = PLANT.simulate(v, state=PLANT.relaxed()).displacement
    frame = wide.frame([Record(np.arange(v.size) * STEP, v, y)])
    assert frame.with_inertia() is frame
