"""Least squares from sums: the answer of the program on rows, from any start, and its optimality conditions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dehyst.identification.solvers.least_squares import ActiveSet, NormalEquations
from dehyst.identification.solvers.program import solve


@st.composite
def programs(draw):
    """Rows, targets, the number of free columns, and inequalities that x = 1 meets."""
    seed, free, bounded, limits = (
        draw(st.integers(0, 2**32 - 1)),
        draw(st.integers(0, 3)),
        *draw(st.tuples(st.integers(1, 12), st.integers(0, 6))),
    )
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(60, free + bounded)) * 10.0 ** rng.uniform(-1, 1, free + bounded)
    matrix = np.hstack([np.zeros((limits, free)), rng.normal(size=(limits, bounded))])
    lower = matrix @ np.ones(free + bounded) - rng.uniform(0, 1, limits)
    target = rows @ rng.normal(size=free + bounded) + rng.normal(size=60)
    start = ActiveSet(rng.random(free + bounded) < 0.5, rng.random(limits) < 0.3) if draw(st.booleans()) else None
    return rows, target, free, (matrix, lower), start


@given(programs())
def test_it_is_the_answer_of_the_program_on_rows(program):
    rows, target, free, (matrix, lower), start = program
    x, _ = NormalEquations.of_rows(rows, target, free).minimum((matrix, lower), start)
    limits = (matrix[:, free:], lower) if lower.size else None
    expected = solve(rows[:, :free], rows[:, free:], target, norm="l2", constraints=limits)
    assert expected.optimal
    objective, least = np.sum((rows @ x - target) ** 2), np.sum(expected.residual**2)
    assert objective == pytest.approx(least, rel=1e-6, abs=1e-9 * float(target @ target))
    assert np.all(x[free:] >= 0)
    assert np.all(matrix @ x >= lower - 1e-6 * (1 + np.abs(x).max()))


@given(programs())
def test_the_active_set_of_an_answer_is_its_own_start(program):
    """From the active set of the answer the answer comes back without an exchange."""
    rows, target, free, inequalities, start = program
    sums = NormalEquations.of_rows(rows, target, free)
    x, active_set = sums.minimum(inequalities, start)
    again, same = sums.minimum(inequalities, active_set)
    np.testing.assert_array_equal(again, x)
    np.testing.assert_array_equal(same.moving, active_set.moving)


def test_sums_of_fewer_rows_are_differences():
    rng = np.random.default_rng(1)
    rows, target = rng.normal(size=(50, 6)), rng.normal(size=50)
    whole, part = (NormalEquations.of_rows(rows[some], target[some], 1) for some in (slice(None), slice(0, 20)))
    none = np.zeros((0, 6)), np.zeros(0)
    left, _ = (whole - part).minimum(none)
    expected = solve(rows[20:, :1], rows[20:, 1:], target[20:], norm="l2")
    np.testing.assert_allclose(left, np.append(expected.free, expected.nonnegative), atol=1e-12)


def test_a_column_without_rows_gets_nothing():
    rows = np.array([[1.0, 0.0, 2.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    x, active_set = NormalEquations.of_rows(rows, np.array([1.0, 2.0, 3.0]), 2).minimum((np.zeros((0, 3)), np.zeros(0)))
    assert x[1] == 0
    assert not active_set.moving[1]
