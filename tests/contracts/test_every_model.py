"""What every model must do. To enter a model, add one line to `MODELS`."""

from dataclasses import replace

import numpy as np
import pytest
from model_contract import ModelCandidate, ModelContract

from dehyst import Actuator, DisplacementCreep, MaxwellSlip, Spring
from dehyst.model import GradedSlip, SmoothSlip, Transformer
from dehyst.trust.baselines import Linear, TwoBranches

VOLTS = 100.0


def actuator(elements, knots, volts):
    """Return an actuator of 10 um; elements of increasing stiffness on a uniform grid."""
    rho = 5e-6 * np.arange(1, elements + 1) / max(elements, 1)
    kappa = 4e6 * np.arange(1, elements + 1) / max(elements, 1) ** 2
    return Actuator(MaxwellSlip(rho, kappa), Spring(knots, volts))


CREEP = DisplacementCreep([0.01, 0.3, 10.0], [0.01, 0.03, 0.02])


def wider(elements, *, creep):
    """Return an actuator whose elements are stiffer in the middle, seen through a bent transformer."""
    rho = 5e-6 * np.arange(1, elements + 1) / elements
    slip = GradedSlip(rho, [0, 3e-6, 7e-6, 1e-5], np.outer(4e6 * rho / rho.sum(), [0.9, 1.2, 1.0]))
    bend = Transformer([0, 0.3 * VOLTS, VOLTS], [0, 0.35 * VOLTS, VOLTS])
    return Actuator(slip, Spring([0, 1e-5], [0, 80]), transformer=bend, displacement_creep=CREEP if creep else None)


def smooth():
    """Return ten elements beside three smooth ones."""
    plain = actuator(10, np.linspace(0, 1e-5, 11), 60 * np.linspace(0, 1, 11) ** 1.3)
    return Actuator(plain.slip, plain.spring, smooth=SmoothSlip([3e-7, 1e-6, 4e-6], [1, 0.5, 0.8], [5e6, 3e6, 2e6]))


def two_branches():
    """Return a table of a loop whose branches are parabolas."""
    volts = np.linspace(0, VOLTS, 11)
    bend = 1e-8 * volts * (1 - volts / VOLTS)
    return TwoBranches(volts, 1e-7 * volts - bend, 1e-7 * volts + bend)


MODELS = [
    ModelCandidate("spring alone", lambda: actuator(0, [0, 4e-6, 1e-5], [0, 60, 100])),
    ModelCandidate("one element", lambda: actuator(1, [0, 1e-5], [0, 80])),
    ModelCandidate("ten elements", lambda: actuator(10, np.linspace(0, 1e-5, 11), 90 * np.linspace(0, 1, 11) ** 1.3)),
    ModelCandidate("thousand elements", lambda: actuator(1000, [0, 2e-6, 1e-5], [0, 10, 90])),
    ModelCandidate("graded elements and a transformer", lambda: wider(10, creep=False)),
    ModelCandidate("graded elements, a transformer and creep", lambda: wider(10, creep=True)),
    ModelCandidate(
        "plain elements and creep", lambda: replace(actuator(10, [0, 1e-5], [0, 80]), displacement_creep=CREEP)
    ),
    ModelCandidate("linear ratio", lambda: Linear(1e-7, 1e-6)),
    ModelCandidate("smooth elements", smooth, wipes_out=False),
    ModelCandidate("two branches", two_branches, wipes_out=False, moves=False),
]


class TestEveryModel(ModelContract):
    @pytest.fixture(params=MODELS, ids=lambda candidate: candidate.name)
    def candidate(self, request):
        return request.param
