"""Smooth elements: the core's own mathematics, the laws of Dahl and of Bouc and Wen, and actuators that have them."""

import math

import compiled_exports
import numpy as np
import plain_records
import pytest
import reference_model
import strategies as our
from hypothesis import given
from hypothesis import strategies as st

from dehyst import Actuator, MaxwellSlip, Spring, State
from dehyst.model import SmoothSlip, turned

EXACT = 1e-12
SLIP, SPRING = MaxwellSlip([1e-6, 2e-6], [1e6, 2e6]), Spring([0, 4e-6, 1e-5], [0, 30, 100])
SMOOTH = SmoothSlip([1e-6, 3e-6], [1, 0.7], [4e6, 2e6])
ACTUATOR = Actuator(SLIP, SPRING, smooth=SMOOTH)


MATHEMATICS = r"""
#include <stdio.h>
#include "dehyst.c"
int main(void)
{
    double x;
    while (scanf("%la", &x) == 1)
        printf("%a %a\n", (double)dehyst_decay((dehyst_real)x), (double)dehyst_log1p((dehyst_real)(x < 1 ? x : 1)));
    return 0;
}
"""


def mathematics(folder, number, x):
    """Return decay(x) and log1p(min(x, 1)) of the exported core."""
    compiled_exports.need("gcc")
    compiled_exports.written(folder, compiled_exports.plain(), number)
    (folder / "mathematics.c").write_text(MATHEMATICS)
    compiled_exports.must_run(["gcc", *compiled_exports.STRICT, "-O2", "mathematics.c", "-o", "mathematics"], folder)
    text = "\n".join(float(number).hex() for number in x)
    words = compiled_exports.must_run(["./mathematics"], folder, input=text).split()
    return np.array([float.fromhex(word) for word in words]).reshape(-1, 2).T


@pytest.mark.parametrize(("number", "kind", "ulps"), [("double", np.float64, 2), ("float", np.float32, 3)])
def test_exponential_and_logarithm_are_accurate(tmp_path, number, kind, ulps):
    """Within few units in the last place of Python's, from the smallest numbers to where nothing is left."""
    x = np.unique(np.concatenate([np.geomspace(1e-30, 60, 2001), np.linspace(0, 45, 2001)]).astype(kind))
    # About half-way between multiples of ln 2, and where the logarithm changes its form, the reduction is tightest.
    ties = (np.arange(60)[:, None] + 0.5) * math.log(2) * (1 + 1e-15 * np.arange(-4, 5))
    x = np.concatenate([x, ties.ravel().astype(kind), 0.4142 + 1e-6 * np.arange(-5, 6), [0.0, 1.0]]).astype(kind)
    decay, logarithm = mathematics(tmp_path / "c", number, x)
    for found, exact in ((decay, lambda v: -math.expm1(-v)), (logarithm, lambda v: math.log1p(min(v, 1.0)))):
        expected = np.array([exact(float(v)) for v in x])
        assert np.all(np.abs(found - expected) <= ulps * np.spacing(expected.astype(kind)))


@given(our.SEEDS, st.integers(1, 5), st.integers(0, 60), st.sampled_from([1e-3, 0.1, 1, 30]))
def test_elongations_agree_with_the_oracle(seed, count, samples, reach):
    rng, smooth = np.random.default_rng(seed), our.make_smooth(seed, 1.0, 1.0, count)
    path = reach * rng.normal(size=samples).round(rng.integers(0, 4))
    steps, q, expected = np.diff(path, prepend=path[:1]), np.zeros(count), []
    for step in steps:
        q = reference_model.smooth_step(smooth.length, smooth.closing, q, step)
        expected.append(q)
    got = smooth.elongations(path)
    assert got.shape == (samples, count)
    plain_records.assert_close(got / smooth.length, np.reshape(expected, (samples, count)) / smooth.length, 1e-13)


@pytest.mark.parametrize("closing", [0.5, 0.6, 0.99, 1.0])
def test_elongations_agree_with_an_ode_solver(closing):
    from scipy.integrate import solve_ivp

    smooth, path, q = SmoothSlip([0.7], [closing], [1.0]), np.array([0, 1.3, -0.2, 0.5, -2.0, 3.0, 2.9]), 0.0
    for a, b, got in zip(path[:-1], path[1:], smooth.elongations(path)[1:, 0], strict=True):
        way = np.sign(b - a)

        def slope(_, q, way=way):
            return 1 - np.abs(q / 0.7) * (closing * np.sign(q * way) + 1 - closing)

        q = solve_ivp(slope, (a, b), [q], method="DOP853", rtol=1e-11, atol=1e-13, max_step=1e-2).y[0, -1]
        assert abs(got - q) < 1e-7 * 0.7  # the right-hand side has a corner that the solver steps over


@pytest.mark.parametrize("seed", range(60))
def test_elongations_satisfy_the_equation_to_rounding(seed):
    """Wherever knots crowd and whatever slopes meet: no more is left than one rounding of what is held there."""
    rng = np.random.default_rng(seed)
    n, count, m = rng.integers(0, 6), rng.integers(1, 5), rng.integers(2, 40)
    gaps, slopes = 10 ** rng.uniform(-6, 0, m - 1), 10 ** rng.uniform(-3, 3, m - 1)
    spring = Spring(np.cumsum([0, *gaps]), np.cumsum([0, *(gaps * slopes)]))
    span = spring.displacement[-1]
    slip = MaxwellSlip(np.sort(span * rng.uniform(0.01, 1, n)), 10 ** rng.uniform(-3, 3, n))
    smooth = SmoothSlip(
        span * 10 ** rng.uniform(-4, 1, count), rng.uniform(0.5, 1, count), 10 ** rng.uniform(-3, 6, count)
    )
    actuator = Actuator(slip, spring, smooth=smooth)
    ends = [actuator.voltage(turned(actuator, end, rising=end > 0)) for end in (0.0, span)]
    v = ends[0] + (ends[1] - ends[0]) * rng.uniform(-0.3, 1.3, 60)
    y = actuator.simulate(v, extrapolate=True).displacement
    slope = slip.stiffness.sum() + spring.slopes.max() + 2 * smooth.stiffness.sum()
    held = np.ptp(spring.voltage) + 2 * slip.friction.sum() + 2 * smooth.stiffness @ smooth.length
    rounding = np.spacing(np.abs(y)) * slope + np.spacing(np.abs(v)) + np.finfo(float).eps * held
    assert np.all(np.abs(actuator.compensate(y, extrapolate=True).voltage - v) <= 2 * rounding)


def test_a_long_motion_gives_the_largest_elongation():
    far = ACTUATOR.compensate([1.0, -1.0, 5e-6], extrapolate=True).state
    top = turned(ACTUATOR, 5e-6)
    plain_records.assert_close(far.smooth, top.smooth, 0.0)
    plain_records.assert_close(far.carts, top.carts, 1e-18)
    assert np.array_equal(turned(ACTUATOR, 0, rising=False).smooth, -SMOOTH.length)
    assert ACTUATOR.state.smooth.tolist() == SMOOTH.length.tolist()
    slipping = SLIP.friction.sum() + SMOOTH.stiffness @ SMOOTH.length
    assert ACTUATOR.voltage(top) == pytest.approx(float(SPRING(5e-6)) + slipping, rel=1e-14)
    # A state with a rounding error is accepted.
    long = State(0, [0, 0], smooth=SMOOTH.length * (1 + 1e-12))
    assert ACTUATOR.compensate([0.0], state=long).state.smooth.tolist() == SMOOTH.length.tolist()
