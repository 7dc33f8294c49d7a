"""What a wider model must not leave: patterns that are put into residuals are found, noise alone is not."""

from dataclasses import replace

import numpy as np
import pytest
import structured_records

from dehyst import identify
from dehyst.identification import RecordErrors, Structure, Trace, Verdict
from dehyst.identification.diagnostics.checks import model_checks

STROKE = 10e-6
PLANT = structured_records.plant(structured_records.STRUCTURES["graded, transformer"])
ACTUATOR = replace(PLANT.actuator, limits=(0.0, 200.0))


def left(pattern, noise=0.05, seed=0):
    """Checks by name of twenty cycles whose residual [% of the stroke] is a pattern of place, direction and time."""
    time = np.arange(8000) / 100
    phase = time / 4
    place, up = 0.5 - 0.5 * np.cos(2 * np.pi * phase), np.sin(2 * np.pi * phase) > 0
    simulated = STROKE * 1.6 * place
    made = np.broadcast_to(pattern(place, np.where(up, 1.0, -1.0), time), time.shape)
    # A fit leaves no constant.
    residual = made - made.mean() + noise * np.random.default_rng(seed).normal(size=time.size)
    trace = Trace("made", "training", time, 200 * place, simulated + residual / 100 * STROKE, simulated)
    errors = RecordErrors("made", "training", time.size, 0, 0, 0, 0, 0, STROKE, 0, 0, 0)
    return {check.name: check for check in model_checks(ACTUATOR, (), [trace], [errors])}


def test_noise_alone_is_not_a_pattern():
    failed = 0
    for seed in range(40):
        checks = left(lambda *_: 0.0, noise=5.0, seed=seed)
        failed += sum(checks[name].verdict is Verdict.FAILS for name in ("Width", "Middle line", "No drift"))
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
def test_patterns_are_found(pattern, name, value):
    checks = left(pattern)
    assert checks[name].verdict is Verdict.FAILS
    assert checks[name].value == pytest.approx(value, rel=0.1)
    assert checks[name].floor < 0.2 * value
    others = {"Width", "Middle line", "No drift"} - {name}
    assert all(checks[other].value < 0.3 * value for other in others)


def test_what_is_small_does_not_matter():
    checks = left(lambda place, side, time: 0.09 * side, noise=0.001)
    assert checks["Width"].verdict is Verdict.HOLDS


def test_a_transformer_left_out_shows_in_the_middle_or_the_width():
    record = PLANT.record(noise=1e-9)
    right, poor = (
        identify(record, structure=one, delay=0.0)
        for one in (Structure(elements=6, grades=3, knots=7, transformer=5), Structure(elements=6, grades=2, knots=2))
    )
    good = {check.name: check for check in model_checks(right.actuator, (), right.traces, right.errors)}
    bad = {check.name: check for check in model_checks(poor.actuator, (), poor.traces, poor.errors)}
    assert all(check.verdict is Verdict.HOLDS for check in good.values())
    assert Verdict.FAILS in (bad["Width"].verdict, bad["Middle line"].verdict)


def test_the_least_slope_is_that_of_a_branch():
    checks = left(lambda *_: 0.0)
    y = np.linspace(*ACTUATOR.spring.displacement[[0, -1]], 4001)
    straight = replace(ACTUATOR, transformer=None)
    volts = [[straight.voltage(straight.turned(float(at), rising=up)) for at in y] for up in (True, False)]
    least = min(float((np.diff(one) / np.diff(y)).min()) for one in volts)
    assert checks["Rising branches"].value * 1e6 == pytest.approx(least, rel=0.02)


def test_elements_that_never_slide_are_told():
    time = np.arange(400) / 100
    small = 0.1 * STROKE * np.sin(time * 6)
    trace = Trace("small", "training", time, 10 + small * 1e6, small, small)
    errors = RecordErrors("small", "training", 400, 0, 0, 0, 0, 0, STROKE, 0, 0, 0)
    (sliding,) = (one for one in model_checks(ACTUATOR, (), [trace], [errors]) if one.name == "Sliding elements")
    assert sliding.verdict is Verdict.FAILS
