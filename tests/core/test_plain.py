"""The C core: two evaluators and the oracle give one answer, a record may be cut anywhere, memory stays bounded."""

import numpy as np
import pytest
import reference_model
import strategies as our
from hypothesis import example, given, settings
from hypothesis import strategies as st

from dehyst import Actuator, MaxwellSlip, ModelError, Spring, State
from dehyst._native import EMPTY, Core, CoreState, StepCoefficients, slip_elongations
from dehyst.model import evaluator_of, turned
from examples import examples

RANGE = 1e-12
SLIP = MaxwellSlip([1e-6, 2e-6], [1e6, 2e6])
SPRING = Spring([0, 4e-6, 1e-5], [0, 30, 100])
ACTUATOR = Actuator(SLIP, SPRING)
CORE = evaluator_of(ACTUATOR).core


def numbers(actuator, state):
    slip, spring = actuator.slip, actuator.spring
    return slip.breakaway, slip.stiffness, spring.displacement, spring.voltage, state.deformation, state.carts


def span_with(actuator, state, path):
    """Range [m] that a motion covers, the actuator's own included: what 1e-12 is measured by."""
    return max(our.span_of(actuator), float(np.ptp(np.append(path, state.deformation))))


def volts_with(actuator, voltages):
    return max(our.volts_of(actuator), float(np.ptp(voltages)) if len(voltages) else 0.0)


def assert_close(got, expected, allowance):
    assert np.shape(got) == np.shape(expected)
    assert np.abs(np.subtract(got, expected)).max(initial=0.0) <= allowance


def assert_same_motion(motion, other, metres, volts):
    assert_close(motion.voltage, other.voltage, volts)
    assert_close(motion.displacement, other.displacement, metres)
    assert_close(motion.state.deformation, other.state.deformation, metres)
    assert_close(motion.state.carts, other.state.carts, metres)


def barely_nested():
    """A relaxed element: the amplitude 2 rho of its outermost loop, 1.4 - (-0.4), comes out one bit below 1.8."""
    actuator = Actuator(MaxwellSlip([0.9], [1]), Spring([-1, 1], [-1, 1]))
    return actuator, State(0.5, [0.5]), np.array([0, 0.5, 1, 1.6, 0])


def shortened_branch():
    """A path through the places at which the last cart lets go: rounding shortens its outermost branch by a bit."""
    knots = [
        -0.8656961892293875,
        -0.43605599226834757,
        -0.3735116657399876,
        0.05587403875994656,
        0.376856202514648,
        0.6456266897536116,
    ]
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


NESTED = our.motions(our.actuators(1, 3), ("relaxed", "reached", "turned up"), ("nested", "walk"), max_samples=40)


@given(st.one_of(NESTED, our.motions(max_samples=400)), our.SEEDS)
@example(barely_nested(), 0)
@examples(40, nightly=300)
def test_clips_and_stack_agree(motion, seed):
    actuator, state, path = motion
    v = our.voltages_like(actuator, state, path, seed)
    for run, drive in ((actuator.compensate, path), (actuator.simulate, v)):
        stack, clips = (run(drive, state=state, stack=on, extrapolate=True) for on in (True, False))
        metres = RANGE * span_with(actuator, state, clips.displacement)
        assert_same_motion(stack, clips, metres, RANGE * volts_with(actuator, clips.voltage))


@pytest.mark.parametrize("stack", [True, False])
@given(motion=our.motions())
@example(motion=barely_nested())
def test_compensate_agrees_with_the_oracle(stack, motion):
    actuator, state, path = motion
    v, y, carts = reference_model.compensate(*numbers(actuator, state), path)
    got = actuator.compensate(path, state=state, stack=stack, extrapolate=True)
    metres = RANGE * span_with(actuator, state, path)
    assert_close(got.voltage, v, RANGE * volts_with(actuator, v))
    assert_close(got.state.deformation, y, metres)
    assert_close(got.state.carts, carts, metres)


