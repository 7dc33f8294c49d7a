"""The wider class: graded elements, transformer and creep. Laws, the oracle, an ODE solver, and every refusal."""

import numpy as np
import plain_records
import pytest
import reference_model
import strategies as our
from hypothesis import assume, given
from hypothesis import strategies as st

from dehyst import Actuator, Creep, MaxwellSlip, ModelError, Spring, State
from dehyst.model import GradedSlip, Physical, Transformer
from examples import examples

EXACT = 1e-12
SLIP, SPRING = MaxwellSlip([1e-6, 2e-6], [1e6, 2e6]), Spring([0, 4e-6, 1e-5], [0, 30, 100])
TAU, CREEP = Transformer([0, 50, 100], [0, 60, 100]), Creep([0.1, 1.0], [1e6, 2e6])
GRADED = GradedSlip([1e-6, 2e-6], [0, 5e-6, 1e-5], [[1e6, 2e6], [2e6, 3e6]])
CONSTANTS = {"transformer_ratio": 0.042, "mechanical_stiffness": 1.4e6, "electrical_stiffness": 8.82e4}


def scales(actuator, state, path):
    """Rounding [V] and [m]: what creep and elements hold at most over this motion, and its range."""
    metres = max(our.span_of(actuator), float(np.ptp(np.append(path, state.deformation))))
    creep = 0.0 if actuator.creep is None else float(actuator.creep.stiffness.sum())
    slopes = actuator.spring.slopes.max() + np.sum(actuator.slip.stiffness) + creep
    return EXACT * slopes * metres, EXACT * metres


def same_state(one, two, metres):
    plain_records.assert_close(one.deformation, two.deformation, metres)
    plain_records.assert_close(one.carts, two.carts, metres)
    plain_records.assert_close(one.creep, two.creep, metres)


@pytest.mark.parametrize("stack", [True, False])
@given(motion=our.wider_motions())
def test_compensate_agrees_with_the_oracle(stack, motion):
    actuator, state, time, path = motion
    volts, metres = scales(actuator, state, path)
    got, known = (
        actuator.compensate(path, time=time, state=state, stack=stack, extrapolate=True),
        reference_model.Wide(actuator, state),
    )
    plain_records.assert_close(got.voltage, known.compensate(path, time), 3 * volts)
    same_state(got.state, State(known.y, known.carts, known.y - known.z), metres)


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
    same_state(got.state, State(known.y, known.carts, known.y - known.z), 10 * metres)


@given(motion=our.wider_motions({"creep": True}, max_samples=30), parts=st.integers(2, 5))
def test_samples_added_on_a_straight_path_change_nothing(motion, parts):
    """Creep is exact for a displacement that is linear in time between samples."""
    actuator, state, time, path = motion
    assume(path.size > 1)
    fine = np.interp(np.arange(parts * (path.size - 1) + 1) / parts, np.arange(path.size), time)
    volts, _ = scales(actuator, state, path)
    coarse = actuator.compensate(path, time=time, state=state, extrapolate=True).voltage
    dense = actuator.compensate(np.interp(fine, time, path), time=fine, state=state, extrapolate=True).voltage
    # np.interp rounds times and places; a gain near 1 hands that on.
    plain_records.assert_close(dense[::parts], coarse, 30 * volts)


@pytest.mark.parametrize("seed", range(3))
def test_creep_agrees_with_an_ode_solver(seed):
    from scipy.integrate import solve_ivp

    rng = np.random.default_rng(seed)
    creep, spring = Creep(10 ** rng.uniform(-1, 1, 3), rng.uniform(1e6, 3e6, 3)), Spring([0, 1e-5], [0, 90])
    time, path = np.cumsum(rng.uniform(0.05, 0.5, 12)), 1e-5 * rng.random(12)
    actuator = Actuator(SLIP, spring, creep=creep)
    start = State(path[0], np.full(2, path[0]))
    d, found = np.zeros(3), [np.zeros(3)]
    for k in range(1, 12):
        slope = (path[k] - path[k - 1]) / (time[k] - time[k - 1])
        d = solve_ivp(
            lambda t, d, s=slope: s - d / creep.time_constants, time[k - 1 : k + 1], d, rtol=1e-12, atol=1e-20
        ).y[:, -1]
        found.append(d)
    plain = Actuator(SLIP, spring).compensate(path, state=start).voltage
    got = actuator.compensate(path, time=time, state=start)
    np.testing.assert_allclose(got.voltage, plain + np.array(found) @ creep.stiffness, atol=1e-8)
    np.testing.assert_allclose(creep.strains(time, path), found, atol=1e-15)


