"""A table of two branches: exact on the major loop, its inverse by the wanted direction, and what it refuses."""

import numpy as np
import plain_records
import pytest

from dehyst import IdentifyError, ModelError, Record, RecordError
from dehyst.trust.baselines import TwoBranches

VOLTS = np.linspace(0, 100, 11)
TABLE = TwoBranches(
    VOLTS, 1e-7 * VOLTS - 1e-8 * VOLTS * (1 - VOLTS / 100), 1e-7 * VOLTS + 1e-8 * VOLTS * (1 - VOLTS / 100)
)


def test_each_direction_has_its_branch_and_between_them_nothing_moves():
    up = TABLE.simulate(VOLTS)
    assert np.array_equal(up.displacement, TABLE.rising)
    down = TABLE.simulate(VOLTS[::-1], state=up.state)
    assert np.array_equal(down.displacement, TABLE.falling[::-1])
    turn = TABLE.simulate([50.0, 49.0, 51.0])
    assert turn.displacement[0] == turn.displacement[1] < turn.displacement[2]


def test_the_major_loop_of_a_record_is_met():
    plant = plain_records.plant()
    record = plain_records.loops(plant, (0, 1, 0, 1, 0))
    table = TwoBranches.fit(record)
    cycle = slice(len(record) // 2, len(record))
    error = table.simulate(record.voltage).displacement - record.displacement
    error -= error[cycle].mean()
    assert np.abs(error[cycle]).max() < 0.01 * plain_records.STROKE
    line = record.displacement - plain_records.STROKE / plain_records.VOLTS * record.voltage
    assert np.ptp(line[cycle]) > 0.05 * plain_records.STROKE


@pytest.mark.parametrize(
    "columns",
    [
        ([0], [0], [0]),
        ([0, 1], [0, 1], [0, 1, 2]),
        ([0, 0], [0, 1], [0, 1]),
        ([0, 1], [1, 0], [1, 2]),
        ([0, 1], [0, 1], [0, 0.5]),
        ([0, 1], [0, np.nan], [0, 1]),
    ],
)
def test_what_is_no_table_is_refused(columns):
    with pytest.raises(ModelError):
        TwoBranches(*columns)


def test_records_without_both_directions_are_refused():
    with pytest.raises(IdentifyError, match="got no records"):
        TwoBranches.fit([])
    u = np.linspace(0, 1, 400)
    with pytest.raises(RecordError):
        TwoBranches.fit(Record(u, 100 * u, 1e-5 * u, "rises"))
