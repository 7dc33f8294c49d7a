"""The laws of the model (theory sections 1-5, 7, 10, 11), each on random actuators, states and paths.

Voltages agree to `EXACT` of the major loop's, displacements to `EXACT` of the range: rounding, not approximation.
"""

import numpy as np
import pytest
import strategies as our
from hypothesis import given, settings
from hypothesis import strategies as st

from dehyst import State
from dehyst.model import Physical, turned

EXACT = 1e-12
KM, T, KE = 1.4e6, 0.042, 8.82e4
SOME = our.actuators(1, 20)
AFFINE = our.actuators(1, 20, knots=2)


def loop_area(voltage, displacement):
    """Return the area of a closed loop [V m]: the integral of v dy, positive if energy is lost (kappa_i >= 0)."""
    return float(np.sum(0.5 * (voltage + np.roll(voltage, -1)) * np.diff(displacement, append=displacement[:1])))


def close(got, expected, allowance):
    return np.abs(np.subtract(got, expected)).max(initial=0.0) <= allowance


def same_state(state, other, metres):
    return close(state.deformation, other.deformation, metres) and close(state.carts, other.carts, metres)


def compensated(actuator, path, start):
    return actuator.compensate(path, state=start, extrapolate=True).voltage


def major(actuator, extra=1.0):
    """Bottom and top [m] of a loop about the spring's middle in which every element slides, both ways."""
    knots = actuator.spring.displacement
    half = extra * max(actuator.slip.breakaway[-1], our.span_of(actuator) / 2)
    return (knots[0] + knots[-1]) / 2 - half, (knots[0] + knots[-1]) / 2 + half


def scales(actuator):
    bottom, top = major(actuator, 3)
    volts = actuator.spring(top) - actuator.spring(bottom) + 2 * actuator.slip.friction.sum()
    return EXACT * float(volts), EXACT * (top - bottom)


@given(our.motions(max_samples=12), our.SEEDS)
def test_every_sample_satisfies_the_force_balance(motion, seed):
    """Eq. 2: v = sum kappa_i s_i + eta(y) after every sample, with every |s_i| <= rho_i."""
    actuator, state, path = motion
    slip = actuator.slip
    for v in our.voltages_like(actuator, state, path, seed):
        state = actuator.simulate([v], state=state, extrapolate=True).state
        s = state.deformation - state.carts
        assert np.all(np.abs(s) <= slip.breakaway + EXACT * our.span_of(actuator))
        balance = slip.stiffness @ s + actuator.spring(state.deformation)
        assert close(balance, v, EXACT * (our.volts_of(actuator) + abs(v)))


def in_newtons(actuator):
    return Physical.of(actuator, transformer_ratio=T, mechanical_stiffness=KM, electrical_stiffness=KE)


@given(SOME, our.SEEDS)
def test_the_peak_voltage_is_that_of_equation_4(actuator, seed):
    """Eq. 4: once every element has slid, F0 = sum f_i + keq X + g(X), in newtons."""
    rho, top = actuator.slip.breakaway, actuator.spring.displacement[-1]
    bottom = top - 2 * rho[-1]
    start = State(bottom, bottom + np.random.default_rng(seed).uniform(-1, 1, rho.size) * rho)
    paper = in_newtons(actuator)
    force = paper.friction.sum() + paper.equivalent_stiffness * paper.deformation[-1] + paper.nonlinear[-1]
    volts = scales(actuator)[0] + EXACT * paper.equivalent_stiffness * np.abs(paper.deformation[-1]) / T
    assert close(compensated(actuator, [top], start), force / T, volts)


@given(SOME)
def test_break_points_have_the_forces_of_equations_6_and_7(actuator):
    """Eqs. 6 and 7: the force at X - 2 r_i going down and at x(T0) + 2 r_i going up, in the paper's symbols."""
    bottom, top = major(actuator)
    slip, paper = actuator.slip, in_newtons(actuator)
    c = paper.equivalent_stiffness / KM
    sliding = np.cumsum(paper.friction)
    stuck = paper.stiffness.sum() - np.cumsum(paper.stiffness)
    drop = 2 * sliding + 2 * (paper.equivalent_stiffness + stuck) * paper.breakaway

    def g(y):
        return T * actuator.spring(y) - paper.equivalent_stiffness * y / c

    down, up = top - 2 * slip.breakaway, bottom + 2 * slip.breakaway
    at_top, at_bottom = turned(actuator, top), turned(actuator, bottom, rising=False)
    f_down = T * actuator.voltage(at_top) - drop + g(down) - g(top)
    f_up = T * actuator.voltage(at_bottom) + drop + g(up) - g(bottom)
    volts = scales(actuator)[0] + EXACT * paper.equivalent_stiffness * (top - bottom) / c / T
    assert close(compensated(actuator, down, at_top), f_down / T, volts)
    assert close(compensated(actuator, up, at_bottom), f_up / T, volts)


