"""The solver of least squares: conditions of an optimum, SciPy's solvers, and programs that are hard."""

from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import LinearConstraint, minimize, nnls

from dehyst import IdentifyError
from dehyst.identification import solver
from dehyst.identification.solver import ActiveSet, NormalEquations
from examples import examples

NONE = np.zeros(0)


class Program(NamedTuple):
    rows: np.ndarray
    target: np.ndarray
    free: int
    matrix: np.ndarray
    lower: np.ndarray

    @property
    def sums(self):
        return NormalEquations.none(self.rows.shape[1], self.free).with_rows(self.rows, self.target).whole

    def least(self, start=None):
        return self.sums.minimum((self.matrix, self.lower), start)

    def objective(self, x):
        return float(np.sum((self.rows @ x - self.target) ** 2))


def random(seed, free=2, bounded=8, limits=0, spread=1.0, rows=60):
    """A random program whose inequalities some point keeps and the best point without them need not."""
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(rows, free + bounded)) * 10.0 ** rng.uniform(-spread, spread, free + bounded)
    x = np.append(rng.normal(size=free), np.maximum(rng.normal(size=bounded), 0))
    matrix = np.hstack([np.zeros((limits, free)), rng.normal(size=(limits, bounded))])
    lower = matrix @ (x + np.append(np.zeros(free), rng.uniform(0, 1, bounded))) - rng.uniform(0, 0.2, limits)
    return Program(a, a @ x + 0.5 * rng.normal(size=rows), free, matrix, lower)


def graded(seed, elements=12, grades=4, limits=0):
    """Elongations of slip elements times hats over a random path: columns that nearly depend on one another."""
    rng = np.random.default_rng(seed)
    path = np.interp(np.linspace(0, 24, 600), np.arange(25), rng.uniform(0, 1, 25))
    columns = [np.ones(600), path]
    for length in 0.5 * np.linspace(0.05, 1, elements) ** 2:
        middle, slip = path[0], []
        for y in path:
            middle = min(max(middle, y - length), y + length)
            slip.append(y - middle)
        columns += [slip * np.clip(1 - np.abs(path * (grades - 1) - grade), 0, 1) for grade in range(grades)]
    rows = np.column_stack(columns)
    x = np.append([0.1, 0.5], np.maximum(rng.normal(size=rows.shape[1] - 2), 0))
    matrix = np.zeros((limits, x.size))
    for row in matrix:
        row[rng.choice(np.arange(2, x.size), 5, replace=False)] = 1.0
    lower = matrix @ x * rng.uniform(0.8, 1.2, limits)
    return Program(rows, rows @ x + 0.01 * rng.normal(size=600), 2, matrix, lower)


PROGRAMS = st.builds(
    random, st.integers(0, 10**9), st.integers(0, 3), st.integers(1, 14), st.integers(0, 12), st.floats(0, 2)
)


def assert_kept(program, x, tolerance=1e-7):
    """Bounds and inequalities hold, as parts of the largest term of each."""
    size = (np.abs(program.matrix) * np.linalg.norm(program.rows, axis=0) ** -1.0).max(axis=1, initial=0.0)
    largest = max(np.abs(x * np.linalg.norm(program.rows, axis=0)).max(), np.linalg.norm(program.target))
    assert np.all(x[program.free :] >= 0)
    assert np.all(program.matrix @ x >= program.lower - tolerance * size * largest)


def assert_least(program, x, tolerance=1e-6):
    """Karush, Kuhn and Tucker: the gradient is a non-negative combination of the limits that are met (Farkas)."""
    assert_kept(program, x)
    length = np.linalg.norm(program.rows, axis=0)
    y, matrix = x * length, program.matrix / length
    matrix = matrix / np.abs(matrix).max(axis=1, initial=0.0, keepdims=True)
    size = max(np.abs(y).max(), 1e-300)
    gradient = program.rows.T @ (program.rows @ x - program.target) / length
    slack = (program.matrix @ x - program.lower) / np.abs(program.matrix / length).max(axis=1, initial=0.0)
    bounds = np.eye(x.size)[(np.arange(x.size) >= program.free) & (y <= 1e-6 * size)]
    cone = np.vstack([bounds, matrix[slack <= 1e-6 * size]])
    left = nnls(cone.T, gradient)[1] if len(cone) else np.linalg.norm(gradient)
    assert left <= tolerance * np.linalg.norm(program.target)


@examples(100, nightly=500)
@given(PROGRAMS | st.builds(graded, st.integers(0, 10**9), limits=st.integers(0, 15)))
def test_the_conditions_of_an_optimum_hold(program):
    assert_least(program, program.least()[0])


