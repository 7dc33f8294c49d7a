"""The verdict: its rules, and that a better model never gets a worse one."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dehyst import Record
from dehyst.identification import Check, Readiness, RecordErrors, Trace, Verdict
from dehyst.identification.checks import RemainingError
from dehyst.identification.comparison import rms_over_travel
from dehyst.identification.expectation import Expectation, HeldOutErrors, expectation, growth, new_branches, validity_of
from dehyst.model import Outcome, Promise

STROKE = 1e-5
ERRORS = RecordErrors("a", "training", 1000, 0, 5e-8, 1e-8, 5e-8, 1e-8, STROKE, 0.0, 0.0, 0.0, 5e-8, 1e-8)


def record(*turns):
    voltage = np.interp(np.arange(100 * (len(turns) - 1) + 1) / 100, np.arange(len(turns)), turns)
    time = 1e-3 * np.arange(voltage.size)
    return Record(time, voltage, 1e-7 * voltage)


TOPS = record(0, 100, 0, 100, 0, 80, 0, 60, 0, 40, 0)


def seen(*errors, held_out=None, noise=0.0, vibration=0.0, records=None, **lags):
    causes = []
    for error in errors:
        shares = min(noise**2 / error.rms**2, 1.0), min(0.5 * vibration**2 / error.rms**2, 1.0)
        causes.append(RemainingError(error.record, error.role, error.rms, shares[0], 0.0, shares[1], 0.0, 5.0))
    records = records or [TOPS] * len(errors)
    traces = [trace(record) for record in records]
    return validity_of(records, errors, causes, traces, held_out or HeldOutErrors(), noise, **lags)


def trace(record, error=0.0):
    return Trace(record.name, "training", record.time, record.voltage, record.displacement, record.displacement - error)


def expected(*errors, checks=(), goal=1.0, outcome=Outcome.IDENTIFIED, caveats=(), noise=0.0, **known):
    validity = seen(*errors, noise=noise, **known)
    return expectation(outcome, errors, checks, validity, noise, goal, caveats)


def test_the_verdict_depends_on_the_error():
    assert expected(ERRORS).readiness is Readiness.READY
    assert expected(replace(ERRORS, rms=6e-8, settled_rms=6e-8)).readiness is Readiness.USABLE
    assert expected(replace(ERRORS, rms=2e-7, settled_rms=2e-7)).readiness is Readiness.NOT_USABLE
    assert expected(replace(ERRORS, rms=6e-8, settled_rms=6e-8), goal=4.8).readiness is Readiness.READY


def test_a_promise_is_at_least_the_error_on_the_records():
    assert expected(replace(ERRORS, settled_largest=3e-7)).largest == 3e-7
    assert expected(replace(ERRORS, settled_largest=3e-7), noise=1e-8).largest == pytest.approx(2.6e-7)


def test_errors_on_validation_records_replace_held_out_errors():
    other = replace(ERRORS, role="validation", rms=5e-8, settled_rms=5e-8)
    found = seen(ERRORS, other, held_out=HeldOutErrors(1.0))
    assert found.rms == 5e-8
    verdict = expected(ERRORS, other, held_out=HeldOutErrors(1.0))
    assert verdict.basis == "validation records"


def test_a_model_that_misses_its_training_records_is_not_usable():
    own, other = replace(ERRORS, settled_largest=6e-7), replace(ERRORS, role="validation")
    validity = seen(own)
    found = expectation(Outcome.INACCURATE, (own, other), (), validity, 0.0, 1.0)
    assert found.readiness is Readiness.NOT_USABLE and found.basis != "validation records"


def test_the_larger_of_held_out_and_record_error_is_used():
    assert seen(ERRORS, held_out=HeldOutErrors(9e-8)).rms == pytest.approx(9e-8)
    assert seen(ERRORS, held_out=HeldOutErrors(1e-9)).rms == ERRORS.rms


def test_fast_branches_count_as_much_as_slow_ones():
    time, voltage = np.append(np.arange(200.0), 200 + 0.1 * np.arange(200)), np.tile(np.r_[0:100, 100:0:-1], 2)
    made = trace(Record(time, voltage, 1e-7 * voltage), np.where(time < 200, 0.0, 1e-8))
    assert rms_over_travel(made) == pytest.approx(1e-8 / 2**0.5, rel=0.01)


def test_disagreement_of_structures_widens_the_promise_at_new_turns():
    agreed, disagreed = (seen(ERRORS, held_out=HeldOutErrors(1e-8, apart)).anywhere for apart in (0.0, 3e-8))
    assert disagreed.largest > 1.2 * agreed.largest
    turns = [0, 100, *np.random.default_rng(0).uniform(0, 100, 60)]
    random = HeldOutErrors(1e-8, 3e-8, new=(0.1, 0.1))
    assert seen(ERRORS, held_out=random, records=[record(*turns)]).anywhere.largest < disagreed.largest


def test_noise_and_vibration_of_the_sensor_are_subtracted():
    loud = replace(ERRORS, rms=5e-8, settled_rms=5e-8)
    assert seen(loud, noise=4e-8).rms == pytest.approx((3e-8**2 + 4e-9**2) ** 0.5, rel=1e-6)
    assert seen(loud, vibration=4e-8 * 2**0.5).rms == pytest.approx(3e-8)
    held = HeldOutErrors(5e-8, noise=3e-8)
    assert seen(loud, noise=5e-8, held_out=held).rms == pytest.approx((16e-16 + 25e-18) ** 0.5)


def test_a_lag_of_unknown_cause_is_stated_separately():
    known, open_ = expected(ERRORS), expected(ERRORS, lag=1e-3, lag_open=True)
    assert known.rms < open_.rms < 2 * known.rms
    assert (open_.promise.delay, known.promise.delay) == (1e-3, 0.0)


def test_new_branches_are_measured_by_the_distance_of_their_turning_points():
    def branches(*turns):
        return np.column_stack([turns[:-1], turns[1:]]).astype(float)

    assert new_branches(branches(0, 100, 0), branches(0, 100, 0)) == (0.0, 0.0)
    # The rise from 0 V passes 50 V; the fall from there begins 50 V below the only one.
    assert new_branches(branches(0, 50, 0), branches(0, 100, 0)) == pytest.approx((0.0, 0.5))
    # From wherever voltages are counted.
    assert new_branches(branches(0, 50, 0) + 70, branches(0, 100, 0) + 70) == pytest.approx((0.0, 0.5))
    # Up to their ends all count: the fall from 100 V is a known one, the rise from 50 V begins 50 V above the only one.
    assert new_branches(branches(50, 100, 0), branches(0, 100, 0)) == pytest.approx((0.5, 0.0))
    # Beyond the others nothing is known.
    assert new_branches(branches(0, 150, 0), branches(0, 100, 0)) == (0.0, 0.0)


@pytest.mark.parametrize(("slow", "fast"), [(1e-8, 1e-8), (1e-8, 8e-8), (4e-8, 1e-8)])
def test_the_growth_of_errors_with_speed_is_measured(slow, fast):
    turns = [0.0, *np.tile([100.0, 0.0], 10)]
    seconds = np.repeat([10.0, 1.0], 10)
    voltage = np.interp(np.arange(2001) / 100, np.arange(21), turns)
    time = np.interp(np.arange(2001) / 100, np.arange(21), np.append(0, np.cumsum(seconds)))
    error = np.where(np.arange(2001) <= 1000, slow, fast) * np.where(np.arange(2001) % 2, 1, -1)
    made = trace(Record(time, voltage, 1e-7 * voltage), error)
    grown, share = growth([made], 100.0)
    assert grown == pytest.approx(max(fast**2 - slow**2, 0) ** 0.5, rel=0.02, abs=1e-12)
    assert share == pytest.approx(grown**2 * 10.08 / (10 * fast**2 + 8 * slow**2), abs=0.05)
    assert growth([replace(made, time=np.arange(2001.0))], 100.0) == (0, 0)


FAILED = Check("Width", Verdict.FAILS, 1.0, 0.1, "%", "too wide")


@pytest.mark.parametrize(
    ("errors", "known"),
    [
        (replace(ERRORS, left_out=200), {}),
        (replace(ERRORS, drift=2e-7), {}),
        (ERRORS, {"checks": [FAILED]}),
        (ERRORS, {"caveats": ["the sensor or the actuator lags"]}),
    ],
)
def test_a_reason_against_a_model_prevents_the_verdict_ready(errors, known):
    found = expected(errors, **known)
    assert found.readiness is Readiness.USABLE
    assert len(found.reasons) == 1


@given(st.floats(1e-9, 1e-6), st.floats(0, 1), st.floats(0, 1e-7))
def test_a_smaller_error_never_gives_a_worse_verdict(largest, share, noise):
    order = [Readiness.READY, Readiness.USABLE, Readiness.NOT_USABLE]
    worse, better = (
        Expectation(
            Promise("", size / 3, size, {"model": size}, np.full(1, size), STROKE, 0.0),
            size / 3,
            noise,
            1.0,
            "training records",
        )
        for size in (largest, share * largest)
    )
    assert order.index(better.readiness) <= order.index(worse.readiness)
