"""The wider class: graded elements, transformer and creep. Laws and the oracle."""

import numpy as np
import plain_records
import pytest
import reference_model
import strategies as our
from hypothesis import assume, given
from hypothesis import strategies as st

from dehyst import Actuator, DisplacementCreep, MaxwellSlip, ModelError, Spring, State
from dehyst.model import GradedSlip, Physical, Transformer, turned
from examples import examples

EXACT = 1e-12
SLIP, SPRING = MaxwellSlip([1e-6, 2e-6], [1e6, 2e6]), Spring([0, 4e-6, 1e-5], [0, 30, 100])
TAU, CREEP = Transformer([0, 50, 100], [0, 60, 100]), DisplacementCreep([0.1, 1.0], [0.1, 0.2])
GRADED = GradedSlip([1e-6, 2e-6], [0, 5e-6, 1e-5], [[1e6, 2e6], [2e6, 3e6]])
CONSTANTS = {"transformer_ratio": 0.042, "mechanical_stiffness": 1.4e6, "electrical_stiffness": 8.82e4}


def scales(actuator, state, path):
    """Rounding [V] and [m]: what elements hold at most over this motion, and its range."""
    metres = max(our.span_of(actuator), float(np.ptp(np.append(path, state.deformation))))
    slopes = actuator.spring.slopes.max() + np.sum(actuator.slip.stiffness)
    return EXACT * slopes * metres, EXACT * metres


def same_state(first, second, metres):
    plain_records.assert_close(first.deformation, second.deformation, metres)
    plain_records.assert_close(first.carts, second.carts, metres)
    plain_records.assert_close(first.displacement_creep, second.displacement_creep, metres)


@pytest.mark.parametrize("stack", [True, False])
@given(motion=our.wider_motions())
def test_compensate_agrees_with_the_oracle(stack, motion):
    actuator, state, time, path = motion
    volts, metres = scales(actuator, state, path)
    known = reference_model.Wide(actuator, state)
    got = actuator.compensate(path, time=time, state=state, stack=stack, extrapolate=True)
    plain_records.assert_close(got.voltage, known.compensate(path, time), 3 * volts)
    same_state(got.state, State(known.y, known.carts, displacement_creep=known.y - known.z), metres)


@pytest.mark.parametrize("stack", [True, False])
@given(motion=our.wider_motions(max_elements=6, max_samples=25))
@examples(10, nightly=80)
def test_simulate_agrees_with_the_oracle(stack, motion):
    actuator, state, time, path = motion
    v = actuator.compensate(path, time=time, state=state, extrapolate=True).voltage
    v = v + 0.1 * np.ptp(v) * np.random.default_rng(1).normal(size=v.size) if v.size else v
    known = reference_model.Wide(actuator, state)
    expected = known.simulate(v, time)
    metres = EXACT * (our.span_of(actuator) + np.ptp(np.append(expected, state.deformation)))
    got = actuator.simulate(v, time=time, state=state, stack=stack, extrapolate=True)
    plain_records.assert_close(got.displacement, expected, 10 * metres)
    same_state(got.state, State(known.y, known.carts, displacement_creep=known.y - known.z), 10 * metres)