@pytest.mark.parametrize("stack", [True, False])
@given(motion=our.motions(max_samples=25), seed=our.SEEDS)
@settings(max_examples=40)
def test_simulate_agrees_with_the_oracle(stack, motion, seed):
    actuator, state, path = motion
    v = our.voltages_like(actuator, state, path, seed)
    y, last, carts = reference_model.simulate(*numbers(actuator, state), v)
    got = actuator.simulate(v, state=state, stack=stack, extrapolate=True)
    metres = RANGE * span_with(actuator, state, y)
    assert_close(got.displacement, y, metres)
    assert_close(got.state.deformation, last, metres)
    assert_close(got.state.carts, carts, metres)


@pytest.mark.parametrize("there", [True, False])
@pytest.mark.parametrize("back", [True, False])
@given(motion=our.motions(max_samples=300))
@example(motion=barely_nested())
@example(motion=shortened_branch())
def test_simulating_the_compensating_voltage_gives_the_path(there, back, motion):
    actuator, state, path = motion
    sent = actuator.compensate(path, state=state, stack=there, extrapolate=True)
    came = actuator.simulate(sent.voltage, state=state, stack=back, extrapolate=True)
    assert_same_motion(came, sent, RANGE * span_with(actuator, state, path), 0.0)


@pytest.mark.parametrize("stack", [True, False])
@given(motion=our.motions(max_samples=600), seed=our.SEEDS, cuts=st.lists(st.floats(0, 1), max_size=4))
@example(motion=barely_nested(), seed=0, cuts=[0.4])
def test_a_record_may_be_cut_anywhere(stack, motion, seed, cuts):
    actuator, start, path = motion
    v = our.voltages_like(actuator, start, path, seed)
    for run, given_in in ((actuator.compensate, path), (actuator.simulate, v)):
        whole = run(given_in, state=start, stack=stack, extrapolate=True)
        state, parts = start, []
        for part in np.split(given_in, sorted(int(cut * len(given_in)) for cut in cuts)):
            parts.append(run(part, state=state, stack=stack, extrapolate=True))
            state = parts[-1].state
        metres = 1e-13 * span_with(actuator, start, whole.displacement)
        volts = 1e-13 * volts_with(actuator, whole.voltage)
        assert_close(np.concatenate([part.voltage for part in parts]), whole.voltage, volts)
        assert_close(np.concatenate([part.displacement for part in parts]), whole.displacement, metres)
        assert_close(state.carts, whole.state.carts, metres)


@pytest.mark.parametrize("stack", [True, False])
@given(motion=our.motions(max_samples=0))
def test_nothing_in_nothing_out(stack, motion):
    actuator, state, _ = motion
    for run in (actuator.compensate, actuator.simulate):
        got = run([], state=state, stack=stack)
        assert got.voltage.shape == got.displacement.shape == (0,)
        assert got.state.deformation == state.deformation
        assert np.array_equal(got.state.carts, state.carts)


@pytest.mark.parametrize("stack", [True, False])
@given(motion=our.motions(), seed=our.SEEDS)
def test_more_voltage_more_displacement(stack, motion, seed):
    actuator, state, path = motion
    v = our.voltages_like(actuator, state, path, seed)
    y = np.append(state.deformation, actuator.simulate(v, state=state, stack=stack, extrapolate=True).displacement)
    rise, steps = np.diff(y), np.diff(np.append(actuator.voltage(state), v))
    clear = np.abs(steps) > RANGE * volts_with(actuator, v)
    assert np.all(rise[clear] * steps[clear] > 0)


@given(our.motions(our.actuators(1, 12), max_samples=0), our.SEEDS, st.sampled_from([0.01, 0.3, 1.0, 2.0, 4.0]))
def test_jitter_about_the_width_in_which_nothing_slides_changes_no_answer(motion, seed, share):
    """Below it the stack does not turn at all; at it, every way back is a close question."""
    actuator, state, _ = motion
    rng = np.random.default_rng(seed)
    sweep = np.cumsum(rng.uniform(-1, 1, 12).repeat(25)) * our.span_of(actuator) / 50
    noise = share * actuator.slip.breakaway[0] * rng.choice([-1, 1, rng.uniform(-1, 1)], sweep.size)
    path = state.deformation + sweep + noise
    clips = actuator.compensate(path, state=state, stack=False, extrapolate=True)
    stack = actuator.compensate(path, state=state, extrapolate=True)
    metres, volts = RANGE * span_with(actuator, state, path), RANGE * volts_with(actuator, clips.voltage)
    assert_same_motion(stack, clips, metres, volts)
    came = actuator.simulate(clips.voltage, state=state, extrapolate=True)
    assert_same_motion(came, clips, metres, 0.0)
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


