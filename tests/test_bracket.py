"""What is known of the state: nothing leaves its bracket, brackets only shrink, and a homing homes from anywhere."""

import itertools
import re
from itertools import pairwise

import bench
import numpy as np
import pytest
import strategies as our
from hypothesis import given
from hypothesis import strategies as st

from dehyst import Actuator, MaxwellSlip, ModelError, Spring, State, identify
from dehyst._native import stops
from dehyst.bracket import (
    Bracket,
    first_move_error,
    known_by_displacement,
    least_range,
)
from dehyst.homing import shortest_homing

EXACT = 1e-12
PLANT = bench.plant(10, seed=4)
SOME = our.actuators(1, 15)
SHAPES = ("walk", "scatter", "growing", "dying", "steps up")
# Enough for the steepest spring that the strategies draw.
PLENTY = 40.0


def equilibrium(actuator, voltage, rng):
    """Any elongations at all; the spring holds the rest of the voltage."""
    rho = actuator.slip.breakaway
    s = rng.uniform(-1, 1, rho.size) * rho * rng.choice([0.1, 1.0])
    at_ends = rng.random(rho.size) < rng.choice([0.0, 0.0, 0.5, 1.0])
    s = np.where(at_ends, np.where(rng.random(rho.size) < 0.5, -rho, rho), s)
    y = actuator.core.spring_inverse(voltage - float(actuator.slip.stiffness @ s))
    return State(y, y - s)


def voltages(actuator, start, seed, shape, n):
    rng = np.random.default_rng([seed, 4])
    size = our.volts_of(actuator) * 10 ** rng.uniform(-2, 0.7)
    makers = {
        "walk": lambda: np.cumsum(rng.normal(size=n)),
        "scatter": lambda: rng.normal(size=n),
        "growing": lambda: np.arange(n) / max(n, 1) * (-1.0) ** np.arange(n),
        "dying": lambda: (1 - np.arange(n) / max(n, 1)) * (-1.0) ** np.arange(n),
        "steps up": lambda: np.linspace(0, 1, n),
    }
    return start + size * makers[shape]()


@st.composite
def drives(draw, bank=SOME, max_samples=60):
    """Draw an actuator, the voltage it rests at, and voltages to go through."""
    actuator, seed = draw(bank), draw(our.SEEDS)
    start = float(np.random.default_rng([seed, 5]).uniform(-1, 1)) * our.volts_of(actuator)
    path = voltages(actuator, start, seed, draw(st.sampled_from(SHAPES)), draw(st.integers(0, max_samples)))
    return actuator, start, path, seed


def metres(actuator, *paths):
    """Rounding in the motion: the longest of the lengths that took part."""
    lengths = [
        our.span_of(actuator),
        2 * actuator.slip.breakaway.max(initial=0.0),
        np.abs(actuator.spring.displacement).max(),
    ]
    return EXACT * float(max([*lengths, *(np.abs(path).max(initial=0.0) for path in paths)]))


def carts_along(actuator, voltage, state):
    y = actuator.simulate(voltage, state=state).displacement
    return y, y[:, None] - stops(actuator.slip.breakaway, state.carts, y)[0]


def range_of(actuator):
    return our.span_of(actuator)


def travel(turns):
    return sum(abs(b - a) for a, b in pairwise(turns))


def ends_known(actuator, turns, stiff_only=False):
    """Whether two simulations meet, by the carts alone and without the stack."""
    start = Bracket.at_rest(actuator, turns[0])
    low, high = (actuator.simulate(turns, state=state, stack=False).state for state in (start.lower, start.upper))
    counted = actuator.slip.stiffness > 0 if stiff_only else slice(None)
    widest = np.abs(high.carts - low.carts)[counted].max(initial=0.0)
    return max(widest, abs(high.displacement - low.displacement)) <= EXACT * range_of(actuator)


# y known


