"""What an unknown start leaves open: the possible states bound every history, and a homing before a path closes it."""

from dataclasses import replace

import numpy as np
import plain_records
import pytest
import structured_records

from dehyst import Compensator, DisplacementCreep, Dynamics, ModelError, RecordError, Stage, Thermal
from dehyst.control import PossibleStart, plan_path, wave_table
from dehyst.control.planning.path import plan_voltage
from dehyst.control.planning.start import model_error
from dehyst.model import SmoothSlip, apply, needs_time, standing, turned, with_identification
from dehyst.waveforms import Triangle

LIMITS = -40.0, 260.0
STROKE = plain_records.STROKE
PLAIN = replace(plain_records.plant(6), limits=LIMITS)
CREEPING = replace(PLAIN, displacement_creep=DisplacementCreep([2.0, 30.0, 200.0], [0.01, 0.02, 0.02]))
GRADED = replace(structured_records.plant(structured_records.STRUCTURES["graded, transformer"]).actuator, limits=LIMITS)
ACTUATORS = {
    "plain": PLAIN,
    "graded, transformer": GRADED,
    "creep": CREEPING,
    "inertia": replace(PLAIN, dynamics=Dynamics(95.5, 0.05)),
}


def history(actuator, rng, present):
    """Return a state that voltages within the limits may have led to, the last one the present voltage."""
    turns = np.append(rng.uniform(*LIMITS, 9), present)
    turns[rng.integers(0, 9, 3)] = rng.choice(LIMITS, 3)
    time = np.cumsum(rng.choice([0.5, 5.0, 1e4], turns.size))
    still = replace(actuator, dynamics=None, state=None)
    # The long first rest lets creep forget what no voltage led to.
    state = still.simulate(turns, time=time, state=turned(still, 0.5 * STROKE)).state
    if actuator.dynamics is None:
        return state
    return replace(state, motion=[state.deformation, 0.0])


def way(rng, size, limits=LIMITS):
    """Return a slow voltage through random turns, and its time."""
    at = np.sort(rng.choice(np.arange(1, size - 1), 4, replace=False))
    return np.interp(np.arange(size), [0, *at, size], rng.uniform(*limits, 6)), np.arange(size) * 0.1


@pytest.mark.parametrize("name", ACTUATORS)
def test_the_possible_states_bound_every_history(name):
    actuator, rng = ACTUATORS[name], np.random.default_rng(3)
    voltage, time = way(rng, 300)
    error = PossibleStart.unknown(actuator, float(voltage[0])).error_along(actuator, voltage, time=time)
    for _ in range(30):
        state = history(actuator, rng, float(voltage[0]))
        y = actuator.simulate(voltage, time=time, state=state).displacement
        # The order is that of the electrical side: a mass rings a little about it.
        slack = (1e-9 if actuator.dynamics is None else 1e-6) * STROKE
        assert np.all((error.lowest - slack <= y) & (y <= error.highest + slack))


@pytest.mark.parametrize("name", ACTUATORS)
@pytest.mark.parametrize("present", [None, 70.0])
def test_after_the_homing_the_path_is_followed_from_any_history(name, present):
    """Also by what the report says: the start then leaves less than the model's error."""
    actuator, rng = ACTUATORS[name], np.random.default_rng(5)
    time = np.arange(400) * 0.05
    wanted = STROKE * (0.5 - 0.3 * np.cos(2 * np.pi * time / 5))
    homed = plan_path(Compensator(actuator, slew_rate=500.0), wanted, time=time, present=present, home=True)
    assert homed.certified and not homed.failure and not homed.error.matters and not homed.clamped.any()
    assert homed.voltage[0] == (0.0 if present is None else present)
    first = homed.first
    assert np.array_equal(homed.displacement[first:], wanted)
    assert np.all(np.diff(homed.phase) >= 0) and np.count_nonzero(homed.phase == 2) == wanted.size
    np.testing.assert_allclose(homed.time[first:], homed.seconds + time, atol=1e-9)
    assert np.all(np.diff(homed.time) > 0)
    assert np.abs(np.diff(homed.voltage) / np.diff(homed.time)).max() <= 500 * (1 + 1e-6)
    assert homed.voltage.min() >= LIMITS[0] and homed.voltage.max() <= LIMITS[1]
    for _ in range(10):
        state = history(actuator, rng, float(homed.voltage[0]))
        when = homed.time
        y = actuator.simulate(homed.voltage, time=when, state=state).displacement[first:]
        assert np.abs(y - wanted).max() <= model_error(actuator)


