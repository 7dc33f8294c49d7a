"""What is put right before a fit, found where it is and only there: transients, gaps, zeros, drift."""

import numpy as np
import plain_records
import pytest

import dehyst
from dehyst import Record
from dehyst.identification import Structure, cleaning
from dehyst.records import gaps
from examples import at_night

PLANT = plain_records.plant(10)
TEN = Structure(elements=10, knots=11, smoothing=0.0)
TOPS = plain_records.loops(PLANT, plain_records.DESCENDING_TOPS, name="tops")
CLEAN = {
    "tops": TOPS,
    "curves": plain_records.loops(PLANT, plain_records.REVERSAL_CURVES),
    "three loops": plain_records.loops(PLANT, plain_records.THREE_LOOPS),
    "major": plain_records.loops(PLANT, plain_records.MAJOR * 3),
    "few samples": plain_records.loops(PLANT, plain_records.MAJOR * 3, samples=30),
}


def sine(cycles=12, samples=97.3, *, noise=0.0):
    """A steady sine after a long rise; its samples fall elsewhere in every cycle."""
    t = np.arange(int(cycles * samples))
    y = plain_records.STROKE * (0.5 + 0.5 * np.cos(2 * np.pi * t / samples))
    return plain_records.record(PLANT, y, name="sine", noise=noise)


def without(record, start, stop):
    """The record with the samples start..stop-1 missing."""
    keep = np.ones(len(record), dtype=bool)
    keep[start:stop] = False
    return Record(record.time[keep], record.voltage[keep], record.displacement[keep], record.name)


@pytest.mark.parametrize("name", ["three loops", "few samples", *map(at_night, ["tops", "curves", "major"])])
def test_clean_data_are_not_repaired(name):
    assert cleaning.transient(CLEAN[name]) == 0
    fit = dehyst.identify(CLEAN[name], structure=TEN)
    assert [said for said in fit.repairs if "samples a cycle" not in said] == []
    assert fit.actuator.delay == 0
    assert (fit.errors[0].drift, fit.errors[0].zero) == (0, 0)


@pytest.mark.parametrize("sigma", [0.0, 0.003, 0.01])
def test_noise_and_a_steady_sine_have_no_transient(sigma):
    noise = sigma * plain_records.STROKE
    tops = [plain_records.loops(PLANT, plain_records.DESCENDING_TOPS, noise=noise, seed=seed) for seed in range(3)]
    sines = [sine(samples=samples, noise=noise) for samples in (60.7, 97.3, 203.9)]
    assert [cleaning.transient(record) for record in (*tops, *sines)] == [0] * 6


@pytest.mark.parametrize("length", [10, 30, 45])
def test_only_a_start_up_transient_is_left_out(length):
    record = sine()
    y = record.displacement.copy()
    # Upwards: downwards from the upper branch would be into the loop, where nothing can tell.
    y[:length] += 0.1 * plain_records.STROKE
    assert cleaning.transient(Record(record.time, record.voltage, y, "transient")) == length


@pytest.mark.parametrize(
    ("samples", "share", "allowed"), [(np.s_[:40], 0.1, 1e-6), (np.s_[1210:], 0.01, 0.01), (np.s_[1540:], -0.05, 0.01)]
)
def test_a_transient_or_a_jump_of_the_zero_is_repaired_and_reported(samples, share, allowed):
    record = plain_records.loops(PLANT, (*plain_records.MAJOR, *plain_records.DESCENDING_TOPS))
    y = record.displacement.copy()
    y[samples] += share * plain_records.STROKE
    fit = dehyst.identify(Record(record.time, record.voltage, y, "moved"), structure=TEN)
    assert plain_records.stiffness_error(fit.actuator, PLANT) < allowed
    assert len(fit.repairs) == 1 and fit.errors[0].drift == 0
    assert fit.errors[0].samples + fit.errors[0].left_out == len(record)


@pytest.mark.parametrize(("start", "stop"), [(650, 690), (650, 1040), at_night(690, 720), at_night(650, 850)])
def test_a_gap_that_may_hide_a_reversal_cuts_the_record(start, stop):
    fit = dehyst.identify(without(TOPS, start, stop), structure=TEN)
    assert plain_records.stiffness_error(fit.actuator, PLANT) < 1e-6
    assert plain_records.spring_error(fit.actuator, PLANT) < 1e-6
    assert len(fit.repairs) == 1


def test_a_pause_between_two_repetitions_does_not_cut_the_record():
    cycle = plain_records.loops(PLANT, plain_records.MAJOR[:3])
    step = cycle.sample_time
    time = np.concatenate([cycle.time, cycle.time[-1] + 3 * step + cycle.time - cycle.time[0]])
    twice = Record(time, np.tile(cycle.voltage, 2), np.tile(cycle.displacement, 2), "twice")
    assert len(gaps(twice.time)) == 1
    pieces, said = cleaning.split_at_gaps(twice)
    assert ([len(piece) for piece in pieces], said) == ([len(twice)], [])


def test_shared_zero_with_a_shifted_sensor_gives_wrong_stiffnesses():
    three = plain_records.loops(PLANT, plain_records.THREE_LOOPS, name="three", zero=0.1 * plain_records.STROKE)
    fit = dehyst.identify([TOPS, three], structure=TEN, shared_zero=True)
    assert fit.errors[1].zero == 0
    assert plain_records.stiffness_error(fit.actuator, PLANT) > 0.05
    # Quietly: the residual alone would not alarm anybody (theory, section 7).
    assert 0.05 < fit.errors[1].rms_percent < 1


def test_several_shifted_sensor_zeros_are_found():
    shifts = {0.3: 0.1, 0.5: -0.07, 0.7: 0.02}
    records = [plain_records.loops(PLANT, plain_records.MAJOR, name="major")]
    for seed, (top, shift) in enumerate(shifts.items()):
        y = plain_records.path((0.1, top, 0, top, 0, top, 0))
        state = plain_records.any_state(PLANT, float(y[0]), seed)
        records.append(
            plain_records.record(PLANT, y, state=state, name=f"minor {top}", zero=shift * plain_records.STROKE)
        )
    fit = dehyst.identify(records, structure=TEN)
    found = [error.zero / plain_records.STROKE for error in fit.errors[1:]]
    np.testing.assert_allclose(found, list(shifts.values()), atol=3e-3)
    assert plain_records.stiffness_error(fit.actuator, PLANT) < 1e-2


def creeping(part):
    """A sensor that drifts by a part of the stroke a decade of time."""
    drift = part * plain_records.STROKE * np.log10(1 + TOPS.time / (0.1 * cleaning.cycle_time(TOPS)))
    return Record(TOPS.time, TOPS.voltage, TOPS.displacement + drift, "creeping")


@pytest.mark.parametrize("part", [at_night(0.01), -0.02])
def test_a_logarithmic_drift_is_subtracted(part):
    (error,) = dehyst.identify(creeping(part), structure=TEN).errors
    assert error.drift == pytest.approx(part * plain_records.STROKE, rel=0.25)
    assert error.largest_percent < 0.5
    assert error.rms_with_drift > 4 * error.rms


def test_a_section_with_a_slower_rate_is_no_gap():
    time = np.concatenate([np.arange(0, 20, 0.1), 20 + np.arange(0, 10, 0.01)])
    record = Record(time, 50 + 40 * np.sin(time), 1e-6 * np.sin(time), name="two rates")
    pieces, sentences = cleaning.split_at_gaps(record)
    assert (len(pieces), sentences) == (1, [])
