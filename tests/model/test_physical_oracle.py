"""The actuator against an electric circuit of the paper's numbers, whose friction SciPy integrates."""

import numpy as np
import pytest
from electromechanical_oracle import branches, quasi_static
from paper_stacks import KE, KEQ, KM, T, actuator_of, assert_proportional, paper_stack

from dehyst import Dynamics, State
from examples import at_night

STACK = paper_stack()
TURNS = [0, 200, 0, 140, 30, 90, 60, 150, -20, 0]
RESISTANCES = np.array([4e3, 1e3, 250.0])


def assert_vanishes(errors):
    assert_proportional(errors, RESISTANCES)
    assert errors[-1] < 5e-4


@pytest.mark.parametrize("residual", [at_night(False), True], ids=["relaxed", "with residual charge"])
def test_displacement_and_charge_converge_to_those_of_the_circuit(residual):
    """The charge is T x, with x = y km / keq."""
    actuator = actuator_of(STACK)
    time, voltage = branches(TURNS, 40)
    reach = STACK.friction / STACK.stiffness
    carts = T * reach * np.linspace(0.9, -0.4, reach.size) if residual else 0 * reach
    errors = []
    for resistance in RESISTANCES:
        q, y = quasi_static(STACK, time, voltage, resistance, carts=carts)
        start = State(y[0], KEQ / KM * carts / T)
        # The circuit starts in balance: its first voltage is the actuator's of that state.
        assert actuator.voltage(start) == pytest.approx(0.0, abs=1e-9)
        got = actuator.simulate(voltage(time), state=start).displacement
        errors.append([np.abs(got - y).max() / np.ptp(y), np.abs(T * KM / KEQ * got - q).max() / np.ptp(q)])
    for kind in np.transpose(errors):
        assert_vanishes(kind)


@pytest.mark.nightly
def test_a_slow_load_at_constant_voltage_changes_the_charge():
    """With ke / T as series spring, and a mass so small that it follows at once."""
    actuator = actuator_of(STACK, dynamics=Dynamics(1.6e6, 1.0, KE / T), load_stiffness=KM + KE)
    time, voltage = branches([0, 200, 0, 140, 30, 90, 0], 400)

    def load(t):
        return 8 * np.sin(2.1 * t)

    start = State(0.0, np.zeros(STACK.friction.size), motion=[0.0, 0.0])
    got = actuator.simulate(voltage(time), time=time, load=load(time), state=start).displacement
    errors = []
    for resistance in RESISTANCES:
        q, y = quasi_static(STACK, time, voltage, resistance, load=load)
        charge = T * KM / KEQ * (got - load(time) / (KM + KE))
        errors.append(max(np.abs(got - y).max() / np.ptp(y), np.abs(charge - q).max() / np.ptp(q)))
    assert_vanishes(errors)
    # Far more than what a plain F / kc leaves out.
    plain = actuator_of(STACK, load_stiffness=KM + KE)
    stiff = plain.simulate(voltage(time), load=load(time), state=plain.relaxed()).displacement
    assert np.abs(stiff - y).max() / np.ptp(y) > 20 * errors[-1]
