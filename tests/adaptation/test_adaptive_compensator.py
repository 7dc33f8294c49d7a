"""The loop that learns: it follows ageing, believes no bad sensor, and keeps to limits and slew rate."""

import json
import math
import pickle
import warnings
from dataclasses import replace

import numpy as np
import plain_records
import pytest
from ageing_plant import LIMITS, PERIOD, PLANT, STROKE, TURNS, aged, cycle
from hypothesis import given, settings
from hypothesis import strategies as st

import dehyst
from dehyst import (
    AdaptiveCompensator,
    ClampWarning,
    Compensator,
    DisplacementCreep,
    ModelError,
    Stage,
    StageCompensator,
    State,
    Thermal,
)
from dehyst.adaptation import AdaptiveSnapshot, AdaptiveStageCompensator
from dehyst.adaptation.adaptive_compensator import _slow_loop


def lived(loop, cycles, *, age=lambda k: 0.0, sensor=lambda y, k, n: y, path=cycle):
    """Play cycles; return the largest error of each as a part of the stroke."""
    state, y, errors, count = None, None, [], 0
    for k in range(cycles):
        plant, error = aged(age(k / cycles)), []
        for wanted in path(k).tolist():
            count += 1
            measured = None if y is None else sensor(y, k, count)
            voltage = loop.step(wanted, measured) if isinstance(loop, AdaptiveCompensator) else loop.step(wanted)
            start = plant.turned(STROKE * TURNS[-1], rising=False) if state is None else state
            motion = plant.simulate([voltage], state=start)
            state, y = motion.state, float(motion.displacement[0])
            error.append(abs(y - wanted) / STROKE)
        errors.append(max(error))
    return np.array(errors)


def loop_of(kind=AdaptiveCompensator, actuator=PLANT, **options):
    start = PLANT.turned(STROKE * TURNS[-1], rising=False)
    return kind(actuator, LIMITS, period=PERIOD, state=start, warns=False, **options)


def test_without_a_measurement_it_is_the_compensator():
    plain, loop = loop_of(Compensator), loop_of()
    path = np.concatenate([cycle(k) for k in range(8)])
    assert [loop.step(y) for y in path] == [plain.step(y) for y in path]
    assert loop.voltage == plain.voltage
    assert not any(one.used for one in loop.log)


def test_a_model_that_is_true_stays_as_it_is():
    loop = loop_of()
    assert lived(loop, 20).max() < 1e-9
    assert loop.datum == pytest.approx(0, abs=1e-12)


def test_ageing_is_learnt():
    frozen, loop = loop_of(Compensator), loop_of()
    before, errors = lived(frozen, 60, age=float), lived(loop, 60, age=float)
    assert errors[-6:].mean() < 0.2 * before[-6:].mean()
    assert np.all(errors <= 1.2 * np.maximum(before, 0.005))
    slope, friction = loop.log[-1].slope, loop.log[-1].friction
    assert slope == pytest.approx(1 / 0.93, rel=0.03)
    assert friction == pytest.approx(1.25 / 0.93, rel=0.15)
    assert loop.actuator.slip.breakaway.tolist() == PLANT.slip.breakaway.tolist()


BEHIND = {
    "creep in displacement": {"displacement_creep": DisplacementCreep([0.05, 1.0], [0.02, 0.04])},
    "temperature": {"thermal": Thermal(4e-3, 3e-4 * STROKE, 20.0)},
}


def lived_behind(loop, parts, cycles, ages):
    """As `lived`, of a plant with parts behind its elements, which warms from 20 to 35 degrees Celsius."""
    thermal, errors = "thermal" in parts, []
    start = PLANT.turned(STROKE * TURNS[-1], rising=False)
    state, y, last = State(start.displacement, start.carts), None, loop.voltage
    for k in range(cycles):
        plant, error = replace(aged(ages * k / cycles), **parts), []
        warm = {"temperature": 20 + 15 * k / cycles} if thermal else {}
        for wanted in cycle(k).tolist():
            voltage = (
                loop.step(wanted, y, **warm) if isinstance(loop, AdaptiveCompensator) else loop.step(wanted, **warm)
            )
            motion = plant.simulate([last, voltage], time=[0.0, PERIOD], state=state, **warm)
            state, y, last = motion.state, float(motion.displacement[-1]), voltage
            error.append(abs(y - wanted) / STROKE)
        errors.append(max(error))
    return np.array(errors)


