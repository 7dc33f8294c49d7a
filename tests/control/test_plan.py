"""A plan of a path: on time, at its own speed, of one axis and several."""

import tracemalloc
from dataclasses import replace

import numpy as np
import plain_records
import pytest

from dehyst import Actuator, Compensator, ModelError, Stage, plan_path
from dehyst.model import Identification, Validity, parts_of, turned, with_identification

STEP, DELAY = 5e-3, 0.0172
TIME = STEP * np.arange(600)
WANTED = plain_records.STROKE * (0.5 - 0.3 * np.cos(2 * np.pi * TIME / 1.5))
PLANT = with_identification(replace(plain_records.plant(6), limits=(-40.0, 260.0)), slew_rate=200.0)
LATE = replace(PLANT, delay=DELAY, identification=Identification(lag_of="actuator"))


def shown(actuator: Actuator, plan):
    """What the sensor shows [m] along the path: the displacement of a delay before."""
    fine = np.linspace(plan.time[0], plan.time[-1], 20 * plan.time.size)
    moved = actuator.simulate(np.interp(fine, plan.time, plan.voltage), state=plan.start.state, extrapolate=True)
    return np.interp(plan.time[plan.first :] - actuator.delay, fine, moved.displacement)


@pytest.mark.parametrize("home", [True, False])
def test_a_path_of_an_actuator_that_lags_is_on_time(home):
    start = None if home else turned(LATE, float(WANTED[0]))
    plan = plan_path(LATE, WANTED, time=TIME, home=home, start=start)
    assert np.count_nonzero(plan.phase == 2) == WANTED.size and not plan.failure and not plan.clamped.any()
    np.testing.assert_array_equal(plan.displacement[plan.first :], WANTED)
    np.testing.assert_allclose(np.diff(plan.time[plan.first :]), STEP)
    # Between samples the voltages are straight, where the plant has kinks.
    assert np.abs(shown(LATE, plan) - WANTED).max() < 5e-4 * plain_records.STROKE
    late = plan_path(LATE, WANTED, time=TIME, home=home, start=start, on_time=False)
    assert np.abs(shown(LATE, late) - WANTED).max() > 2e-2 * plain_records.STROKE
    assert any("on time" in said for said in plan.warnings) and any("later" in said for said in late.warnings)


def test_the_promise_of_a_late_path_excludes_the_delay():
    tested = Validity(1e-8, 1e-7, 0.0, plain_records.STROKE, limits=(-40.0, 260.0))
    known = replace(LATE, identification=Identification(lag_of="actuator", validity=tested))
    delays = [
        plan_path(known, WANTED, time=TIME, home=True, on_time=on_time).promise.delay for on_time in (True, False)
    ]
    assert delays == [0.0, DELAY]


def test_a_plan_needs_little_memory():
    time = np.arange(200_000) * 1e-3
    wanted = 8e-6 - 4e-6 * np.cos(0.3 * time)
    tracemalloc.start()
    plan_path(replace(PLANT, identification=None), wanted, time=time, home=True)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 14 * wanted.nbytes


def test_model_and_plans_say_the_same_about_the_lag():
    models = [replace(LATE, identification=Identification(lag_of=lag_of)) for lag_of in ("actuator", "sensor", "")]
    said = [{part.name: part.sentence for part in parts_of(model)}["Delay"] for model in models]
    start = turned(PLANT, float(WANTED[0]))
    leads = [plan_path(model, WANTED, time=TIME, start=start).voltage.size > TIME.size for model in models]
    assert leads == ["lead" in sentence for sentence in said] and len({*said}) == 3


@pytest.mark.parametrize("lag_of", ["", "sensor"])
def test_only_a_lag_of_the_actuator_is_compensated_by_default(lag_of):
    actuator = replace(LATE, identification=Identification(lag_of=lag_of))
    plan = plan_path(actuator, WANTED, time=TIME, start=turned(PLANT, float(WANTED[0])))
    np.testing.assert_array_equal(plan.voltage, plan_path(PLANT, WANTED, time=TIME, start=plan.start).voltage)
    assert any("later" in warning for warning in plan.warnings) == (lag_of == "")
    asked = plan_path(actuator, WANTED, time=TIME, start=plan.start, on_time=True)
    assert asked.voltage.size > plan.voltage.size