@given(SOME, our.SEEDS, our.SEEDS)
def test_the_state_after_all_elements_slid_is_independent_of_the_start(actuator, seed, other):
    """Once every element has slid, the state does not depend on the start."""
    v, metres = scales(actuator)
    bottom, top = major(actuator, 2)
    a, b = (our.make_state(actuator, s, "arbitrary") for s in (seed, other))
    path = our.make_path(actuator, bottom, seed, "nested", 20).clip(bottom, top)
    path = np.concatenate([path, [bottom, top, 0.3 * bottom + 0.7 * top]])
    first, second = (
        actuator.compensate(path, state=a, extrapolate=True),
        actuator.compensate(path, state=b, extrapolate=True),
    )
    assert same_state(first.state, second.state, metres)
    assert close(first.voltage[-2:], second.voltage[-2:], v)


@given(AFFINE)
def test_with_an_affine_spring_the_loop_is_antisymmetric(actuator):
    """With an affine spring the loop is anti-symmetric about its centre."""
    bottom, top = major(actuator)
    rise = np.linspace(bottom, top, 101)
    up = compensated(actuator, rise, turned(actuator, bottom, rising=False))
    down = compensated(actuator, rise[::-1], turned(actuator, top))
    assert close(up + down, up[-1] + down[-1], scales(actuator)[0])


@given(SOME, our.SEEDS)
def test_the_curve_after_a_reversal_is_the_doubled_virgin_curve(actuator, seed):
    """After a reversal the stops' force follows the virgin curve phi doubled: F_R - 2 phi(u / 2)."""
    slip = actuator.slip
    y0 = actuator.relaxed().deformation
    peak = slip.breakaway[-1] * np.random.default_rng(seed).uniform(0.1, 1.5)
    u = np.linspace(0, 2 * peak, 50)
    phi = np.minimum(u[:, None] / 2, slip.breakaway) @ slip.stiffness
    path = np.concatenate([y0 + u / 2, y0 + peak - u])
    force = compensated(actuator, path, actuator.relaxed()) - actuator.spring(path)
    assert close(force[:50], phi, scales(actuator)[0])
    assert close(force[50:], force[49] - 2 * phi, scales(actuator)[0])


@given(SOME, our.SEEDS, our.SEEDS)
def test_loops_between_equal_displacements_are_congruent(actuator, seed, other):
    """Closed loops between the same two displacements differ by a constant voltage, whatever came before."""
    bottom, top = np.sort(np.random.default_rng(seed).uniform(*major(actuator), 2))
    loop = np.concatenate([np.linspace(bottom, top, 40), np.linspace(top, bottom, 40)])
    starts = [our.make_state(actuator, s, "arbitrary") for s in (seed, other)]
    loops = [compensated(actuator, np.tile(loop, 2), start)[80:] for start in starts]
    assert close(np.ptp(loops[0] - loops[1]), 0.0, scales(actuator)[0])


@given(SOME, st.floats(0.1, 3))
def test_a_loop_dissipates_the_work_of_friction(actuator, width):
    """A loop of range R loses sum 2 f_i max(0, R - 2 r_i): nothing at all while no element slides."""
    rho, friction = actuator.slip.breakaway, actuator.slip.friction
    size = 2 * width * rho[min(1, rho.size - 1)]
    bottom = major(actuator)[0]
    ticks = bottom + np.unique(np.append(2 * rho[2 * rho < size], [0, size]))
    ends = np.concatenate([ticks[:-1], ticks[:0:-1], size + 2 * bottom - ticks])
    ticks = np.unique(np.append(ends, actuator.spring.displacement.clip(bottom, bottom + size)))
    loop = np.concatenate([ticks[:-1], ticks[:0:-1]])
    v = np.array_split(compensated(actuator, np.tile(loop, 2), turned(actuator, bottom)), 2)[1]
    lost = 2 * friction @ np.maximum(0, size - 2 * rho)
    assert close(loop_area(v, loop), lost, EXACT * loop.size * size * np.ptp(v) + scales(actuator)[0] * size)


@given(our.motions(SOME, max_samples=1), our.SEEDS)
@settings(max_examples=30)
def test_the_equations_hold_in_physical_units(motion, seed):
    """Eqs. 1-3 in newtons: T v = sum k_i s_i + keq x + g(x), f_i = k_i r_i, y = (keq / km) x; Sec. 4's T, km, ke."""
    actuator, state, _ = motion
    paper = in_newtons(actuator)
    keq = KE * KM / (KE + KM)
    knot = int(np.random.default_rng(seed).integers(paper.deformation.size))
    at = actuator.simulate(
        compensated(actuator, [actuator.spring.displacement[knot]], state), state=state, extrapolate=True
    ).state
    s = (at.deformation - at.carts) * KM / keq
    force = paper.stiffness @ s + keq * paper.deformation[knot] + paper.nonlinear[knot]
    volts = scales(actuator)[0] + EXACT * np.abs(keq * paper.deformation).max() / T
    assert close(force / T, actuator.voltage(at), volts)
    np.testing.assert_allclose(paper.friction, paper.stiffness * paper.breakaway, rtol=1e-13)
    np.testing.assert_allclose(paper.breakaway, actuator.slip.breakaway * KM / keq, rtol=1e-13)
    np.testing.assert_allclose(paper.parallel, keq * paper.deformation + paper.nonlinear, atol=T * volts)
    assert paper.equivalent_stiffness == pytest.approx(keq, rel=1e-15)
    x0 = np.interp(0, paper.parallel, paper.deformation, left=0, right=0)
    assert abs(x0) <= EXACT * np.ptp(paper.deformation)
