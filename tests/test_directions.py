"""The directions that records determine do not depend on noise, drift, sampling or how often a loop is repeated."""

import bench
import numpy as np
import pytest

from dehyst.directions import directions
from dehyst.record import Record
from dehyst.regression import Regression
from dehyst.rows import collect

PLANT = bench.plant()
RHO = PLANT.slip.breakaway
MAJOR = (1, 0, 1, 0)
TABLE = {
    MAJOR: 5,
    MAJOR * 5: 5,
    (*MAJOR, 0.3, 0, 0.3, 0): 6,
    (*MAJOR, 0.5, 0, 0.5, 0): 7,
    bench.THREE_LOOPS: 9,
    bench.DESCENDING_TOPS: 9,
    bench.REVERSAL_CURVES: 9,
}


def told(records):
    rows, _ = collect([(0, records[0], np.zeros(len(records[0])))], RHO, [0.0])
    regression = Regression(rows, PLANT.spring.displacement, 1.0, np.arange(RHO.size) < RHO.size - 1, np.zeros(1))
    return directions(records, RHO, regression)


# A minor loop whose top noise puts elsewhere may really tell more: the table holds for tops on the grid.
NOISES = [*((turns, noise) for turns in TABLE for noise in (0.0, 1e-3)), (MAJOR, 5e-3), (MAJOR * 5, 5e-3)]


@pytest.mark.parametrize(("turns", "noise"), NOISES)
def test_noise_is_no_knowledge(turns, noise):
    determined = TABLE[turns]
    record = bench.loops(PLANT, turns, samples=200, noise=noise * bench.STROKE)
    assert told([record]) == (determined, 9)


def test_drift_is_no_knowledge():
    record = bench.loops(PLANT, MAJOR * 10)
    drift = 0.015 * bench.STROKE * np.linspace(0, 1, len(record))
    assert told([Record(record.time, record.voltage, record.displacement + drift)]) == (5, 9)


def test_separate_records_add_up():
    records = [bench.loops(PLANT, turns, name=str(turns)) for turns in (MAJOR, (0.3, 0, 0.3, 0), (0.5, 0, 0.5, 0))]
    assert [told(records[:k])[0] for k in (1, 2, 3)] == [5, 6, 8]
    assert told([bench.loops(PLANT, (1, 0.99, 1))]) == (0, 9)