@examples(60, nightly=200)
@given(PROGRAMS, st.integers(0, 10**9))
def test_any_start_gives_the_same_answer(program, seed):
    rng = np.random.default_rng(seed)
    x, found = program.least()
    start = ActiveSet(rng.random(x.size) < 0.5, rng.random(program.lower.size) < 0.3)
    scale = np.linalg.norm(program.rows, axis=0)
    size = np.abs(x * scale).max()
    np.testing.assert_allclose(program.least(start)[0] * scale, x * scale, atol=1e-6 * size)
    again, same = program.least(found)
    np.testing.assert_allclose(again * scale, x * scale, atol=1e-6 * size)
    np.testing.assert_array_equal(same.moving, found.moving)
    np.testing.assert_array_equal(same.active, found.active)


@examples(40, nightly=150)
@given(st.integers(0, 10**9), st.integers(1, 6), st.booleans(), st.booleans())
def test_dependent_columns_and_repeated_inequalities_do_not_change_the_prediction(seed, bounded, column, limit):
    program = random(seed, 1, bounded, 5)
    wide = program
    if column:
        wide = wide._replace(
            rows=np.hstack([wide.rows, wide.rows[:, -1:]]), matrix=np.hstack([wide.matrix, wide.matrix[:, -1:]])
        )
    if limit:
        wide = wide._replace(matrix=np.vstack([wide.matrix] * 2), lower=np.append(wide.lower, wide.lower))
    x, y = program.least()[0], wide.least()[0]
    assert_kept(wide, y)
    size = np.linalg.norm(program.target)
    np.testing.assert_allclose(wide.rows @ y, program.rows @ x, atol=1e-6 * size)


@pytest.mark.parametrize("method", ["_exchanged", None])
@pytest.mark.parametrize("limits", [0, 8])
@pytest.mark.parametrize("seed", range(4))
def test_the_fallback_methods_find_the_same_solution(monkeypatch, seed, limits, method):
    program = graded(seed, limits=limits)
    x, _ = program.least()
    if method:
        monkeypatch.setattr(solver, method, lambda *_: None)
    else:
        monkeypatch.setattr(solver, "_RIDGES", (1e-8,))
    other, _ = program.least()
    assert_kept(program, other, 1e-6)
    assert program.objective(other) == pytest.approx(program.objective(x), rel=1e-5)


@pytest.mark.parametrize("free", [0, 2])
def test_contradictory_inequalities_are_refused(free):
    program = random(6, free, 2)
    matrix = np.hstack([np.zeros((2, free)), np.array([[1.0, 1.0], [-1.0, -1.0]])])
    with pytest.raises(IdentifyError):
        program._replace(matrix=matrix, lower=np.array([1.0, -0.5])).least()
    # Below zero alone contradicts the bounds.
    with pytest.raises(IdentifyError):
        program._replace(matrix=matrix[1:], lower=np.array([0.5])).least()


@pytest.mark.parametrize("seed", range(20))
def test_degenerate_programs_end(seed):
    """Integers of a small range: exact ties, dependent columns, repeated and redundant inequalities."""
    rng = np.random.default_rng(seed)
    rows = rng.integers(-1, 2, (12, 16)).astype(float)
    matrix = rng.integers(0, 2, (20, 16)).astype(float)
    matrix[:, :2] = 0.0
    program = Program(rows, rng.integers(-2, 3, 12).astype(float), 2, matrix, np.minimum(1.0, matrix.sum(axis=1)))
    x, _ = program.least()
    assert_kept(program._replace(rows=rows + 1e-9), x, 1e-6)
    bounds = [(None, None)] * 2 + [(0, None)] * 14
    limits = LinearConstraint(matrix, program.lower)
    options = {"ftol": 1e-13, "maxiter": 1000}
    best = minimize(program.objective, np.ones(16), bounds=bounds, constraints=limits, method="SLSQP", options=options)
    assert program.objective(x) <= best.fun + 1e-5


def test_a_column_without_rows_has_the_coefficient_0():
    program = random(2, 1, 5)
    program.rows[20:, 3] = 0.0
    part = NormalEquations.none(program.rows.shape[1], 1).with_rows(program.rows[:20], program.target[:20]).whole
    x, found = (program.sums - part).minimum((np.zeros((0, 6)), NONE))
    assert x[3] == 0
    assert not found.moving[3]
    rest = program._replace(rows=np.delete(program.rows[20:], 3, axis=1), target=program.target[20:])
    expected, _ = rest._replace(matrix=np.zeros((0, 5))).least()
    np.testing.assert_allclose(np.delete(x, 3), expected, rtol=1e-8, atol=1e-12)