@given(our.motions(bank=our.actuators(0, 30)))
def test_widths_from_a_known_displacement_are_exact(motion):
    """The widths are those between the extreme elongations, and no elongation lies outside."""
    actuator, _, path = motion
    rho = actuator.slip.breakaway
    known = known_by_displacement(actuator, path)
    assert known.widths.shape == (path.size, rho.size)
    if not path.size:
        return
    lowest, _ = stops(rho, path[0] + rho, path)
    highest, _ = stops(rho, path[0] - rho, path)
    allowance = metres(actuator, path)
    np.testing.assert_allclose(highest - lowest, known.widths, rtol=0, atol=allowance)
    between, _ = stops(rho, path[0] + np.random.default_rng(path.size).uniform(-rho, rho), path)
    assert np.all((between >= lowest - allowance) & (between <= highest + allowance))


@given(our.motions(bank=SOME))
def test_unknown_counts_the_widths(motion):
    actuator, _, path = motion
    known = known_by_displacement(actuator, path)
    counted = np.count_nonzero(known.widths > known.tolerance, axis=1)
    # A width within rounding of the tolerance may count either way.
    close = np.any(np.abs(known.widths - known.tolerance) < 1e-3 * known.tolerance, axis=1)
    np.testing.assert_array_equal(known.unknown[~close], counted[~close])
    assert np.all(np.diff(known.unknown) <= 0)
    first = known.first_known
    assert first is None or (known.unknown[first] == 0 and np.all(known.unknown[:first] > 0))
    assert first is not None or np.all(known.unknown > 0)


@pytest.mark.parametrize("elements", [1, 3, 7, 10, 19, 20, 33])
@pytest.mark.parametrize("offset", [0.0, -0.3, 1.0, 17.0])
def test_one_excursion_of_just_two_rho_tells_all(elements, offset):
    """The usual case, rho_N half the range: rounding must not leave the last element unknown."""
    actuator = bench.plant(elements)
    known = known_by_displacement(actuator, bench.path((offset, offset + 1), 10))
    assert known.first_known == 10
    short = known_by_displacement(actuator, bench.path((offset, offset + 0.999), 10))
    assert (short.first_known, short.unknown[-1]) == (None, 1)


def test_breakaway_alone_will_do():
    path = bench.path((0, 0.3, 0.1, 0.6))
    by_actuator, by_rho = (known_by_displacement(a, path) for a in (PLANT, PLANT.slip.breakaway.tolist()))
    np.testing.assert_array_equal(by_actuator.widths, by_rho.widths)
    # Element i has 2 rho_i = i/10 of the stroke.
    np.testing.assert_array_equal(by_actuator.unknown[[0, 100, 200, 300]], [10, 7, 7, 4])


# v known


@given(drives(bank=our.actuators(0, 15)))
def test_no_equilibrium_leaves_the_bracket(drive):
    actuator, start, path, seed = drive
    bracket = Bracket.at_rest(actuator, start)
    known = bracket.drive(actuator, path)
    low, carts_low = carts_along(actuator, path, bracket.lower)
    high, carts_high = carts_along(actuator, path, bracket.upper)
    allowance = metres(actuator, low, high)
    rng = np.random.default_rng(seed)
    for _ in range(5):
        state = equilibrium(actuator, start, rng)
        assert bracket.lower.displacement - allowance <= state.displacement <= bracket.upper.displacement + allowance
        y, carts = carts_along(actuator, path, state)
        assert np.all((y >= known.lowest - allowance) & (y <= known.highest + allowance))
        assert np.all((carts >= carts_low - allowance) & (carts <= carts_high + allowance))
        end = actuator.simulate(path, state=state).state
        for name, sign in (("lower", 1), ("upper", -1)):
            bound = getattr(known.bracket, name)
            assert np.all(sign * (end.carts - bound.carts) >= -allowance)
            assert sign * (end.displacement - bound.displacement) >= -allowance