@pytest.mark.parametrize("name", BEHIND)
def test_parts_behind_the_elements_stay_while_the_weights_adapt(name):
    parts = BEHIND[name]
    model = replace(PLANT, **parts)
    assert lived_behind(loop_of(actuator=model), parts, 10, 0.0).max() < 1e-9
    frozen, loop = loop_of(Compensator, model), loop_of(actuator=model)
    before, errors = lived_behind(frozen, parts, 60, 1.0), lived_behind(loop, parts, 60, 1.0)
    assert errors[-6:].mean() < 0.2 * before[-6:].mean()
    assert np.all(errors <= 1.2 * np.maximum(before, 0.005))
    assert (loop.actuator.displacement_creep, loop.actuator.thermal) == (model.displacement_creep, model.thermal)
    again = loop_of(actuator=model)
    again.restore(AdaptiveSnapshot.from_dict(json.loads(json.dumps(loop.snapshot().as_dict()))))
    path = cycle(7).tolist()
    assert [again.step(y, y) for y in path] == [loop.step(y, y) for y in path]


def test_noise_does_no_harm():
    rng = np.random.default_rng(1)
    frozen, loop = loop_of(Compensator), loop_of()
    before = lived(frozen, 40, age=float)
    errors = lived(loop, 40, age=float, sensor=lambda y, k, n: y + 0.005 * STROKE * rng.normal())
    assert errors[-4:].mean() < 0.35 * before[-4:].mean()


def test_a_drift_of_the_sensors_zero_is_no_property_of_the_stage():
    loop = loop_of()
    errors = lived(loop, 40, sensor=lambda y, k, n: y + 0.02 * STROKE * n / 6400)
    assert errors.max() < 0.003
    assert loop.datum == pytest.approx(0.02 * STROKE, rel=0.15)


