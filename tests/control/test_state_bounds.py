"""What is known of the state: nothing leaves its bracket, brackets only shrink, a first move has an error bar."""

from itertools import pairwise

import numpy as np
import plain_records
import pytest
import strategies as our
from hypothesis import given
from hypothesis import strategies as st
from rest_states import EXACT, PLANT, SOME, carts_along, drives, equilibrium, metres, roomy

from dehyst import ModelError
from dehyst._native import slip_elongations
from dehyst.control import StateBounds, shortest_homing
from dehyst.control.planning.states import MajorLoop, first_known_by_displacement, least_width


@given(our.motions(bank=our.actuators(0, 30)))
def test_elements_are_known_from_a_displacement_once_their_extremes_meet(motion):
    """The interval of an elongation is exactly as wide as that between its extremes: max(0, 2 rho - R)."""
    actuator, _, path = motion
    rho = actuator.slip.breakaway
    if not path.size:
        return
    lowest, _ = slip_elongations(rho, path[0] + rho, path)
    highest, _ = slip_elongations(rho, path[0] - rho, path)
    widths = np.maximum(0.0, 2 * rho - (np.maximum.accumulate(path) - np.minimum.accumulate(path))[:, None])
    allowance = metres(actuator, path)
    np.testing.assert_allclose(highest - lowest, widths, rtol=0, atol=allowance)
    between, _ = slip_elongations(rho, path[0] + np.random.default_rng(path.size).uniform(-rho, rho), path)
    assert np.all((between >= lowest - allowance) & (between <= highest + allowance))
    first = first_known_by_displacement(rho, path)
    unknown = (widths > 2e-12 * 2 * rho.max(initial=0.0)).any(axis=1)
    assert unknown.all() if first is None else not unknown[first:].any()
    assert first is None or np.all((widths > 0).any(axis=1)[:first])


@pytest.mark.parametrize("elements", [1, 3, 7, 10, 19, 20, 33])
@pytest.mark.parametrize("offset", [0.0, -0.3, 1.0, 17.0])
def test_one_excursion_of_just_two_rho_shows_all(elements, offset):
    """The usual case, rho_N half the range: rounding must not leave the last element unknown."""
    rho = plain_records.plant(elements).slip.breakaway
    assert first_known_by_displacement(rho, plain_records.path((offset, offset + 1), 10)) == 10
    assert first_known_by_displacement(rho, plain_records.path((offset, offset + 0.999), 10)) is None


@given(drives(bank=our.actuators(0, 15)))
def test_no_equilibrium_leaves_the_bracket(drive):
    actuator, start, path, seed = drive
    bracket = StateBounds.at_rest(actuator, start)
    known = bracket.propagate(actuator, path)
    low, carts_low = carts_along(actuator, path, bracket.lower)
    high, carts_high = carts_along(actuator, path, bracket.upper)
    allowance = metres(actuator, low, high)
    rng = np.random.default_rng(seed)
    for _ in range(5):
        state = equilibrium(actuator, start, rng)
        assert bracket.lower.deformation - allowance <= state.deformation <= bracket.upper.deformation + allowance
        y, carts = carts_along(actuator, path, state)
        assert np.all((y >= known.lowest - allowance) & (y <= known.highest + allowance))
        assert np.all((carts >= carts_low - allowance) & (carts <= carts_high + allowance))
        end = actuator.simulate(path, state=state, extrapolate=True).state
        for name, sign in (("lower", 1), ("upper", -1)):
            bound = getattr(known.bounds, name)
            assert np.all(sign * (end.carts - bound.carts) >= -allowance)
            assert sign * (end.deformation - bound.deformation) >= -allowance


