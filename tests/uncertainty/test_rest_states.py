"""States of rest (theory section 2, Appendix A.1): the set, the order of sliding, the shift of the loop, the estimate.

Second ways to the answers: linear programs in (y, s) by SciPy, the box that the set is in increments, a history that
ends in a wanted state, the paper's own formula for the first rise.
"""

from itertools import pairwise

import numpy as np
import plain_records
import pytest
import strategies as our
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from dehyst import Actuator, MaxwellSlip, ModelError, Record, RecordError, Spring, State
from dehyst._native import slip_elongations
from dehyst.records.metrics import largest, percent, rms
from dehyst.uncertainty import RestStates, state_from_first_rise
from dehyst.uncertainty.rest_states import shift, sliding_order
from dehyst.virtual import PlayActuator

SOME = our.actuators(1, 20)
KINDS = ("random", "vertex")
NM = 1e-9
KM, T, KE = 1.4e6, 0.042, 8.82e4


def gaps(actuator):
    return np.diff(actuator.slip.breakaway, prepend=0.0)


def size(actuator):
    return our.span_of(actuator) + float(actuator.slip.breakaway.max())


def elongations(state):
    return state.displacement - state.carts


def draw(actuator, seed, kind, reachable, voltage=0.0):
    """One equilibrium: inside the set, or a corner of it."""
    rest = RestStates(actuator, voltage, reachable)
    if kind == "random":
        return rest.random(1, seed=seed % 1000)[0]
    return rest.vertex(np.random.default_rng(seed).normal(size=len(actuator.slip)) / actuator.slip.breakaway)


EQUILIBRIA = (our.SEEDS, st.sampled_from(KINDS), st.booleans())


def raised_cosine(peaks, samples=400):
    """Cycles 0 -> peak -> 0 [V], the rest before them among the samples."""
    shape = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(1, samples + 1) / samples)
    return np.concatenate([[0.0], *(peak * shape for peak in peaks)])


@given(SOME, st.floats(-0.5, 0.5), st.booleans())
def test_range_of_displacements(actuator, share, reachable):
    """It is eta^-1([V - sum f_i, V + sum f_i]), and both ends are equilibria."""
    voltage, force = share * our.volts_of(actuator), float(actuator.slip.friction.sum())
    rest = RestStates(actuator, voltage, reachable)
    expected = [actuator.relaxed(voltage - side * force).displacement for side in (1, -1)]
    assert largest(np.subtract(rest.range(), expected)) <= 1e-9 * (expected[1] - expected[0]) + 1e-14 * size(actuator)
    relaxed = actuator.relaxed(voltage).displacement
    np.testing.assert_allclose(rest.residual_range(), np.subtract(rest.range(), relaxed), rtol=1e-15)
    for side, end in zip((1, -1), rest.range(), strict=True):
        extreme = rest.state(side * actuator.slip.breakaway)
        assert rest.holds(extreme)
        assert abs(extreme.displacement - end) <= 1e-9 * (expected[1] - expected[0]) + 1e-14 * size(actuator)


def range_by_segments(actuator, voltage, reachable):
    """Lowest and highest y by SciPy's programs in (y, s) in units of the size, one for each segment of the spring."""
    slip, spring, unit = actuator.slip, actuator.spring, size(actuator)
    n, force = len(slip), our.volts_of(actuator)
    knots = np.concatenate([[-np.inf], spring.displacement[1:-1], [np.inf]]) / unit
    inequality = np.hstack([np.zeros((n - 1, 1)), np.diff(np.eye(n), axis=0)])
    rows, room = np.vstack([inequality, -inequality]), np.tile(gaps(actuator)[1:], 2) / unit
    ends = []
    for j, slope in enumerate(spring.slopes):
        balance = np.append(slope, slip.stiffness)[None] * unit / force
        right = (voltage - spring.voltage[j] + slope * spring.displacement[j]) / force
        bounds = [tuple(knots[j : j + 2]), *((-r, r) for r in slip.breakaway / unit)]
        for side in (1, -1):
            cost = side * np.eye(n + 1)[0]
            more = {"A_ub": rows, "b_ub": room} if reachable else {}
            answer = linprog(cost, A_eq=balance, b_eq=[right], bounds=bounds, **more)
            ends += [answer.x[0] * unit] if answer.success else []
    return min(ends), max(ends)


