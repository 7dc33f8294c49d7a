"""What is said of an identification: only what is worth a sentence, and what the record can show."""

import re

import numpy as np
import plain_records
import pytest

import dehyst
from dehyst.identification.diagnostics.messages import repaired
from dehyst.records import Record

SAMPLE = 1e-3
PLANT = plain_records.plant(10, seed=4)


def test_a_delay_that_no_record_shows_is_not_worth_a_sentence():
    for delay in (0.0, 1.6e-17, 0.009 * SAMPLE):
        assert repaired([], delay, SAMPLE, given=False) == []
    (sentence,) = repaired([], 0.5 * SAMPLE, SAMPLE, given=False)
    assert sentence.startswith("The displacement lags the voltage by 0.5 ms (0.5 samples, estimated)")


def drifting(turns, share):
    """A record whose sensor drifts evenly by a share of the stroke."""
    made = plain_records.loops(PLANT, turns, name="made")
    drift = share * plain_records.STROKE * np.linspace(0, 1, len(made))
    return Record(made.time, made.voltage, made.displacement + drift, "made")


@pytest.mark.parametrize(
    ("turns", "why"),
    [
        ((*plain_records.MAJOR, 1, 0), "too short a time to determine a rate of creep"),
        (plain_records.DESCENDING_TOPS, "which is more than creep"),
    ],
)
def test_a_drift_that_cannot_be_creep_is_not_called_so(turns, why):
    """Told as a rate, it was 200 % of the range a decade."""
    fit = dehyst.identify(drifting(turns, 0.8), structure="paper", elements=10, delay=0.0, throw=False)
    (said,) = [sentence for sentence in fit.repairs if "set aside" in sentence]
    found = re.fullmatch(rf"made: drifts by (\S+) % of the range over the samples that count, {why}; set aside\.", said)
    assert found
    assert 5 < float(found[1]) < 150
    assert not any("a decade" in check.sentence for check in fit.checks)


def test_a_creep_is_told_as_a_rate():
    made = plain_records.loops(PLANT, plain_records.DESCENDING_TOPS, name="made")
    crept = made.displacement + 0.02 * plain_records.STROKE * np.log10(1 + made.time / 0.1)
    fit = dehyst.identify(Record(made.time, made.voltage, crept, "made"), structure="paper", elements=10, delay=0.0)
    (said,) = [sentence for sentence in fit.repairs if "set aside" in sentence]
    assert re.fullmatch(r"made: creeps by \S+ % of the range a decade of time since its start; set aside\.", said)
