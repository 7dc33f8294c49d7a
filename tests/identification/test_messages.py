"""What is said of an identification: reasons for care beside the verdict, and only what the record can show."""

import numpy as np
import plain_records
import pytest
from scipy.signal import cont2discrete, lfilter

from dehyst import Actuator, Record, identify
from dehyst.identification import Readiness, RecordErrors
from dehyst.identification.preparation import prepare
from dehyst.model import MaxwellSlip, Spring

STROKE, STEP, LAG = 1e-5, 0.01, 0.08


def records():
    """A plain actuator seen by a sensor of first order, and as it moves."""
    turns = np.random.default_rng(3).uniform(0, 1, 14)
    v = 80 / plain_records.STROKE * plain_records.path([0, 1, 0, 1, 0, *turns, 0])
    ends = np.array([-0.2 * STROKE, 1.5 * STROKE])
    slip = MaxwellSlip(STROKE / 2 * np.array([0.05, 0.2, 0.5, 0.9]), np.array([2e6, 1e6, 8e5, 4e5]))
    y = Actuator(slip, Spring(ends, 7e6 * ends)).simulate(v).displacement
    # Exact for a displacement that is linear between samples.
    num, den, _ = cont2discrete(([1], [LAG, 1]), STEP, "foh")
    seen = y[0] + lfilter(num.ravel(), den, y - y[0])
    return Record(np.arange(y.size) * STEP, v, seen + 1e-9 * np.random.default_rng(4).normal(size=y.size)), y


def test_the_displacement_before_the_filter_of_the_sensor_is_found():
    seen, y = records()
    before = prepare(seen).without_lag(LAG).record
    first = seen.time.size - len(before)
    error = before.displacement - y[first:]
    assert np.sqrt(np.mean(error**2)) < 0.005 * STROKE
    assert np.sqrt(np.mean((seen.displacement - y) ** 2)) > 0.04 * STROKE


def test_the_message_about_a_lag_follows_the_option_lag_of():
    seen, _ = records()
    unknown, none, known = (identify(seen, structure="maxwell_slip", sensor_lag=lag) for lag in (None, 0.0, LAG))
    assert unknown.actuator.delay + unknown.actuator.lag > 0.5 * LAG
    assert unknown.promise.readiness is not Readiness.READY
    assert len(none.promise.reasons) < len(unknown.promise.reasons)
    assert known.actuator.delay + known.actuator.lag < 0.1 * LAG
    assert known.options["sensor_lag"] == known.actuator.identification.sensor_lag == LAG


def test_a_coarse_voltage_keeps_a_model_from_being_ready():
    seen, y = records()
    exact = Record(seen.time, seen.voltage, y)
    coarse = Record(seen.time, np.round(seen.voltage / 0.3) * 0.3, y)
    fine, verdict = (identify(record, structure="maxwell_slip").promise for record in (exact, coarse))
    assert verdict.readiness is not Readiness.READY
    assert len(fine.reasons) < len(verdict.reasons)


@pytest.mark.parametrize(
    ("rate", "decades", "steady", "creeps"),
    [(0.02, 2.0, False, True), (0.3, 2.0, False, False), (0.3, 0.4, False, False), (0.02, 2.0, True, False)],
)
def test_a_drift_too_large_for_creep_is_not_called_creep(rate, decades, steady, creeps):
    """Too large, too short to tell, or straight in time."""
    stroke = plain_records.STROKE
    lengths = dict.fromkeys(
        ("largest", "rms", "largest_with_drift", "rms_with_drift", "offset", "zero", "settled_largest", "settled_rms"),
        0.0,
    )
    errors = RecordErrors(
        "made", "training", 100, 0, **lengths, stroke=stroke, drift=rate * stroke, decades=decades, steady=steady
    )
    assert errors.creeps == creeps