@given(our.actuators(2, 8), st.floats(-0.5, 0.5), st.booleans())
@settings(max_examples=25)
def test_range_by_one_program_a_segment(actuator, share, reachable):
    voltage = share * our.volts_of(actuator)
    found = RestStates(actuator, voltage, reachable).range()
    assert largest(np.subtract(found, range_by_segments(actuator, voltage, reachable))) <= 1e-8 * size(actuator)


@given(SOME, our.SEEDS, st.booleans())
def test_vertex(actuator, seed, reachable):
    """It goes as far as the box of elongations, or of their increments, allows, and lies in a corner of it."""
    rho, rest = actuator.slip.breakaway, RestStates(actuator, reachable=reachable)
    direction = np.random.default_rng(seed).normal(size=rho.size) / rho
    state = rest.vertex(direction)
    s = elongations(state)
    weights = np.cumsum(direction[::-1])[::-1] if reachable else direction
    room = gaps(actuator) if reachable else rho
    farthest = float(np.abs(weights) @ room)
    assert rest.holds(state)
    assert direction @ s == pytest.approx(farthest, abs=1e-8 * float(np.abs(direction) @ rho))
    rounding = 1e-9 * (size(actuator) + abs(state.displacement))
    at_bound = np.abs(np.abs(np.diff(s, prepend=0.0) if reachable else s) - room) <= rounding
    # A weight of nearly nothing leaves its bound open.
    assert np.all(at_bound | (np.abs(weights) * room <= 1e-8 * farthest))


@given(SOME, our.SEEDS, st.booleans(), st.floats(-0.5, 0.5))
def test_random_states_rest_inside(actuator, seed, reachable, share):
    rest = RestStates(actuator, share * our.volts_of(actuator), reachable)
    states = rest.random(5, seed=seed)
    low, high = rest.range()
    for state in states:
        assert rest.holds(state)
        assert RestStates(actuator, rest.voltage).holds(state)
        assert abs(actuator.voltage(state) - rest.voltage) <= 1e-11 * (our.volts_of(actuator) + abs(rest.voltage))
        assert low - 1e-9 * size(actuator) <= state.displacement <= high + 1e-9 * size(actuator)
    again = rest.random(5, seed=seed)
    assert all(np.array_equal(a.carts, b.carts) for a, b in zip(states, again, strict=True))
    assert not np.array_equal(states[0].carts, states[1].carts)


@pytest.mark.parametrize("reachable", [False, True])
def test_random_states_are_uniform(reachable):
    """Mean and variance of 4000 draws in the coordinates in which the set is a box, within five standard errors."""
    actuator, count = plain_records.plant(6), 4000
    s = np.array([elongations(state) for state in RestStates(actuator, 0.0, reachable).random(count)])
    box = np.diff(s, axis=1, prepend=0.0) / gaps(actuator) if reachable else s / actuator.slip.breakaway
    assert np.abs(box).max() <= 1 + 1e-9
    assert np.abs(box.mean(axis=0)).max() <= 5 / np.sqrt(3 * count)
    assert np.abs((box**2).mean(axis=0) - 1 / 3).max() <= 5 * np.sqrt(4 / 45 / count)
    together = np.corrcoef(box.T) - np.eye(6)
    assert np.abs(together).max() <= 5 / np.sqrt(count)


@given(our.motions(SOME, states=("relaxed", "turned up", "reached"), max_samples=40), our.SEEDS, st.floats(-0.5, 0.5))
def test_what_a_history_leaves_is_reachable(motion, seed, share):
    actuator, state, path = motion
    voltage = share * our.volts_of(actuator)
    driven = np.append(our.voltages_like(actuator, state, path, seed), voltage)
    left = actuator.simulate(driven, state=state, extrapolate=True).state
    assert RestStates(actuator, voltage, reachable=True).holds(left)


@given(SOME, our.SEEDS, st.sampled_from(KINDS))
def test_what_is_reachable_some_history_leaves(actuator, seed, kind):
    """Up to b_i + rho_i and down to b_i - rho_i for i = N .. 1, then to y: from any state this leads to the wanted."""
    rho = actuator.slip.breakaway
    wanted = draw(actuator, seed, kind, reachable=True)
    visits = [b + side * r for b, r in zip(wanted.carts[::-1], rho[::-1], strict=True) for side in (1, -1)]
    start = our.make_state(actuator, seed, "arbitrary")
    reached = actuator.compensate([*visits, wanted.displacement], state=start, extrapolate=True).state
    rounding = 1e-9 * size(actuator)
    assert largest(reached.carts - wanted.carts) <= rounding


