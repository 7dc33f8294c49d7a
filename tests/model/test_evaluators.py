"""Both evaluators, every class: the oracle's answer, each other's inverse, a record that may be cut anywhere."""

import numpy as np
import pytest
import reference_model
import strategies as our
from hypothesis import assume, example, given
from hypothesis import strategies as st
from plain_records import assert_close

from dehyst import Actuator, MaxwellSlip, ModelError, Spring, State
from dehyst.model import GradedSlip, evaluator_of
from examples import examples

RANGE = 1e-12
ACTUATOR = Actuator(MaxwellSlip([1e-6, 2e-6], [1e6, 2e6]), Spring([0, 4e-6, 1e-5], [0, 30, 100]))
CORE = evaluator_of(ACTUATOR).core
STACKS = pytest.mark.parametrize("stack", [True, False])


def timed(motion):
    """A motion of the plain class, with a time of each sample."""
    actuator, state, path = motion
    return actuator, state, np.arange(len(path)) * 1.0, path


def span_with(actuator, state, path):
    """Range [m] that a motion covers, the actuator's own included: what 1e-12 is measured by."""
    return max(our.span_of(actuator), float(np.ptp(np.append(path, state.deformation))))


def is_plain(actuator):
    parts = actuator.transformer, actuator.displacement_creep, actuator.smooth
    return isinstance(actuator.slip, MaxwellSlip) and parts == (None, None, None)


def scales(actuator, state, path, voltage):
    """Rounding [V] and [m]: of the plain class that of the voltages, of a wider one of what its parts hold at most."""
    metres = span_with(actuator, state, path)
    if is_plain(actuator):
        return RANGE * max(our.volts_of(actuator), float(np.ptp(voltage)) if len(voltage) else 0.0), RANGE * metres
    smooth = actuator.smooth.stiffness.sum() if actuator.smooth else 0.0
    slopes = actuator.spring.slopes.max() + np.sum(actuator.slip.stiffness) + smooth
    return 3 * RANGE * slopes * metres, RANGE * metres


def assert_same_state(first, second, metres):
    for part in ("deformation", "carts", "displacement_creep", "smooth"):
        assert_close(getattr(first, part), getattr(second, part), metres)


def reached(known):
    """The state of the oracle."""
    return State(known.y, known.carts, smooth=known.q, displacement_creep=known.y - known.z)


def barely_nested():
    """A relaxed element: the amplitude 2 rho of its outermost loop, 1.4 - (-0.4), comes out one bit below 1.8."""
    actuator = Actuator(MaxwellSlip([0.9], [1]), Spring([-1, 1], [-1, 1]))
    return actuator, State(0.5, [0.5]), np.array([0, 0.5, 1, 1.6, 0])


def shortened_branch():
    """A path through the places at which the last cart lets go: rounding shortens its outermost branch by a bit."""
    knots = [-0.8656961892293875, -0.43605599226834757, -0.3735116657399876]
    knots += [0.05587403875994656, 0.376856202514648, 0.6456266897536116]
    volts = [
        0.713581623069496,
        0.846782822028675,
        0.8839323878382238,
        1.1246994749755306,
        1.3887834762105535,
        1.6451861345093217,
    ]
    actuator = Actuator(MaxwellSlip([0.9375861923041937], [0.7031061056953217]), Spring(knots, volts))
    state = State(0.940325206469228, [0.0027390141650343])
    high, low, top = 2.8154975910776154, -0.9348471781391594, 0.940325206469228
    path = np.array([high, low, top, low, -0.1, low, top, 0.1, 1.8779113987734217])
    return actuator, state, path


MOTIONS = st.one_of(our.motions().map(timed), our.wider_motions())
SHORT = st.one_of(our.motions(max_samples=25).map(timed), our.wider_motions(max_elements=6, max_samples=25))
NESTED = our.motions(our.actuators(1, 3), ("relaxed", "reached", "turned up"), ("nested", "walk"), max_samples=40)


@given(st.one_of(NESTED, our.motions(max_samples=400)), our.SEEDS)
@example(barely_nested(), 0)
@example(shortened_branch(), 0)
@examples(40, nightly=300)
def test_clipped_elements_and_stack_agree(motion, seed):
    actuator, state, path = motion
    v = our.voltages_like(actuator, state, path, seed)
    for run, drive in ((actuator.compensate, path), (actuator.simulate, v)):
        stack, clips = (run(drive, state=state, stack=on, extrapolate=True) for on in (True, False))
        assert_same_motion(stack, clips, *scales(actuator, state, clips.displacement, clips.voltage))


def assert_same_motion(motion, other, volts, metres):
    assert_close(motion.voltage, other.voltage, volts)
    assert_close(motion.displacement, other.displacement, metres)
    assert_same_state(motion.state, other.state, metres)


