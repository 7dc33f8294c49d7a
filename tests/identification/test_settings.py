"""Options of an identification, and the deadline of its searches."""

import signal
import time

import numpy as np
import pytest

from dehyst.identification import Deadline
from dehyst.identification.settings import Settings


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