def test_a_state_that_no_history_leaves():
    actuator = Actuator(MaxwellSlip([1e-6, 2e-6], [1e6, 1e6]), Spring([0, 1e-5], [0, 100]))
    torn = RestStates(actuator).state([1e-6, -2e-6])
    assert RestStates(actuator).holds(torn)
    assert not RestStates(actuator, reachable=True).holds(torn)
    assert not RestStates(actuator, 5.0).holds(torn)
    assert RestStates(actuator, actuator.voltage(actuator.turned(3e-6)), reachable=True).holds(actuator.turned(3e-6))


def moved(actuator, state, path):
    """Which carts have moved at each displacement of a rise (n, N), by stepping the stop operators."""
    carts, found = state.carts, []
    for y in path:
        carts = slip_elongations(actuator.slip.breakaway, carts, np.array([y]))[1]
        found.append(carts > state.carts + 1e-12 * size(actuator))
    return np.array(found)


@given(SOME, *EQUILIBRIA)
def test_sliding_order_is_the_simulation_s(actuator, seed, kind, reachable):
    """Between two places at which elements begin to slide, those before have moved and those after have not."""
    state = draw(actuator, seed, kind, reachable)
    order, begin = sliding_order(actuator, state)
    assert sorted(order) == list(range(len(actuator.slip)))
    assert np.all(np.diff(begin) >= 0)
    rounding = 1e-11 * (size(actuator) + abs(state.displacement))
    assert begin[0] >= state.displacement - rounding
    places = np.append(begin, begin[-1] + size(actuator))
    between = [(i + 1, 0.5 * (a + b)) for i, (a, b) in enumerate(pairwise(places)) if b - a > 4 * rounding]
    for (count, _), have in zip(between, moved(actuator, state, [y for _, y in between]), strict=True):
        assert set(np.flatnonzero(have)) == set(order[:count])


@given(our.actuators(1, 20), our.SEEDS, st.sampled_from(KINDS))
def test_reachable_states_slide_in_increasing_order(actuator, seed, kind):
    order, _ = sliding_order(actuator, draw(actuator, seed, kind, reachable=True))
    assert np.array_equal(order, np.arange(len(actuator.slip)))


def test_sliding_order_by_hand():
    """Relaxed carts slide at rho_i; torn ones out of order; after 0 -> top -> 0 the rest go together at the top."""
    actuator = Actuator(MaxwellSlip([1e-6, 2e-6, 4e-6], [1e6, 1e6, 1e6]), Spring([0, 1e-5], [0, 100]))
    order, begin = sliding_order(actuator, actuator.relaxed())
    assert order.tolist() == [0, 1, 2]
    np.testing.assert_allclose(begin, [1e-6, 2e-6, 4e-6], rtol=1e-12)
    torn = RestStates(actuator).state([-1e-6, 2e-6, 4e-6])
    order, begin = sliding_order(actuator, torn)
    assert order.tolist() == [1, 2, 0]
    np.testing.assert_allclose(begin - torn.displacement, [0, 0, 2e-6], atol=1e-18)
    left = actuator.compensate([8e-6, 4.5e-6], state=actuator.relaxed()).state
    order, begin = sliding_order(actuator, left)
    assert order.tolist() == [0, 1, 2]
    np.testing.assert_allclose(begin, [6.5e-6, 8e-6, 8e-6], rtol=1e-12)


def loop_after_peak(actuator, state, peak):
    """What the sensor reads after the first peak, zeroed at t = 0, over cycles of several heights."""
    v = raised_cosine([peak, peak, 0.6 * peak, 0.8 * peak, peak], samples=60)
    return (actuator.simulate(v, state=state, extrapolate=True).displacement - state.displacement)[30:]


def highest_peak(actuator):
    """A voltage at which every element has slid whatever the equilibrium at 0 V was."""
    highest = RestStates(actuator).range()[1] + 2 * float(actuator.slip.breakaway[-1])
    return actuator.voltage(actuator.turned(highest, extrapolate=True))


@given(SOME, *EQUILIBRIA)
def test_residual_strain_shifts_the_loop(actuator, seed, kind, reachable):
    """Eq. 10: from any equilibrium at 0 V the loop is the relaxed one's, moved vertically by `shift`."""
    state, peak = draw(actuator, seed, kind, reachable), highest_peak(actuator)
    relaxed = loop_after_peak(actuator, actuator.relaxed(), peak)
    loop = loop_after_peak(actuator, state, peak)
    assert largest(loop - relaxed - shift(actuator, state)) <= 1e-9 * np.ptp(relaxed)


