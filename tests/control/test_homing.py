"""A homing leads from any state to a known state, through the limits or the range of the records."""

from dataclasses import replace

import numpy as np
import plain_records
import pytest

from dehyst import Actuator, DisplacementCreep, Dynamics, MaxwellSlip, ModelError, RecordError, Spring, plan_path
from dehyst.control import Compensator, shortest_homing
from dehyst.model import with_identification
from dehyst.records.events import counted_events
from dehyst.waveforms import Sampling
from examples import at_night

PLANT = plain_records.plant(10, seed=4)


CREEPING = with_identification(
    replace(PLANT, displacement_creep=DisplacementCreep([20.0], [0.02]), limits=(0.0, 260.0)), slew_rate=200.0
)


def test_wider_limits_are_used_only_if_the_range_of_the_records_is_too_narrow():
    enough, narrow = replace(PLANT, limits=(0.0, 260.0)), replace(PLANT, limits=(50.0, 90.0))
    assert max(shortest_homing(enough, limits=(-100, 400)).turns) == 260.0
    assert shortest_homing(narrow, limits=(-100, 400)).certified
    assert max(shortest_homing(narrow, limits=(-100, 400)).turns) == 400.0


def test_a_homing_does_not_use_more_time_than_it_needs():
    needed = shortest_homing(CREEPING)
    assert shortest_homing(CREEPING, within=10 * needed.played.duration).played.duration == needed.played.duration


def test_a_plan_names_an_assumed_start_other_than_0_volts():
    wanted, time = np.linspace(0.6, 0.7, 50) * plain_records.STROKE, 0.1 * np.arange(50)
    for present, said in ((None, 1), (50.0, 0)):
        plan = plan_path(PLANT, wanted, time=time, limits=(50, 260), home=True, present=present)
        assert plan.voltage[0] == 50.0 and sum("ramp there first" in words for words in plan.warnings) == said


def test_limits_that_are_too_narrow_are_remarked():
    homing = shortest_homing(PLANT, limits=(0, 100))
    assert not homing.certified and "wider limits" in homing.remarks[0]


def test_a_known_state_needs_no_homing():
    none = shortest_homing(Actuator(MaxwellSlip([], []), Spring([0, 1e-5], [0, 100])), limits=(0, 100))
    assert none.turns == (0.0,) and none.certified


@pytest.mark.parametrize("seconds", [2.0, 5.0, 20.0, 60.0])
def test_a_homing_takes_no_longer_than_is_allowed(seconds):
    drive = Sampling(0.1, 100.0, slew_rate=2000.0)
    homing = shortest_homing(CREEPING, drive=drive, within=seconds)
    assert homing.played.duration <= seconds + 0.021
    assert homing.spread > shortest_homing(CREEPING, drive=drive).spread


@pytest.mark.parametrize("wanted", [np.linspace(0.3, 0.6, 50), np.linspace(0.95, 0.1, 50)])
def test_the_least_time_that_a_refused_homing_names_suffices(wanted):
    time, actuator = 0.02 * np.arange(50), with_identification(CREEPING, slew_rate=100.0)
    given = actuator, wanted * plain_records.STROKE
    needs = set()
    for within in (0.1, 2.0, 3.0):
        with pytest.raises(RecordError) as refused:
            plan_path(*given, time=time, home=True, home_within=within)
        assert refused.value.argument == "home_within"
        needs.add(refused.value.need)
    (need,) = needs
    least = float(need.split()[0])
    assert 0.99 * least <= plan_path(*given, time=time, home=True, home_within=least).seconds <= least


def test_limits_that_a_path_does_not_need_have_no_effect_on_its_homing():
    wanted, time = np.linspace(0.3, 0.6, 200) * plain_records.STROKE, np.arange(200) * 0.02
    plans = [plan_path(CREEPING, wanted, time=time, limits=limits) for limits in (None, (-100, 260), (-300, 800))]
    for plan in plans[1:]:
        np.testing.assert_array_equal(plan.voltage, plans[0].voltage)
        assert plan.promise == plans[0].promise and plan.error.largest == plans[0].error.largest
    far = plan_path(CREEPING, 1.1 * plain_records.STROKE + 0 * wanted, time=time, limits=(-300, 800))
    assert far.seconds > plans[0].seconds


@pytest.mark.parametrize(("step", "within"), [(1e-3, None), (1e-4, None), (1e-4, 15.0)])
def test_rows_of_a_homing_are_near_in_voltage_and_on_its_straight_lines(step, within):
    path = np.linspace(0.3, 0.6, 2000) * plain_records.STROKE
    actuator = replace(CREEPING, displacement_creep=DisplacementCreep([200.0], [0.02]))
    plan = plan_path(actuator, path, time=step * np.arange(path.size), home=True, home_within=within)
    played, before = plan.homing.played, slice(np.count_nonzero(plan.phase == 0))
    time, voltage = plan.time[before], plan.voltage[before]
    assert np.abs(voltage - np.interp(time, played.time, played.voltage)).max() < 1e-11
    assert np.isin(played.time[:-1], time).all()
    steps, seconds = np.abs(np.diff(voltage)), np.diff(time)
    assert 5 * step < seconds[steps > 0].max() and steps.max() <= 1e-3 * 260.0
    assert np.abs(steps / seconds).max() <= 200.0 * (1 + 1e-6)
    # Rows of a hold stay far apart.
    assert len(time) < 2.5e4 and (within or seconds.max() == pytest.approx(1 / played.sample_rate))
    # A fringe is half of 633 nm.
    moved = plan.expected[before] / 316.4e-9
    when, count = counted_events(time, voltage, np.cos(2 * np.pi * moved), 1)
    assert np.ptp(count - np.interp(when, time, moved)) < 0.2


SWINGING = replace(CREEPING, dynamics=Dynamics(500.0, 0.02))


@pytest.mark.parametrize(
    ("actuator", "step"), [(CREEPING, 1e-6), (CREEPING, 0.02), (SWINGING, 1e-4), at_night(SWINGING, 1e-6)]
)
def test_a_homing_with_its_way_takes_at_most_the_given_time(actuator, step):
    wanted = np.linspace(0.3, 0.6, 200) * plain_records.STROKE
    loop, time = Compensator(actuator, period=step), np.arange(200) * step
    seconds = 0.5 * plan_path(loop, wanted, time=time).seconds
    plan = plan_path(loop, wanted, time=time, home_within=seconds)
    assert 0 < plan.homing.played.duration < plan.seconds <= seconds + 2 / plan.homing.played.sample_rate
    for bad in (0.0, -1.0, np.nan):
        with pytest.raises(ModelError, match="home_within"):
            plan_path(loop, wanted, time=time, home=bad < 0, home_within=bad)


@pytest.mark.parametrize(("name", "bad"), [("present", -1), ("tolerance", 0), ("within", -1), ("limits", None)])
def test_wrong_options_are_refused(name, bad):
    with pytest.raises(ModelError) as caught:
        shortest_homing(PLANT, **{"limits": (0, 100), name: bad})
    assert (caught.value.argument or "limits").endswith(name)
