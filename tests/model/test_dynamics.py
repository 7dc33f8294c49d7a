"""Inertia, damping, load and lag: SciPy's exact steps, an ODE solver, and second order where no step is exact."""

from dataclasses import replace

import numpy as np
import pytest
import reference_model
import strategies as our
from hypothesis import given, settings
from hypothesis import strategies as st

from dehyst import Actuator, DisplacementCreep, Dynamics, MaxwellSlip, ModelError, Spring, State
from dehyst.model import GradedSlip, Transformer

HERTZ, OMEGA = 1000.0, 2 * np.pi * 1000
RHO = 0.5e-6 * np.arange(1, 11)
LINE = Spring([0, 1e-5], [3, 93])
K = 9e6
CURVE = Spring(np.linspace(-4e-6, 1.6e-5, 21), 170 * np.linspace(0, 1, 21) ** 1.2 - 30)
TAU = Transformer([-200, 0, 30, 60, 100, 300], [-184, 0, 28, 63, 100, 296])
CREEP = DisplacementCreep(np.geomspace(1e-4, 1, 4), [0.03, 0.01, 0.02, 0.02])
GRADED = GradedSlip(RHO, np.linspace(0, 1e-5, 9), 2e5 * (1 + 0.4 * np.sin(np.arange(80.0)).reshape(10, 8)))
PLAIN = MaxwellSlip(RHO, 1e6 * (0.2 + np.sin(np.arange(10.0)) ** 2))


def free(series, damping, spring=LINE):
    return Actuator(MaxwellSlip([], []), spring, dynamics=Dynamics(HERTZ, damping, series))


def second_order(series, damping):
    """(y, y') of an actuator whose voltage is K w + beta (w - y), w put in."""
    stiffness = 1 - series / (K + series)
    return [[0, 1], [-(OMEGA**2) * stiffness, -2 * damping * OMEGA]], [[0], [OMEGA**2 / (K + series)]]


@pytest.mark.parametrize("series", [0.0, 1e6, 3e7])
@pytest.mark.parametrize("damping", [0.0, 0.01, 1.0, 2.0])
@pytest.mark.parametrize("step", [0.01, 0.5, 3.0, 50.0])
def test_without_hysteresis_a_mass_is_exact_for_any_step(series, damping, step):
    from scipy.signal import StateSpace, lsim

    time = np.arange(200) * step / OMEGA
    voltage = 3 + 50 * np.random.default_rng(0).random(200)
    start = State(1e-6, [], motion=[2e-6, 0.01])
    a, b = second_order(series, damping)
    expected = lsim(StateSpace(a, b, [[1, 0]], [[0]]), voltage - 3, time, X0=[2e-6, 0.01])[1]
    for stack in (True, False):
        got = free(series, damping).simulate(voltage, time=time, state=start, stack=stack)
        np.testing.assert_allclose(got.displacement, expected, atol=1e-11 * np.ptp(expected))


@pytest.mark.parametrize(
    "slip",
    [MaxwellSlip([5e-7, 1e-6], [3e6, 2e6]), GradedSlip([5e-7, 1e-6], [2e-6, 4e-6, 6e-6], [[3e6, 1e6], [2e6, 3e6]])],
)
def test_a_mass_moves_as_by_runge_kutta(slip):
    """Theory section 9 as it stands: an ODE in (y, y') whose right side solves for w; carts follow at whole steps."""
    from scipy.optimize import brentq

    series, damping, h = 5e6, 0.1, 1e-6
    actuator = Actuator(slip, CURVE, transformer=TAU, dynamics=Dynamics(HERTZ, damping, series), load_stiffness=5e6)
    time = np.arange(350) * h
    start = actuator.relaxed(40.0)
    memory = reference_model.Reference(Actuator(slip, CURVE), start)

    def voltage(t):
        return 40 + 30 * np.sin(2 * np.pi * 800 * t)

    def load(t):
        return 5 * np.sin(2 * np.pi * 1300 * t)

    def w_of(t, y):
        drive = reference_model.line(voltage(t), TAU.voltage, TAU.drive)
        return brentq(lambda w: memory.drive(w) + series * (w - y) - drive, y - 5e-5, y + 5e-5, xtol=1e-18, rtol=1e-15)

    def rates(t, z):
        push = w_of(t, z[0]) + load(t) / 5e6
        return np.array([z[1], OMEGA**2 * (push - z[0]) - 2 * damping * OMEGA * z[1]])

    z, path = np.array([start.deformation, 0.0]), [start.deformation]
    for t in time[:-1]:
        first = rates(t, z)
        second = rates(t + h / 2, z + h / 2 * first)
        third = rates(t + h / 2, z + h / 2 * second)
        z = z + h / 6 * (first + 2 * second + 2 * third + rates(t + h, z + h * third))
        memory.commit(w_of(t + h, z[0]), 0)
        path.append(z[0])
    got = actuator.simulate(voltage(time), time=time, load=load(time), state=start).displacement
    assert np.ptp(path) > 2e-6
    np.testing.assert_allclose(got, path, atol=1e-5 * np.ptp(path))


