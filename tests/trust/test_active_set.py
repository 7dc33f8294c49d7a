"""The stepwise program: feasible after each step, never worse, and at the minimum that other solvers find."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import LinearConstraint, minimize, nnls

from dehyst.trust.active_set import StepwiseProgram


def program(seed, size, rows):
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(3 * size, size)) * 10 ** rng.uniform(-1, 1, size)
    least, start = np.zeros(size), rng.uniform(0.1, 1.0, size)
    matrix = rng.normal(size=(rows, size))
    return columns, rng.normal(size=3 * size), least, matrix, matrix @ start - rng.uniform(0, 0.2, rows), start


@given(st.integers(0, 10_000), st.integers(1, 20), st.integers(0, 6))
def test_every_step_is_feasible_and_no_worse_and_the_last_is_the_minimum(seed, size, rows):
    columns, target, least, matrix, lower, start = program(seed, size, rows)
    gram, image = columns.T @ columns, columns.T @ target
    made = StepwiseProgram(gram, image, least, matrix, lower, start)
    value = 0.5 * start @ gram @ start - image @ start
    for _ in range(500):
        done = made.step()
        now = 0.5 * made.x @ gram @ made.x - image @ made.x
        assert now <= value + 1e-9 * (1 + abs(value))
        assert np.all(made.x >= 0)
        assert np.all(matrix @ made.x >= lower - 1e-6)
        value = now
        if done:
            break
    assert done
    if rows:
        limits = [LinearConstraint(matrix, lower, np.inf)]
        other = minimize(
            lambda x: 0.5 * x @ gram @ x - image @ x,
            start,
            jac=lambda x: gram @ x - image,
            bounds=[(0, None)] * size,
            constraints=limits,
            method="SLSQP",
            options={"ftol": 1e-14, "maxiter": 500},
        )
        assert value <= other.fun + 1e-6 * (1 + abs(other.fun))
    else:
        best = nnls(columns, target)[0]
        assert np.allclose(made.x, best, rtol=1e-6, atol=1e-8)