BAD = {
    "inverted": lambda y, k, n: STROKE - y,
    "stuck": lambda y, k, n: 5e-6,
    "absent": lambda y, k, n: math.nan,
    "saturated": lambda y, k, n: min(y, 0.2 * STROKE),
    "another axis": lambda y, k, n: STROKE * (0.5 + 0.4 * math.sin(0.37 * n)),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_sensor_is_not_believed(name):
    loop = loop_of()
    assert lived(loop, 12, sensor=BAD[name]).max() < 1e-9
    assert loop.log
    assert not any(one.used for one in loop.log)
    assert all(one.reason for one in loop.log)


def test_a_sensor_that_is_late_is_not_believed():
    loop, seen = loop_of(), []

    def late(y, k, n):
        seen.append(y)
        return seen[-4] if len(seen) > 3 else y

    assert lived(loop, 12, sensor=late).max() < 0.01
    assert sum(one.used for one in loop.log) <= 1
    assert any("late" in one.reason for one in loop.log)


def test_a_sensor_that_gets_late_costs_what_was_learnt_and_no_more():
    frozen, loop, seen = loop_of(Compensator), loop_of(), []

    def late(y, k, n):
        seen.append(y)
        return seen[-4] if k >= 20 else y

    before = lived(frozen, 32, age=lambda part: 1.0)
    errors = lived(loop, 32, age=lambda part: 1.0, sensor=late)
    assert errors[16:20].max() < 0.6 * before[16:20].max()
    assert np.all(errors[20:] <= 1.2 * before[20:])
    assert any("initial weights" in one.reason for one in loop.log[20:])


def test_a_path_below_a_breakaway_is_not_learnt():
    loop = loop_of()
    lived(loop, 8, age=lambda part: 1.0, path=lambda k: cycle(k, scale=0.02))
    assert not any(one.used for one in loop.log)


@pytest.mark.parametrize(
    ("age", "zero_drifts"), [(lambda part: part, True), (lambda part: 1.0, False)], ids=["slowly", "at once"]
)
def test_small_paths_then_a_large_one(age, zero_drifts):
    def path(k):
        return cycle(k, scale=0.25 if k < 30 else 1.0)

    before = lived(loop_of(Compensator), 40, age=age, path=path)
    errors = lived(loop_of(zero_drifts=zero_drifts), 40, age=age, path=path)
    assert np.all(errors[30:] <= 1.2 * before[30:])
    # The means of small cycles in two places determine the gain too, if the sensor keeps its zero.
    assert errors[-1] < (0.3 if zero_drifts else 0.05) * before[-1]


def test_an_offset_at_the_beginning_is_the_sensors():
    loop = loop_of()
    frozen = lived(loop_of(Compensator), 30, age=lambda part: 1.0)
    errors = lived(loop, 30, age=lambda part: 1.0)
    assert errors.max() <= frozen.max()
    assert loop.datum < -0.03 * STROKE


def test_a_true_model_with_a_noisy_sensor_is_kept():
    noise = np.random.default_rng(3)
    frozen = lived(loop_of(Compensator), 60)
    errors = lived(loop_of(), 60, sensor=lambda y, k, n: y + 0.005 * STROKE * noise.standard_normal())
    assert errors.max() < frozen.max() + 0.002


def test_a_clamped_voltage_is_not_learnt_from():
    loop = loop_of()
    loop = AdaptiveCompensator(PLANT, (40.0, 90.0), period=PERIOD, warns=False)
    lived(loop, 8, age=lambda part: 1.0)
    assert not any(one.used for one in loop.log)


def followed(loop, path, cycles, plant):
    """Follow a path (n,) again and again; return each cycle's standard deviation where the voltage is not clamped."""
    state, y, errors = PLANT.turned(STROKE * TURNS[-1], rising=False), None, []
    for _ in range(cycles):
        error = []
        for wanted in path.tolist():
            voltage = loop.step(wanted, y) if isinstance(loop, AdaptiveCompensator) else loop.step(wanted)
            motion = plant.simulate([voltage], state=state)
            state, y = motion.state, float(motion.displacement[0])
            error.append(y - wanted if LIMITS[0] < voltage < LIMITS[1] else math.nan)
        errors.append(float(np.nanstd(error)) / STROKE)
    return np.array(errors)


@pytest.mark.parametrize("samples", [40, 200])
def test_where_the_voltage_is_clamped_the_hysteresis_follows_the_sensor(samples):
    """A path to both ends of the reach, which the aged stage cannot reach any more."""
    low, high = PLANT.reach
    path = low + (high - low) * (0.5 - 0.5 * np.cos(2 * np.pi * np.arange(1, samples + 1) / samples))
    loop = loop_of()
    frozen, errors = (followed(one, path, 30, aged(1.0)) for one in (loop_of(Compensator), loop))
    assert loop.clamps[0] > 0
    assert errors[-1] < 0.05 * frozen[-1]
    (stroke, width), (aged_stroke, aged_width) = (
        _slow_loop(one, LIMITS) for one in (PLANT, replace(aged(1.0), limits=LIMITS))
    )
    gain = aged_stroke / stroke
    assert (loop.drift.gain, loop.drift.width) == pytest.approx((gain - 1, aged_width / width / gain - 1), abs=0.04)


def test_learning_can_be_switched_off():
    loop = loop_of()
    loop.learning = False
    plain = loop_of(Compensator)
    assert np.array_equal(lived(loop, 12, age=lambda part: 1.0), lived(plain, 12, age=lambda part: 1.0))
    assert loop.actuator is PLANT


def test_the_zero_of_a_sensor_that_keeps_it_is_learnt():
    """A stage that moves as a whole: with a sensor whose zero may drift it stays, else it is removed."""

    def moved(y, k, n):
        return y

    def path(k):
        return cycle(k)

    shifts = {}
    for zero_drifts in (True, False):
        loop = loop_of(zero_drifts=zero_drifts)
        lived(loop, 30, age=lambda part: part)
        shifts[zero_drifts] = abs(loop.datum)
    assert shifts[False] <= shifts[True] + 1e-12


def test_integral_action_removes_an_offset_and_stands_still_without_a_sensor():
    shifted = loop_of(integral_time=0.02)
    lived(shifted, 6, sensor=lambda y, k, n: y - 0.02 * STROKE)
    assert shifted._correction == pytest.approx(0.02 * STROKE, rel=0.1)
    before = shifted._correction
    for wanted in cycle(0).tolist():
        shifted.step(wanted)
    assert shifted._correction == before


@pytest.mark.parametrize("warmth", [5.0, 35.0])
def test_integral_action_settles_at_the_wanted_displacement_whatever_the_temperature(warmth):
    """With a gain of 0.94 or 1.06, and a sensor with an offset."""
    plant, wanted = replace(PLANT, thermal=Thermal(-4e-3, 1e-9, 20.0)), 0.5 * STROKE
    loop, measured = loop_of(actuator=plant, integral_time=20 * PERIOD), None
    state = loop.state
    for _ in range(1000):
        voltage = loop.step(wanted, measured, warmth)
        motion = plant.simulate([voltage], temperature=warmth, state=state)
        state, measured = motion.state, float(motion.displacement[0]) + 0.02 * STROKE
    assert measured == pytest.approx(wanted, abs=1e-9 * STROKE)


@pytest.mark.parametrize("kind", [Compensator, AdaptiveCompensator, StageCompensator, AdaptiveStageCompensator])
@pytest.mark.parametrize("warned", [False, True])
def test_a_refused_step_at_a_new_temperature_changes_nothing(kind, warned):
    """Refused because a number is impossible, or by a warning that is an error."""
    warm = replace(PLANT, thermal=Thermal(-4e-3, 1e-9, 20.0))
    state, learns = PLANT.turned(0.5 * STROKE), kind in (AdaptiveCompensator, AdaptiveStageCompensator)
    if kind in (StageCompensator, AdaptiveStageCompensator):
        many, loop = 2, kind(Stage((warm, warm)), period=PERIOD, limits=[LIMITS] * 2, states=[state] * 2)
    else:
        integral = {"integral_time": 20 * PERIOD} if learns else {}
        many, loop = 1, kind(warm, LIMITS, period=PERIOD, state=state, **integral)

    def values(number):
        return number if many == 1 else [number] * many

    def numbers():
        found = [one.as_dict() for one in np.atleast_1d(np.array(loop.snapshot(), dtype=object)).tolist()]
        for one in found:
            # Refusals are counted.
            one.get("loop", one)["counts"].pop()
        return found

    def step(wanted, warmth):
        seen = (values(0.48 * STROKE),) if learns else ()
        return loop.step(values(wanted), *seen, temperature=warmth)

    for _ in range(3):
        step(0.5 * STROKE, 30.0)
    before = numbers()
    with warnings.catch_warnings():
        warnings.simplefilter("error", ClampWarning)
        for wanted, warmth in [(3 * STROKE, 40.0)] if warned else [(math.nan, 40.0), (0.4 * STROKE, 1e4)]:
            with pytest.raises(ClampWarning if warned else ModelError):
                step(wanted, warmth)
            assert numbers() == before
    step(0.5 * STROKE, 40.0)
    assert numbers() != before


def test_snapshots_continue_bit_for_bit(tmp_path):
    loop = loop_of()
    lived(loop, 10, age=lambda part: part)
    snapshot = loop.snapshot()
    snapshot.save(tmp_path / "loop.json")
    other, same = loop_of(), loop_of()
    other.restore(AdaptiveSnapshot.load(tmp_path / "loop.json"))
    same.restore(pickle.loads(pickle.dumps(snapshot)))
    assert np.array_equal(other.actuator.slip.stiffness, loop.actuator.slip.stiffness)
    assert lived(other, 6, age=lambda part: 1.0).tolist() == lived(same, 6, age=lambda part: 1.0).tolist()
    assert json.loads(json.dumps(snapshot.as_dict())) == snapshot.as_dict()
    with pytest.raises(ModelError, match="another actuator"):
        AdaptiveCompensator(replace(plain_records.plant(8, seed=4), limits=LIMITS), period=PERIOD).restore(snapshot)


def memory_of(loop):
    return json.dumps(loop.snapshot().as_dict())


def test_a_snapshot_of_another_loop_changes_nothing():
    """Of another period, of an actuator with as many elements, and from outside the limits."""
    donor = AdaptiveCompensator(PLANT, LIMITS, period=2 * PERIOD, warns=False)
    lived(donor, 8, age=lambda part: part)
    stiff = replace(PLANT, slip=replace(PLANT.slip, stiffness=1.2 * PLANT.slip.stiffness))
    outside = AdaptiveCompensator(PLANT, (LIMITS[0] - 90, LIMITS[1]), period=PERIOD, warns=False)
    outside.step(-STROKE)
    for other in (donor, loop_of(actuator=stiff), outside):
        loop = loop_of()
        lived(loop, 3)
        before, gain = memory_of(loop), loop.drift.gain
        with pytest.raises(ModelError):
            loop.restore(other.snapshot())
        assert (memory_of(loop), loop.drift.gain) == (before, gain)
    loop.restore(loop_of().snapshot())
    assert loop.log == ()


def test_impossible_arguments_are_refused():
    for options in ({"memory": 0.5}, {"memory": math.nan}, {"time_constant": -1.0}, {"integral_time": 0.0}):
        with pytest.raises(ModelError) as caught:
            loop_of(**options)
        assert caught.value.argument == next(iter(options))
    with pytest.raises(ModelError, match="period"):
        AdaptiveCompensator(PLANT, LIMITS, integral_time=1.0)
    loop = loop_of()
    before = loop.step(5e-6)
    for wanted, measured in ((math.nan, 0.0), (5e-6, "far")):
        with pytest.raises(ModelError):
            loop.step(wanted, measured)
    assert loop.voltage == before


def test_units_are_those_of_both_displacements():
    metres, microns = loop_of(), loop_of(units="um")
    state, y = PLANT.turned(STROKE * TURNS[-1], rising=False), None
    for wanted in np.concatenate([cycle(k) for k in range(5)]).tolist():
        voltage = metres.step(wanted, y)
        assert microns.step(wanted * 1e6, None if y is None else y * 1e6) == pytest.approx(voltage, rel=1e-9)
        motion = aged(1.0).simulate([voltage], state=state)
        state, y = motion.state, float(motion.displacement[0])
    assert microns.datum == pytest.approx(1e6 * metres.datum, rel=1e-6, abs=1e-9)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["nan", "stuck", "inverted", "late", "wild", "good"]), st.booleans())
