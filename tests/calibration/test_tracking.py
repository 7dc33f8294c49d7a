"""The path of a calibration, at the temperature that the rig measured."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from truths import AgeingActuator, AgeingCourse
from truths.warm_rig import WarmRig

import dehyst
from dehyst.calibration import TrackedPath
from dehyst.calibration.plan import Excitations
from dehyst.calibration.tracking import PathPlanner, later_temperature
from dehyst.virtual import PlayActuator


@pytest.fixture(scope="module")
def model():
    time = 0.01 * np.arange(2400)
    tops = np.interp(time, np.arange(0, 26, 2), [0, 200, 0, 200, 0, 170, 0, 140, 0, 110, 0, 80, 0])
    record = dehyst.Record(time, tops, PlayActuator(seed=1).play(tops, time=time), name="new")
    return dehyst.identify(record, structure="maxwell_slip").actuator


def test_the_path_of_a_calibration_is_planned_at_the_measured_temperature(model):
    """While it warms by 20 K, by an eighth of that along the path."""
    truth = AgeingActuator(PlayActuator(seed=1), AgeingCourse(gain=-7, seconds=60, kelvins=20))
    rig = WarmRig(truth)
    rig._wait(30.0)
    planner = PathPlanner(Excitations((rig.limits,), 400.0))
    aware, missed = replace(model, thermal=dehyst.Thermal(-0.07 / 20, 0.0, 20.0)), []
    for trained in (model, aware):
        homed = rig.play(planner.homing)
        before = [homed, rig.play(planner.nominal(trained, [homed]).excitation)]
        planned = planner.compensated(trained, before)
        reached = rig.play(planned.excitation)
        missed.append(TrackedPath.of(planned, reached, rig.rows(len(planned.excitation))).rms_percent)
    assert missed[0] > 1 and missed[1] < 0.25


def test_the_drift_of_a_temperature_goes_on_for_as_long_as_it_was_seen():
    time, noise = 0.1 * np.arange(100), np.random.default_rng(0).normal(0, 0.05, 100)
    warm = SimpleNamespace(thermal=0.0)
    for drift in (0.0, 0.2):
        degrees = 25 + drift * time + noise
        record = dehyst.Record(time, time, time, "", others={"temperature_C": degrees})
        expected = degrees[-5:].mean() if not drift else 25 + drift * (9.9 + np.array([0.0, 5.0, 9.9, 9.9]))
        assert later_temperature(warm, record, [0.0, 5.0, 9.9, 500.0]) == pytest.approx(expected, abs=0.1)
    assert later_temperature(warm, dehyst.Record(time, time, time), [0.0]) is None
    assert later_temperature(SimpleNamespace(thermal=None), record, [0.0]) is None
