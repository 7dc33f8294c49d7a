"""What is said of an identification: only what is worth a sentence, and what the record can show."""

import itertools
import re
import shlex

import numpy as np
import plain_records
import pytest
from click.testing import CliRunner

import dehyst
from dehyst.cli import main
from dehyst.identification import RecordErrors
from dehyst.identification.diagnostics import messages
from dehyst.identification.diagnostics.identifiability import Identifiability
from dehyst.identification.diagnostics.messages import repaired
from dehyst.identification.preprocessing.preparation import prepare
from dehyst.records import Record
from dehyst.waveforms import Sampling

SAMPLE = 1e-3
PLANT = plain_records.plant(10, seed=4)


def test_a_delay_that_no_record_shows_is_not_worth_a_sentence():
    for delay in (0.0, 1.6e-17, 0.009 * SAMPLE):
        assert repaired([], delay, SAMPLE, given=False) == []
    (sentence,) = repaired([], 0.5 * SAMPLE, SAMPLE, given=False)
    assert sentence.startswith("The displacement lags the voltage by 0.5 ms (0.5 samples, estimated)")


def drifting(turns, share, shape):
    """A record whose sensor drifts by a share of the stroke."""
    made = plain_records.loops(PLANT, turns, name="made")
    drift = shape(made.time) - shape(made.time[0])
    return Record(made.time, made.voltage, made.displacement + share * plain_records.STROKE * drift / drift[-1], "made")


def set_aside(fit):
    (sentence,) = [sentence for sentence in fit.repairs if "set aside" in sentence]
    return sentence


STEADILY = r"made: drifts steadily by (\S+) % .*temperature.*set aside\."
TOO_SHORT = r"made: drifts by (\S+) % .*too short.*set aside\."


@pytest.mark.parametrize(
    ("turns", "shape", "words"),
    [
        ((*plain_records.MAJOR, 1, 0), lambda time: time, STEADILY),
        (plain_records.DESCENDING_TOPS, lambda time: time, STEADILY),
        ((*plain_records.MAJOR, 1, 0), lambda time: np.log10(1 + time / 0.1), TOO_SHORT),
    ],
)
def test_a_drift_that_cannot_be_creep_is_not_called_so(turns, shape, words):
    """Told as a rate, it was 200 % of the stroke a decade."""
    record = drifting(turns, 0.8, shape)
    fit = dehyst.identify(record, structure="maxwell_slip", elements=10, delay=0.0, throw=False)
    found = re.fullmatch(words, set_aside(fit))
    assert found
    assert 5 < float(found[1]) < 150
    assert not any("a decade" in check.sentence for check in fit.checks)


@pytest.mark.parametrize(
    ("rate", "decades", "steady", "words"),
    [
        (0.02, 2.0, False, r"creeps by 2 % .*a decade"),
        (0.3, 2.0, False, r"drifts by 60 % .*more than creep"),
        (0.3, 0.4, False, r"drifts by 12 % .*too short"),
        (0.02, 2.0, True, r"drifts steadily by 4 % .*sensor"),
    ],
)
def test_a_drift_is_named_by_its_course_and_size(rate, decades, steady, words):
    stroke = plain_records.STROKE
    lengths = dict.fromkeys(("largest", "rms", "largest_with_drift", "rms_with_drift", "offset", "datum"), 0.0)
    errors = RecordErrors(
        "made", "training", 100, 0, **lengths, stroke=stroke, drift=rate * stroke, decades=decades, steady=steady
    )
    (sentence,) = repaired([errors], 0.0, SAMPLE, given=False)
    assert re.match(f"made: {words}", sentence)
    assert errors.creeps == ("creeps" in words)


def test_a_creep_is_told_as_a_rate():
    made = plain_records.loops(PLANT, plain_records.DESCENDING_TOPS, name="made")
    crept = made.displacement + 0.02 * plain_records.STROKE * np.log10(1 + made.time / 0.1)
    fit = dehyst.identify(
        Record(made.time, made.voltage, crept, "made"), structure="maxwell_slip", elements=10, delay=0.0
    )
    said = set_aside(fit)
    assert re.fullmatch(r"made: creeps by \S+ % .*a decade.*set aside\.", said)


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
    drive = messages.drive_like(limits, [prepare(Record(time, volts, 1e-7 * volts))])
    open_ = Identifiability(np.array([1.0, 0.0]))
    remarks = [
        messages.DRIFT_OR_CREEP.format(hold=messages.hold(drive)),
        messages.of_creep_not_tried(0.0, 1.0, drive),
        messages.of_dropped("creep", 1e-9, 2e-9, 1e-6, drive),
        *messages.of_turns(open_, drive),
        *messages.of_one_ended_loops([through(0, 100, 0, 70, 0, 40, 0)], drive),
    ]
    assert len(remarks) == 5
    asked = float(re.search(r"--hold (\S+)", messages.of_creep_not_tried(9.0, 11.0, drive))[1])
    assert asked >= 11.0
    for remark in remarks:
        words = shlex.split(remark[remark.index("dehyst excite") :])
        done = CliRunner().invoke(main, [*words[1:], "--force"])
        assert done.exit_code == 0, done.output
        _, played = np.loadtxt("voltage.csv", delimiter=",", skiprows=1, unpack=True)
        assert played.max() - high <= 1e-5 * (high - low)
        assert low - played.min() <= 1e-5 * (high - low)
        assert np.ptp(played) > 0.99 * (high - low)
