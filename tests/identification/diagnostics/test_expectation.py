"""The verdict: its rules, and that a better model never gets a worse one."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dehyst.identification import Check, Outcome, Readiness, RecordErrors, Verdict
from dehyst.identification.expectation import Expectation, HeldOutErrors, expectation
from dehyst.identification.results import RemainingError

STROKE = 1e-5
ERRORS = RecordErrors("a", "training", 1000, 0, 5e-8, 1e-8, 5e-8, 1e-8, STROKE, 0.0, 0.0, 0.0)


def expected(*errors, held_out=None, checks=(), goal=1.0, noise=0.0, vibration=0.0, outcome=Outcome.WIDER, caveats=()):
    causes = []
    for one in errors:
        shares = min(noise**2 / one.rms**2, 1.0), min(0.5 * vibration**2 / one.rms**2, 1.0)
        causes.append(RemainingError(one.record, one.role, one.rms, shares[0], 0.0, shares[1], 0.0, 5.0))
    return expectation(outcome, errors, checks, held_out or HeldOutErrors(), causes, noise, goal, caveats)


def test_small_errors_are_ready_and_large_ones_of_no_use():
    assert expected(ERRORS).readiness is Readiness.READY
    assert expected(replace(ERRORS, largest=3e-7)).readiness is Readiness.USABLE
    assert expected(replace(ERRORS, largest=6e-7)).readiness is Readiness.NOT_USABLE
    assert expected(replace(ERRORS, largest=3e-7), goal=4.0).readiness is Readiness.READY


def test_the_sensor_s_peaks_are_not_the_model_s():
    noisy = replace(ERRORS, largest=2e-7)
    assert expected(noisy).readiness is Readiness.USABLE
    assert expected(noisy, noise=3e-8).readiness is Readiness.READY


def test_validation_records_are_what_counts():
    other = replace(ERRORS, role="validation", rms=5e-8, largest=9e-8)
    found = expected(ERRORS, other, held_out=HeldOutErrors(1.0, 1.0))
    assert (found.rms, found.basis) == (5e-8, "validation records")
    assert "5.0 times" in found.sentence
    # A path may have loops that neither have.
    assert expected(ERRORS, other, held_out=HeldOutErrors(1.0, 1.0, 1e-7)).rms == pytest.approx(1.25e-14**0.5)


def test_a_model_that_misses_its_own_records_is_of_no_use_whatever_it_makes_of_others():
    own, other = replace(ERRORS, largest=6e-7), replace(ERRORS, role="validation")
    found = expected(own, other, outcome=Outcome.INACCURATE)
    assert (found.readiness, found.basis) == (Readiness.NOT_USABLE, "training records")


def test_held_out_parts_count_where_they_are_worse():
    assert expected(ERRORS, held_out=HeldOutErrors(9e-8)).rms == pytest.approx(9e-8)
    assert expected(ERRORS, held_out=HeldOutErrors(9e-8)).largest == pytest.approx(2.7e-7)
    assert expected(ERRORS, held_out=HeldOutErrors(1e-9)).rms == ERRORS.rms
    sizes = expected(ERRORS, held_out=HeldOutErrors(2e-8, 9e-8))
    assert (sizes.rms, sizes.basis) == (pytest.approx(9e-8), "loops of sizes held out")


def test_other_structures_that_disagree_add_to_the_error():
    assert expected(ERRORS, held_out=HeldOutErrors(4e-8, 0.0, 3e-8)).rms == pytest.approx(5e-8)


def test_what_the_sensor_adds_is_not_of_the_path():
    seen = replace(ERRORS, rms=5e-8, largest=2e-7)
    found = expected(seen, noise=4e-8)
    assert found.rms == pytest.approx((3e-8**2 + 4e-9**2) ** 0.5, rel=1e-6)
    assert found.measured == seen.rms
    shaken = expected(seen, vibration=4e-8 * 2**0.5)
    assert shaken.rms == pytest.approx(3e-8)
    assert shaken.largest == pytest.approx(2e-7 - 4e-8 * 2**0.5)
    found = expected(seen, held_out=HeldOutErrors(5e-8, noise=3e-8), noise=5e-8)
    assert found.rms == pytest.approx((16e-16 + 25e-18) ** 0.5)


def test_a_doubt_keeps_a_model_from_being_ready():
    found = expected(ERRORS, caveats=["the sensor or the actuator lags"])
    assert found.readiness is Readiness.USABLE
    assert "The sensor or the actuator lags" in found.sentence


@pytest.mark.parametrize(
    ("errors", "words"),
    [
        (replace(ERRORS, left_out=200), "17 % of the samples were set aside"),
        (replace(ERRORS, drift=2e-7), "drift of 2 % was removed"),
    ],
)
def test_what_speaks_against_a_model_is_said(errors, words):
    found = expected(errors)
    assert found.readiness is Readiness.USABLE
    assert words in found.sentence


def test_a_failed_check_is_a_reason():
    check = Check("Width", Verdict.FAILS, 1.0, 0.1, "%", "too wide")
    assert "Width" in expected(ERRORS, checks=[check]).reasons[0]


@given(st.floats(1e-9, 1e-6), st.floats(0, 1), st.floats(0, 1e-7))
def test_a_smaller_error_is_never_judged_worse(largest, share, noise):
    order = [Readiness.READY, Readiness.USABLE, Readiness.NOT_USABLE]
    worse, better = (
        Expectation(size / 3, size, size / 3, noise, STROKE, 1.0, "training records")
        for size in (largest, share * largest)
    )
    assert order.index(better.readiness) <= order.index(worse.readiness)
