"""Records and what moves them: the error of held-out time, states at epochs, and folds."""

from dataclasses import replace

import moving_records as moved
import numpy as np
import plain_records
import pytest
import structured_records as wide

from dehyst.identification import search

STROKE = plain_records.STROKE
STATIC = list(wide.STRUCTURES)


@pytest.mark.parametrize("name", STATIC)
def test_held_out_time_of_a_truth_of_the_class_is_predicted(name):
    made = search.fitted(wide.frame([wide.plant(wide.STRUCTURES[name]).record()]), wide.STRUCTURES[name], 4000)
    assert made.held_out < 1e-6 * STROKE


@pytest.mark.parametrize("name", ["plain", "graded", "smooth", "graded, transformer"])
def test_the_state_at_an_epoch_continues_the_record(name):
    structure = wide.STRUCTURES[name]
    made = search.fitted(wide.frame([wide.plant(structure).record()]), structure, 4000)
    frame, source = made.frame, made.source
    actuator = frame.actuator(made.program, made.found)
    for judged in frame.judged(source):
        offset = made.found.offsets[judged.number] - float(actuator.spring.voltage[0])
        state = frame.state(source, judged.piece, judged.epoch, actuator)
        time, missed = frame.missed(judged.piece, judged.epoch, actuator, state, offset)
        assert time.size == judged.epoch.stop - judged.epoch.start
        assert np.abs(missed).max() < 1e-6 * STROKE


def test_folds_are_sixths_of_the_time_of_each_record():
    made = search.fitted(wide.frame([moved.still(), replace(moved.still(), name="other")]), moved.STRUCTURE, 10**6)
    fold, rows = made.program.fold, made.program.rows
    for q in range(2):
        own = rows.record == q
        record = made.frame.training[q].record
        sixth = 6 * (rows.time[own] - record.time[0]) / np.ptp(record.time)
        for k in range(3):
            expected = ((sixth >= k) & (sixth < k + 1)) | ((sixth >= k + 3) & (sixth < k + 4 + 1e-9 * (k == 2)))
            np.testing.assert_array_equal(fold[own] == k, expected)


def test_times_are_those_of_the_finest_and_the_longest_record():
    records = [plain_records.loops(plain_records.plant(10), plain_records.MAJOR, rate=rate) for rate in (200.0, 50.0)]
    assert wide.frame(records).times == pytest.approx((1 / 200, float(np.ptp(records[1].time))))
