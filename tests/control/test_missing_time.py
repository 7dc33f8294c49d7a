"""A model that needs time is refused in a sentence without it, a known period is the time base, never a raw error."""

import numpy as np
import pytest
from summaries import NEEDING_TIME, PARTS, STROKE, anatomy

from dehyst import Compensator, DehystError, ModelError, plan_path
from dehyst.control.following import follow
from dehyst.model import turned

PERIOD = 1e-3
N = 50
PATH = STROKE * (0.5 + 0.2 * np.sin(np.linspace(0, 4, N)))
TIME = PERIOD * np.arange(N)
WRONG_TIMES = {
    "short": TIME[1:],
    "long": np.append(TIME, 1.0),
    "falling": TIME[::-1],
    "repeated": np.zeros(N),
    "none": [],
    "not finite": np.where(TIME > 0.01, np.nan, TIME),
    "a column": TIME[:, None],
    "words": ["soon"] * N,
    "number": 1.0,
}


def calls(actuator, **time):
    """Each way to play a whole path."""
    compensator = Compensator(actuator)
    voltage = np.linspace(20.0, 150.0, N)
    return {
        "simulate": lambda: actuator.simulate(voltage, **time),
        "compensate": lambda: actuator.compensate(PATH, **time),
        "follow": lambda: follow(compensator._axes[0], PATH, **time),
        "plan": lambda: plan_path(compensator, PATH, home=False, **time),
        "trajectory from a state": lambda: follow(compensator._axes[0], PATH, state=turned(actuator, 0.0), **time),
        "rates": lambda: follow(compensator._axes[0], PATH, velocity=np.zeros(N), acceleration=np.zeros(N), **time),
    }


@pytest.mark.parametrize("kind", PARTS)
def test_without_time_each_call_works_or_names_the_missing_time(kind):
    for call in calls(anatomy(kind)).values():
        if kind in NEEDING_TIME:
            with pytest.raises(ModelError, match="answer depends") as refused:
                call()
            assert "time" in refused.value.change
        else:
            call()


@pytest.mark.parametrize("wrong", WRONG_TIMES)
@pytest.mark.parametrize("kind", PARTS)
def test_times_of_another_number_are_refused(kind, wrong):
    for call in calls(anatomy(kind), time=WRONG_TIMES[wrong]).values():
        with pytest.raises(ModelError, match=r"^time: "):
            call()


@pytest.mark.parametrize("preview", [False, True])
@pytest.mark.parametrize("kind", PARTS)
def test_the_period_is_the_time_base_of_a_trajectory(kind, preview):
    actuator = anatomy(kind)
    timed = follow(Compensator(actuator)._axes[0], PATH, time=TIME)
    by_period = follow(Compensator(actuator, period=PERIOD, preview=preview)._axes[0], PATH)
    assert np.array_equal(by_period.voltage, timed.voltage)


@pytest.mark.parametrize("kind", ["plain", "inertia"])
def test_given_times_replace_the_period(kind):
    uneven = TIME.copy()
    uneven[10] += 0.4 * PERIOD
    for time in (TIME, uneven):
        without = follow(Compensator(anatomy(kind))._axes[0], PATH, time=time)
        command = follow(Compensator(anatomy(kind), period=2 * PERIOD)._axes[0], PATH, time=time)
        assert np.array_equal(command.voltage, without.voltage)


@pytest.mark.parametrize("kind", NEEDING_TIME)
def test_a_loop_without_a_needed_period_is_refused(kind):
    actuator = anatomy(kind)
    calls = {"step": PATH[:1], "offer": PATH[:1], "commit": [50.0], "hold": [], "run": [PATH], "snapshot": []}
    for name, given in calls.items():
        with pytest.raises(ModelError, match=r"give the period \[s\]"):
            getattr(Compensator(actuator), name)(*given)


@pytest.mark.parametrize("kind", PARTS)
def test_short_paths_are_computed_or_refused(kind):
    actuator = anatomy(kind)
    for path in ([], [5e-6], [5e-6, 6e-6], 5e-6, [[5e-6]], None, [np.nan]):
        for period in (None, PERIOD):
            try:
                size = np.size(path)
                assert follow(Compensator(actuator, period=period)._axes[0], path).voltage.shape == (size,)
            except DehystError:
                assert period is None or np.ndim(path) != 1 or not np.all(np.isfinite(np.array(path, dtype=float)))


@pytest.mark.parametrize("factor", [1e9, 1e-9])
def test_a_path_with_times_in_another_unit_is_refused(factor):
    with pytest.raises(ModelError) as refused:
        plan_path(anatomy("plain"), PATH, time=factor * TIME)
    assert refused.value.argument == "time"
