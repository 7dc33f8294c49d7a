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


MOVED = {
    "delay": (lambda: [moved.delayed(3)], {"delay": 3 * moved.STEP}, 1e-8),
    "drift": (lambda: [moved.drifting(0.02)], {"drift": np.array([0.02 * STROKE])}, 1e-8),
    "datum": (lambda: moved.shifted(0.1 * STROKE), {"datum": np.array([0.0, 0.1 * STROKE])}, 1e-8),
    "creep": (
        lambda: [moved.creeping()],
        {"time_constants": moved.CREEP.time_constants, "gains": moved.CREEP.gains, "begun": np.zeros((1, 3))},
        1e-8,
    ),
    "begun": (
        lambda: [moved.creeping((1e-8, 2e-7, -4e-7))],
        {
            "time_constants": moved.CREEP.time_constants,
            "gains": moved.CREEP.gains,
            "begun": moved.CREEP.gains * [[1e-8, 2e-7, -4e-7]],
        },
        1e-8,
    ),
    "thermal": (lambda: [moved.warmed(15, 45)], {"thermal": moved.THERMAL}, 1e-8),
    # The path that drives the elements is read off derivatives of the displacement.
    "inertia": (
        lambda: [moved.swinging()],
        {"mass": moved.DYNAMICS.omega**-2, "damping": 2 * moved.DYNAMICS.damping / moved.DYNAMICS.omega},
        2e-4,
    ),
}


@pytest.mark.parametrize("name", MOVED)
def test_held_out_time_shows_what_moves(name):
    """With the true numbers held-out time is predicted, without them it is not."""
    records, numbers, least = MOVED[name]
    known, unknown = (
        search.fitted(wide.frame(records(), **kw), moved.STRUCTURE, 4000).held_out / STROKE for kw in (numbers, {})
    )
    assert known < least < 0.2 * unknown


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


def test_numbers_that_were_found_move_the_records():
    frame = wide.frame([moved.drifting(0.02)])
    made = search.fitted(frame, moved.STRUCTURE, 4000, ("drift",), 12)
    (before,) = made.frame.before
    expected = np.interp(before.record.time, moved.still().time, moved.still().displacement)
    assert np.ptp(before.record.displacement - expected) < 1e-6 * STROKE
    assert frame.motion.drift[0] == 0


def test_times_are_those_of_the_finest_and_the_longest_record():
    records = [plain_records.loops(plain_records.plant(10), plain_records.MAJOR, rate=rate) for rate in (200.0, 50.0)]
    assert wide.frame(records).times == pytest.approx((1 / 200, float(np.ptp(records[1].time))))