def test_a_long_decay_is_pruned_and_a_major_loop_is_forgotten():
    decay = 5e-6 + 5e-6 * np.linspace(1, 0, 20000) * np.where(np.arange(20000) % 2, -1, 1)
    major = 5e-6 - 5e-6 * np.cos(np.linspace(0, 20 * np.pi, 1000))
    start = ACTUATOR.state.deformation, ACTUATOR.state.carts
    assert CORE.depth(decay, *start) <= 2 * 2 + 8
    assert CORE.depth(major, *start) <= 2
    assert CORE.depth(np.concatenate([decay, major]), *start) <= 2


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Actuator(SLIP, SPRING, State(0, [0])), "state carts: got 1 numbers, need 2"),
        (lambda: Actuator(SLIP, SPRING, limits=(5, 5)), "two finite voltages, the lower one first"),
        (lambda: Actuator(SLIP, SPRING, limits=("a", "b")), "limits"),
        (lambda: Actuator(SLIP, SPRING, limits=(1,)), "limits"),
        (lambda: Actuator(SLIP, SPRING, limits=3), "limits"),
        (lambda: turned(ACTUATOR, "far"), "displacement"),
        (lambda: ACTUATOR.relaxed("off"), "voltage"),
        (lambda: turned(ACTUATOR, np.nan), "displacement: got nan, need a finite number"),
        (lambda: ACTUATOR.simulate([0], state=State(0, [5e-6, 0])), "state carts: got number 0"),
    ],
)
def test_impossible_numbers_are_refused(make, message):
    with pytest.raises(ModelError, match=message):
        make()


@pytest.mark.parametrize("run", [ACTUATOR.compensate, ACTUATOR.simulate])
@pytest.mark.parametrize("bad", [[0.0, np.nan], [np.inf], [[0.0]], "text", ["1"], None, [1j], 3.0])
def test_paths_that_are_none_never_reach_the_core(run, bad):
    with pytest.raises(ModelError, match=r"(voltage|displacement): "):
        run(bad)


KNOTS, VOLTS = SPRING.displacement, SPRING.voltage
ZERO, TWO = np.zeros(1), np.zeros(2)
STEPS = StepCoefficients(np.array([0, 1]), *[np.zeros((1, 0))] * 3)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Core(SLIP.breakaway, ZERO, KNOTS, VOLTS), "different lengths"),
        (lambda: Core(SLIP.breakaway, -SLIP.stiffness, KNOTS, VOLTS), "must be >= 0"),
        (lambda: Core(SLIP.breakaway[::-1], SLIP.stiffness, KNOTS, VOLTS), "strictly increase"),
        (lambda: Core(SLIP.breakaway, np.nan * SLIP.stiffness, KNOTS, VOLTS), "not finite"),
        (lambda: Core(SLIP.breakaway, SLIP.stiffness, KNOTS, VOLTS[::-1]), "strictly increase"),
        (lambda: Core(SLIP.breakaway, SLIP.stiffness, KNOTS[:1], VOLTS[:1]), "fewer than two knots"),
        (
            lambda: CORE.compensate(ZERO, STEPS, CoreState(0.0, ZERO, EMPTY, EMPTY)),
            "different lengths",
        ),
        (
            lambda: CORE.simulate(ZERO, STEPS, CoreState(0.0, TWO + 1, EMPTY, EMPTY)),
            "farther from the disp",
        ),
        (lambda: CORE.voltage(CoreState(np.nan, TWO, EMPTY, EMPTY)), "not finite"),
        (lambda: CORE.depth(ZERO, 0.0, TWO + 1), "farther from the displacement"),
        (lambda: CORE.depth(ZERO, 0.0, np.array([1e-6, -2e-6])), "no history from rest"),
        (lambda: slip_elongations(SLIP.breakaway, ZERO, ZERO), "different lengths"),
    ],
)
def test_the_core_itself_refuses_what_python_did_not(make, message):
    with pytest.raises(ModelError, match=message):
        make()
