"""A table of two branches: exact on the major loop, its inverse by the wanted direction, and what it refuses."""

import numpy as np
import plain_records
import pytest
from hypothesis import given
from strategies import SEEDS

from dehyst import IdentifyError, ModelError, Record, RecordError
from dehyst.trust.baselines import BranchState, TwoBranches

VOLTS = np.linspace(0, 100, 11)
TABLE = TwoBranches(
    VOLTS, 1e-7 * VOLTS - 1e-8 * VOLTS * (1 - VOLTS / 100), 1e-7 * VOLTS + 1e-8 * VOLTS * (1 - VOLTS / 100)
)


def walk(seed, n=200):
    return np.random.default_rng(seed).uniform(-0.2e-5, 1.2e-5, n)


@given(SEEDS)
def test_simulating_the_compensation_gives_the_path(seed):
    wanted = walk(seed)
    sent = TABLE.compensate(wanted)
    np.testing.assert_allclose(TABLE.simulate(sent.voltage).displacement, wanted, atol=1e-18)
    assert np.all(np.diff(sent.voltage) * np.diff(wanted) > 0)


@given(SEEDS)
def test_the_state_handed_back_carries_on(seed):
    for run in (TABLE.compensate, TABLE.simulate):
        drive = walk(seed) * (1e7 if run == TABLE.simulate else 1)
        whole, first = run(drive), run(drive[:70])
        rest = run(drive[69:], state=first.state)
        assert (rest.state, whole.state) == (whole.state, BranchState(whole.voltage[-1], whole.displacement[-1]))
        for column in ("voltage", "displacement"):
            assert np.array_equal(getattr(rest, column)[1:], getattr(whole, column)[70:])


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