@given(SOME, *EQUILIBRIA)
def test_the_shift_is_the_paper_s(actuator, seed, kind, reachable):
    """-(keq/km) x(0), with x from the physical model, whose x = 0 is where the spring alone holds 0 V."""
    state = draw(actuator, seed, kind, reachable)
    paper = actuator.physical(transformer_ratio=T, mechanical_stiffness=KM, electrical_stiffness=KE)
    c = paper.equivalent_stiffness / KM
    x0 = paper.deformation[0] + (state.displacement - actuator.spring.displacement[0]) / c
    assert shift(actuator, state) == pytest.approx(-c * x0, abs=1e-10 * size(actuator))
    assert shift(actuator, actuator.relaxed()) == pytest.approx(0, abs=1e-10 * size(actuator))


@given(SOME, *EQUILIBRIA)
def test_the_first_rise_in_closed_form(actuator, seed, kind, reachable):
    """v = eta(y) + sum kappa_i (rho_i - max(t_i - (y - y(0)), 0)), t_i = rho_i - s_i(0)."""
    slip, state = actuator.slip, draw(actuator, seed, kind, reachable)
    way = slip.breakaway - elongations(state)
    y = state.displacement + np.linspace(0, 3 * slip.breakaway[-1], 50)
    left = np.maximum(way - (y - state.displacement)[:, None], 0)
    expected = actuator.spring(y) + (slip.breakaway - left) @ slip.stiffness
    found = actuator.compensate(y, state=state, extrapolate=True).voltage
    assert largest(found - expected) <= 1e-11 * (our.volts_of(actuator) + largest(expected))


def measured(actuator, state, *, noise=0.0, seed=0, peaks=(200.0, 200.0), samples=400, zero=0.0):
    """A record from `state`; the sensor reads `zero` at t = 0."""
    record = plain_records.driven(actuator, raised_cosine(peaks, samples), state=state, noise=noise, seed=seed)
    return Record(record.time, record.voltage, record.displacement - state.displacement + zero, "rise")


def predicted(actuator, record, state, found):
    """Error of the predicted first rise [m], on the model's axis."""
    v = record.voltage[: np.argmax(record.voltage) + 1]
    return actuator.simulate(v, state=found.state).displacement - actuator.simulate(v, state=state).displacement


CASES = [(elements, seed, kind) for elements in (10, 20) for seed in range(3) for kind in KINDS]


@pytest.mark.parametrize(("elements", "seed", "kind"), CASES)
def test_first_rise_without_noise(elements, seed, kind):
    """The rise to rounding; each cart with stiffness too, but for those that begin between the same two samples."""
    actuator = plain_records.plant(elements, seed=seed)
    state = draw(actuator, seed, kind, reachable=True)
    record = measured(actuator, state, samples=2000, zero=3e-6)
    found = state_from_first_rise(actuator, record)
    assert largest(predicted(actuator, record, state, found)) <= 1e-9 * record.stroke
    assert found.rms <= 1e-9 * record.stroke
    assert found.datum == pytest.approx(state.displacement - 3e-6, abs=1e-9 * record.stroke)
    assert found.state.displacement == pytest.approx(state.displacement, abs=1e-9 * record.stroke)
    assert found.unknown.tolist() == [False] * (elements - 1) + [True]
    error = np.abs(found.state.carts - state.carts)[:-1]
    assert np.all(error <= np.maximum(found.doubt[:-1], 1e-9 * record.stroke))
    spacing = np.diff(record.displacement[:1001]).max()
    assert error.max() <= spacing
    assert RestStates(actuator, reachable=True).holds(found.state)
    if kind == "random":
        assert np.median(error) <= 1e-9 * record.stroke
        assert not found.relaxed


def test_first_rise_with_noise():
    """2 nm on 16 um: the rise within 2 nm RMS and 10 nm at most; 90 % of the carts within 1.645 doubts."""
    inside, errors = [], []
    for seed in range(24):
        actuator = plain_records.plant(10, seed=seed)
        state = draw(actuator, seed, "random", reachable=True)
        record = measured(actuator, state, noise=2 * NM, seed=seed)
        found = state_from_first_rise(actuator, record)
        error = predicted(actuator, record, state, found)
        assert rms(error) <= 2 * NM
        assert largest(error) <= 10 * NM
        assert 1.5 * NM <= found.rms <= 2.5 * NM
        errors.append(found.state.displacement - state.displacement)
        inside.append(np.abs(found.state.carts - state.carts)[:-1] <= 1.645 * found.doubt[:-1])
    assert rms(errors) <= 1 * NM
    assert 0.85 <= np.mean(inside) <= 0.95


