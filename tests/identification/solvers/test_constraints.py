"""Linear inequalities among the coefficients: in every norm, against solvers and proofs that share nothing with it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import nnls

from dehyst import IdentifyError
from dehyst.identification.solvers.program import NORMS, solve
from examples import at_night, examples


def problem(seed, free=2, positive=7, rows=50, limits=6):
    """A random problem whose inequalities some point keeps and the best point without them does not."""
    rng = np.random.default_rng(seed)
    f, p = rng.normal(size=(rows, free)), rng.normal(size=(rows, positive))
    x = np.maximum(rng.normal(size=positive), 0)
    b = f @ rng.normal(size=free) + p @ x + 0.3 * rng.standard_t(3, rows)
    c = rng.normal(size=(limits, positive))
    inside = x + rng.uniform(0, 1, positive)
    return f, p, b, c, c @ inside - rng.uniform(0, 0.2, limits)


def assert_least_squares(f, p, b, c, low, found, tolerance=1e-7):
    """Karush, Kuhn and Tucker: the gradient is a non-negative combination of the limits that are met (Farkas)."""
    x, a = found.nonnegative, np.hstack([f, p])
    size = max(1.0, np.abs(x).max())
    gradient = a.T @ (a @ np.append(found.free, x) - b)
    met = c[c @ x < low + 1e-7 * size * np.abs(c).max(axis=1)]
    cone = np.vstack([np.eye(x.size)[x < 1e-7 * size], met])
    cone = np.hstack([np.zeros((len(cone), f.shape[1])), cone])
    left = nnls(cone.T, gradient)[1] if len(cone) else np.linalg.norm(gradient)
    assert left <= tolerance * np.abs(a.T @ b).max()


def assert_kept(c, low, found, tolerance=1e-8):
    x = found.nonnegative
    assert np.all(x >= 0)
    assert np.all(c @ x >= low - tolerance * max(1.0, np.abs(x).max()) * np.abs(c).max(axis=1, initial=1.0))


@examples(60, nightly=150)
@given(st.integers(0, 10**6), st.integers(0, 3), st.integers(1, 12), st.integers(0, 25))
def test_the_least_squares_are_proven_by_their_multipliers(seed, free, positive, limits):
    f, p, b, c, low = problem(seed, free, positive, 60, limits)
    found = solve(f, p, b, norm="l2", constraints=(c, low))
    assert found.optimal, found.status
    assert_kept(c, low, found)
    assert_least_squares(f, p, b, c, low, found)


@examples(60, nightly=100)
@given(st.integers(0, 10**6), st.integers(1, 6), st.sampled_from(["column", "limit", "both"]))
def test_dependent_columns_and_repeated_limits_change_nothing(seed, positive, kind):
    f, p, b, c, low = problem(seed, 1, positive)
    best = np.linalg.norm(solve(f, p, b, norm="l2", constraints=(c, low)).residual)
    wide, limits, lows = p, c, low
    if kind in ("column", "both"):
        wide, limits = np.hstack([p, p[:, :1]]), np.hstack([c, c[:, :1]])
    if kind in ("limit", "both"):
        limits, lows = np.vstack([limits, limits]), np.append(lows, lows)
    found = solve(f, wide, b, norm="l2", constraints=(limits, lows))
    assert found.optimal, found.status
    assert_kept(limits, lows, found)
    assert np.linalg.norm(found.residual) == pytest.approx(best, rel=1e-9)


@pytest.mark.parametrize("norm", NORMS)
@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_units_only_scale_the_answer(norm, unit):
    f, p, b, c, low = problem(3)
    one = solve(f, p, b, norm=norm, constraints=(c, low))
    other = solve(f * 7, p * 5 * unit, b, norm=norm, constraints=(c * 3 * unit, low * 3 / 5))
    np.testing.assert_allclose(other.nonnegative * 5 * unit, one.nonnegative, atol=1e-7)
    np.testing.assert_allclose(other.free * 7, one.free, atol=1e-7)


@pytest.mark.parametrize("norm", NORMS)
def test_a_floor_that_is_not_reached_changes_nothing_and_one_that_is_holds(norm):
    f, p, b, _, _ = problem(5)
    free = solve(f, p, b, norm=norm)
    least = float(free.nonnegative.sum())
    ones = np.ones((1, p.shape[1]))
    same = solve(f, p, b, norm=norm, constraints=(ones, np.array([0.9 * least])))
    np.testing.assert_allclose(same.nonnegative, free.nonnegative, atol=1e-8)
    more = solve(f, p, b, norm=norm, constraints=(ones, np.array([2.0 * least])))
    assert more.nonnegative.sum() == pytest.approx(2 * least, rel=1e-9)


@pytest.mark.parametrize("norm", NORMS)
def test_nothing_keeps_contradictory_limits_and_the_answer_says_so(norm):
    f, p, b, _, _ = problem(6, positive=2)
    found = solve(f, p, b, norm=norm, constraints=(np.array([[1.0, 1.0], [-1.0, -1.0]]), np.array([1.0, -0.5])))
    assert not found.optimal
    assert found.status == "no coefficients that are not negative keep the inequalities"


@pytest.mark.slow
@pytest.mark.parametrize("limits", [at_night(0), 300])
def test_hundreds_of_collinear_columns_on_a_hundred_thousand_rows(limits):
    rng = np.random.default_rng(1)
    t = rng.uniform(0, 1, 100_000)
    p = np.clip(t[:, None] - np.linspace(0, 1, 300, endpoint=False), 0, 0.2)
    f = np.ones((t.size, 1))
    x = np.maximum(rng.normal(size=300), 0)
    b = p @ x + 0.1 * rng.normal(size=t.size)
    c = (rng.uniform(size=(limits, 300)) < 0.1).astype(float)
    low = c @ x * rng.uniform(0.8, 1.1, limits)
    found = solve(f, p, b, norm="l2", constraints=(c, low))
    assert found.optimal, found.status
    assert_kept(c, low, found)
    assert_least_squares(f, p, b, c, low, found)
    assert found.gap < 1e-9


def test_refusals():
    f, p, b, c, low = problem(0)
    with pytest.raises(IdentifyError, match=r"shape \(6, 5\)"):
        solve(f, p, b, constraints=(c[:, :5], low))
    with pytest.raises(IdentifyError, match="constraints: got NaN"):
        solve(f, p, b, constraints=(c, np.full(6, -np.inf)))
