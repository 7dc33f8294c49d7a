"""Options of an identification: what is taken is given back, all else is refused with what was got."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dehyst import IdentifyError, _validation

NO_NUMBERS = st.sampled_from(["3", None, [1], True, 1j, float("nan"), np.True_])


@given(st.integers(-600, 600), st.integers(-5, 5), st.integers(10, 500))
def test_a_count_is_taken_between_its_bounds_and_only_there(value, least, most):
    if least <= value <= most:
        assert _validation.count(value, "cells", least, most) == value
        assert type(_validation.count(np.int32(value), "cells", least, most)) is int
    else:
        with pytest.raises(IdentifyError):
            _validation.count(value, "cells", least, most)


@given(st.floats(-2, 2))
def test_a_fraction_lies_between_0_and_1(value):
    if 0 < value < 1:
        assert _validation.fraction(value, "floor") == value
    else:
        with pytest.raises(IdentifyError):
            _validation.fraction(value, "floor")


def test_a_fraction_may_begin_elsewhere():
    assert _validation.fraction(0, "smoothing", 0.0) == 0.0
    assert _validation.fraction(Fraction(1, 3), "smoothing") == pytest.approx(1 / 3)


@given(NO_NUMBERS)
def test_what_is_no_number_is_refused_everywhere(value):
    for check in (
        _validation.count,
        _validation.fraction,
        _validation.seconds,
        lambda x, name: _validation.between(x, name, 0, 4),
    ):
        with pytest.raises(IdentifyError, match=r"it: got .*, need"):
            check(value, "it")


def test_seconds_bounds_and_words():
    assert _validation.seconds(0, "delay") == 0.0
    assert _validation.count(10**9, "starts", most=None) == 10**9
    assert _validation.between(np.float64(4), "spacing", 0.5, 4) == 4.0
    _validation.choice("l1", "norm", ("l1", "l2"))
    np.testing.assert_array_equal(_validation.vector((1, 2.5), "breakaway", error=IdentifyError), [1, 2.5])


@pytest.mark.parametrize(
    "check",
    [
        lambda: _validation.vector([[1.0]], "breakaway", error=IdentifyError),
        lambda: _validation.count(0, "starts", most=None),
        lambda: _validation.seconds(-1e-9, "delay"),
        lambda: _validation.seconds(float("inf"), "delay"),
        lambda: _validation.between(4.1, "spacing", 0.5, 4, "an exponent"),
        lambda: _validation.choice("l3", "norm", ("l1", "l2")),
        lambda: _validation.fraction(1e-7, "floor", 1e-6),
    ],
)
def test_what_lies_beyond_is_refused(check):
    with pytest.raises(IdentifyError):
        check()