@given(drives())
def test_brackets_are_attained(drive):
    """The extremes are themselves equilibria, and what is reported lies between just their two motions."""
    actuator, start, path, _ = drive
    bracket = Bracket.at_rest(actuator, start)
    volts = EXACT * (our.volts_of(actuator) + abs(start))
    slope = max(actuator.spring.slopes.max(), 0.0) * metres(actuator)
    assert actuator.voltage(bracket.lower) == pytest.approx(start, abs=volts + slope)
    assert actuator.voltage(bracket.upper) == pytest.approx(start, abs=volts + slope)
    known = bracket.drive(actuator, path)
    (low, carts_low), (high, carts_high) = (carts_along(actuator, path, s) for s in (bracket.lower, bracket.upper))
    allowance = metres(actuator, low, high)
    np.testing.assert_allclose(known.lowest, low, rtol=0, atol=allowance)
    np.testing.assert_allclose(known.highest, high, rtol=0, atol=allowance)
    np.testing.assert_allclose(known.width, (carts_high - carts_low).max(axis=1), rtol=0, atol=allowance)


@given(drives())
def test_the_widest_bracket_never_grows(drive):
    actuator, start, path, _ = drive
    bracket = Bracket.at_rest(actuator, start)
    known = bracket.drive(actuator, path)
    allowance = metres(actuator, known.lowest, known.highest)
    assert np.all(np.diff(known.width, prepend=bracket.width) <= allowance)
    assert np.all(known.highest - known.lowest <= known.width + allowance)
    assert known.bracket.width == pytest.approx(known.width[-1] if path.size else bracket.width, abs=allowance)


@given(drives())
def test_the_widest_bracket_in_closed_form(drive):
    """It is max(0, 2 rho_N - D), D from the extremes of the voltage alone: why no homing is shorter than ours."""
    actuator, start, path, _ = drive
    known = Bracket.at_rest(actuator, start).drive(actuator, path)
    visited = np.concatenate([[start], path])
    extremes = zip(np.minimum.accumulate(visited)[1:], np.maximum.accumulate(visited)[1:], strict=True)
    least = np.array([least_range(actuator, low, high) for low, high in extremes])
    expected = np.maximum(0.0, 2 * actuator.slip.breakaway[-1] - least)
    np.testing.assert_allclose(known.width, expected, rtol=0, atol=metres(actuator, known.lowest, known.highest))


@given(drives())
def test_every_state_covers_the_least_range(drive):
    actuator, start, path, seed = drive
    if not path.size:
        return
    visited = np.concatenate([[start], path])
    state = equilibrium(actuator, start, np.random.default_rng(seed))
    y = actuator.simulate(path, state=state).displacement
    covered = np.ptp(np.append(y, state.displacement))
    assert covered >= least_range(actuator, visited.min(), visited.max()) - metres(actuator, y)


@given(drives(), st.integers(0, 60))
def test_a_drive_in_two_parts_is_one_drive(drive, cut):
    actuator, start, path, _ = drive
    bracket = Bracket.at_rest(actuator, start)
    whole = bracket.drive(actuator, path)
    first = bracket.drive(actuator, path[:cut])
    second = first.bracket.drive(actuator, path[cut:])
    allowance = metres(actuator, whole.lowest, whole.highest)
    for name in ("lowest", "highest", "width"):
        parts = np.concatenate([getattr(first, name), getattr(second, name)])
        np.testing.assert_allclose(parts, getattr(whole, name), rtol=0, atol=allowance)
    np.testing.assert_allclose(second.bracket.widths, whole.bracket.widths, rtol=0, atol=allowance)


def test_long_records_and_their_turning_points_say_the_same():
    turns = [0, 150, 20, 120, 60, 170, 5]
    steps = [np.linspace(a, b, 1500)[1:] for a, b in pairwise(turns)]
    dense = Bracket.at_rest(PLANT).drive(PLANT, np.concatenate(steps))
    sparse = Bracket.at_rest(PLANT).drive(PLANT, turns[1:])
    assert dense.width.size == 6 * 1499
    np.testing.assert_allclose(dense.width[1498::1499], sparse.width, rtol=0, atol=metres(PLANT))
    np.testing.assert_allclose(dense.bracket.lower.carts, sparse.bracket.lower.carts, rtol=0, atol=metres(PLANT))
    np.testing.assert_allclose(dense.bracket.upper.carts, sparse.bracket.upper.carts, rtol=0, atol=metres(PLANT))


