"""Inertia, damping and load against an electric circuit with a mass, integrated by SciPy from event to event."""

import numpy as np
import pytest
from electromechanical_oracle import moving
from paper_stacks import CONSTANTS, KE, KM, T, actuator_of, paper_stack

from dehyst import Dynamics, State
from dehyst.model import Physical

STACK = paper_stack()
OMEGA = 2 * np.pi * 1000
MASS = (KM + KE) / OMEGA**2
END, COARSE = 6e-3, 400
REST = State(0.0, np.zeros(STACK.friction.size), motion=[0.0, 0.0])


def voltage(t):
    """Two tones, one of which decays: minor loops of many sizes."""
    return 160 * np.sin(2 * np.pi * 300 * t) ** 2 * np.exp(-100 * t) + 60 * np.sin(2 * np.pi * 700 * t)


def rate(t):
    turn = 2 * np.pi * 300
    grown = turn * np.sin(2 * turn * t) - 100 * np.sin(turn * t) ** 2
    return 160 * np.exp(-100 * t) * grown + 60 * 2 * np.pi * 700 * np.cos(2 * np.pi * 700 * t)


@pytest.mark.parametrize("damping", [0.02, 0.5])
@pytest.mark.parametrize("force", [0.0, 6.0], ids=["free", "loaded"])
def test_motion_and_charge_are_the_circuits_at_second_order_in_the_step(damping, force):
    def load(t):
        return force * np.sin(2 * np.pi * 450 * t)

    # m y'' + b y' + (km + ke) y: omega^2 = (km + ke) / m, 2 zeta omega = b / m; beta = ke / T.
    actuator = actuator_of(STACK, dynamics=Dynamics(OMEGA / (2 * np.pi), damping, KE / T), load_stiffness=KM + KE)
    coarse = END * np.arange(COARSE + 1) / COARSE
    q, y = moving(STACK, MASS, 2 * damping * OMEGA * MASS, coarse, voltage, rate, load=load)
    # Most elements slide both ways.
    assert np.ptp(q) > 2 * T * (STACK.friction / STACK.stiffness)[3]
    errors = []
    for finer in (1, 2, 4, 8):
        time = END * np.arange(finer * COARSE + 1) / (finer * COARSE)
        got = actuator.simulate(voltage(time), time=time, load=load(time), state=REST)
        charge = Physical.of(actuator, **CONSTANTS).charge([got.state.deformation])[0]
        errors.append(
            [np.abs(got.displacement[::finer] - y).max() / np.ptp(y), np.abs(charge - q[-1]).max() / np.ptp(q)]
        )
    motion, last = np.transpose(errors)
    # An element breaks away at another place of the step after each halving: all three halvings give the order.
    assert np.all(motion[1:] < 0.5 * motion[:-1]), motion
    assert np.log2(motion[0] / motion[-1]) / 3 > 1.9, motion
    assert motion[-1] < 5e-6
    assert last[-1] < 5e-6
