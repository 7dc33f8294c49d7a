"""Creep in displacement: its equation by other means, its inverse, its memory, and what refuses it."""

from dataclasses import replace

import numpy as np
import plain_records
import pytest

from dehyst import ClampWarning, Compensator, DisplacementCreep, Dynamics, Thermal
from dehyst.model import knots_of, turned

PLANT = plain_records.plant(10, seed=4)
PART = DisplacementCreep([0.02, 0.3, 4.0], [0.02, 0.03, 0.04])
CREEPING = replace(PLANT, displacement_creep=PART)
PARTS = {
    "alone": {},
    "load": {"load_stiffness": 5e7},
    "inertia": {"dynamics": Dynamics(30, 0.03, 2e6), "load_stiffness": 5e7},
    "lag": {"lag": 0.01},
}


def uneven(n, seed=1):
    """Times [s] of uneven steps."""
    return np.cumsum(np.random.default_rng(seed).uniform(1e-4, 0.02, n))


def smooth(time):
    """A smooth path [m] within the reach."""
    low, high = CREEPING.reach
    return low + (high - low) * (0.5 + 0.3 * np.sin(3 * time) + 0.1 * np.sin(11 * time))


@pytest.mark.parametrize("name", PARTS)
def test_the_inverse_is_exact_at_uneven_steps(name):
    actuator = replace(CREEPING, **PARTS[name])
    time = uneven(3000) if name not in ("inertia", "lag") else np.arange(6000) * 2e-4
    path = smooth(time)
    load = 20 * np.sin(5 * time) if actuator.load_stiffness else None
    state = replace(turned(actuator, path[0]), displacement_creep=[1e-7, -2e-7, 3e-7])
    start = actuator.compensate(path[:1], time=time[:1], load=None if load is None else load[:1], state=state).state
    motion = actuator.compensate(path, time=time, load=load, state=start)
    back = actuator.simulate(motion.voltage, time=time, load=load, state=start, extrapolate=True)
    exact = name not in ("inertia", "lag")
    settled = slice(None) if exact else slice(3000, None)
    np.testing.assert_allclose(back.displacement[settled], path[settled], rtol=0, atol=1e-17 if exact else 1e-8)
    if exact:
        np.testing.assert_allclose(back.state.displacement_creep, motion.state.displacement_creep, rtol=0, atol=1e-17)


def test_a_held_voltage_ends_at_the_displacement_at_rest():
    assert PART.at_rest == pytest.approx(1.09)
    np.testing.assert_allclose(CREEPING.reach, 1.09 * np.array(PLANT.reach), rtol=1e-12, atol=1e-18)
    np.testing.assert_allclose(knots_of(CREEPING), 1.09 * PLANT.spring.displacement[[0, -1]], rtol=1e-12)
    top = turned(CREEPING, 5e-6)
    assert CREEPING.displacement(top) == pytest.approx(5e-6, rel=1e-14)
    held = CREEPING.simulate(np.full(3, 80.0), time=[0.0, 100.0, 1e4], state=CREEPING.relaxed(0.0))
    assert held.displacement[-1] == pytest.approx(1.09 * held.state.deformation, rel=1e-12)
    assert CREEPING.displacement(held.state) == pytest.approx(held.displacement[-1], rel=1e-14)


def test_a_snapshot_keeps_gain_and_offset_of_a_loop():
    loop, other = (Compensator(CREEPING, (0, 200), period=1e-3, units="um") for _ in range(2))
    loop.scale(1.05, 0.1)
    loop.step(6.0)
    other.restore(loop.snapshot())
    assert loop.scale() == (1.05, 0.1) and other.scale() == pytest.approx((1.05, 0.1))
    assert other.step(5.0) == loop.step(5.0) and other.snapshot() == loop.snapshot()
    with pytest.warns(ClampWarning):
        loop.step(1e3)


THERMAL = replace(CREEPING, thermal=Thermal(0.004, 2e-9, 25.0))


def test_temperature_changes_gain_and_offset_after_all_other_parts():
    time = 1e-3 * np.arange(500)
    path, kelvins = smooth(time), 15 * np.sin(2 * time)
    warm = THERMAL.simulate(np.full(500, 50.0), time=time, temperature=35.0).displacement
    still = THERMAL.simulate(np.full(500, 50.0), time=time).displacement
    np.testing.assert_allclose(warm, 2e-8 + 1.04 * still, rtol=1e-14)
    motion = THERMAL.compensate(path, time=time, temperature=25 + kelvins)
    back = THERMAL.simulate(motion.voltage, time=time, temperature=25 + kelvins, extrapolate=True)
    np.testing.assert_allclose(back.displacement, path, rtol=0, atol=1e-17)
    np.testing.assert_array_equal(
        THERMAL.compensate(path, time=time).voltage, CREEPING.compensate(path, time=time).voltage
    )