def test_the_first_sample_at_which_all_is_known():
    voltage = np.concatenate([np.linspace(0, 230, 100), np.linspace(230, 0, 100)])
    known = Bracket.at_rest(PLANT).drive(PLANT, voltage)
    assert known.first_known is not None
    assert known.unknown[0] == 10
    assert np.all(known.unknown[known.first_known :] == 0)
    assert known.unknown[known.first_known - 1] > 0
    assert known.bracket.known(metres(PLANT))
    assert Bracket.at_rest(PLANT).drive(PLANT, [10.0, 0.0]).first_known is None
    assert not Bracket.at_rest(PLANT).known(1e-9)


def test_looser_tolerances_know_earlier():
    counts = [Bracket.at_rest(PLANT).drive(PLANT, [180.0, 0.0], tolerance=t).unknown[-1] for t in (1e-18, 1e-6, 1e-5)]
    assert counts[0] == 10
    assert counts[2] == 0
    assert sorted(counts, reverse=True) == counts


# homing

BENCH_LIMITS = [
    ((0, 200), 0, None), ((0, 260), 0, None), ((-40, 200), 0, None), ((-100, 120), 0, None), ((-300, 0), 0, None),
    ((-300, 300), 0, None), ((-50, 250), 100, None), ((0, 200), 100, None), ((0, 200), 200, None),
    ((0, 250), 60, 20), ((0, 250), 20, 60), ((-200, 400), -50, 350), ((-200, 400), 350, -50),
]  # fmt: skip


def most_spread(actuator, homing, count, seed=0):
    """Largest difference [m] from the certified state over that many random equilibria."""
    rng = np.random.default_rng(seed)
    worst = 0.0
    for _ in range(count):
        end = actuator.simulate(homing.turns, state=equilibrium(actuator, homing.turns[0], rng)).state
        carts = np.abs(end.carts - homing.state.carts).max(initial=0.0)
        worst = max(worst, carts, abs(end.displacement - homing.state.displacement))
    return worst


def within(homing, limits, present, end):
    inside = all(limits[0] <= turn <= limits[1] for turn in homing.turns)
    return inside and (homing.turns[0], homing.turns[-1]) == (present, present if end is None else end)


def shortened(turns, share):
    """Each inner turn of its own brought in by that share of the whole excursion."""
    low, high = min(turns), max(turns)
    for i, turn in enumerate(turns[1:-1], 1):
        moved = turn - share * (high - low) if turn == high else turn + share * (high - low)
        yield (*turns[:i], moved, *turns[i + 1 :])


@pytest.mark.parametrize(("limits", "present", "end"), BENCH_LIMITS)
@pytest.mark.parametrize("actuator", [PLANT, bench.plant(20, seed=1, curved=0.6), bench.plant(1, share=0.1)])
def test_homing_from_1000_states(actuator, limits, present, end):
    homing = shortest_homing(actuator, limits=limits, present=present, end=end)
    assert within(homing, limits, present, end)
    assert homing.certified, homing.remarks
    assert homing.unknown == ()
    assert homing.width <= EXACT * range_of(actuator)
    assert most_spread(actuator, homing, 1000) <= EXACT * range_of(actuator)
    assert all(not ends_known(actuator, turns) for turns in shortened(homing.turns, 0.01))


def roomy(actuator, seed):
    """Limits that allow every homing, and a present voltage anywhere between."""
    rng = np.random.default_rng([seed, 6])
    volts = our.volts_of(actuator)
    present = float(rng.uniform(-1, 1) * volts)
    below, above = rng.choice([(PLENTY, PLENTY), (0.0, PLENTY), (PLENTY, 0.0), (0.2, PLENTY), (PLENTY, 0.2)])
    end = None if rng.random() < 0.5 else float(rng.uniform(-1, 1) * volts)
    ends = (present, present if end is None else end)
    return (min(ends) - below * volts, max(ends) + above * volts), present, end