@given(actuator=our.actuators(1, 12), seed=our.SEEDS, width=st.floats(0.1, 3))
def test_dissipation_of_graded_elements(actuator, seed, width):
    """A loop loses what friction takes: rho_i psi_i' |db_i| of each cart that slides, here to and fro."""
    wider = our.make_wider(actuator, seed, graded=True, transformer=False, creep=False)
    slip, knots = wider.slip, wider.spring.displacement
    rho, bottom = slip.breakaway, float(np.mean(knots)) - width * slip.breakaway[-1]
    top = bottom + 2 * width * rho[-1]
    bends = np.concatenate(
        [(slip.knots[:, None] + np.append(0, [-rho, rho])).ravel(), knots, top - 2 * rho, bottom + 2 * rho]
    )
    ticks = np.unique(np.append(bends.clip(bottom, top), [bottom, top]))
    loop = np.concatenate([ticks, ticks[-2::-1]])
    v = wider.compensate(
        np.concatenate([loop, loop]), state=turned(wider, bottom, rising=False), extrapolate=True
    ).voltage[loop.size :]
    area = float(np.sum(0.5 * (v[1:] + v[:-1]) * np.diff(loop)))
    low, high = bottom + rho, np.maximum(top - rho, bottom + rho)
    lost = float(2 * rho @ (slip.internal_voltage(high) - slip.internal_voltage(low)))
    volts, _ = scales(wider, turned(wider, bottom), loop)
    assert lost >= 0
    plain_records.assert_close(area, lost, loop.size * volts * (top - bottom))


@given(motion=our.wider_motions(max_samples=0), seed=our.SEEDS)
def test_states_rest_where_they_say(motion, seed):
    actuator, state, *_ = motion
    v = actuator.voltage(state)
    volts, metres = scales(actuator, state, [])
    here = actuator.compensate([actuator.displacement(state)], time=[seed], state=state, extrapolate=True)
    plain_records.assert_close(here.voltage, [v], 3 * volts)
    came = actuator.simulate([v], time=[seed], state=state, extrapolate=True)
    plain_records.assert_close(came.displacement, [actuator.displacement(state)], 10 * metres)
    relaxed = actuator.relaxed(v, extrapolate=True)
    plain_records.assert_close(actuator.voltage(relaxed), v, 3 * volts + 1e-12 * abs(v))
    assert np.ptp(np.append(relaxed.carts, relaxed.deformation)) == 0


def outer_slopes(slip, spring, y):
    """Slopes of the two outermost branches at y, by differences."""
    h = 1e-9 * np.ptp(spring.displacement)
    for rho in (slip.breakaway, -slip.breakaway):
        v = [
            spring(at[:, 0]) + (slip.internal_voltage(at) - slip.internal_voltage(at - rho)).sum(axis=-1)
            for at in (y[:, None] - h, y[:, None] + h)
        ]
        yield (v[1] - v[0]) / (2 * h)


@given(seed=our.SEEDS, size=st.floats(0.1, 10))
def test_branches_that_fall_are_refused_and_no_others(seed, size):
    rng = np.random.default_rng(seed)
    spring = Spring([0, 0.4, 1], [0, 0.5, 1])
    slip = GradedSlip(np.cumsum(rng.uniform(0.05, 0.3, 4)), np.sort(rng.uniform(0, 1, 5)), size * rng.random((4, 4)))
    y = np.linspace(-1.5, 2.5, 4001)
    slope = min(s.min() for s in outer_slopes(slip, Spring([0, 0.4, 1], [0, 0.5, 1]), y))
    assume(abs(slope) > 1e-6)
    try:
        Actuator(slip, spring)
    except ModelError as error:
        assert "outermost branch" in str(error)
    else:
        assert slope > 0


@given(motion=our.motions(our.actuators(1, 12), max_samples=30))
def test_charge_balances_power(motion):
    """The work v dq at the terminals is F dx on the elements and the spring: T v dx."""
    actuator, state, path = motion
    assume(path.size > 1)
    paper, v = Physical.of(actuator, **CONSTANTS), actuator.compensate(path, state=state, extrapolate=True).voltage
    q = paper.charge(path)
    x = np.diff(path) * 1.4e6 / paper.equivalent_stiffness
    mean = 0.5 * (v[1:] + v[:-1])
    np.testing.assert_allclose(mean * np.diff(q), 0.042 * mean * x, atol=1e-12 * np.abs(v).max() * np.ptp(q))
    at_knots = paper.charge(actuator.spring.displacement)
    np.testing.assert_allclose(at_knots, 0.042 * paper.deformation, atol=1e-12 * np.ptp(at_knots))
