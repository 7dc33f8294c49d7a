"""Where the error comes from: residuals of one cause each are found to be of that cause."""

import numpy as np
import pytest

from dehyst.identification import Trace
from dehyst.identification.checks import remaining_error

TIME = np.arange(4000) * 0.01
VOLTAGE = 50 - 50 * np.cos(2 * np.pi * 0.5 * TIME)
RNG = np.random.default_rng(0)


def of(residual):
    zero = np.zeros(TIME.size)
    return remaining_error(Trace("a", "training", TIME, VOLTAGE, zero + residual, zero))


@pytest.mark.parametrize(
    ("residual", "cause"),
    [
        (RNG.normal(size=TIME.size), "noise"),
        (np.linspace(-1, 1, TIME.size), "slow"),
        (np.sin(2 * np.pi * 3.1 * TIME), "vibration"),
        (np.sin(2 * np.pi * 0.5 * TIME), "model"),
    ],
)
def test_a_residual_of_one_cause(residual, cause):
    found = of(1e-8 * residual)
    shares = {name: getattr(found, name) for name in ("noise", "slow", "vibration", "model")}
    assert shares[cause] > 0.8
    assert sum(shares.values()) == pytest.approx(1.0, abs=1e-6)


def test_a_vibration_is_named_with_frequency_and_size():
    found = of(1e-8 * np.sin(2 * np.pi * 3.1 * TIME) + 2e-9 * RNG.normal(size=TIME.size))
    assert found.frequency == pytest.approx(3.1, abs=0.05)
    assert found.vibration_amplitude == pytest.approx(1e-8, rel=0.1)


def test_harmonics_of_a_periodic_voltage_are_the_model_s():
    for multiple in (2, 3, 5):
        assert of(1e-8 * np.sin(2 * np.pi * 0.5 * multiple * TIME)).model > 0.8


def test_a_line_far_above_a_slow_voltage_is_a_vibration():
    slow = 50 - 50 * np.cos(2 * np.pi * 0.2 * TIME)
    zero = np.zeros(TIME.size)
    found = remaining_error(Trace("a", "training", TIME, slow, zero + 1e-8 * np.sin(2 * np.pi * 6.2 * TIME), zero))
    assert found.frequency == pytest.approx(6.2, abs=0.05)


def test_nothing_left_has_no_cause():
    assert of(0 * TIME).rms == 0