@given(SOME, our.SEEDS)
def test_homing_of_any_actuator(actuator, seed):
    limits, present, end = roomy(actuator, seed)
    homing = shortest_homing(actuator, limits=limits, present=present, end=end)
    assert homing.certified, homing.remarks
    assert homing.unknown == ()
    assert within(homing, limits, present, end)
    assert most_spread(actuator, homing, 20, seed) <= EXACT * range_of(actuator)
    assert homing.travel == pytest.approx(travel(homing.turns))
    assert len(homing.turns) <= 4


def least_scale(known, most):
    """Bisection: the least scale at which `known` holds, from above."""
    low, high = 0.0, most
    if not known(high):
        return np.inf
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if known(middle) else (middle, high)
    return high


def families(present, low, limits, end):
    """Up and down and down and up through `low`, as functions of the peak."""
    base = max(present, end)
    yield lambda rise: (present, base + rise, low, end)
    yield lambda rise: (present, low, base + rise, end)


@given(our.actuators(1, 6), our.SEEDS)
def test_bisection_finds_nothing_shorter(actuator, seed):
    """A second way: for many bottoms, the least peak after which two simulations meet."""
    limits, present, end = roomy(actuator, seed)
    end = present if end is None else end
    homing = shortest_homing(actuator, limits=limits, present=present, end=end)
    near = min(present, end)
    bottoms = [min(homing.turns), near, *np.linspace(max(limits[0], near - 2 * our.volts_of(actuator)), near, 4)]
    travels = []
    for low in bottoms:
        for turns in families(present, low, limits, end):
            rise = least_scale(lambda r, turns=turns: ends_known(actuator, turns(r)), limits[1] - max(present, end))
            travels.append(travel(turns(rise)) if np.isfinite(rise) else np.inf)
    assert min(travels) >= homing.travel * (1 - 1e-9)
    assert min(travels) <= homing.travel * (1 + 1e-9)


@given(our.actuators(1, 6), our.SEEDS, st.integers(1, 6))
def test_no_waveform_of_any_shape_is_shorter(actuator, seed, turns):
    rng = np.random.default_rng([seed, 7])
    volts = our.volts_of(actuator)
    present = float(rng.uniform(-1, 1) * volts)
    shape = np.array([0.0, *rng.normal(size=turns), 0.0])
    limits = (present - PLENTY * volts, present + PLENTY * volts)
    scale = least_scale(lambda s: ends_known(actuator, present + s * shape), PLENTY * volts / np.abs(shape).max())
    homing = shortest_homing(actuator, limits=limits, present=present)
    assert not np.isfinite(scale) or travel(present + scale * shape) >= homing.travel * (1 - 1e-9)


@given(our.actuators(1, 6), our.SEEDS)
def test_higher_peaks_home_too(actuator, seed):
    limits, present, end = roomy(actuator, seed)
    homing = shortest_homing(actuator, limits=limits, present=present, end=end)
    rng = np.random.default_rng([seed, 8])
    low, high = min(homing.turns), max(homing.turns)
    more = rng.uniform(0, 2, 2) * our.volts_of(actuator)
    farther = tuple(turn + more[1] * (turn == high) - more[0] * (turn == low) for turn in homing.turns[1:-1])
    assert ends_known(actuator, (homing.turns[0], *farther, homing.turns[-1]))


@given(our.actuators(1, 10), our.SEEDS)
def test_what_would_do_beyond_too_narrow_limits(actuator, seed):
    """Uncertified: the whole of the limits is used, and the volts it asks for are those that are missing."""
    rng = np.random.default_rng([seed, 9])
    volts = our.volts_of(actuator)
    present = float(rng.uniform(-1, 1) * volts)
    limits = (present - 0.1 * rng.random() * volts, present + 0.1 * rng.random() * volts)
    homing = shortest_homing(actuator, limits=limits, present=present)
    stiff = actuator.slip.stiffness > 0
    if homing.certified:
        assert all(not stiff[i] for i in homing.unknown)
        return
    assert set(homing.turns) == {present, *limits}
    (said,) = homing.remarks
    assert said.startswith("not certified: leaves element")
    above, below = map(float, re.search(r"; (\S+) V above .* or (\S+) V below", said).groups())
    for share, enough in ((1.001, True), (0.999, False)):
        higher = (limits[0], limits[1] + share * above)
        lower = (limits[0] - share * below, limits[1])
        assert shortest_homing(actuator, limits=higher, present=present).certified is enough
        assert shortest_homing(actuator, limits=lower, present=present).certified is enough


