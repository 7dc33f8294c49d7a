"""Every way by which a voltage leaves keeps limits and slew rate, from the present voltage on."""

from collections import Counter

import numpy as np
import pytest
import ways_out
from hypothesis import given
from hypothesis import strategies as st

from dehyst import Actuator, Compensator, MaxwellSlip, Spring
from dehyst.model import turned
from examples import examples

pytestmark = pytest.mark.filterwarnings("ignore")


@examples(30, nightly=200)
@given(st.integers(0, 2**32 - 1))
def test_random_calls_never_make_the_voltage_jump(seed):
    assert ways_out.play(seed, 0, lambda _: None) == []


@pytest.mark.parametrize("call", ways_out.SHARES)
def test_each_call_alone_never_makes_the_voltage_jump(call):
    counts = Counter()
    for case in range(6 if call in ("table", "stage_home") else 20):
        life = ways_out.Life(np.random.default_rng([11, case]), lambda word: counts.update([word]))
        getattr(life, call)()
        life.end()
        assert life.findings == []
    assert counts["voltages"] or call == "reset"


def test_the_check_finds_a_jump():
    """The check sees what it is for."""
    life = ways_out.Life(np.random.default_rng(3))
    step = life.slew * life.period
    life.hold_against("a step", [life.low + 1.001 * step], life.low, life.period)
    life.hold_against("a limit", [life.high + 1e-6 * (life.high - life.low)], life.high, life.period)
    assert len(life.findings) == 2


def test_the_first_voltage_is_that_of_the_state_if_the_spring_has_a_steep_end():
    """The voltage of a state was rounded to 0 V by the range of the whole spring."""
    spring = Spring([0, 1e-5, 1.1e-5], [0, 10, 1e30])
    actuator = Actuator(MaxwellSlip([1e-6], [1e6]), spring, limits=(0, 10))
    loop = Compensator(actuator, slew_rate=1.0, period=1e-3, state=turned(actuator, 5e-6))
    before = loop.voltage
    assert before == pytest.approx(6, rel=1e-12)
    assert abs(loop.step(0.0) - before) <= 1e-3 * (1 + 1e-9)