def test_no_voltage_leaves_limits_or_slew_rate_whatever_the_sensor_says(seed, kind, integral):
    rng = np.random.default_rng(seed)
    low, high = np.sort(rng.uniform(-20, 220, 2))
    high += 5.0
    slew = float(10 ** rng.uniform(2, 5))
    loop = AdaptiveCompensator(
        PLANT, (low, high), slew, period=PERIOD, warns=False, memory=2.0, integral_time=0.01 if integral else None
    )
    plant, before, seen = aged(1.0), loop.voltage, [0.0]
    state = plant.turned(STROKE / 2)
    for wanted in np.concatenate([cycle(k) for k in range(6)]).tolist():
        measured = {
            "nan": math.nan,
            "stuck": 4e-6,
            "inverted": STROKE - seen[-1],
            "late": seen[max(-9, -len(seen))],
            "wild": float(rng.choice([1e30, -1e30, math.inf, seen[-1]])),
            "good": seen[-1],
        }[kind]
        voltage = loop.step(wanted, measured)
        assert low <= voltage <= high
        assert abs(voltage - before) <= slew * PERIOD * (1 + 1e-9) + 1e-12
        motion = plant.simulate([voltage], state=state)
        state, before = motion.state, voltage
        seen.append(float(motion.displacement[0]))


