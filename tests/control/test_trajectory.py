"""The voltage that leaves the program: never out of limits or slew rate, and the model knows what was really sent."""

from dataclasses import replace

import numpy as np
import plain_records
import pytest
import strategies as our
from hypothesis import given
from hypothesis import strategies as st

from dehyst import Compensator, Dynamics
from dehyst.control import following
from dehyst.control.following import follow
from examples import examples

PLANT = plain_records.plant(10, seed=4)
LOW, HIGH = 20.0, 150.0
RATE = 2e4
SHORTEST = 0.5e-3


def wanted(seed, size=400):
    """It leaves what the limits allow on both sides."""
    return plain_records.wild_path(seed, size, beyond=0.3, corners=(2, 12))


def times(seed, size):
    return np.cumsum(np.random.default_rng(seed + 1).uniform(SHORTEST, 2e-3, size))


WIDE = {
    "graded": {"graded": True, "transformer": False, "creep": False},
    "transformer": {"graded": False, "transformer": True, "creep": False},
    "creep": {"graded": False, "transformer": False, "creep": True},
    "all three": {"graded": True, "transformer": True, "creep": True},
}


def wider(kind, seed=5, **more):
    """The plant with wider parts; they leave its voltages about where they were."""
    return replace(our.make_wider(PLANT, seed, **WIDE[kind]), **more)


@pytest.mark.parametrize("kind", ["plain", *WIDE])
@given(st.integers(0, 10**6), st.booleans(), st.integers(1, 400))
def test_the_memory_follows_the_sent_voltage(kind, seed, slewing, size):
    plant = PLANT if kind == "plain" else wider(kind)
    path, time = wanted(seed)[:size], times(seed, 400)[:size]
    compensator = Compensator(plant, (LOW, HIGH), RATE if slewing else None, period=SHORTEST)
    command = follow(compensator._axes[0], path, time=time)
    motion = plant.simulate(command.voltage, time=time, stack=False, extrapolate=True)
    np.testing.assert_allclose(command.displacement, motion.displacement, atol=1e-9 * plain_records.STROKE)
    np.testing.assert_allclose(command.state.carts, motion.state.carts, atol=1e-9 * plain_records.STROKE)
    np.testing.assert_allclose(
        command.state.displacement_creep, motion.state.displacement_creep, atol=1e-9 * plain_records.STROKE
    )
    np.testing.assert_array_equal(command.displacement[~command.clamped], path[~command.clamped])
    if not slewing:
        # Only a sample out of reach is clamped: at the limit on its side.
        at, short = command.clamped, path - command.displacement
        np.testing.assert_array_equal(command.voltage[at], np.where(short > 0, HIGH, LOW)[at])


@pytest.mark.parametrize("kind", ["plain", *WIDE])
@given(st.integers(0, 10**6), st.booleans())
@examples(8, nightly=80)
def test_a_whole_path_is_clamped_like_single_steps(kind, seed, slewing):
    """Two parts of a path at different rates: one by one where time is even, or piece by piece as where it is not."""
    plant = PLANT if kind == "plain" else wider(kind)
    path, time = wanted(seed), np.append(np.arange(250) * 1e-3, 0.25 + np.arange(150) * 2e-3)
    compensator = Compensator(plant, (LOW, HIGH), RATE if slewing else None)
    commands = []
    for few in (following._FEW, 0):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(following, "_FEW", few)
            commands.append(follow(compensator._axes[0], path, time=time))
    first, other = commands
    np.testing.assert_allclose(first.voltage, other.voltage, atol=1e-10 * HIGH)
    np.testing.assert_allclose(first.displacement, other.displacement, atol=1e-10 * plain_records.STROKE)
    np.testing.assert_allclose(first.state.carts, other.state.carts, atol=1e-10 * plain_records.STROKE)
    # If a displacement lies on a limit to rounding, only one of the two may call it clamped.
    differ = first.clamped != other.clamped
    assert np.abs(first.displacement - path)[differ].max(initial=0.0) < 1e-10 * plain_records.STROKE