@given(drives())
def test_brackets_are_attained(drive):
    """The extremes are themselves equilibria, and what is reported lies between just their two motions."""
    actuator, start, path, _ = drive
    bracket = StateBounds.at_rest(actuator, start)
    volts = EXACT * (our.volts_of(actuator) + abs(start))
    slope = max(actuator.spring.slopes.max(), 0.0) * metres(actuator)
    assert actuator.voltage(bracket.lower) == pytest.approx(start, abs=volts + slope)
    assert actuator.voltage(bracket.upper) == pytest.approx(start, abs=volts + slope)
    known = bracket.propagate(actuator, path)
    (low, carts_low), (high, carts_high) = (carts_along(actuator, path, s) for s in (bracket.lower, bracket.upper))
    allowance = metres(actuator, low, high)
    np.testing.assert_allclose(known.lowest, low, rtol=0, atol=allowance)
    np.testing.assert_allclose(known.highest, high, rtol=0, atol=allowance)
    np.testing.assert_allclose(known.width, (carts_high - carts_low).max(axis=1), rtol=0, atol=allowance)


@given(drives())
def test_the_widest_bracket_never_grows(drive):
    actuator, start, path, _ = drive
    bracket = StateBounds.at_rest(actuator, start)
    known = bracket.propagate(actuator, path)
    allowance = metres(actuator, known.lowest, known.highest)
    assert np.all(np.diff(known.width, prepend=bracket.width) <= allowance)
    assert np.all(known.highest - known.lowest <= known.width + allowance)
    assert known.bounds.width == pytest.approx(known.width[-1] if path.size else bracket.width, abs=allowance)


@given(drives())
def test_the_widest_bracket_in_closed_form(drive):
    """It is max(0, 2 rho_N - D), D from the extremes of the voltage alone: why no homing is shorter than ours."""
    actuator, start, path, _ = drive
    known = StateBounds.at_rest(actuator, start).propagate(actuator, path)
    visited = np.concatenate([[start], path])
    extremes = zip(np.minimum.accumulate(visited)[1:], np.maximum.accumulate(visited)[1:], strict=True)
    least = np.array([MajorLoop(actuator).least_range(low, high) for low, high in extremes])
    expected = np.maximum(0.0, 2 * actuator.slip.breakaway[-1] - least)
    np.testing.assert_allclose(known.width, expected, rtol=0, atol=metres(actuator, known.lowest, known.highest))


@given(drives())
def test_every_state_covers_the_least_range(drive):
    actuator, start, path, seed = drive
    if not path.size:
        return
    visited = np.concatenate([[start], path])
    state = equilibrium(actuator, start, np.random.default_rng(seed))
    y = actuator.simulate(path, state=state, extrapolate=True).displacement
    covered = np.ptp(np.append(y, state.deformation))
    assert covered >= MajorLoop(actuator).least_range(visited.min(), visited.max()) - metres(actuator, y)


@given(drives(), st.integers(0, 60))
def test_a_drive_in_two_parts_is_one_drive(drive, cut):
    actuator, start, path, _ = drive
    bracket = StateBounds.at_rest(actuator, start)
    whole = bracket.propagate(actuator, path)
    first = bracket.propagate(actuator, path[:cut])
    second = first.bounds.propagate(actuator, path[cut:])
    allowance = metres(actuator, whole.lowest, whole.highest)
    for name in ("lowest", "highest", "width"):
        parts = np.concatenate([getattr(first, name), getattr(second, name)])
        np.testing.assert_allclose(parts, getattr(whole, name), rtol=0, atol=allowance)
    np.testing.assert_allclose(second.bounds.widths, whole.bounds.widths, rtol=0, atol=allowance)


def test_long_records_and_their_turning_points_say_the_same():
    turns = [0, 150, 20, 120, 60, 170, 5]
    steps = [np.linspace(a, b, 1500)[1:] for a, b in pairwise(turns)]
    dense = StateBounds.at_rest(PLANT).propagate(PLANT, np.concatenate(steps))
    sparse = StateBounds.at_rest(PLANT).propagate(PLANT, turns[1:])
    assert dense.width.size == 6 * 1499
    np.testing.assert_allclose(dense.width[1498::1499], sparse.width, rtol=0, atol=metres(PLANT))
    np.testing.assert_allclose(dense.bounds.lower.carts, sparse.bounds.lower.carts, rtol=0, atol=metres(PLANT))
    np.testing.assert_allclose(dense.bounds.upper.carts, sparse.bounds.upper.carts, rtol=0, atol=metres(PLANT))