def test_too_narrow_limits_in_words():
    homing = shortest_homing(PLANT, limits=(0, 100))
    assert homing.turns == (0.0, 100.0, 0.0)
    assert not homing.certified
    assert homing.unknown == tuple(range(10))
    assert re.fullmatch(
        r"not certified: leaves elements 1 to 9 of 10 unknown, by up to [\d.]+ um; "
        r"[\d.]+ V above 100 V, or [\d.]+ V below 0 V, would do",
        homing.remarks[0],
    )
    assert homing.width == pytest.approx(bench.STROKE - least_range(PLANT, 0, 100), rel=1e-9)


def test_an_element_without_stiffness_is_homed_where_the_limits_allow_it():
    """rho_N is half the range and 0 to 200 V just covers it; a volt less leaves it unknown, and it does not matter."""
    just = shortest_homing(PLANT, limits=(0, 200))
    assert (just.turns, just.certified, just.unknown) == ((0.0, 200.0, 0.0), True, ())
    assert "only home elements without stiffness (stiff_only=True)" in just.remarks[0]
    less = shortest_homing(PLANT, limits=(0, 199))
    spared = shortest_homing(PLANT, limits=(0, 200), stiff_only=True)
    assert less.turns == spared.turns
    assert less.certified
    assert less.unknown == spared.unknown == (9,)
    assert "leaves element 10 of 10 unknown" in less.remarks[0]
    assert re.search(r"no motion depends on; 1 V above 199 V, or [\d.]+ V below 0 V, would do", less.remarks[0])
    assert spared.remarks[0].endswith("which no motion depends on")
    assert not ends_known(PLANT, [turn * 0.99 for turn in spared.turns], stiff_only=True)


def test_unknown_carts_without_stiffness_move_nothing():
    homing = shortest_homing(PLANT, limits=(0, 200), stiff_only=True)
    rng = np.random.default_rng(3)
    later = rng.uniform(0, 200, 50)
    expected = PLANT.simulate(later, state=homing.state).displacement
    for _ in range(50):
        state = PLANT.simulate(homing.turns, state=equilibrium(PLANT, 0.0, rng)).state
        np.testing.assert_allclose(
            PLANT.simulate(later, state=state).displacement, expected, rtol=0, atol=EXACT * bench.STROKE
        )


def test_the_full_excursion_is_enough_whatever_rounding_says():
    """rho_N is half the range to the last bit or two: with some actuators below, with others above."""
    missing = []
    for elements, seed in itertools.product((2, 3, 5, 7, 10, 13, 20, 50), range(40)):
        actuator = bench.plant(elements, seed=seed)
        low, high = (
            float(actuator.compensate([y], state=actuator.turned(bench.STROKE - y, rising=bool(y))).voltage[0])
            for y in (0.0, bench.STROKE)
        )
        homing = shortest_homing(actuator, limits=(low, high), present=low)
        assert homing.certified
        assert homing.unknown == ()
        assert homing.turns == pytest.approx((low, high, low), rel=1e-9, abs=1e-9)
        missing.append(2 * actuator.slip.breakaway[-1] - least_range(actuator, low, high))
    assert min(missing) <= 0 < max(missing) < EXACT * bench.STROKE


@pytest.mark.slow
def test_an_identified_actuator_homes_within_its_own_limits():
    fit = identify(bench.loops(PLANT, bench.DESCENDING_TOPS), elements=10)
    low, high = fit.actuator.limits
    homing = shortest_homing(fit.actuator, present=low)
    assert homing.certified
    assert within(homing, (low, high), low, None)
    # The plant homes by it too, to what the model is off: the waveform is just long enough for the model.
    ends = [PLANT.simulate(homing.turns, state=equilibrium(PLANT, low, np.random.default_rng(i))).state.displacement
            for i in range(100)]  # fmt: skip
    assert np.ptp(ends) <= 1e-6 * bench.STROKE


