"""Searches of one number: a lower bound of a convex cost, and a delay with as few fits as it needs."""

from math import sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dehyst.identification.regression.nuisances import _least_of_convex, searched_delay

# Legs of different heights [V].
VOLTAGE = np.array([0.0, 1.0, 0.0, 0.6, 0.0, 0.3, 0.0])
STROKE, SAMPLE = 1.0, 1e-3

convex = st.tuples(
    st.floats(-2, 2),
    st.floats(0.1, 3),
    st.floats(0, 2),
    st.lists(st.floats(-1, 1), min_size=4, max_size=9, unique=True),
)


@given(convex)
def test_a_convex_function_lies_above_its_bound(case):
    at, bend, slope, places = case
    places = [round(x, 3) for x in places]

    def function(x):
        return bend * (x - at) ** 2 + slope * abs(x)

    low, high = min(places), max(places)
    bound = _least_of_convex({x: function(x) for x in places})
    assert bound <= function(np.linspace(low, high, 2001)).min() + 1e-9


def test_the_bound_is_exact_between_two_lines():
    values = {x: max(1.0 - x, 2 * x - 2.0) for x in (-2.0, -1.0, 2.0, 3.0)}
    assert _least_of_convex(values) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("delay", [0.0, 0.03, 0.31, 1.0])
def test_a_delay_is_found_and_none_costs_few_fits(delay):
    asked = []

    def cost(place):
        asked.append(place)
        return sqrt(1e-4 + 1e-2 * (place - delay) ** 2)

    found = searched_delay(cost, 1.0, SAMPLE, VOLTAGE, STROKE, points=7)
    assert found == pytest.approx(delay, abs=0.01 * SAMPLE if delay > 0.03 else 0.04)
    assert len(asked) == len(set(asked))
    if not delay:
        assert found == 0
        assert len(asked) < 2 * 7