def test_a_simulation_of_creep_converges_at_second_order():
    """Between samples the voltage is what is straight, not the displacement: an error of the step squared."""
    actuator = Actuator(MaxwellSlip([], []), Spring([0, 1e-5], [0, 90]), creep=CREEP)
    errors, start = [], actuator.relaxed()
    fine = np.linspace(0, 2, 32 * 512 + 1)
    exact = actuator.simulate(40 * fine * (2 - fine), time=fine, state=start).displacement
    for n in (32, 64, 128):
        t = fine[:: 32 * 512 // n]
        errors.append(
            np.abs(
                actuator.simulate(40 * t * (2 - t), time=t, state=start).displacement - exact[:: 32 * 512 // n]
            ).max()
        )
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert np.all(orders > 1.9), orders


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
        np.concatenate([loop, loop]), state=wider.turned(bottom, rising=False, extrapolate=True), extrapolate=True
    ).voltage[loop.size :]
    area = float(np.sum(0.5 * (v[1:] + v[:-1]) * np.diff(loop)))
    low, high = bottom + rho, np.maximum(top - rho, bottom + rho)
    lost = float(2 * rho @ (slip.internal_voltage(high) - slip.internal_voltage(low)))
    volts, _ = scales(wider, wider.turned(bottom, extrapolate=True), loop)
    assert lost >= 0
    plain_records.assert_close(area, lost, loop.size * volts * (top - bottom))


@given(motion=our.wider_motions(max_samples=0), seed=our.SEEDS)
def test_states_rest_where_they_say(motion, seed):
    actuator, state, *_ = motion
    v = actuator.voltage(state)
    volts, metres = scales(actuator, state, [])
    here = actuator.compensate([state.deformation], time=[seed], state=state, extrapolate=True)
    plain_records.assert_close(here.voltage, [v], 3 * volts)
    plain_records.assert_close(
        actuator.simulate([v], time=[seed], state=state, extrapolate=True).displacement,
        [state.deformation],
        10 * metres,
    )
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


@pytest.mark.parametrize(
    "make",
    [
        lambda: GradedSlip([1, 2], [0, 1], [[1], [1], [1]]),
        lambda: GradedSlip([1, 2], [0], [[], []]),
        lambda: GradedSlip([1], [0, 1], [1]),
        lambda: GradedSlip([1], [0, 1], [[np.nan]]),
        lambda: GradedSlip([1], [0, 1], [["a"]]),
        lambda: GradedSlip([1], [1, 1], [[1]]),
        lambda: GradedSlip([1], [0, 1], [[-1]]),
        lambda: GradedSlip([2, 1], [0, 1], [[1], [1]]),
        lambda: Transformer([0, 1], [0]),
        lambda: Transformer([0], [0]),
        lambda: Transformer([0, 0], [0, 1]),
        lambda: Transformer([0, 1], [1, 0]),
        lambda: Creep([1], [1, 2]),
        lambda: Creep([0], [1]),
        lambda: Creep([1], [-1]),
        lambda: Actuator(SLIP, SPRING, transformer=CREEP),
        lambda: Actuator(SLIP, SPRING, creep=3),
        lambda: Actuator(SPRING, SPRING),
        lambda: Actuator(SLIP, SPRING, State(0, [0, 0], [1e-9])),
        lambda: Actuator(SLIP, SPRING, creep=CREEP).simulate([0.0]),
        lambda: Actuator(SLIP, SPRING, creep=CREEP).compensate([0.0]),
        lambda: Actuator(SLIP, SPRING, creep=CREEP).simulate([0.0, 1], time=[1, 1]),
        lambda: Actuator(SLIP, SPRING, creep=CREEP).simulate([0.0, 1], time=[1]),
        lambda: Actuator(SLIP, SPRING).simulate([0.0, 1], time=[1, 0]),
        lambda: Actuator(SLIP, SPRING, creep=CREEP).simulate([0.0, 1], time=[0, np.nan]),
        lambda: State(0, [0], motion=[1]),
        lambda: Physical.of(Actuator(GRADED, SPRING), **CONSTANTS),
        lambda: Physical.of(Actuator(SLIP, SPRING, transformer=TAU), **CONSTANTS),
        lambda: Physical.of(Actuator(SLIP, SPRING), **{**CONSTANTS, "transformer_ratio": 0}),
    ],
)
def test_impossible_parts_are_refused(make):
    with pytest.raises(ModelError):
        make()


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
