"""What is said of an identification: only what is worth a sentence, and what the record can show."""

import itertools
import shlex

import numpy as np
import plain_records
import pytest
from click.testing import CliRunner

from dehyst.cli import main
from dehyst.identification import RecordErrors, messages
from dehyst.identification.preparation import prepare
from dehyst.records import Record
from dehyst.waveforms import Sampling


@pytest.mark.parametrize(
    ("rate", "decades", "steady", "creeps"),
    [(0.02, 2.0, False, True), (0.3, 2.0, False, False), (0.3, 0.4, False, False), (0.02, 2.0, True, False)],
)
def test_a_drift_that_cannot_be_creep_is_not_called_so(rate, decades, steady, creeps):
    """Too large, too short to tell, or straight in time."""
    stroke = plain_records.STROKE
    lengths = dict.fromkeys(("largest", "rms", "largest_with_drift", "rms_with_drift", "offset", "datum"), 0.0)
    errors = RecordErrors(
        "made", "training", 100, 0, **lengths, stroke=stroke, drift=rate * stroke, decades=decades, steady=steady
    )
    assert errors.creeps == creeps


def through(*corners):
    return np.concatenate([np.linspace(a, b, 50) for a, b in itertools.pairwise(corners)])


@pytest.mark.parametrize(
    ("corners", "end"),
    [
        ((0, 100, 0, 70, 0, 40, 0), "lowest"),
        ((0, 100, 20, 100, 50, 100, 0), "highest"),
        ((0, 100, 20, 80, 40, 60, 0), None),
        ((0, 100, 0, 100, 0, 100), None),
        ((0, 100, 0), None),
    ],
)
def test_loops_that_turn_at_one_end_are_remarked(corners, end):
    drive = Sampling(frequency=1, limits=(0, 100))
    remarks = messages.of_one_ended_loops([through(*corners)], drive)
    assert [end in remark for remark in remarks] == ([True] if end else [])
    # One record with other loops is enough.
    assert messages.of_one_ended_loops([through(*corners), through(0, 100, 30, 70, 30, 100, 0)], drive) == []


@pytest.mark.parametrize("limits", [(0.0, 100.0), (0.236332, 3.423671), (-30.0, 120.0), (-1e-15, 5.0)])
def test_a_remark_that_asks_for_a_record_has_a_command_that_writes_its_voltage(limits, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    time = 0.005 * np.arange(2000)
    low, high = limits
    volts = low + (high - low) * (0.5 - 0.5 * np.cos(2 * np.pi * time))
    drive = messages.drive_like(limits, [prepare(Record(time, volts, 1e-7 * volts * (1 + 1e-3 * volts)))])
    remarks = messages.of_one_ended_loops([through(0, 100, 0, 70, 0, 40, 0)], drive)
    assert len(remarks) == 1
    for remark in remarks:
        words = shlex.split(remark[remark.index("dehyst excite") :])
        done = CliRunner().invoke(main, [*words[1:], "--force"])
        assert done.exit_code == 0, done.output
        _, played = np.loadtxt("voltage.csv", delimiter=",", skiprows=1, unpack=True)
        assert played.max() - high <= 1e-5 * (high - low)
        assert low - played.min() <= 1e-5 * (high - low)
        assert np.ptp(played) > 0.99 * (high - low)