def follow(actuator, n, *, given):
    """Largest miss [fraction of the stroke] of a path of n steps, played back."""
    time = np.linspace(0, 4e-3, n + 1)
    rate, turn = 200.0, 2 * np.pi * 300
    shrink = np.exp(-rate * time)
    path = 5e-6 - 4e-6 * np.cos(turn * time) * shrink
    velocity = 4e-6 * shrink * (turn * np.sin(turn * time) + rate * np.cos(turn * time))
    acceleration = 4e-6 * shrink * (turn**2 * np.cos(turn * time) - rate * turn * np.sin(turn * time)) - rate * velocity
    load = 8 + 10 * np.sin(2 * np.pi * 700 * time)
    w = (
        path
        + 2 * actuator.dynamics.damping / OMEGA * velocity
        + acceleration / OMEGA**2
        - load / actuator.load_stiffness
    )
    start = State(w[0], np.full(10, w[0]), motion=[path[0], velocity[0]])
    derivatives = {"velocity": velocity, "acceleration": acceleration} if given else {}
    sent = actuator.compensate(path, time=time, load=load, state=start, **derivatives)
    came = actuator.simulate(sent.voltage, time=time, load=load, state=start)
    clipped = actuator.simulate(sent.voltage, time=time, load=load, state=start, stack=False)
    np.testing.assert_allclose(came.displacement, clipped.displacement, atol=1e-12 * 8e-6)
    if given:
        np.testing.assert_allclose(sent.state.motion, [path[-1], velocity[-1]], rtol=1e-12)
    return np.abs(came.displacement - path).max() / 8e-6


@pytest.mark.parametrize("slip", [PLAIN, GRADED], ids=["plain", "graded"])
@pytest.mark.parametrize("lag", [0.0, 1e-4])
@pytest.mark.parametrize("series", [0.0, 3e6])
@pytest.mark.parametrize("given", [True, False], ids=["derivatives", "spline"])
def test_simulating_the_feedforward_converges_at_second_order(slip, lag, series, given):
    """With hysteresis, transformer and a load that begins as a preload."""
    dynamics = Dynamics(HERTZ, 0.05, series)
    actuator = Actuator(slip, CURVE, transformer=TAU, dynamics=dynamics, lag=lag, load_stiffness=5e6)
    errors = [follow(actuator, n, given=given) for n in (800, 1600, 3200, 6400)]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert np.all(orders > 1.9), (errors, orders)
    assert errors[-1] < 3e-6


@given(motion=our.wider_motions({"creep": False, "smooth": False}, max_samples=120), seed=our.SEEDS)
def test_a_slow_load_shifts_an_actuator_without_mass(motion, seed):
    actuator, state, time, path = motion
    loaded = Actuator(actuator.slip, actuator.spring, transformer=actuator.transformer, load_stiffness=2e6)
    load = 2e6 * our.span_of(actuator) * np.random.default_rng(seed).normal(size=path.size)
    sent = loaded.compensate(path + load / 2e6, time=time, load=load, state=state, extrapolate=True)
    # w is the path again, but for the rounding of the sum and its difference.
    scale = 1e-12 * (our.span_of(actuator) + np.ptp(np.append(path, state.deformation)))
    slopes = actuator.spring.slopes.max() + np.sum(actuator.slip.stiffness)
    plain = actuator.compensate(path, time=time, state=state, extrapolate=True)
    assert np.abs(sent.voltage - plain.voltage).max(initial=0) <= 3 * slopes * scale
    came = loaded.simulate(sent.voltage, time=time, load=load, state=state, extrapolate=True)
    assert np.abs(came.displacement - path - load / 2e6).max(initial=0) <= 3 * scale