@pytest.mark.parametrize("present", [(None, None), (0.0, 70.0), (20.0, None)])
def test_an_axis_with_a_shorter_homing_waits_before_it_at_its_present_voltage(present):
    """The homing makes the state known: nothing may come between it and the path."""
    time = np.arange(400) * 0.05
    stage, slews = Stage((CREEPING, PLAIN), [[1.0, 0.03], [-0.05, 1.0]]), (100.0, 200.0)
    wanted = STROKE * np.column_stack([0.5 - 0.3 * np.cos(time), 0.5 - 0.2 * np.cos(2 * time)])
    loop = Compensator(stage, slew_rate=slews)
    paths = plan_path(loop, wanted, time=time, home=True, present=present).each
    first, when = paths[0].first, paths[0].time
    own = apply(stage.decoupling, wanted)[:, 1]
    alone = plan_path(Compensator(PLAIN, slew_rate=200.0), own, time=time, home=True, present=present[1])
    waits = paths[1].seconds - alone.seconds
    assert waits > 100 and alone.seconds < 20
    rows = when < when[0] + waits - 1e-6
    assert np.all(paths[1].voltage[rows] == (present[1] or 0.0)) and paths[0].voltage[0] == (present[0] or 0.0)
    # Then it is homed as if it were alone, until the path begins.
    np.testing.assert_allclose(
        paths[1].voltage[~rows], np.interp(when[~rows] - when[0] - waits, alone.time, alone.voltage), atol=1e-6
    )
    for path, slew in zip(paths, slews, strict=True):
        assert np.abs(np.diff(path.voltage) / np.diff(when)).max() <= slew * (1 + 1e-6)
        assert path.voltage.min() >= LIMITS[0] and path.voltage.max() <= LIMITS[1] and path.certified
    homings = [path.phase == 0 for path in paths]
    np.testing.assert_array_equal(*homings)
    # It ends when the last axis is homed.
    assert when[homings[0]][-1] >= when[0] + waits + alone.time[alone.phase == 0][-1] - 1e-6
    # The expectation is the motion of the plant with these voltages, with all coupling.
    moved = [
        plant.simulate(path.voltage, time=when, state=standing(plant, float(path.voltage[0]), LIMITS)).displacement
        for plant, path in zip(stage.actuators, paths, strict=True)
    ]
    moved = apply(stage.coupling, np.column_stack(moved))
    for j, path in enumerate(paths):
        np.testing.assert_allclose(path.expected[:first], moved[:first, j], atol=1e-12)
        np.testing.assert_allclose(path.expected[first:], moved[first:, j], atol=path.error.model_error)


def test_without_a_homing_a_path_begins_at_the_present_voltage_if_one_is_given():
    loop, time = Compensator(PLAIN, slew_rate=100.0), np.arange(400) * 0.05
    wanted = STROKE * (0.5 - 0.3 * np.cos(time))
    for home in (False, None):
        # A model whose error is larger than what the start leaves open is not homed by default either.
        coarse = PLAIN if home is False else with_identification(PLAIN, largest_error=STROKE)
        plan = plan_path(Compensator(coarse, slew_rate=100.0), wanted, time=time, home=home, present=20.0)
        assert plan.homing is None and plan.voltage[0] == 20.0 and set(plan.phase) == {1, 2} and not plan.clamped.any()
        assert np.abs(np.diff(plan.voltage) / np.diff(plan.time)).max() <= 100.0 * (1 + 1e-9)
        rng = np.random.default_rng(2)
        for _ in range(10):
            y = PLAIN.simulate(plan.voltage, state=history(PLAIN, rng, 20.0)).displacement[plan.first :]
            slack = 1e-9 * STROKE
            assert np.all((plan.error.lowest - slack <= y) & (y <= plan.error.highest + slack))
    assert plan_path(loop, wanted, time=time, home=False).first == 0
    with pytest.raises(RecordError, match="present: got 900 V"):
        plan_path(loop, wanted, time=time, home=False, present=900.0)


def test_the_way_to_a_path_begins_within_reach():
    """The middle of the possible states at 0 V lies far below what voltages within the limits reach."""
    actuator = replace(plain_records.plant(6, share=0.9), limits=(0.0, plain_records.VOLTS))
    low, high = actuator.reach
    assert PossibleStart.unknown(actuator, actuator.limits[0]).state.deformation < low - (high - low)
    wanted = low + (high - low) * (0.5 - 0.3 * np.cos(np.linspace(0, 2 * np.pi, 200)))
    time, present = np.arange(200.0), actuator.limits[0]
    homed = plan_path(Compensator(actuator), wanted, time=time, home=True, present=present)
    table = wave_table(actuator, Triangle(low, high - 0.1 * (high - low), 0.1).path(), present=present).plan
    for path in (homed, table):
        before = path.displacement[path.phase < 1]
        assert before.size and before.min() >= low - 1e-9 and before.max() <= high + 1e-9
        assert np.array_equal(before, path.expected[path.phase < 1])


def test_possible_states_of_smooth_elements_and_creep_are_simulated():
    actuator = replace(CREEPING, smooth=SmoothSlip([1e-6, 5e-6], [1.0, 0.5], [2e6, 1e6]))
    assert len(PossibleStart.unknown(actuator, 20.0).states) > 10
    homed = plan_path(Compensator(actuator), np.linspace(3e-6, 9e-6, 100), time=np.arange(100.0), home=True)
    assert homed.error.percent(homed.error.largest) < 1


