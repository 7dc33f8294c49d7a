"""Play operators with curves and low-passes: laws, second opinions, refusals."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import SEEDS

from dehyst import ModelError
from dehyst_rivals.plays import PlayBank, PlayState

VOLTS = 100.0


def random_bank(seed, plays, knots, passes=0, flat=0.0):
    """Return a bank of 10 um at 100 V; `flat` of the slopes but those of the first play are 0."""
    rng = np.random.default_rng(seed)
    thresholds = np.concatenate([[0.0], np.sort(rng.uniform(0, 0.5 * VOLTS, plays - 1))])
    places = [np.sort(rng.uniform(-0.1, 1.1, rng.integers(0, knots + 1))) * VOLTS for _ in range(plays)]
    slopes = [rng.exponential(1e-7 / plays, k.size + 1) * (rng.random(k.size + 1) >= flat) for k in places]
    slopes[0] = slopes[0] + 1e-8
    times, shares = 10 ** rng.uniform(-2, 2, passes), rng.exponential(1e-8, passes)
    return PlayBank(thresholds, places, slopes, rng.normal(scale=1e-6), times, shares)


def random_state(bank, seed):
    rng = np.random.default_rng([seed, 1])
    v = rng.uniform(0, VOLTS)
    return PlayState(
        v, v + bank.thresholds * rng.uniform(-1, 1, bank.thresholds.size), rng.uniform(0, VOLTS, bank.times.size), 1.0
    )


def slowly(bank, voltage, state, time=None):
    """Displacement [m], written down once more."""
    z, q, before, at, out = state.plays.copy(), state.lowpasses.copy(), state.voltage, state.time, []
    for t, v in enumerate(voltage):
        z = np.maximum(np.minimum(z, v + bank.thresholds), v - bank.thresholds)
        y = bank.offset
        for place, knots, slopes in zip(z, bank.knots, bank.slopes, strict=True):
            origin = knots[0] if knots.size else 0.0
            ends = np.concatenate([[min(place, origin) - 1], knots, [max(place, origin) + 1]])
            fine = np.unique(np.concatenate([np.clip(ends, min(place, origin), max(place, origin))]))
            middle = 0.5 * (fine[1:] + fine[:-1])
            y += np.sign(place - origin) * np.diff(fine) @ slopes[np.searchsorted(knots, middle)]
        if time is not None and bank.times.size:
            parts = 4000
            step = (time[t] - at) / parts
            for k in range(parts):
                middle = before + (v - before) * (k + 0.5) / parts
                q = q + (middle - q) * -np.expm1(-step / bank.times)
            at, before = time[t], v
        out.append(y + bank.shares @ q)
    return np.array(out)


@given(SEEDS, st.integers(1, 12), st.integers(0, 5))
def test_a_second_method_gives_the_same_sum_of_curves(seed, plays, knots):
    bank = random_bank(seed, plays, knots)
    state = random_state(bank, seed)
    voltage = np.random.default_rng([seed, 2]).uniform(-20, 130, 40)
    y, after = bank.simulate(voltage, state, None)
    np.testing.assert_allclose(y, slowly(bank, voltage, state), rtol=0, atol=1e-12 * 1e-5)
    assert bank.simulate(voltage[-1:], after, None)[0] == pytest.approx(y[-1:], abs=1e-17)


def test_low_passes_agree_with_small_steps():
    bank = random_bank(3, 4, 3, passes=5)
    state = random_state(bank, 3)
    rng = np.random.default_rng(5)
    voltage, time = rng.uniform(0, 100, 12), 1.0 + np.cumsum(rng.uniform(0.01, 3, 12))
    y, after = bank.simulate(voltage, state, time)
    # The rectangle rule on steps of 1/4000 is good to their square.
    np.testing.assert_allclose(y, slowly(bank, voltage, state, time), rtol=0, atol=1e-6 * 1e-5)
    assert after.time == time[-1]


@given(SEEDS, st.integers(1, 12), st.integers(0, 8), st.integers(0, 4), st.sampled_from([0.0, 0.5, 1.0]))
def test_the_stepwise_inverse_is_exact(seed, plays, knots, passes, flat):
    bank = random_bank(seed, plays, knots, passes, flat)
    state = random_state(bank, seed)
    rng = np.random.default_rng([seed, 3])
    voltage = rng.uniform(0, VOLTS, 50)
    time = 1 + np.cumsum(rng.exponential(1.0, 50)) if passes else None
    y, end = bank.simulate(voltage, state, time)
    v, after = bank.compensate(y, state, time)
    np.testing.assert_allclose(v, voltage, rtol=0, atol=1e-10 * VOLTS)
    np.testing.assert_allclose(after.plays, end.plays, rtol=0, atol=1e-10 * VOLTS)
    again, _ = bank.simulate(v, state, time)
    np.testing.assert_allclose(again, y, rtol=0, atol=1e-12 * 1e-5)


@given(SEEDS, st.integers(1, 30), st.booleans())
def test_closed_form_and_stepwise_inverse_agree(seed, plays, reached_by_a_history):
    rng = np.random.default_rng(seed)
    thresholds = np.concatenate([[0.0], np.cumsum(rng.uniform(0.1, 4, plays - 1))])
    weights = rng.exponential(1e-8, plays) * (rng.random(plays) > 0.3)
    weights[0] = 2e-8
    bank = PlayBank(thresholds, [()] * plays, list(weights[:, None]), 3e-7)
    state = random_state(bank, seed)
    if reached_by_a_history:
        _, state = bank.simulate(rng.uniform(0, VOLTS, 8), bank.state_after_descent(0.0), None)
    y, _ = bank.simulate(rng.uniform(0, VOLTS, 40), state, None)
    # Curves with a knot that changes no slope have no closed form.
    bent = [[50.0]] * plays, np.repeat(weights[:, None], 2, axis=1), 3e-7 + 50.0 * float(weights.sum())
    walked, after = PlayBank(thresholds, *bent).compensate(y, state, None)
    closed, reached = bank.compensate(y, state, None)
    np.testing.assert_allclose(closed, walked, rtol=0, atol=1e-10 * VOLTS)
    np.testing.assert_allclose(reached.plays, after.plays, rtol=0, atol=1e-10 * VOLTS)
    assert reached.voltage == closed[-1]


@given(SEEDS)
def test_a_bank_wipes_out_its_memory_and_continues_in_parts(seed):
    bank = random_bank(seed, 10, 4, passes=2)
    rng = np.random.default_rng([seed, 4])
    voltage, time = rng.uniform(0, VOLTS, 30), np.cumsum(rng.uniform(0.1, 1, 30))
    state = bank.state_after_descent(0.0)
    whole, end = bank.simulate(voltage, state, time)
    parts = []
    for cut in (slice(0, 0), slice(0, 1), slice(1, 17), slice(17, 30)):
        y, state = bank.simulate(voltage[cut], state, time[cut])
        parts.append(y)
    np.testing.assert_array_equal(np.concatenate(parts), whole)
    np.testing.assert_array_equal(state.plays, end.plays)


def test_a_time_that_begins_again_continues_after_one_interval():
    bank = random_bank(1, 3, 2, passes=2)
    voltage = np.array([10.0, 80, 40])
    _, state = bank.simulate(voltage, bank.state_after_descent(0.0), [5.0, 6, 7])
    anew, _ = bank.simulate(voltage, state, [0.0, 0.5, 2])
    on, _ = bank.simulate(voltage, state, [7.5, 8, 9.5])
    np.testing.assert_allclose(anew, on, rtol=1e-14)


def test_the_state_after_descent_is_that_after_a_long_branch():
    bank = random_bank(2, 8, 3)
    _, down = bank.simulate(np.array([400.0, 60]), bank.state_after_descent(0.0), None)
    np.testing.assert_array_equal(down.plays, bank.state_after_descent(60.0).plays)


def test_an_unreachable_displacement_is_refused():
    bank = PlayBank([0.0], [[0.0, 10.0]], [[0, 1e-7, 0]])
    v, _ = bank.compensate(np.array([0.0, 1e-6, 0.5e-6]), bank.state_after_descent(0.0), None)
    np.testing.assert_allclose(v, [0, 10, 5])
    with pytest.raises(ModelError, match="index 1 is beyond"):
        bank.compensate(np.array([0.0, 1.1e-6]), bank.state_after_descent(0.0), None)


PASSING = PlayBank([0.0, 2], [(), ()], [[1e-7], [1e-7]], 0.0, [1.0], [1e-9])


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: PlayBank([0.0, 1], [()], [[1]]), "need knots and slopes for each threshold"),
        (lambda: PlayBank([0.0], [[1.0]], [[1]]), "one slope more than knots"),
        (lambda: PlayBank([-1.0], [()], [[1]]), "thresholds of 0 or more"),
        (lambda: PlayBank([0.0], [[2.0, 1]], [[1, 1, 1]]), "increasing knots"),
        (lambda: PlayBank([0.0], [()], [[-1]]), "a negative slope or share"),
        (lambda: PlayBank([0.0], [()], [[1]], 0.0, [1.0], [-1.0]), "a negative slope or share"),
        (lambda: PlayBank([0.0], [()], [[1]], 0.0, [0.0], [1.0]), "low-passes: need a time above 0"),
        (lambda: PlayBank([0.0], [()], [[np.nan]]), "slopes of play 1: 1 of 1 values are not finite"),
        (
            lambda: PASSING.simulate(np.zeros(2), PASSING.state_after_descent(0), None),
            "creeps: it needs the time of each sample",
        ),
        (lambda: PASSING.simulate(np.zeros(2), PASSING.state_after_descent(0), [1.0]), "time: got 1 samples, need 2"),
        (
            lambda: PASSING.simulate(np.zeros(2), PASSING.state_after_descent(0), [1.0, 1]),
            "does not increase at sample 1",
        ),
        (lambda: PASSING.simulate(np.zeros(2), PlayState(0.0, [0.0], [0.0]), [1.0, 2]), "got 1 plays and 1 low-passes"),
        (lambda: PASSING.simulate(np.zeros(2), PlayState(0.0, [0.0, 9], [0.0]), [1.0, 2]), "a play lies farther"),
    ],
)
def test_impossible_banks_states_and_times_are_refused(build, message):
    with pytest.raises(ModelError, match=message):
        build()
