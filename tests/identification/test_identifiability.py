"""The directions that records determine: the theory's table, what the numbers mean, and that noise is no knowledge.

The second way is written out here: stops by clipping, hat functions, projections and ranks of finely sampled records.
"""

from itertools import pairwise

import numpy as np
import plain_records
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dehyst.identification.identifiability import identifiability
from dehyst.identification.structure import Grid
from dehyst.records import Record

PLANT = plain_records.plant()
MAJOR = (1, 0, 1, 0)


def loops(*tops):
    return (*MAJOR, *(turn for top in tops for turn in (top, 0, top, 0)))


# Theory, section 6: turning points as fractions of the range, and how many directions of ten they tell.
TABLE = {
    MAJOR: 5,
    loops(0.3): 6,
    loops(0.5): 7,
    loops(0.7): 8,
    loops(0.3, 0.5): 8,
    loops(0.3, 0.5, 0.7): 9,
    loops(0.6, 0.35): 9,
    (*MAJOR, 0.65, 0.35, 0.65, 0.35, 0.65, 0): 9,
    plain_records.DESCENDING_TOPS: 9,
    plain_records.REVERSAL_CURVES: 9,
}


def grid(elements):
    return plain_records.STROKE / (2 * elements) * np.arange(1, elements + 1)


def straight(turns, samples=100):
    """Displacement [m] through turning points, uniform on each branch."""
    branches = [np.linspace(a, b, samples + 1)[1:] for a, b in pairwise(turns)]
    return plain_records.STROKE * np.concatenate([[float(turns[0])], *branches])


def clipped(y, elements):
    """Elongations over rho (n, N); at first at the top of a long rise."""
    rho, cart = grid(elements), y[0] - grid(elements)
    out = np.empty((y.size, elements))
    for t, place in enumerate(y):
        cart = np.clip(cart, place - rho, place + rho)
        out[t] = (place - cart) / rho
    return out


def hats(y, elements):
    knots = np.linspace(0, plain_records.STROKE, elements + 1)
    return np.column_stack([np.interp(y, knots, direction) for direction in np.eye(elements + 1)])


def without(columns, others):
    """The columns, less what the others can stand for."""
    left, values, _ = np.linalg.svd(others, full_matrices=False)
    basis = left[:, values > 1e-10 * values[0]]
    return columns - basis @ (basis.T @ columns)


def projected(turns, elements=10, *, samples=100):
    """Columns over rho, spring and constant projected out, of the samples that count: n > samples."""
    y = straight(turns, samples)
    # The first descent makes the state known; the sample at its end belongs to it.
    counts = slice(samples + 1, None)
    return without(clipped(y, elements)[counts], hats(y, elements)[counts])


def unseen(turns, elements=10):
    """Changes of the stiffnesses, (p, N), that a finely sampled record without noise does not notice."""
    _, values, vectors = np.linalg.svd(projected(turns, elements))
    return vectors[values < 1e-9] / grid(elements)


def told(records, elements=10, *, movable=None):
    every = np.ones(elements, dtype=bool) if movable is None else movable
    knots = np.linspace(0, plain_records.STROKE, elements + 1)
    return identifiability(records, Grid(grid(elements), knots[[0, -1]], knots, sliding=every))


def told_of(turns, elements=10, **options):
    plant = plain_records.plant(elements)
    return told([plain_records.record(plant, straight(turns))], elements, **options)


@pytest.mark.parametrize("turns", TABLE)
def test_the_determined_directions_are_those_of_the_theory(turns):
    found = told_of(turns)
    assert (found.determined, found.of) == (TABLE[turns], 10)
    assert len(unseen(turns)) == 10 - TABLE[turns]


@st.composite
def turnings(draw):
    """A number of elements, and a major loop with what follows, turning at multiples of twice its spacing."""
    elements = draw(st.integers(1, 14))
    turns = [elements, 0, elements, 0]
    for _ in range(draw(st.integers(0, 8))):
        rising = turns[-1] < turns[-2]
        room = (turns[-1] + 1, elements) if rising else (0, turns[-1] - 1)
        if room[0] > room[1]:
            break
        turns.append(draw(st.integers(*room)))
    return elements, tuple(turn / elements for turn in turns)


@given(turnings())
def test_the_rank_is_that_of_a_finely_sampled_record(drawn):
    elements, turns = drawn
    found = told_of(turns, elements)
    assert found.determined == elements - len(unseen(turns, elements))


@pytest.mark.parametrize("turns", [MAJOR, loops(0.3), (*MAJOR, 0.6, 0.2, 0.9, 0)])
def test_singular_values_are_those_of_the_projected_elongations(turns):
    # The outline has 4 N + 20 samples on each branch.
    left = projected(turns, samples=60)
    expected = np.linalg.svd(left, compute_uv=False) / np.sqrt(len(left))
    assert told_of(turns).values == pytest.approx(expected, rel=1e-9, abs=1e-12)


def test_elements_that_do_not_move_are_left_out():
    movable = np.arange(10) < 6
    found = told_of(MAJOR, movable=movable)
    assert found.of == 6
    assert found.determined == np.linalg.matrix_rank(projected(MAJOR)[:, movable], tol=1e-9) == 5
    nothing = told_of(MAJOR, movable=movable & False)
    assert (nothing.determined, nothing.of) == (0, 0)


def test_records_without_loops_determine_no_direction():
    found = told([plain_records.loops(PLANT, (1, 0))])
    assert (found.determined, found.of) == (0, 10)
    # Beside a record with loops they do no harm.
    both = told([plain_records.loops(PLANT, (1, 0)), plain_records.loops(PLANT, MAJOR)])
    assert both.determined == 5


# A minor loop whose top noise puts elsewhere may really tell more: the table holds for tops on the grid.
NOISES = [*((turns, noise) for turns in TABLE for noise in (0.0, 1e-3)), (MAJOR, 5e-3), (MAJOR * 5, 5e-3)]


@pytest.mark.parametrize(("turns", "noise"), NOISES)
def test_noise_determines_no_direction(turns, noise):
    record = plain_records.loops(PLANT, turns, samples=200, noise=noise * plain_records.STROKE)
    found = told([record], movable=np.arange(10) < 9)
    assert (found.determined, found.of) == (TABLE.get(turns, 5), 9)


def test_drift_determines_no_direction():
    record = plain_records.loops(PLANT, MAJOR * 10)
    drift = 0.015 * plain_records.STROKE * np.linspace(0, 1, len(record))
    assert told([Record(record.time, record.voltage, record.displacement + drift)]).determined == 5


def test_directions_of_separate_records_add_up():
    records = [
        plain_records.loops(PLANT, turns, name=str(turns)) for turns in (MAJOR, (0.3, 0, 0.3, 0), (0.5, 0, 0.5, 0))
    ]
    assert [told(records[:k]).determined for k in (1, 2, 3)] == [5, 6, 8]
    assert told([plain_records.loops(PLANT, (1, 0.99, 1))]).determined == 0