def test_nothing_to_home():
    spring = Spring([0.0, 1e-5], [0.0, 100.0])
    none = shortest_homing(Actuator(MaxwellSlip([], []), spring), limits=(0, 100))
    assert (none.turns, none.travel, none.width, none.certified) == ((0.0,), 0.0, 0.0, True)
    idle = Actuator(MaxwellSlip([1e-6, 2e-6], [0.0, 0.0]), spring)
    assert shortest_homing(idle, limits=(0, 100), stiff_only=True).turns == (0.0,)
    assert shortest_homing(idle, limits=(0, 100)).turns == pytest.approx((0.0, 40.0, 0.0), rel=1e-9)
    far = shortest_homing(PLANT, limits=(0, 200), present=0, end=200)
    assert (far.turns, far.certified, far.remarks) == ((0.0, 200.0), True, ())


def test_the_gentler_part_of_the_spring_is_homed_on():
    """A motion over a soft part of the spring takes fewer volts: down and up is found where it is shorter."""
    spring = Spring(np.array([-20, -10, 0, 10, 20]) * 1e-6, [-400.0, -40.0, 0.0, 400.0, 800.0])
    actuator = Actuator(MaxwellSlip([1e-6, 4e-6], [1e6, 1e6]), spring)
    homing = shortest_homing(actuator, limits=(-500, 500))
    # F = 5 V; the lower extreme state tops at eta^-1(H - 5), so H >= 0 is 5 V short of the soft part's end.
    assert homing.turns == pytest.approx((0.0, 5.0, -37.0, 0.0), rel=1e-9)
    assert homing.travel == pytest.approx(84.0)


@given(SOME, our.SEEDS, st.floats(-6, 0.5))
def test_a_coarser_tolerance_needs_less(actuator, seed, decades):
    """Its whole width is used, and no more."""
    tolerance = range_of(actuator) * 10**decades
    limits, present, end = roomy(actuator, seed)
    fine, coarse = (
        shortest_homing(actuator, limits=limits, present=present, end=end, tolerance=t) for t in (None, tolerance)
    )
    assert coarse.certified
    assert coarse.travel <= fine.travel * (1 + 1e-9)
    assert most_spread(actuator, coarse, 20, seed) <= 0.5 * tolerance + metres(actuator)
    if len(coarse.turns) > 2:
        assert coarse.width == pytest.approx(tolerance, rel=1e-5)


def test_a_tolerance_below_rounding_is_told():
    homings = [
        shortest_homing(bench.plant(10, seed=seed), limits=(0, 220), present=present, tolerance=1e-26)
        for seed in range(10)
        for present in (0, 37, 100)
    ]
    told = [homing for homing in homings if not homing.certified]
    assert told
    for homing in told:
        assert homing.remarks[0].startswith("not certified: rounding leaves a width of")
        assert homing.width <= EXACT * bench.STROKE


def test_the_actuators_own_limits_are_the_default():
    limited = Actuator(PLANT.slip, PLANT.spring, limits=(-10, 210))
    assert shortest_homing(limited).turns == shortest_homing(PLANT, limits=(-10, 210)).turns


# the first move


@given(SOME, our.SEEDS)
def test_the_error_bar_of_a_first_move(actuator, seed):
    """Readings from a sensor that starts at zero: as far apart as the starts, once all have homed."""
    limits, present, end = roomy(actuator, seed)
    homing = shortest_homing(actuator, limits=limits, present=present, end=end)
    bracket = Bracket.at_rest(actuator, present)
    rng = np.random.default_rng(seed)
    states = [bracket.lower, bracket.upper, *(equilibrium(actuator, present, rng) for _ in range(20))]
    readings = [actuator.simulate(homing.turns, state=s).displacement - s.displacement for s in states]
    allowance = metres(actuator, *readings)
    final = [reading[-1] for reading in readings]
    assert np.ptp(final) == pytest.approx(first_move_error(bracket), abs=allowance)
    known = bracket.drive(actuator, homing.turns)
    for reading in readings:
        assert np.all(reading >= known.lowest - bracket.upper.displacement - allowance)
        assert np.all(reading <= known.highest - bracket.lower.displacement + allowance)