@STACKS
@given(motion=MOTIONS)
@example(motion=timed(barely_nested()))
def test_compensate_agrees_with_the_oracle(stack, motion):
    actuator, state, time, path = motion
    known = reference_model.Reference(actuator, state)
    expected = known.compensate(path, time)
    volts, metres = scales(actuator, state, path, expected)
    got = actuator.compensate(path, time=time, state=state, stack=stack, extrapolate=True)
    assert_close(got.voltage, expected, volts)
    assert_same_state(got.state, reached(known), metres)
    assert_close(got.state.smooth, known.q, RANGE * (actuator.smooth.length.max() if actuator.smooth else 0.0))


@STACKS
@given(motion=SHORT, seed=our.SEEDS)
@examples(40, nightly=80)
def test_simulate_agrees_with_the_oracle(stack, motion, seed):
    actuator, state, time, path = motion
    v = actuator.compensate(path, time=time, state=state, extrapolate=True).voltage
    v = v + 0.1 * np.ptp(v) * np.random.default_rng(seed).normal(size=v.size) if v.size else v
    known = reference_model.Reference(actuator, state)
    expected = known.simulate(v, time)
    # The voltages of a wider class were rounded too.
    metres = (1 if is_plain(actuator) else 10) * scales(actuator, state, expected, v)[1]
    got = actuator.simulate(v, time=time, state=state, stack=stack, extrapolate=True)
    assert_close(got.displacement, expected, metres)
    assert_same_state(got.state, reached(known), metres)


@given(our.motions(our.actuators(1, 12), max_samples=0), our.SEEDS, st.sampled_from([0.01, 0.3, 1.0, 2.0, 4.0]))
def test_both_evaluators_agree_on_jitter_of_twice_the_smallest_breakaway(motion, seed, share):
    """Below it the stack does not turn at all; at it, every way back is a close question."""
    actuator, state, _ = motion
    rng = np.random.default_rng(seed)
    sweep = np.cumsum(rng.uniform(-1, 1, 12).repeat(25)) * our.span_of(actuator) / 50
    noise = share * actuator.slip.breakaway[0] * rng.choice([-1, 1, rng.uniform(-1, 1)], sweep.size)
    path = state.deformation + sweep + noise
    clips = actuator.compensate(path, state=state, stack=False, extrapolate=True)
    stack = actuator.compensate(path, state=state, extrapolate=True)
    volts, metres = scales(actuator, state, path, clips.voltage)
    assert_same_motion(stack, clips, volts, metres)
    came = actuator.simulate(clips.voltage, state=state, extrapolate=True)
    assert_same_motion(came, clips, 0.0, metres)
    # Cut where the way back is under way, the memory must have been put down.
    cut = int(rng.integers(1, sweep.size))
    first = actuator.simulate(clips.voltage[:cut], state=state, extrapolate=True)
    second = actuator.simulate(clips.voltage[cut:], state=first.state, extrapolate=True)
    assert_close(second.displacement, path[cut:], metres)
    assert_close(second.state.carts, clips.state.carts, metres)


@given(our.motions(states=("relaxed", "reached", "turned up"), paths=("decay", "noisy ramp", "walk"), max_samples=3000))
def test_the_stack_of_reversals_stays_short(motion):
    actuator, state, path = motion
    assert 1 <= evaluator_of(actuator).core.depth(path, state.deformation, state.carts) <= 2 * len(actuator.slip) + 8


def test_the_stack_drops_reversals_without_effect_and_those_before_a_major_loop():
    decay = 5e-6 + 5e-6 * np.linspace(1, 0, 20000) * np.where(np.arange(20000) % 2, -1, 1)
    major = 5e-6 - 5e-6 * np.cos(np.linspace(0, 20 * np.pi, 1000))
    start = ACTUATOR.state.deformation, ACTUATOR.state.carts
    assert CORE.depth(decay, *start) <= 2 * 2 + 8
    assert CORE.depth(major, *start) <= 2
    assert CORE.depth(np.concatenate([decay, major]), *start) <= 2


@given(motion=our.wider_motions(max_samples=0), seed=our.SEEDS)
def test_a_state_at_rest_keeps_voltage_and_displacement(motion, seed):
    actuator, state, *_ = motion
    v = actuator.voltage(state)
    volts, metres = scales(actuator, state, [], [v])
    here = actuator.compensate([actuator.displacement(state)], time=[seed], state=state, extrapolate=True)
    assert_close(here.voltage, [v], volts)
    came = actuator.simulate([v], time=[seed], state=state, extrapolate=True)
    assert_close(came.displacement, [actuator.displacement(state)], 10 * metres)
    relaxed = actuator.relaxed(v, extrapolate=True)
    assert_close(actuator.voltage(relaxed), v, volts + 1e-12 * abs(v))
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
def test_only_falling_branches_are_refused(seed, size):
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
