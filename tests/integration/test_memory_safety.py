"""Huge, tiny and damaged numbers: a clear error or a finite answer, never a crash; voltages stay in their limits."""

from dataclasses import replace

import numpy as np
import pytest

from dehyst import Actuator, Compensator, DisplacementCreep, Dynamics, MaxwellSlip, ModelError, Spring
from dehyst._validation import FARTHEST, MOST

pytestmark = pytest.mark.filterwarnings("ignore::dehyst.ClampWarning")

UNIFORM = MaxwellSlip([3e-7, 6e-7, 9e-7], [1.7e6, 2.9e6, 3.2e6])
SPRING = Spring([-1e-6, 0.0, 4e-7, 6e-7], [-10.0, -4.3, -1.9, 0.3])
PLAIN = Actuator(UNIFORM, SPRING, limits=(-10.0, 0.3))
CREEPING = replace(PLAIN, displacement_creep=DisplacementCreep([1.0], [0.01]))
LOADED = replace(PLAIN, load_stiffness=1e-20)
FAR = replace(PLAIN.relaxed(), deformation=1e305, carts=PLAIN.relaxed().carts + 1e305)


def swinging(damping):
    return replace(PLAIN, dynamics=Dynamics(1.6e3, damping))


@pytest.mark.parametrize(
    "call",
    [
        lambda: Actuator(UNIFORM, SPRING, limits=(-1e308, 1e308)),
        lambda: CREEPING.simulate([0.0, -1.0], time=[-1.7e308, 1.7e308]),
        lambda: swinging(0.1).simulate([0.0, -1.0], time=[0.0, 1e20]),
        lambda: swinging(1e25).simulate([0.0, -1.0], time=[0.0, 1e-3]),
        lambda: LOADED.simulate([0.0, -1.0], load=[0.0, 1e300]),
        lambda: PLAIN.simulate([0.0, 1e281, 0.0], extrapolate=True),
        lambda: PLAIN.compensate([0.0, 1e305], extrapolate=True),
        lambda: PLAIN.voltage(FAR),
        lambda: Compensator(PLAIN, state=FAR),
    ],
)
def test_numbers_that_cannot_be_computed_with_are_refused(call):
    with pytest.raises(ModelError):
        call()


def test_the_farthest_place_leaves_room():
    """A model that is refused nowhere computes finite voltages at the farthest place."""
    actuator = Actuator(UNIFORM, Spring([0.0, 1.0], [0.0, MOST]))
    assert np.isfinite(actuator.compensate([0.5 * FARTHEST, -0.5 * FARTHEST], extrapolate=True).voltage).all()
