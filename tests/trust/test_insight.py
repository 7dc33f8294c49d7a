"""What `insight` says holds: directions are counted, and a trap is caught."""

import numpy as np
import plain_records
import pytest

from dehyst import Record
from dehyst.identification.identifiability import identifiability
from dehyst.identification.structure import Grid
from dehyst.waveforms import Sampling, raised_cosine

PLANT = plain_records.plant(10, seed=2)
MAJOR = (1, 0, 1, 0)
TABLE = [
    (MAJOR, 5),
    ((*MAJOR, 0.3, 0, 0.3, 0), 6),
    ((*MAJOR, 0.5, 0, 0.5, 0), 7),
    ((*MAJOR, 0.7, 0, 0.7, 0), 8),
    ((*MAJOR, 0.3, 0, 0.3, 0, 0.5, 0, 0.5, 0), 8),
    (plain_records.THREE_LOOPS, 9),
    ((1, 0, 1, 0, 0.6, 0, 0.6, 0, 0.35, 0, 0.35, 0), 9),
    ((*MAJOR, 0.65, 0.35, 0.65, 0.35), 9),
    (plain_records.DESCENDING_TOPS, 9),
    (plain_records.REVERSAL_CURVES, 9),
]


def told(turns, plant=PLANT):
    record, rho = plain_records.loops(plant, turns), plant.slip.breakaway
    grid = Grid.maxwell_slip(rho, plant.spring.displacement, np.ones(rho.size, dtype=bool))
    return identifiability([record], grid)


@pytest.mark.parametrize(("turns", "determined"), TABLE)
def test_the_table_of_identifiability_to_the_digit(turns, determined):
    found = told(turns)
    assert (found.determined, found.of) == (determined, 10)
    # Between what is known and what is not lie twelve decades, not a matter of taste.
    assert found.values[determined] < 1e-12 * found.values[determined - 1]


@pytest.mark.parametrize("elements", [2, 3, 7, 10, 20])
def test_the_major_loop_tells_half_of_the_directions(elements):
    assert told(MAJOR, plain_records.plant(elements)).determined == elements // 2


def trapped(truth, cycles):
    drive = Sampling(sample_rate=4.0)
    made = raised_cosine([truth.highest], cycles=cycles, drive=drive)
    return Record(made.time, made.voltage, truth.play(made.voltage), "major")
