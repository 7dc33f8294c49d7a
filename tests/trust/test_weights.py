"""Weights: columns times factors are the voltages of the model, whatever its parts."""

import numpy as np
import plain_records
import pytest
import structured_records as wide

from dehyst._native import slip_elongations, smooth_elongations, strains
from dehyst.trust.weights import Weights

PERIOD = 1 / wide.RATE
PLANTS = {name: wide.plant(structure, seed=3).actuator for name, structure in sorted(wide.STRUCTURES.items())}
PLANTS["plain"] = plain_records.plant(10, seed=4)


def tau(actuator, voltage):
    return voltage if actuator.transformer is None else actuator.transformer(voltage)


def memory(actuator, path, start):
    """Carts (n, N), and strains and elongations (n, J + L), along a path (n,) [m] that begins in a state."""
    y = np.concatenate([[start.deformation], path])
    internal = [np.zeros((path.size, 0))]
    if actuator.creep is not None:
        tables = actuator.creep.tables(np.array([0.0, PERIOD]))
        # The start's own sample takes no time; then a period each.
        begun = strains(y[:2], np.array([0, 2]), *actuator.creep.tables(np.array([0.0])), start.creep)[-1:]
        later = strains(path, np.array([0, 1, path.size]), *tables, begun[-1])[1:]
        internal.append(np.vstack([begun, later]))
    if actuator.smooth is not None:
        internal.append(smooth_elongations(actuator.smooth.length, actuator.smooth.closing, y, start.smooth)[1:])
    elongations, _ = slip_elongations(actuator.slip.breakaway, start.carts, y)
    return path[:, None] - elongations[1:], np.hstack(internal)


@pytest.mark.parametrize("name", sorted(PLANTS))
def test_columns_times_factors_are_the_voltages_of_the_model_of_these_factors(name):
    actuator = PLANTS[name]
    weights = Weights.of(actuator)
    y = plain_records.wild_path(5, 120, beyond=0.05, corners=(5, 12))
    start = actuator.model.complete_state(actuator.turned(float(y[0])))
    rng = np.random.default_rng(1)
    nearly = np.where(weights.initial > 0, rng.uniform(0.9, 1.1, weights.initial.size), 0.0)
    for factors in (weights.initial, nearly):
        model = weights.model(factors, 3.5)
        time = PERIOD * np.arange(y.size) if model.needs_time else None
        expected = model.compensate(y, time=time, state=start).voltage
        found = 3.5 + weights.columns(y, *memory(actuator, y, start)) @ factors
        assert np.allclose(found, tau(model, expected), rtol=1e-9, atol=1e-9 * plain_records.VOLTS)


@pytest.mark.parametrize("name", sorted(PLANTS))
def test_the_model_of_the_initial_factors_is_the_model(name):
    actuator = PLANTS[name]
    weights = Weights.of(actuator)
    made = weights.model(weights.initial, float(actuator.spring.voltage[0]))
    assert np.allclose(made.slip.stiffness, actuator.slip.stiffness, rtol=1e-12)
    assert np.allclose(made.spring.voltage, actuator.spring.voltage, rtol=1e-12)
    low, high = weights.constants(weights.initial)
    assert low == pytest.approx(high) == pytest.approx(float(actuator.spring.voltage[0]))
