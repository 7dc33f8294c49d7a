"""Virtual records from known actuators, shared by the tests of the identification.

Records are made from displacement to voltage, which is explicit: they are exact to rounding, and the turning points
lie where the test puts them, so that the identified grid and the true one can be the same.
"""

from itertools import pairwise

import numpy as np

from dehyst import Actuator, MaxwellSlip, Record, Spring, State
from dehyst.model import turned

STROKE = 16e-6
VOLTS = 200.0
MAJOR = (1, 0, 1, 0, 1, 0)
THREE_LOOPS = (*MAJOR, 0.3, 0, 0.3, 0, 0.5, 0, 0.5, 0, 0.7, 0, 0.7, 0)
DESCENDING_TOPS = (*MAJOR, 0.9, 0, 0.8, 0, 0.7, 0, 0.6, 0, 0.5, 0, 0.4, 0, 0.3, 0, 0.2, 0, 0.1, 0)
REVERSAL_CURVES = (*MAJOR, 1, 0.9, 1, 0.8, 1, 0.7, 1, 0.6, 1, 0.5, 1, 0.4, 1, 0.3, 1, 0.2, 1, 0.1, 1, 0, 1)


def plant(elements=10, *, seed=0, curved=0.3, share=0.4):
    """An actuator on the uniform grid over STROKE; slip elements hold about `share` of VOLTS on the major loop.

    The last element never slides in a motion over STROKE and has no stiffness: it is not separable from the spring.
    """
    rng = np.random.default_rng(seed)
    rho = STROKE / (2 * elements) * np.arange(1, elements + 1)
    kappa = rng.uniform(0.2, 1.5, elements) * np.exp(-np.arange(elements) / elements)
    kappa[-1] = 0.0 if elements > 1 else kappa[-1]
    kappa *= share * VOLTS / (2 * float(kappa @ rho))
    y = np.linspace(0, STROKE, elements + 1)
    slopes = 1 + curved * np.sin(3 * np.linspace(0, 1, elements)) + curved * 0.3 * rng.uniform(-1, 1, elements)
    rise = np.concatenate([[0.0], np.cumsum(slopes)])
    eta = 0.5 * share * VOLTS + (1 - share) * VOLTS * rise / rise[-1]
    return Actuator(MaxwellSlip(rho, kappa), Spring(y, eta))


def wild_path(seed, size, beyond, corners):
    """Displacement [m] of branches between random corners, up to a share of STROKE beyond it; half are rough."""
    rng = np.random.default_rng(seed)
    count = rng.integers(*corners)
    at = np.sort(rng.choice(np.arange(1, size - 1), count, replace=False))
    y = np.interp(np.arange(size), [0, *at, size], rng.uniform(-beyond, 1 + beyond, count + 2))
    return STROKE * (y + 0.05 * rng.normal(size=size) * rng.integers(0, 2))


def path(turns, samples=100):
    """Displacement [m] through turning points given as fractions of STROKE, half a cosine for each branch."""
    u = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, samples + 1) / samples)
    branches = [a + (b - a) * u for a, b in pairwise(turns)]
    return STROKE * np.concatenate([[float(turns[0])], *branches])


def falling_tops(steps, samples):
    """Voltages [V] (n,): two major loops, then tops that descend to 0 V; all branches have the same duration."""
    lower = [1 - k / steps for k in range(steps)]
    return VOLTS / STROKE * path([0, *([1, 0] * 2), *(v for top in lower for v in (top, 0))], samples)


def any_state(actuator, displacement, seed):
    """Carts at random allowed positions, which need not result from any history."""
    rho = actuator.slip.breakaway
    return State(displacement, displacement + np.random.default_rng(seed).uniform(-rho, rho))


def record(actuator, displacement, *, state=None, rate=200.0, name="made", noise=0.0, seed=0, zero=0.0):
    """The record of a displacement path from `state` (default: after a long rise to the path's start)."""
    start = turned(actuator, float(displacement[0])) if state is None else state
    motion = actuator.compensate(displacement, state=start)
    sensor = displacement - zero + noise * np.random.default_rng(seed).normal(size=displacement.size)
    return Record(np.arange(displacement.size) / rate, motion.voltage, sensor, name)


def loops(actuator, turns, *, samples=100, **options):
    """The record of `path(turns)`."""
    return record(actuator, path(turns, samples), **options)


def driven(actuator, voltage, *, rate=200.0, name="driven", noise=0.0, seed=0, state=None):
    """The record of a voltage [V], as measured in a laboratory."""
    y = actuator.simulate(voltage, state=state).displacement
    y = y + noise * np.random.default_rng(seed).normal(size=y.size)
    return Record(np.arange(y.size) / rate, voltage, y, name)


def stiffness_error(found, true):
    """Largest error of a stiffness, relative to the largest true one."""
    return float(np.abs(found.slip.stiffness - true.slip.stiffness).max() / true.slip.stiffness.max())


def spring_error(found, true):
    """Largest error of the spring's slopes, relative to the largest true one."""
    return float(np.abs(found.spring.slopes - true.spring.slopes).max() / true.spring.slopes.max())


def assert_close(got, expected, allowance):
    """Assert that two arrays have the same shape and differ nowhere by more than a tolerance."""
    assert np.shape(got) == np.shape(expected)
    assert np.abs(np.subtract(got, expected)).max(initial=0.0) <= allowance
