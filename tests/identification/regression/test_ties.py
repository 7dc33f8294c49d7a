"""What the constants of epochs owe to one another: true for every actuator that slips, from any carts."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dehyst._native import slip_elongations
from dehyst.identification.preprocessing.regressors import Epoch, NumberedEpoch
from dehyst.identification.regression.coefficients import ties
from dehyst.identification.structure import Grid

RHO = np.array([1.0, 2.0, 4.0, 7.0])
DATUM = np.zeros(3)


def of_range(low, high):
    return Epoch(0, 1, 2, high - low, 0.5 * (low + high), high - low)


def epochs_of(path, grid, stiffness, carts):
    """Ranges, and the constants that the true carts give, wherever the range has just grown and rests."""
    ranges, constants = [], {}
    elongation, _ = slip_elongations(RHO, carts, path)
    for k, stop in enumerate(range(2, path.size + 1, 2)):
        low, high = path[:stop].min(), path[:stop].max()
        one = NumberedEpoch(k, 0, 0, of_range(float(low), float(high)))
        stuck = one.epoch.reach < 2 * RHO
        cart = path[stop - 1] - elongation[stop - 1]
        ranges.append(one)
        constants[k] = float(stiffness @ np.where(stuck, one.epoch.middle - cart, 0.0))
    return ranges, constants


@given(
    st.lists(st.floats(0.01, 3.0), min_size=2, max_size=6),
    st.lists(st.floats(0.0, 5.0), min_size=4, max_size=4),
    st.lists(st.floats(-1, 1), min_size=4, max_size=4),
)
def test_every_actuator_meets_them(growths, stiffness, u):
    ends = np.cumsum(growths)
    path = np.concatenate([[0.0, 0.0], *[[end, -end] for end in ends]])
    carts = np.cumsum(np.diff(RHO, prepend=0.0) * np.array(u))
    grid = Grid.maxwell_slip(RHO, np.array([-20.0, 20.0]), np.ones(4, dtype=bool))
    ranges, constants = epochs_of(np.ascontiguousarray(path), grid, np.array(stiffness), carts)
    rows = ties(grid, ranges, DATUM)
    assert len(rows) == 4 * (len(ranges) - 1)
    for signs, row in rows:
        assert sum(sign * constants[k] for k, sign in signs.items()) + row @ np.array(stiffness) >= -1e-9


def test_constants_that_no_actuator_has_are_refused():
    grid = Grid.maxwell_slip(RHO, np.array([-20.0, 20.0]), np.ones(4, dtype=bool))
    ranges = [NumberedEpoch(0, 0, 0, of_range(-1.0, 1.0)), NumberedEpoch(1, 0, 0, of_range(-1.5, 1.5))]
    far = {0: 100.0, 1: -100.0}
    values = [sum(sign * far[k] for k, sign in signs.items()) + row.sum() for signs, row in ties(grid, ranges, DATUM)]
    assert min(values) < 0


def test_records_and_pieces_have_chains_of_their_own():
    grid = Grid.maxwell_slip(RHO, np.array([-20.0, 20.0]), np.ones(4, dtype=bool))
    other = [NumberedEpoch(k, k, 0, of_range(-1.0, 1.0)) for k in range(3)]
    assert ties(grid, other, DATUM) == []
    pieces = [NumberedEpoch(k, 0, k, of_range(-1.0, 1.0)) for k in range(2)]
    assert len(ties(grid, pieces, DATUM)) == 2
