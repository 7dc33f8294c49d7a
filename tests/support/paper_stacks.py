"""Stacks with the paper's T, km and ke, and the actuator of each by the conversion of docs/theory.md."""

import numpy as np
from electromechanical_oracle import Stack

from dehyst import Actuator, MaxwellSlip, Spring

T, KM, KE = 0.042, 1.4e6, 8.82e4
KEQ = KE * KM / (KE + KM)
CONSTANTS = {"transformer_ratio": T, "mechanical_stiffness": KM, "electrical_stiffness": KE}


def paper_stack(elements=6, *, linear=False, seed=1):
    """A stack that 200 V move from rest by about X [m of x], with the paper's grid r_i = i X / (2 N).

    Its friction needs about 2 N; the rest is h, which is keq x if `linear` and a curve otherwise.
    """
    rng = np.random.default_rng(seed)
    span = 6.4 / KEQ if linear else 270e-6
    reach = span / (2 * elements) * np.arange(1, elements + 1)
    stiffness = rng.uniform(0.3, 1.5, elements)
    stiffness *= 2 / (stiffness @ reach)
    x = span * np.linspace(-0.5, 1.5, 17)
    u = x / span
    g = 0 * x if linear else 6 * (u + 0.25 * u * (u - 1)) - KEQ * x
    return Stack(T, KM, KE, stiffness, stiffness * reach, x, g)


def actuator_of(stack, **parts):
    """The same in terminal coordinates: kappa = k / (T c), rho = c r, eta(y) = h / T, c = keq / km."""
    c = KEQ / KM
    slip = MaxwellSlip(c * stack.friction / stack.stiffness, stack.stiffness / (T * c))
    return Actuator(slip, Spring(c * stack.x, (KEQ * stack.x + stack.g) / T), **parts)


def assert_proportional(errors, resistances):
    """Each error is proportional to the resistance of the friction within a tenth: it vanishes without resistance."""
    np.testing.assert_allclose(errors, errors[-1] * resistances / resistances[-1], rtol=0.1)
