"""Weights: columns times factors are the voltages of the model, whatever its parts."""

import numpy as np
import plain_records
import pytest
import structured_records as wide

from dehyst.adaptation.weights import Tracker, Weights

PERIOD = 1 / wide.RATE
PLANTS = {name: wide.plant(structure, seed=3).actuator for name, structure in sorted(wide.STRUCTURES.items())}
PLANTS["plain"] = plain_records.plant(10, seed=4)


def tau(actuator, voltage):
    return voltage if actuator.transformer is None else actuator.transformer(voltage)


@pytest.mark.parametrize("name", sorted(PLANTS))
@pytest.mark.parametrize("groups", [{}, {"elements": 3, "grades": 2, "segments": 4}])
def test_columns_times_factors_are_the_voltages_of_the_model_of_these_factors(name, groups):
    actuator = PLANTS[name]
    weights = Weights.of(actuator, **groups)
    y = plain_records.wild_path(5, 120, beyond=0.05, corners=(5, 12))
    start = actuator.model.complete_state(actuator.turned(float(y[0])))
    rng = np.random.default_rng(1)
    nearly = np.where(weights.initial > 0, rng.uniform(0.9, 1.1, weights.initial.size), 0.0)
    for factors in (weights.initial, nearly):
        model = weights.model(factors, 3.5)
        time = PERIOD * np.arange(y.size) if model.needs_time else None
        # The start's own sample takes no time; then a period each.
        expected = model.compensate(y, time=time, state=start).voltage
        tracker = Tracker(weights, start)
        carts, internal = tracker.follow(y, PERIOD)
        found = 3.5 + weights.columns(y, carts, internal) @ factors
        if actuator.creep is None:
            assert np.allclose(found, tau(model, expected), rtol=1e-9, atol=1e-9 * plain_records.VOLTS)
        else:
            carts, internal = Tracker(weights, start).follow(y[:1], 0.0)
            begun = Tracker(weights, start)
            begun.follow(y[:1], 0.0)
            carts, internal = begun.follow(y[1:], PERIOD)
            found = 3.5 + weights.columns(y[1:], carts, internal) @ factors
            assert np.allclose(found, tau(model, expected[1:]), rtol=1e-9, atol=1e-9 * plain_records.VOLTS)


@pytest.mark.parametrize("name", sorted(PLANTS))
def test_the_model_of_the_initial_factors_is_the_model(name):
    actuator = PLANTS[name]
    weights = Weights.of(actuator)
    made = weights.model(weights.initial, float(actuator.spring.voltage[0]))
    assert np.allclose(made.slip.stiffness, actuator.slip.stiffness, rtol=1e-12)
    assert np.allclose(made.spring.voltage, actuator.spring.voltage, rtol=1e-12)
    low, high = weights.constants(weights.initial)
    assert low == pytest.approx(high) == pytest.approx(float(actuator.spring.voltage[0]))
    assert weights.ratios(weights.initial) == pytest.approx((1.0, 1.0))


def test_followed_in_parts_it_is_the_same_memory():
    actuator = PLANTS["plain"]
    weights = Weights.of(actuator)
    y = plain_records.wild_path(2, 90, beyond=0.0, corners=(4, 9))
    whole, parts = (Tracker(weights, actuator.turned(float(y[0]))) for _ in range(2))
    carts, _ = whole.follow(y, None)
    halves = np.vstack([parts.follow(part, None)[0] for part in (y[:40], y[40:])])
    assert np.array_equal(carts, halves)
    assert np.array_equal(whole.state.carts, parts.state.carts)