@given(
    motion=our.wider_motions({"graded": False, "smooth": False}, max_elements=10, max_samples=150),
    series=st.sampled_from([0.0, 0.5, 20.0]),
)
@settings(max_examples=40)
def test_stack_and_carts_agree_with_a_mass(motion, series):
    actuator, state, time, path = motion
    volts = actuator.compensate(path, time=time, state=state, extrapolate=True).voltage
    hertz = 1.0 / np.median(np.diff(time)) if time.size > 1 else 1.0
    moving = replace(actuator, dynamics=Dynamics(hertz, 0.3, series * actuator.spring.slopes.min()))
    first, two = (
        moving.simulate(volts, time=time, state=state, stack=stack, extrapolate=True) for stack in (True, False)
    )
    scale = 1e-12 * (our.span_of(actuator) + np.ptp(np.append(first.displacement, state.deformation)))
    assert np.abs(first.displacement - two.displacement).max(initial=0) <= 30 * scale
    assert np.abs(first.state.carts - two.state.carts).max(initial=0) <= 30 * scale


def test_a_lag_is_a_low_pass_of_the_command():
    from scipy.signal import lfilter

    tau, dt = 2e-3, 1e-4
    actuator = Actuator(PLAIN, CURVE, lag=tau)
    time, command = np.arange(500) * dt, 40 + 30 * np.sin(np.arange(500) / 20)
    start = actuator.relaxed(40.0)
    a = np.exp(-dt / tau)
    g = (1 - a) * tau / dt
    acts = lfilter([1 - g, g - a], [1, -a], command, zi=[40.0 - (1 - g) * 40.0])[0]
    got = actuator.simulate(command, time=time, state=start)
    quick = Actuator(PLAIN, CURVE).simulate(acts, state=start)
    np.testing.assert_allclose(got.displacement, quick.displacement, atol=1e-12 * 1e-5)
    assert actuator.simulate([90.0], time=[0.0], state=start).displacement[0] == pytest.approx(start.deformation)


def test_a_record_with_a_mass_may_be_cut_at_any_sample():
    actuator = Actuator(
        PLAIN, CURVE, displacement_creep=CREEP, dynamics=Dynamics(HERTZ, 0.1, 3e6), lag=1e-4, load_stiffness=5e6
    )
    time = np.cumsum(np.random.default_rng(0).uniform(1e-5, 1e-4, 300))
    voltage, load = 40 + 30 * np.sin(4e3 * time), 5 * np.cos(3e3 * time)
    whole = actuator.simulate(voltage, time=time, load=load)
    for k in (0, 1, 150, 299):
        first = actuator.simulate(voltage[: k + 1], time=time[: k + 1], load=load[: k + 1])
        rest = actuator.simulate(voltage[k:], time=time[k:], load=load[k:], state=first.state)
        joined = np.concatenate([first.displacement[:-1], rest.displacement])
        np.testing.assert_allclose(joined, whole.displacement, atol=1e-12 * 1e-5)
        np.testing.assert_allclose(rest.state.motion, whole.state.motion, atol=1e-11 * np.abs(whole.state.motion[1]))


def test_a_step_too_long_for_the_resonance_is_refused():
    uneven = Spring([0, 5e-6, 1e-5], [0, 0.01, 100])
    actuator = free(1e8, 0.0, uneven)
    time = np.arange(4) * 4.5 / OMEGA * np.sqrt(1 + 1e8 / 1e7)
    with pytest.raises(ModelError, match=r"resonance at 1e\+03"):
        actuator.simulate(np.zeros(4), time=time)
    assert np.isfinite(actuator.simulate(np.zeros(4), time=time / 20).displacement).all()