@pytest.mark.parametrize("noise", [0.0, 2 * NM])
@pytest.mark.parametrize("seed", range(3))
def test_a_relaxed_actuator_and_a_pre_energised_one(seed, noise):
    """Fig. 6: 24 hours of rest, against 100 V and off again before t = 0."""
    actuator = plain_records.plant(10, seed=seed)
    relaxed = actuator.relaxed()
    before = actuator.simulate(raised_cosine([100.0]), state=relaxed).state
    rested, energised = (
        state_from_first_rise(actuator, measured(actuator, state, noise=noise, seed=seed))
        for state in (relaxed, before)
    )
    assert rested.relaxed
    assert not energised.relaxed
    assert energised.rms_relaxed > 50 * (energised.rms + NM)
    tolerance = 1e-9 * plain_records.STROKE + noise
    assert shift(actuator, rested.state) == pytest.approx(0, abs=tolerance)
    assert shift(actuator, energised.state) == pytest.approx(shift(actuator, before), abs=tolerance)
    assert shift(actuator, before) < -0.01 * plain_records.STROKE


def test_an_actuator_that_is_no_instance_of_the_model():
    """The model of a virtual stage, told from loops: relaxed is relaxed, and 100 V before t = 0 shows as what it is."""
    import dehyst

    loops = raised_cosine([200.0, 200.0, *np.arange(180, 0, -20)])
    stage = PlayActuator()
    fit = dehyst.identify(Record(np.arange(loops.size) / 4, loops, stage.play(loops)), structure="paper")
    v, found, truth = raised_cosine([200.0, 200.0]), {}, {}
    for before in (0.0, 50.0, 100.0):
        stage = PlayActuator(noise=0.0)
        if before:
            stage.play(raised_cosine([before]))
        y = stage.play(v)
        truth[before] = y[0]
        found[before] = state_from_first_rise(fit.actuator, Record(np.arange(v.size) / 4, v, y - y[0]))
        assert percent(found[before].rms, np.ptp(y)) < 0.3
    assert [found[before].relaxed for before in truth] == [True, False, False]
    for before in (50.0, 100.0):
        strain = found[before].state.displacement - found[0.0].state.displacement
        assert strain == pytest.approx(truth[before] - truth[0.0], abs=0.01 * plain_records.STROKE)


def test_remarks():
    actuator = plain_records.plant(10)
    state = draw(actuator, 0, "random", reachable=True)
    said = " ".join(state_from_first_rise(actuator, measured(actuator, state)).remarks)
    below = -state.displacement * 1e6
    assert below > 1
    assert f"The first {below:.4g} um of the rise" in said
    assert "below the spring's identified range: it was extrapolated" in said
    assert "Elements 10 did not surely slide on the rise or have no stiffness" in said
    few = state_from_first_rise(actuator, measured(actuator, state, samples=60))
    assert any("The rise has 31 samples for 9 elements" in sentence for sentence in few.remarks)


@pytest.mark.parametrize("noise", [0.0, 2 * NM])
@pytest.mark.parametrize("seed", range(4))
def test_a_short_rise_tells_little(seed, noise):
    """Elements that never slid are named, and yet the record is met; where the model stands on its axis is doubtful."""
    actuator = plain_records.plant(10)
    state = draw(actuator, seed, "random", reachable=True)
    record = measured(actuator, state, peaks=(60.0, 60.0, 60.0), noise=noise)
    found = state_from_first_rise(actuator, record)
    begin = state.carts + actuator.slip.breakaway
    never = begin >= actuator.simulate(record.voltage, state=state).displacement.max()
    assert never.any()
    assert found.unknown[never].all()
    assert found.rms <= 1e-9 * record.stroke + 1.2 * noise
    assert any("too small to show where on its axis the model stands" in sentence for sentence in found.remarks)


def test_a_torn_state_is_not_met():
    """After an abrupt discharge carts may lie where no slow history puts them: the estimate says that it misses."""
    actuator = plain_records.plant(10)
    signs = np.where(np.arange(10) % 2, 1.0, -1.0)
    torn = RestStates(actuator).state(signs * actuator.slip.breakaway)
    found = state_from_first_rise(actuator, measured(actuator, torn))
    assert "no slow history leaves" in found.remarks[-1]
    assert "of its height only (RMS)" in found.remarks[-1]


