"""The carts with which a record begins: found again from voltages, with creep, graded elements and noise."""

import itertools

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dehyst._native import slip_elongations
from dehyst.identification.start_state import fit_start
from dehyst.model import MaxwellSlip

COUNT = 12
RHO = np.arange(1.0, COUNT + 1) * 1e-6
NO_CREEP = np.zeros(0)


def growing(loops=8, largest=12e-6, samples=20):
    branches = [0.0]
    for size in np.linspace(largest / loops, largest, loops):
        branches += [size, -size]
    return np.concatenate([np.linspace(a, b, samples) for a, b in itertools.pairwise(branches)])


def carts_of(u, first):
    return first + np.cumsum(np.diff(RHO, prepend=0.0) * u)


@given(st.lists(st.floats(-1, 1), min_size=COUNT, max_size=COUNT))
def test_the_simulated_force_is_that_of_the_true_carts(u):
    """Some carts bear on no sample: the force is what must come back, and the carts that bear on it."""
    path, slip = growing(), MaxwellSlip(RHO, np.linspace(2e5, 1e5, COUNT))
    true, _ = slip_elongations(RHO, carts_of(np.array(u), path[0]), path)
    force = true @ slip.stiffness + 3.0
    start = fit_start(slip, path, force, np.zeros((path.size, 0)), NO_CREEP)
    found, _ = slip_elongations(RHO, start.carts, path)
    left = force - found @ slip.stiffness - start.constant
    assert np.sqrt(np.mean(left**2)) < 0.01 * np.ptp(force)
    assert np.all(np.abs(start.carts - path[0]) <= RHO * (1 + 1e-9))