def test_it_is_offered_by_the_package():
    assert dehyst.AdaptiveCompensator is AdaptiveCompensator
    assert "exchanges" in repr(loop_of())


def test_cycles_that_are_played_as_a_whole_are_planned_committed_and_learnt():
    loop, plain = loop_of(memory=3.0), loop_of(Compensator)
    state, errors = PLANT.turned(STROKE * TURNS[-1], rising=False), []
    before = lived(loop_of(Compensator), 40, age=float)
    for k in range(40):
        wanted = cycle(k)
        begun = loop.snapshot().loop
        voltage = loop.plan(wanted)
        assert loop.snapshot().loop.as_dict() == begun.as_dict()
        if not k:
            assert voltage.tolist() == plain.run(wanted).tolist()
        motion = aged(k / 40).simulate(voltage, state=state)
        state = motion.state
        loop.learn(wanted, voltage, motion.displacement)
        assert loop.voltage == voltage[-1]
        errors.append(np.abs(motion.displacement - wanted).max() / STROKE)
    assert len(loop.log) == 40
    assert np.mean(errors[-4:]) < 0.2 * before[-4:].mean()
    loops = [_slow_loop(one, LIMITS) for one in (PLANT, aged(1))]
    (stroke, width), (stroke_now, width_now) = loops
    assert loop.drift.gain == pytest.approx(stroke_now / stroke - 1, abs=0.04)
    assert loop.drift.width == pytest.approx(width_now / width * stroke / stroke_now - 1, abs=0.03)


def test_a_cycle_with_unequal_columns_or_impossible_voltages_is_refused():
    loop, wanted = loop_of(), cycle(0)
    for columns in ((wanted, wanted[1:], wanted), (wanted[:9],) * 3):
        with pytest.raises(ModelError) as caught:
            loop.learn(*columns)
        assert caught.value.argument == "measured"
    voltage, before = loop.plan(wanted), memory_of(loop)
    far, nothing = voltage.copy(), np.full(wanted.size, math.nan)
    far[-1] = 1e4
    for columns in ((wanted, far, wanted), (nothing, voltage, wanted), (wanted, nothing, wanted)):
        with pytest.raises(ModelError):
            loop.learn(*columns)
    with pytest.raises(ModelError) as caught:
        loop.plan(wanted, pause=-3.0)
    assert caught.value.argument == "pause" and memory_of(loop) == before


def test_a_refused_plan_takes_no_time():
    """A model that creeps would go on creeping during the pause before it."""
    loop = loop_of(actuator=replace(PLANT, displacement_creep=DisplacementCreep([1.0, 30.0], [0.02, 0.02])))
    lived(loop, 1)
    before = memory_of(loop)
    with pytest.raises(ModelError):
        loop.plan(np.full(40, math.nan), pause=5.0)
    assert memory_of(loop) == before
