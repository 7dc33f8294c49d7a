"""Options of an identification, and the deadline of its searches."""

import signal
import time
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dehyst import IdentifyError, Structure, _validation
from dehyst._validation import Numbers
from dehyst.identification import Deadline
from dehyst.identification.settings import Settings

NO_NUMBERS = st.sampled_from(["3", None, [1], True, 1j, float("nan"), np.True_])


@given(st.integers(-600, 600), st.integers(-5, 5), st.integers(10, 500))
def test_a_count_is_taken_between_its_bounds_and_only_there(value, least, most):
    if least <= value <= most:
        assert _validation.count(value, "cells", least, most) == value
        assert type(_validation.count(np.int32(value), "cells", least, most)) is int
    else:
        with pytest.raises(IdentifyError):
            _validation.count(value, "cells", least, most)


@given(NO_NUMBERS)
def test_what_is_no_number_is_refused_everywhere(value):
    for check in (_validation.count, Numbers(least=0.0, error=IdentifyError)):
        with pytest.raises(IdentifyError, match=r"it: got .*, need"):
            check(value, "it")


def test_bounds_and_words():
    assert Numbers(least=0.0)(0, "delay") == 0.0
    assert Numbers(positive=True)(Fraction(1, 3), "smoothing") == pytest.approx(1 / 3)
    assert Numbers(least=0.5, most=4.0)(np.float64(4), "spacing") == 4.0
    assert _validation.count(10**9, "starts", most=None) == 10**9
    _validation.choice("sensor", "lag_of", ("actuator", "sensor"))
    np.testing.assert_array_equal(_validation.vector((1, 2.5), "breakaway", error=IdentifyError), [1, 2.5])


@pytest.mark.parametrize(
    "check",
    [
        lambda: _validation.vector([[1.0]], "breakaway", error=IdentifyError),
        lambda: _validation.count(0, "starts", most=None),
        lambda: Settings(delay=-1e-9),
        lambda: Settings(sensor_lag=float("inf")),
        lambda: Structure(spacing=4.1),
        lambda: Structure(smoothing=-1e-9),
        lambda: Structure(smooth=1),
        lambda: Deadline(0.0),
        lambda: _validation.choice("both", "lag_of", ("actuator", "sensor")),
    ],
)
def test_what_lies_beyond_is_refused(check):
    with pytest.raises(IdentifyError):
        check()


def test_a_known_lag_of_the_sensor_makes_any_other_the_actuators():
    assert (Settings().lags, Settings(sensor_lag=0.0).lags) == (None, "actuator")
    assert Settings(sensor_lag=0.1, lag_of="sensor").lags == Settings(lag_of="sensor").lags == "sensor"
    assert Settings(sensor_lag=0.1).as_dict() == {
        "shared_datum": False,
        "drift": True,
        "sensor_lag": 0.1,
        "lag_of": "actuator",
    }


def test_a_step_does_not_begin_after_the_limit():
    endless, deadline = Deadline(), Deadline(1e-9)
    assert (endless.left, endless.passed, endless.attempt(lambda: 1, 2, "a step")) == (np.inf, False, 1)
    assert deadline.passed and deadline.left == 0
    assert deadline.attempt(pytest.fail, 2, "the search") == 2
    assert deadline.attempt(pytest.fail, None, "the tuning") is None
    assert deadline.cut == ["the search", "the tuning"]
    assert (len(endless.remarks("one")), len(deadline.remarks("one"))) == (0, 1)


def test_a_step_that_looks_at_the_deadline_is_left():
    deadline, said = Deadline(), []
    report = deadline.watched(said.append)

    def step():
        report("begins")
        deadline.end("Ctrl-C")
        report("goes on")

    deadline.check()
    assert deadline.attempt(step, "so far", "the step") == "so far"
    assert said == ["begins"]
    # Outside of a step progress is only reported.
    report("finishing")
    assert said == ["begins", "finishing"]


def test_an_error_in_a_step_is_an_error():
    deadline = Deadline()
    with pytest.raises(ZeroDivisionError):
        deadline.attempt(lambda: 1 / 0, 0, "a step")
    assert deadline.cut == []


def test_a_signal_handler_leaves_a_step_that_looks_at_nothing():
    deadline = Deadline()
    before = signal.signal(signal.SIGINT, lambda *_: deadline.end("Ctrl-C", leave_step=True))
    try:

        def step():
            signal.raise_signal(signal.SIGINT)
            time.sleep(0)
            pytest.fail("the step went on")

        assert deadline.attempt(step, 7, "a step") == 7
    finally:
        signal.signal(signal.SIGINT, before)