def test_a_known_history_reduces_the_possible_states():
    wide = PossibleStart.after(PLAIN, [0.0, 260.0, -40.0, 50.0])
    narrow = PossibleStart.after(PLAIN, [0.0, 30.0, 10.0])
    assert np.ptp([state.deformation for state in wide.states]) < 1e-9 * STROKE
    assert np.ptp([state.deformation for state in narrow.states]) > 0.01 * STROKE
    with pytest.raises(ModelError, match="got no samples"):
        PossibleStart.after(PLAIN, [])


def test_the_error_of_a_plan_contains_that_of_the_identification():
    assert model_error(PLAIN) == pytest.approx(1e-3 * np.ptp(PLAIN.reach))
    assert model_error(with_identification(PLAIN, largest_error=5e-8)) == 5e-8


def test_a_path_is_homed_if_its_start_matters():
    time = np.arange(200) * 0.05
    wanted = STROKE * (0.5 - 0.3 * np.cos(2 * np.pi * time / 5))
    loop = Compensator(PLAIN, slew_rate=500.0)
    homed, unhomed = plan_path(loop, wanted, time=time), plan_path(loop, wanted, time=time, home=False)
    assert np.array_equal(homed.voltage, plan_path(loop, wanted, time=time, home=True).voltage) and homed.certified
    assert unhomed.error.matters and homed.homing is not None
    assert unhomed.homing is None and set(unhomed.phase) == {2} and not unhomed.start.known
    # From a known start the way to the first sample is left out if one step leads there.
    for name, slow in (("top", 500.0), ("top", None)):
        start = PossibleStart.named(PLAIN, name)
        plan = plan_path(Compensator(PLAIN, slew_rate=slow), wanted, time=time, start=start)
        assert plan.homing is None and plan.error.largest == 0 and (plan.first > 0) == (slow is not None)
        np.testing.assert_allclose(plan.expected[plan.first :], wanted, atol=1e-9 * STROKE)
    micro = plan_path(Compensator(PLAIN, slew_rate=500.0, units="um"), 1e6 * wanted, time=time, home=False)
    np.testing.assert_allclose(micro.voltage, unhomed.voltage, atol=1e-9)
    assert micro.error.largest == unhomed.error.largest


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("name", ACTUATORS)
def test_a_planned_path_has_the_gain_and_the_offset_of_its_compensator(name, known):
    """From its start the path is that of the steps, and what is expected is what the plant does with that scaling."""
    actuator, gain, offset = ACTUATORS[name], 1.07, 3e-7
    time = 0.01 * np.arange(300)
    wanted = STROKE * (0.5 + 0.2 * np.sin(3 * time))
    start = PossibleStart.named(actuator, "bottom") if known else None
    plain, loop = (Compensator(actuator, period=0.01) for _ in range(2))
    loop.scale(gain, offset)
    expected = plan_path(plain, wanted, time=time, start=start)
    planned = plan_path(loop, offset + gain * wanted, time=time, start=start)
    np.testing.assert_allclose(planned.voltage, expected.voltage, atol=1e-6)
    for column in ("displacement", "expected"):
        np.testing.assert_allclose(getattr(planned, column), offset + gain * getattr(expected, column), atol=1e-12)
    np.testing.assert_allclose(planned.error.lowest, offset + gain * expected.error.lowest, atol=1e-12)
    np.testing.assert_allclose(planned.error.difference, gain * expected.error.difference, atol=1e-12)
    # No time passes before the first sample of a path ahead, and a mass moves with it.
    if known and not needs_time(actuator):
        stepped = Compensator(actuator, period=0.01, state=start.state)
        stepped.scale(gain, offset)
        np.testing.assert_allclose(planned.voltage[planned.first :], stepped.run(offset + gain * wanted), atol=1e-9)
    assert loop.reach == pytest.approx(offset + gain * np.array(plain.reach), rel=1e-12)
    assert [bool(loop._straying(0, wanted + share * np.ptp(plain.reach))) for share in (0, 2)] == [False, True]
    seen = plan_voltage(loop, planned.voltage, time=planned.time, start=planned.start)
    if known and actuator.dynamics is None:
        np.testing.assert_allclose(seen.expected, planned.expected, atol=1e-12)


def test_a_path_is_planned_at_the_temperature_of_the_compensator():
    warm = replace(PLAIN, thermal=Thermal(4e-3, 1e-8, 20.0))
    loop, wanted = Compensator(warm, period=0.01), STROKE * (0.5 + 0.2 * np.sin(0.03 * np.arange(300)))
    expected = plan_path(loop, wanted, temperature=35.0)
    loop.scale(temperature=35.0)
    np.testing.assert_array_equal(plan_path(loop, wanted).voltage, expected.voltage)
    loop.scale(temperature=-5.0)
    np.testing.assert_array_equal(plan_path(loop, wanted, temperature=35.0).voltage, expected.voltage)