def test_the_first_sample_at_which_all_is_known():
    voltage = np.concatenate([np.linspace(0, 230, 100), np.linspace(230, 0, 100)])
    known, least = StateBounds.at_rest(PLANT).propagate(PLANT, voltage), least_width(PLANT)
    first = known.first_known(least)
    assert first > 0
    assert np.all(known.width[first:] <= least)
    assert known.width[first - 1] > least
    assert known.bounds.width <= metres(PLANT)
    assert known.first_known(1e-6) < first
    assert StateBounds.at_rest(PLANT).propagate(PLANT, [10.0, 0.0]).first_known(least) is None


@given(SOME, our.SEEDS)
def test_the_error_bar_of_a_first_move(actuator, seed):
    """Readings from a sensor that starts at zero: as far apart as the starts, once all have homed."""
    limits, present, end = roomy(actuator, seed)
    homing = shortest_homing(actuator, limits=limits, present=present, end=end)
    bracket = StateBounds.at_rest(actuator, present)
    rng = np.random.default_rng(seed)
    states = [bracket.lower, bracket.upper, *(equilibrium(actuator, present, rng) for _ in range(20))]
    readings = [actuator.simulate(homing.turns, state=s, extrapolate=True).displacement - s.deformation for s in states]
    allowance = metres(actuator, *readings)
    final = [reading[-1] for reading in readings]
    assert np.ptp(final) == pytest.approx(bracket.move_error, abs=allowance)
    known = bracket.propagate(actuator, homing.turns)
    for reading in readings:
        assert np.all(reading >= known.lowest - bracket.upper.deformation - allowance)
        assert np.all(reading <= known.highest - bracket.lower.deformation + allowance)


def test_the_error_bar_in_closed_form():
    friction = PLANT.slip.friction.sum()
    ends = [PLANT.core.spring_inverse(60 + sign * friction) for sign in (-1, 1)]
    assert StateBounds.at_rest(PLANT, 60).move_error == pytest.approx(ends[1] - ends[0])
    assert StateBounds(PLANT.relaxed(), PLANT.relaxed()).move_error == 0.0


def test_refusals_of_wrong_types():
    rest = StateBounds.at_rest(PLANT)
    for call in (shortest_homing, StateBounds.at_rest, lambda a: rest.propagate(a, [0.0])):
        with pytest.raises(ModelError, match=r"actuator.*str.*Actuator"):
            call("plant")


def test_brackets_refuse():
    rest = StateBounds.at_rest(PLANT)
    with pytest.raises(ModelError, match="lower: got float, need a State"):
        StateBounds(0.0, rest.upper)
    with pytest.raises(ModelError, match="got 10 and 3 carts"):
        StateBounds(rest.lower, plain_records.plant(3).relaxed())
    with pytest.raises(ModelError, match="lower state"):
        StateBounds(rest.upper, rest.lower)
    with pytest.raises(ModelError, match="voltage: got nan"):
        StateBounds.at_rest(PLANT, np.nan)
    with pytest.raises(ModelError, match="voltage: 1 of 2 values"):
        rest.propagate(PLANT, [0.0, np.inf])
    with pytest.raises(ModelError, match="actuator has 3 elements"):
        rest.propagate(plain_records.plant(3), [0.0])
    with pytest.raises(ModelError, match="tolerance: got 0"):
        least_width(PLANT, 0)


def test_a_displacement_that_is_no_array_of_numbers_is_refused():
    rho = PLANT.slip.breakaway
    with pytest.raises(ModelError, match="displacement: 1 of 2 values"):
        first_known_by_displacement(rho, [0.0, np.nan])
    with pytest.raises(ModelError, match="displacement: got an array"):
        first_known_by_displacement(rho, [[0.0]])