def test_where_no_element_has_stiffness():
    actuator = Actuator(MaxwellSlip([1e-6, 2e-6], [0.0, 0.0]), Spring([0, 8e-6, 1.6e-5], [0, 120, 200]))
    found = state_from_first_rise(actuator, measured(actuator, actuator.relaxed()))
    assert found.relaxed
    assert found.unknown.all()
    assert np.array_equal(found.doubt, actuator.slip.breakaway)


def test_the_record_s_delay_is_the_actuator_s():
    plain = plain_records.plant(10)
    lagging = Actuator(plain.slip, plain.spring, delay=0.02)
    state = draw(plain, 1, "random", reachable=True)
    record = measured(plain, state, samples=2000)
    late = Record(record.time + 0.02, record.voltage, record.displacement)
    early = np.interp(late.time, record.time, record.voltage)
    shifted = Record(late.time, early, record.displacement, "late")
    found = state_from_first_rise(lagging, shifted)
    assert rms(found.state.carts[:-1] - state.carts[:-1]) <= 0.01 * plain_records.STROKE
    assert found.rms < 0.1 * state_from_first_rise(plain, shifted).rms


def test_no_elements():
    spring = Actuator(MaxwellSlip([], []), Spring([0, 1e-5], [0, 100]))
    assert RestStates(spring, 50.0).range() == (5e-6, 5e-6)
    assert RestStates(spring, 50.0).holds(RestStates(spring, 50.0).random(1)[0])
    assert sliding_order(spring, spring.relaxed())[0].size == 0
    assert shift(spring, spring.relaxed()) == 0


ONE = Actuator(MaxwellSlip([1e-6, 2e-6], [1e6, 1e6]), Spring([0, 1e-5], [0, 100]))
REFUSED = [
    (lambda: RestStates("x"), "actuator: got str, need an Actuator"),
    (lambda: RestStates(ONE, np.nan), "voltage: got nan, need a finite number"),
    (lambda: RestStates(ONE, reachable=1), "reachable: got 1, need True or False"),
    (lambda: RestStates(ONE).vertex([1.0]), "direction: got .* need a number for each of 2 elements"),
    (lambda: RestStates(ONE).vertex([0.0, 0.0]), "direction: .* not all of them 0"),
    (lambda: RestStates(ONE).vertex([0.0, np.inf]), "direction: 1 of 2 values are not finite"),
    (lambda: RestStates(ONE).state([0.0, 2.1e-6]), "elongation: .* one for each of 2 elements, none beyond"),
    (lambda: RestStates(ONE).state([0.0]), "elongation: .* one for each of 2 elements"),
    (lambda: RestStates(ONE).random(-1), "count: got -1, need an integer of 0 or more"),
    (lambda: RestStates(ONE).random(1.5), "count: got 1.5"),
    (lambda: RestStates(ONE).random(1, seed=-3), "seed: got -3"),
    (lambda: RestStates(ONE).holds(3.0), "state: got float, need a State"),
    (lambda: RestStates(ONE).holds(State(0.0, [0.0])), "state: got 1 carts, this actuator has 2 elements"),
    (lambda: RestStates(ONE).holds(ONE.relaxed(), -1), "tolerance: got -1, need 0 or more"),
    (lambda: sliding_order(None, ONE.relaxed()), "actuator: got NoneType"),
    (lambda: sliding_order(ONE, None), "need a State"),
    (lambda: shift("x", ONE.relaxed()), "actuator: got str"),
    (lambda: shift(ONE, State(0.0, [0.0, 1e-3])), "cart 1 is .* farther from the displacement than its breakaway"),
    (lambda: state_from_first_rise(ONE.slip, None), "actuator: got MaxwellSlip, need an Actuator"),
]


@pytest.mark.parametrize(("call", "message"), REFUSED)
def test_refusals(call, message):
    with pytest.raises(ModelError, match=message):
        call()


def piece(start, stop):
    record = measured(ONE, ONE.relaxed(), peaks=(60.0, 60.0))
    return record.slice(start, stop)


RECORDS = [
    (lambda: [1, 2], "got list, need a Record; read a file with"),
    (lambda: piece(0, 190), r"0 full cycles of the voltage found"),
    (lambda: piece(200, None), "the voltage falls first, from 60 to 0 V; .* start recording at rest"),
    (lambda: piece(0, 500), "no full loop after the first rise, which ends at 1 s; .* go on down and up again"),
]


@pytest.mark.parametrize(("make", "message"), RECORDS)
def test_records_refused(make, message):
    with pytest.raises(RecordError, match=message):
        state_from_first_rise(ONE, make())