def smooth(size=1500):
    time = np.arange(size) * 2e-5
    return time, plain_records.STROKE * (0.5 - 0.2 * np.cos(2 * np.pi * 100 * time))


@pytest.mark.parametrize("lag", [0.0, 2e-4])
def test_wide_limits_do_not_change_a_path_with_mass_and_lag(lag):
    time, path = smooth()
    push = plain_records.STROKE * 0.2 * (2 * np.pi * 100) ** 2
    plant = wider("all three", dynamics=Dynamics(1000, 0.05, 2e6), lag=lag)
    first = plant.compensate(path[:1], time=[0], acceleration=[push]).state
    whole = plant.compensate(path, time=time, state=first)
    command = follow(Compensator(plant, (-1e4, 1e4))._axes[0], path, time=time, state=first)
    np.testing.assert_allclose(command.voltage, whole.voltage, atol=1e-9 * np.ptp(whole.voltage))
    played = plant.simulate(command.voltage, time=time, state=first)
    np.testing.assert_array_equal(command.displacement, played.displacement)
    assert np.abs(command.displacement - path).max() < 1e-3 * plain_records.STROKE


def test_the_displacement_of_a_clamped_mass_is_its_simulated_motion():
    time, path = smooth()
    plant = wider("creep", dynamics=Dynamics(1000, 0.3, 2e6))
    high = 0.9 * plant.compensate(path, time=time).voltage.max()
    command = follow(Compensator(plant, (-1e4, high))._axes[0], path, time=time, state=plant.state)
    assert command.clamped.any()
    assert command.voltage.max() == high
    played = plant.simulate(command.voltage, time=time)
    np.testing.assert_array_equal(command.displacement, played.displacement)
    # Long after the last clamp of a damped mass the path is followed again.
    gaps = np.flatnonzero(command.clamped)
    after = np.arange(time.size)[gaps[-1] + 100 :]
    assert after.size > 50
    assert np.abs(command.displacement - path)[after].max() < 1e-3 * plain_records.STROKE


SCALES = st.floats(0.5, 2.0), st.floats(-0.5, 0.5).map(lambda share: share * plain_records.STROKE)


@given(st.integers(0, 10**6), *SCALES)
def test_the_displacement_of_a_clamped_path_includes_gain_and_offset(seed, gain, offset):
    path = offset + gain * wanted(seed)
    loop = Compensator(PLANT, (LOW, HIGH))
    loop.scale(gain, offset)
    command = follow(loop._axes[0], path)
    moved = offset + gain * PLANT.simulate(command.voltage, state=loop._axes[0].given).displacement
    np.testing.assert_allclose(command.displacement, moved, atol=1e-9 * plain_records.STROKE)


def test_a_given_velocity_includes_the_gain():
    plant, time = replace(PLANT, dynamics=Dynamics(318.0, 0.05)), 1e-3 * np.arange(400)
    inside, velocity = (
        plain_records.STROKE * (a + 0.3 * wave) for a, wave in ((0.5, np.sin(9 * time)), (0, np.cos(9 * time)))
    )
    plain, loop = (Compensator(plant, (-1e4, 1e4), period=1e-3) for _ in range(2))
    loop.scale(1.5, 1e-6)
    given_rates = {"velocity": 9 * velocity, "acceleration": -81 * (inside - 0.5 * plain_records.STROKE)}
    expected = follow(plain._axes[0], inside, **given_rates)
    command = follow(loop._axes[0], 1e-6 + 1.5 * inside, **{name: 1.5 * rate for name, rate in given_rates.items()})
    np.testing.assert_allclose(command.voltage, expected.voltage, atol=1e-8)
    np.testing.assert_allclose(command.displacement, 1e-6 + 1.5 * expected.displacement, atol=1e-13)