@pytest.mark.parametrize(("size", "followed"), [(60, False), (6000, True)])
def test_corners_between_two_samples_are_counted(size, followed):
    time = np.linspace(0, 0.6, size, endpoint=False)
    wanted = plain_records.STROKE * (0.3 + np.abs(time / 0.2 % 2 - 1) / 3)
    late = replace(LATE, delay=0.3 * float(time[1] - time[0]))
    plan = plan_path(late, wanted, time=time, home=False, start=turned(late, float(wanted[0])))
    reached = shown(late, plan)
    assert (not plan.failure) == followed == (np.abs(reached - wanted).max() < 1e-3 * plain_records.STROKE)
    np.testing.assert_allclose(plan.expected[plan.first :], reached, atol=2e-3 * plain_records.STROKE)


def test_each_axis_of_a_stage_is_early_by_its_own_delay():
    stage = Stage((LATE, replace(LATE, delay=3 * STEP)), [[1.0, 0.05], [-0.03, 1.0]])
    wanted = np.column_stack([WANTED, WANTED[::-1]])
    plan = plan_path(stage, wanted, time=TIME, home=True)
    assert not plan.failure and plan.displacement.shape == plan.voltage.shape == (plan.time.size, 2)
    moved = np.column_stack([shown(actuator, part) for actuator, part in zip(stage.actuators, plan.each, strict=True)])
    reached = moved @ stage.coupling.T
    assert np.abs(reached - wanted).max() < 5e-4 * plain_records.STROKE


def test_a_path_keeps_its_speed_and_jumps_keep_that_of_the_records():
    fast = plain_records.STROKE * (0.5 - 0.3 * np.cos(2 * np.pi * TIME / 0.15))
    for start in (PLANT.state, None):
        plan = plan_path(PLANT, fast, time=TIME, start=start)
        speed = np.abs(np.diff(plan.voltage) / np.diff(plan.time))
        assert plan.first and speed[: plan.first].max() <= 200.0 * (1 + 1e-6) < speed[plan.first :].max()
        assert not plan.failure and plan.missed == 0


@pytest.mark.parametrize(("share", "loud"), [(0.999, False), (0.5, True)])
def test_a_warning_in_capitals_means_an_error_above_the_promise(share, loud):
    given = {"time": TIME, "start": turned(LATE, float(WANTED[0]))}
    free = plan_path(LATE, WANTED, **given)
    most = share * np.abs(np.diff(free.voltage[free.first :])).max() / STEP
    plan = plan_path(LATE, WANTED, **given, slew_rate=most)
    assert plan.clamped.any() and plan.missed > 0 and bool(plan.failure) == loud
    said, count = str(plan.warnings), plan.clamped[plan.first :].sum()
    assert ("CLAMPED" in said) == loud and f" {count} of {WANTED.size} " in said


def test_a_model_and_its_compensator_give_the_same_plan():
    stage = Stage((PLANT, replace(PLANT, name="other")))
    pairs = (
        (PLANT, Compensator(PLANT, (0, 250), 900.0), WANTED, (0, 250)),
        (stage, Compensator(stage, (0, 250), 900.0), np.column_stack([WANTED, WANTED[::-1]]), (0, 250)),
    )
    for model, compensator, wanted, limits in pairs:
        plan = plan_path(model, wanted, time=TIME, limits=limits, slew_rate=900.0)
        np.testing.assert_array_equal(plan.voltage, plan_path(compensator, wanted, time=TIME).voltage)
        with pytest.raises(ModelError, match="limits: got"):
            plan_path(compensator, wanted, time=TIME, limits=limits)
    for wrong in (None, WANTED, "model.json"):
        with pytest.raises(ModelError, match="model"):
            plan_path(wrong, WANTED, time=TIME)
