"""Residuals: patterns that are put into them are found, noise alone is not, and each cause has its share."""

import numpy as np
import plain_records
import pytest
import structured_records

from dehyst import identify
from dehyst.identification import Structure, Trace, Verdict
from dehyst.identification.checks import remaining_error, residual_checks

STROKE = plain_records.STROKE
PLANT = structured_records.plant(structured_records.STRUCTURES["graded, transformer"])
PATTERNS = "Width", "Middle line", "No drift"


def checks_of(pattern, noise=0.05, seed=0, role="training"):
    """Checks by name of twenty cycles whose residual [% of the stroke] is a pattern of place, direction and time."""
    time = np.arange(8000) / 100
    phase = time / 4
    place, up = 0.5 - 0.5 * np.cos(2 * np.pi * phase), np.sin(2 * np.pi * phase) > 0
    made = np.broadcast_to(pattern(place, np.where(up, 1.0, -1.0), time), time.shape)
    # A fit leaves no constant.
    residual = made - made.mean() + noise * np.random.default_rng(seed).normal(size=time.size)
    right = Trace("right", "training", time, 200 * place, STROKE * place, STROKE * place)
    trace = Trace("made", role, time, 200 * place, STROKE * (place + residual / 100), STROKE * place)
    traces = [trace] if role == "training" else [right, trace]
    return {check.name: check for check in residual_checks(traces, STROKE)}


def test_checks_hold_with_noise_alone():
    failed = 0
    for seed in range(40):
        checks = checks_of(lambda *_: 0.0, noise=5.0, seed=seed)
        failed += sum(checks[name].verdict is Verdict.FAILS for name in PATTERNS)
    # Each fails by chance in 5 of 100 at most.
    assert failed <= 0.05 * 3 * 40 + 2 * np.sqrt(0.05 * 3 * 40)


@pytest.mark.parametrize(
    ("pattern", "name", "value"),
    [
        (lambda place, side, time: 0.6 * side, "Width", 0.6),
        (lambda place, side, time: 0.8 * (place > 0.917), "Middle line", 0.65),
        (lambda place, side, time: 0.5 * np.log10(time.clip(0.01)), "No drift", 0.5),
    ],
)
def test_a_pattern_fails_its_own_check(pattern, name, value):
    checks = checks_of(pattern)
    assert tuple(checks) == PATTERNS
    assert checks[name].verdict is Verdict.FAILS
    assert checks[name].value == pytest.approx(value, rel=0.1)
    assert checks[name].floor < 0.2 * value
    assert all(checks[other].value < 0.3 * value for other in PATTERNS if other != name)


def test_a_small_pattern_passes_whatever_the_noise():
    checks = checks_of(lambda place, side, time: 0.09 * side, noise=0.001)
    assert checks["Width"].verdict is Verdict.HOLDS
    assert checks["Width"].value > checks["Width"].floor


def test_a_drift_too_large_for_creep_is_stated_as_a_whole():
    checks = checks_of(lambda place, side, time: 30 * np.log10(time.clip(0.01)))
    assert checks["No drift"].unit == "% of the stroke"
    assert checks["No drift"].value > 30


def test_residuals_of_validation_records_do_not_count():
    checks = checks_of(lambda place, side, time: 0.6 * side, role="validation")
    assert all(checks[name].verdict is Verdict.HOLDS for name in PATTERNS)


@pytest.mark.parametrize("turns", [(0, 1), (0, 1, 0)])
def test_too_few_branches_leave_a_check_unknown(turns):
    place = plain_records.path(turns)
    trace = Trace("short", "training", np.arange(place.size) * 0.01, 12e6 * place, place, place)
    checks = {check.name: check for check in residual_checks([trace], STROKE)}
    assert checks["No drift"].verdict is Verdict.UNKNOWN and checks["No drift"].value is None
    assert (checks["Width"].verdict is Verdict.UNKNOWN) == (turns == (0, 1))


def test_only_a_wrong_model_fails_a_check():
    record = PLANT.record(noise=1e-9)
    right, poor = (
        identify(record, structure=made, delay=0.0)
        for made in (Structure(elements=6, grades=3, knots=7, transformer=5), Structure(elements=6, grades=2, knots=2))
    )
    assert all(check.verdict is Verdict.HOLDS for check in right.checks)
    assert Verdict.FAILS in [check.verdict for check in poor.checks if check.name in PATTERNS]


TIME = np.arange(4000) * 0.01
VOLTAGE = 50 - 50 * np.cos(2 * np.pi * 0.5 * TIME)
RNG = np.random.default_rng(0)


def of(residual, voltage=VOLTAGE):
    zero = np.zeros(TIME.size)
    return remaining_error(Trace("a", "training", TIME, voltage, zero + residual, zero))


@pytest.mark.parametrize(
    ("residual", "cause"),
    [
        (RNG.normal(size=TIME.size), "noise"),
        (np.linspace(-1, 1, TIME.size), "slow"),
        (np.sin(2 * np.pi * 3.1 * TIME), "vibration"),
        (np.sin(2 * np.pi * 0.5 * TIME), "model"),
    ],
)
def test_a_residual_is_assigned_to_its_cause(residual, cause):
    found = of(1e-8 * residual)
    shares = {name: getattr(found, name) for name in ("noise", "slow", "vibration", "model")}
    assert shares[cause] > 0.8
    assert sum(shares.values()) == pytest.approx(1.0, abs=1e-6)


def test_the_frequency_and_size_of_a_vibration_are_stated():
    found = of(1e-8 * np.sin(2 * np.pi * 3.1 * TIME) + 2e-9 * RNG.normal(size=TIME.size))
    assert found.frequency == pytest.approx(3.1, abs=0.05)
    assert found.vibration_amplitude == pytest.approx(1e-8, rel=0.1)


def test_harmonics_of_a_periodic_voltage_count_as_errors_of_the_model():
    for multiple in (2, 3, 5):
        assert of(1e-8 * np.sin(2 * np.pi * 0.5 * multiple * TIME)).model > 0.8


def test_a_spectral_line_far_above_the_voltage_is_a_vibration():
    slow = 50 - 50 * np.cos(2 * np.pi * 0.2 * TIME)
    assert of(1e-8 * np.sin(2 * np.pi * 6.2 * TIME), slow).frequency == pytest.approx(6.2, abs=0.05)


def test_a_zero_residual_has_no_cause():
    assert of(0 * TIME).rms == 0