def test_the_error_bar_in_closed_form():
    friction = PLANT.slip.friction.sum()
    ends = [PLANT.core.spring_inverse(60 + sign * friction) for sign in (-1, 1)]
    assert first_move_error(Bracket.at_rest(PLANT, 60)) == pytest.approx(ends[1] - ends[0])
    assert first_move_error(Bracket(PLANT.relaxed(), PLANT.relaxed())) == 0.0


# refusals


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "no voltage limits"),
        ({"limits": (10, 200)}, r"present: got 0 V, need a voltage within the limits 10 to 200 V"),
        ({"limits": (0, 200), "present": -0.1}, "present: got -0.1 V"),
        ({"limits": (0, 200), "end": 201}, "end: got 201 V"),
        ({"limits": (0, 200), "present": np.nan}, "present: got nan, need a finite number"),
        ({"limits": (0, 200), "present": "0"}, "present: got '0', need a finite number"),
        ({"limits": (0, 200), "end": True}, "end: got True, need a finite number"),
        ({"limits": (200, 0)}, "limits: got"),
        ({"limits": (0, np.inf)}, "limits: got inf"),
        ({"limits": 200}, "limits: got 200"),
        ({"limits": (0, 200), "tolerance": 0}, "tolerance: got 0, need a positive number of metres"),
        ({"limits": (0, 200), "tolerance": np.nan}, "tolerance: got nan"),
    ],
)
def test_homing_refuses(options, message):
    with pytest.raises(ModelError, match=message):
        shortest_homing(PLANT, **options)


def test_refusals_of_wrong_types():
    rest = Bracket.at_rest(PLANT)
    for call in (shortest_homing, Bracket.at_rest, lambda a: rest.drive(a, [0.0]), lambda a: least_range(a, 0, 1)):
        with pytest.raises(ModelError, match="actuator: got str, need an Actuator"):
            call("plant")


def test_brackets_refuse():
    rest = Bracket.at_rest(PLANT)
    with pytest.raises(ModelError, match="lower: got float, need a State"):
        Bracket(0.0, rest.upper)
    with pytest.raises(ModelError, match="got 10 and 3 carts, need states of one actuator"):
        Bracket(rest.lower, bench.plant(3).relaxed())
    with pytest.raises(ModelError, match="the lower state lies above the upper one"):
        Bracket(rest.upper, rest.lower)
    with pytest.raises(ModelError, match="voltage: got nan"):
        Bracket.at_rest(PLANT, np.nan)
    with pytest.raises(ModelError, match="voltage: 1 of 2 values are not finite"):
        rest.drive(PLANT, [0.0, np.inf])
    with pytest.raises(ModelError, match="this actuator has 3 elements"):
        rest.drive(bench.plant(3), [0.0])
    with pytest.raises(ModelError, match="tolerance: got -1"):
        rest.drive(PLANT, [0.0], tolerance=-1)
    with pytest.raises(ModelError, match="tolerance: got 0"):
        rest.known(0)
    with pytest.raises(ModelError, match="highest: got inf"):
        least_range(PLANT, 0, np.inf)


def test_known_by_displacement_refuses():
    with pytest.raises(ModelError, match="displacement: 1 of 2 values are not finite"):
        known_by_displacement(PLANT, [0.0, np.nan])
    with pytest.raises(ModelError, match="displacement: got an array of shape"):
        known_by_displacement(PLANT, [[0.0]])
    with pytest.raises(ModelError, match="must be positive and strictly increasing"):
        known_by_displacement([2e-6, 1e-6], [0.0])
    with pytest.raises(ModelError, match="breakaway elongations: got str"):
        known_by_displacement("plant", [0.0])
    with pytest.raises(ModelError, match="tolerance: got 0"):
        known_by_displacement(PLANT, [0.0], tolerance=0)
