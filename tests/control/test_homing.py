"""A homing homes from anywhere, and no shorter one does."""

import itertools
import re

import numpy as np
import plain_records
import pytest
import strategies as our
from hypothesis import given
from hypothesis import strategies as st
from rest_states import (
    EXACT,
    PLANT,
    PLENTY,
    SOME,
    ends_known,
    equilibrium,
    metres,
    range_of,
    roomy,
    travel,
)

from dehyst import Actuator, MaxwellSlip, ModelError, Spring, identify
from dehyst.control import shortest_homing
from dehyst.control.planning.states import MajorLoop

BENCH_LIMITS = [
    ((0, 200), 0, None),
    ((0, 260), 0, None),
    ((-40, 200), 0, None),
    ((-100, 120), 0, None),
    ((-300, 0), 0, None),
    ((-300, 300), 0, None),
    ((-50, 250), 100, None),
    ((0, 200), 100, None),
    ((0, 200), 200, None),
    ((0, 250), 60, 20),
    ((0, 250), 20, 60),
    ((-200, 400), -50, 350),
    ((-200, 400), 350, -50),
]


def most_spread(actuator, homing, count, seed=0):
    """Largest difference [m] from the certified state over that many random equilibria."""
    rng = np.random.default_rng(seed)
    worst = 0.0
    for _ in range(count):
        end = actuator.simulate(homing.turns, state=equilibrium(actuator, homing.turns[0], rng), extrapolate=True).state
        carts = np.abs(end.carts - homing.state.carts).max(initial=0.0)
        worst = max(worst, carts, abs(end.deformation - homing.state.deformation))
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
@pytest.mark.parametrize(
    "actuator", [PLANT, plain_records.plant(20, seed=1, curved=0.6), plain_records.plant(1, share=0.1)]
)
def test_homing_from_1000_states(actuator, limits, present, end):
    homing = shortest_homing(actuator, limits=limits, present=present, end=end)
    assert within(homing, limits, present, end)
    assert homing.certified, homing.remarks
    assert homing.unknown == ()
    assert homing.width <= EXACT * range_of(actuator)
    assert most_spread(actuator, homing, 1000) <= EXACT * range_of(actuator)
    assert all(not ends_known(actuator, turns) for turns in shortened(homing.turns, 0.01))


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


@pytest.mark.nightly
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


def test_an_element_without_stiffness_is_homed_where_the_limits_allow_it():
    """rho_N is half the range and 0 to 200 V just covers it; a volt less leaves it unknown, and it does not matter."""
    just = shortest_homing(PLANT, limits=(0, 200))
    assert (just.turns, just.certified, just.unknown) == ((0.0, 200.0, 0.0), True, ())
    assert "without stiffness (stiff_only)" in just.remarks[0]
    less = shortest_homing(PLANT, limits=(0, 199))
    spared = shortest_homing(PLANT, limits=(0, 200), stiff_only=True)
    assert less.turns == spared.turns
    assert less.certified
    assert less.unknown == spared.unknown == (9,)
    assert "leaves element 10 of 10 unknown" in less.remarks[0]
    assert re.search(r"no motion depends on; 1 V above 199 V, or [\d.]+ V below 0 V, would suffice", less.remarks[0])
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
            PLANT.simulate(later, state=state).displacement, expected, rtol=0, atol=EXACT * plain_records.STROKE
        )


def test_the_full_excursion_is_enough_whatever_rounding_says():
    """rho_N is half the range to the last bit or two: with some actuators below, with others above."""
    missing = []
    for elements, seed in itertools.product((2, 3, 5, 7, 10, 13, 20, 50), range(40)):
        actuator = plain_records.plant(elements, seed=seed)
        low, high = (
            float(actuator.compensate([y], state=actuator.turned(plain_records.STROKE - y, rising=bool(y))).voltage[0])
            for y in (0.0, plain_records.STROKE)
        )
        homing = shortest_homing(actuator, limits=(low, high), present=low)
        assert homing.certified
        assert homing.unknown == ()
        assert homing.turns == pytest.approx((low, high, low), rel=1e-9, abs=1e-9)
        missing.append(2 * actuator.slip.breakaway[-1] - MajorLoop(actuator).least_range(low, high))
    assert min(missing) <= 0 < max(missing) < EXACT * plain_records.STROKE


@pytest.mark.slow
def test_an_identified_actuator_homes_within_its_own_limits():
    fit = identify(plain_records.loops(PLANT, plain_records.DESCENDING_TOPS), elements=10)
    low, high = fit.actuator.limits
    homing = shortest_homing(fit.actuator, present=low)
    assert homing.certified
    assert within(homing, (low, high), low, None)
    # The plant homes by it too, to what the model is off: the waveform is just long enough for the model.
    ends = [
        PLANT.simulate(homing.turns, state=equilibrium(PLANT, low, np.random.default_rng(i))).state.deformation
        for i in range(100)
    ]
    assert np.ptp(ends) <= 1e-6 * plain_records.STROKE


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
        shortest_homing(plain_records.plant(10, seed=seed), limits=(0, 220), present=present, tolerance=1e-26)
        for seed in range(10)
        for present in (0, 37, 100)
    ]
    told = [homing for homing in homings if not homing.certified]
    assert told
    for homing in told:
        assert homing.remarks[0].startswith("not certified: rounding leaves a width of")
        assert homing.width <= EXACT * plain_records.STROKE


def test_the_actuators_own_limits_are_the_default():
    limited = Actuator(PLANT.slip, PLANT.spring, limits=(-10, 210))
    assert shortest_homing(limited).turns == shortest_homing(PLANT, limits=(-10, 210)).turns


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
