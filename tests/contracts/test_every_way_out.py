"""Every way by which a voltage leaves keeps limits and slew rate, from the present voltage on."""

from collections import Counter

import numpy as np
import pytest
import ways_out
from hypothesis import given
from hypothesis import strategies as st

from examples import examples

pytestmark = pytest.mark.filterwarnings("ignore")


@examples(30, nightly=200)
@given(st.integers(0, 2**32 - 1))
def test_random_lives_never_jump(seed):
    assert ways_out.play(seed, 0, lambda _: None) == []


@pytest.mark.parametrize("call", ways_out.SHARES)
def test_each_way_alone_never_jumps(call):
    counts = Counter()
    for case in range(6 if call in ("table", "stage_home", "file") else 20):
        life = ways_out.Life(np.random.default_rng([11, case]), lambda word: counts.update([word]))
        getattr(life, call)()
        assert life.findings == []
    assert counts["voltages"] or call == "reset"


def test_a_jump_is_found():
    """The check sees what it is for."""
    life = ways_out.Life(np.random.default_rng(3))
    step = life.slew * life.period
    life.hold_against("a step", [life.low + 1.001 * step], life.low, life.period)
    life.hold_against("a limit", [life.high + 1e-6 * (life.high - life.low)], life.high, life.period)
    assert len(life.findings) == 2
