"""What an actuator is made of: numbers that a second way gives too."""

import numpy as np
import pytest
from summaries import PARTS, anatomy

from dehyst import Actuator, DisplacementCreep, Dynamics, MaxwellSlip, Spring
from dehyst.model import GradedSlip
from dehyst.model.summary import parts_of, resonance, step_response


def test_the_step_response_of_one_branch_of_creep_is_exponential():
    gain, tau = 0.2, 5.0
    creep, spring = DisplacementCreep([tau], [gain]), Spring([0.0, 10e-6], [0.0, 100.0])
    linear = Actuator(MaxwellSlip([], []), spring, displacement_creep=creep, limits=(0.0, 100.0))
    time, share = step_response(linear)
    # The rise itself lasts a tenth of tau: a ramp, which the low-pass has followed to `z`.
    z = 1 + np.expm1(-0.1) / 0.1
    np.testing.assert_allclose(share, gain * (1 - z) * -np.expm1(-time / tau) / (1 + gain * z), atol=1e-12)


def test_all_elements_and_the_spring_give_the_slope_after_a_turn():
    actuator = Actuator(GradedSlip([1e-6], [0.0, 5e-6, 10e-6], [[2e6, 4e6]]), Spring([0.0, 10e-6], [0.0, 100.0]))
    sentence = parts_of(actuator)[0].sentence
    assert "12 V/um at 0 um" in sentence and "14 V/um" in sentence


def test_the_resonance_agrees_with_section_9_of_the_theory():
    spring = Spring([0.0, 1e-6], [0.0, 10.0])
    assert resonance(Dynamics(100, 0.01, 3e7), spring) == pytest.approx((100, 100 * np.sqrt(1e7 / 4e7)))


@pytest.mark.parametrize("kind", PARTS)
def test_every_part_is_described(kind):
    """Elements and spring, and each part beside them."""
    assert len(parts_of(anatomy(kind))) == {"plain": 2, "graded": 2, "all": 8}.get(kind, 3)
