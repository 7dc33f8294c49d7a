"""Paths that turn at most samples run on the carts in lanes, others on the stack of reversals: one answer."""

import numpy as np
import pytest
from strategies import make_actuator, make_state, span_of, volts_of

from dehyst import Actuator, Creep
from dehyst.model import evaluator_of


def random_path(actuator, seed, n=300):
    random = np.random.default_rng([seed, 9])
    knots = actuator.spring.displacement
    path = random.uniform(knots[0] - 0.1 * span_of(actuator), knots[-1] + 0.1 * span_of(actuator), n)
    path[20:40] = path[20]
    path[100:140] = np.linspace(knots[0], knots[-1], 40)
    return path


@pytest.mark.parametrize("elements", [0, 1, 3, 4, 10, 64, 128, 129])
@pytest.mark.parametrize("knots", [2, 3, 4, 21, 60, 200])
@pytest.mark.parametrize("seed", range(4))
def test_both_evaluators_agree(elements, knots, seed):
    actuator = make_actuator(seed, elements, knots, uniform=seed % 2 == 0, zeros=0.3 * (seed == 3))
    start = make_state(actuator, seed, "arbitrary")
    path = random_path(actuator, seed)
    options = {"state": start, "extrapolate": True}
    voltage, state, *_ = _ran(actuator, "compensate", path, start, stack=True)
    other, other_state, *_ = _ran(actuator, "compensate", path, start, stack=False)
    scale = volts_of(actuator) + np.max(np.abs(voltage))
    np.testing.assert_allclose(voltage, other, rtol=0, atol=1e-12 * scale)
    np.testing.assert_allclose(state.carts, other_state.carts, rtol=0, atol=1e-13 * span_of(actuator))
    back = actuator.simulate(voltage, **options)
    np.testing.assert_allclose(back.displacement, path, rtol=0, atol=3e-11 * (span_of(actuator) + np.ptp(path)))
    np.testing.assert_allclose(back.state.carts, state.carts, rtol=0, atol=3e-11 * (span_of(actuator) + np.ptp(path)))


@pytest.mark.parametrize("seed", range(4))
def test_what_is_not_a_number_moves_nothing(seed):
    actuator = make_actuator(seed, 10, 21)
    start = make_state(actuator, seed, "relaxed")
    path = random_path(actuator, seed)
    voltage, *_ = _ran(actuator, "compensate", path, start, stack=True)
    for function, values in (("compensate", path), ("simulate", voltage)):
        spoiled = np.insert(values, 50, [np.nan, np.inf])
        clean, *_ = _ran(actuator, function, values, start, stack=True)
        found, *_ = _ran(actuator, function, spoiled, start, stack=True)
        np.testing.assert_array_equal(np.delete(found, [50, 51]), clean)


def test_creep_on_a_turning_path():
    plain = make_actuator(5, 10, 21)
    stiffness = volts_of(plain) / span_of(plain) * np.array([0.1, 0.05])
    actuator = Actuator(plain.slip, plain.spring, creep=Creep([1e-2, 1.0], stiffness))
    path = random_path(plain, 5)
    time = 1e-3 * np.arange(path.size)
    voltage = actuator.compensate(path, time=time, extrapolate=True).voltage
    back = actuator.simulate(voltage, time=time, extrapolate=True).displacement
    np.testing.assert_allclose(back, path, rtol=0, atol=1e-11 * span_of(actuator))


def _ran(actuator, function, values, start, *, stack):
    model = evaluator_of(actuator)
    pace = model.step_coefficients(np.array([0, values.size]), np.zeros(1))
    out, reached = getattr(model.core, function)(values, pace, model.core_state(start), stack=stack)
    return out, model.state_of(reached)
