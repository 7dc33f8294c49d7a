"""The convex program against solvers that share nothing with it, and against arithmetic on small cases."""

import numpy as np
import pytest
from scipy.optimize import linprog, lsq_linear

from dehyst import IdentifyError
from dehyst.identification.solvers.highs import minimum
from dehyst.identification.solvers.program import NORMS, solve

CASES = [(seed, free, positive) for seed in range(4) for free, positive in ((1, 5), (3, 8), (0, 6), (4, 0))]


def problem(seed, free, positive, rows=60):
    """A random problem whose best coefficients lie partly on their bound."""
    rng = np.random.default_rng(seed)
    f, p = rng.normal(size=(rows, free)), rng.normal(size=(rows, positive))
    b = f @ rng.normal(size=free) + p @ rng.normal(size=positive) + 0.3 * rng.standard_t(2, rows)
    return f, p, b, rng.uniform(0.1, 1.0, rows)


def value(norm, residual, weights):
    """The objective, weights as the program scales them: relative to the largest."""
    r = np.abs(residual) * weights / weights.max()
    return {"l1": r.sum(), "l2": np.sqrt(r @ r)}[norm]


def reference(norm, f, p, b, weights):
    """The least objective by SciPy: HiGHS on the primal program in epigraph form, or its bounded least squares."""
    a, w = np.hstack([f, p]), weights / weights.max()
    q = a.shape[1]
    low = np.where(np.arange(q) < f.shape[1], -np.inf, 0.0)
    if norm == "l2":
        found = lsq_linear(a * w[:, None], b * w, (low, np.full(q, np.inf)), method="bvls", tol=1e-14, max_iter=1000)
        return np.sqrt(2 * found.cost)
    t = np.diag(1 / w)
    cost = np.concatenate([np.zeros(q), np.ones(t.shape[1])])
    bounds = [(x if np.isfinite(x) else None, None) for x in low] + [(0, None)] * t.shape[1]
    answer = linprog(cost, np.block([[a, -t], [-a, -t]]), np.concatenate([b, -b]), bounds=bounds)
    assert answer.status == 0
    return answer.fun


@pytest.mark.parametrize("norm", NORMS)
@pytest.mark.parametrize(("seed", "free", "positive"), CASES)
def test_agrees_with_another_solver(norm, seed, free, positive):
    f, p, b, w = problem(seed, free, positive)
    found = solve(f, p, b, weights=w, norm=norm)
    assert found.optimal
    assert np.all(found.nonnegative >= 0)
    np.testing.assert_allclose(found.residual, f @ found.free + p @ found.nonnegative - b, atol=1e-12)
    assert value(norm, found.residual, w) == pytest.approx(reference(norm, f, p, b, w), rel=1e-8)
    assert abs(found.gap) < 1e-8


def test_the_l1_fit_of_a_constant_is_the_median_and_the_l2_fit_the_mean():
    b = np.array([1.0, 2.0, 3.5, 10.0, 40.0])
    one, none = np.ones((5, 1)), np.zeros((5, 0))
    assert solve(one, none, b, norm="l1").free[0] == pytest.approx(3.5, rel=1e-12)
    assert solve(one, none, b, norm="l2").free[0] == pytest.approx(11.3, rel=1e-12)


@pytest.mark.parametrize("norm", NORMS)
def test_exact_data_are_met_exactly_whatever_the_units(norm):
    rng = np.random.default_rng(3)
    scale = 10.0 ** rng.uniform(-9, 9, 10)
    x = np.concatenate([rng.normal(size=3), rng.uniform(0.1, 1, 6), [0.0]])
    a = rng.normal(size=(300, 10))
    found = solve(a[:, :3] * scale[:3], a[:, 3:] * scale[3:], a @ x, weights=rng.uniform(0.01, 1, 300), norm=norm)
    got = np.concatenate([found.free, found.nonnegative]) * scale
    np.testing.assert_allclose(got, x, atol=1e-9)
    assert abs(found.gap) < 1e-9


def test_l1_is_not_moved_by_outliers():
    rng = np.random.default_rng(2)
    f, p = np.ones((200, 1)), rng.uniform(0, 1, (200, 3))
    b = 0.5 + p @ [1.0, 2.0, 0.0]
    b[rng.choice(200, 40, replace=False)] += 50.0
    found = solve(f, p, b, norm="l1")
    np.testing.assert_allclose(np.append(found.free, found.nonnegative), [0.5, 1.0, 2.0, 0.0], atol=1e-9)


def test_the_same_question_has_the_same_answer_to_the_bit():
    f, p, b, w = problem(9, 3, 8)
    for norm in NORMS:
        one, two = (solve(f, p, b, weights=w, norm=norm) for _ in range(2))
        assert one.free.tobytes() + one.nonnegative.tobytes() == two.free.tobytes() + two.nonnegative.tobytes()


def test_refusals():
    f, p, b, _ = problem(0, 3, 2)
    with pytest.raises(IdentifyError, match="one of l1, l2"):
        solve(f, p, b, norm="l3")
    for norm in NORMS:
        with pytest.raises(IdentifyError, match="got 2 rows for 5 unknowns"):
            solve(f[:2], p[:2], b[:2], norm=norm)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("solver", ["highs-ds", "highs-ipm"])
def test_multipliers_of_a_linear_program_are_those_of_its_dual(seed, solver):
    rng = np.random.default_rng(seed)
    rows, cost, inside = rng.normal(size=(15, 8)), rng.normal(size=8), rng.uniform(-1, 1, 8)
    bounds, right = (np.full(8, -2.0), np.full(8, 2.0)), rows @ inside + np.append(np.zeros(3), rng.uniform(0, 1, 12))
    found = minimum(cost, bounds, (rows[:3], right[:3]), (rows[3:], right[3:]), solver)
    assert found.optimal, found.status
    np.testing.assert_allclose(rows[:3] @ found.value, right[:3], atol=1e-8)
    assert np.all(rows[3:] @ found.value <= right[3:] + 1e-8)
    assert np.all(found.multipliers[3:] <= 1e-9)
    # What is left of the costs, the bounds hold.
    left = cost - rows.T @ found.multipliers
    dual = right @ found.multipliers + np.where(left > 0, bounds[0], bounds[1]) @ left
    assert dual == pytest.approx(cost @ found.value, rel=1e-8)


def test_a_linear_program_without_an_optimum_says_so():
    none = np.zeros((0, 1)), np.zeros(0)
    nothing = minimum(np.ones(1), (np.zeros(1), np.ones(1)), (np.ones((1, 1)), np.full(1, 3.0)), none)
    assert not nothing.optimal
    assert nothing.status.startswith("HiGHS")
