"""A path on a rig, again and again: the model stays true while the actuator ages, within limits, and safely."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from calibration_listener import Heard

import dehyst
from dehyst import Creep, ModelError, RecordError, RigError
from dehyst.calibration import PathRun, TrackedPath
from dehyst.calibration.plan import ExcitationPlan
from dehyst.calibration.tracking import PathPlanner, SeenTemperature
from dehyst.instruments.simulated import SimulatedRig
from dehyst.virtual import AgeingActuator, AgeingCourse, PlayActuator
from dehyst.waveforms import raised_cosine

RATE, AGEING = 200.0, AgeingCourse(gain=-7, width=25, seconds=12)


@pytest.fixture(scope="module")
def model():
    time = 0.01 * np.arange(2400)
    tops = np.interp(time, np.arange(0, 26, 2), [0, 200, 0, 200, 0, 170, 0, 140, 0, 110, 0, 80, 0])
    record = dehyst.Record(time, tops, PlayActuator(seed=1).play(tops, time=time), name="new")
    return dehyst.identify(record, structure="maxwell_slip").actuator


def path_of(model, turns=(0.1, 0.85, 0.4, 0.7, 0.1), leg=60):
    low, high = model.reach
    rise = 0.5 - 0.5 * np.cos(np.pi * np.arange(leg) / leg)
    legs = [a + (b - a) * rise for a, b in pairwise(turns)]
    return low + (high - low) * np.concatenate(legs)


def rig_of(ageing=AGEING, creep=0.0, **options):
    return SimulatedRig(AgeingActuator(PlayActuator(seed=1, creep=creep), ageing), **options)


def lived(rig, model, cycles, **options):
    run = PathRun(rig, model, path_of(model), RATE, **options)
    return run, list(run.play(cycles))


def test_the_model_stays_true_while_the_actuator_ages(model):
    _, frozen = lived(rig_of(), model, 30)
    rig = rig_of()
    run, adapted = lived(rig, model, 30, adapt=True)
    before, after = (np.array([one.path.rms_percent for one in each]) for each in (frozen, adapted))
    assert after[-1] < 0.4 * before[-1]
    assert np.all(after <= 1.2 * before)
    drift = adapted[-1].drift
    assert drift.gain == pytest.approx(-0.07, abs=0.02)
    assert drift.width == pytest.approx(0.25, abs=0.1)
    assert adapted[-1].drift is not None
    assert frozen[-1].drift is None
    assert run.actuator.slip.stiffness.sum() > model.slip.stiffness.sum()
    bench = rig.instrument.axis
    assert bench.log.refused == 0
    assert (bench.log.lowest, bench.voltage) == (0.0, rig.safe)


def test_without_ageing_adaptation_does_no_harm(model):
    _, frozen = lived(rig_of(AgeingCourse()), model, 10)
    _, adapted = lived(rig_of(AgeingCourse()), model, 10, adapt=True)
    assert adapted[-1].path.rms_percent <= 1.05 * frozen[-1].path.rms_percent


def test_a_drift_of_the_sensor_is_reported_and_not_followed(model):
    _, found = lived(rig_of(AgeingCourse(offset=2, seconds=60)), model, 12, adapt=True)
    last = found[-1]
    reached = (last.path.reached - last.path.wanted).mean()
    assert last.drift.offset == pytest.approx(reached, rel=0.3)
    assert abs(last.drift.gain) < 0.02


def test_limits_and_slew_rate_of_the_rig_hold(model):
    rig = rig_of(limits=(0, 150), slew_rate=150)
    run, found = lived(rig, model, 4, adapt=True)
    assert run.limits == (0, 150)
    log = rig.instrument.axis.log
    assert log.highest <= 150
    assert log.steepest <= 150 * (1 + 1e-6)
    assert sum(one.clamped for one in found) > 0


def test_a_path_that_does_not_end_where_it_begins_gets_a_way_back(model):
    run = PathRun(rig_of(), model, path_of(model, (0.1, 0.8)), RATE)
    (one,) = run.play(1)
    assert one.path.wanted.size == 60
    assert one.record.displacement.size > 110
    assert np.abs(np.diff(one.record.voltage)).max() < 6
    assert one.path.largest_percent < 1


def test_a_wave_in_pieces_and_a_delay_are_matched_sample_by_sample(model):
    rig = rig_of(AgeingCourse(), record_points=97)
    _, found = lived(rig, model, 6, adapt=True)
    assert found[-1].path.rms_percent < 0.3
    assert not found[-1].reason.startswith("the sensor")


def test_an_actuator_creeps_on_while_the_device_prepares_the_next_wave(model):
    creeping = replace(model, creep=Creep([2.0], [0.1 * model.spring.slopes.mean()]))
    rig, found = SimulatedRig(creeping), []
    for one in PathRun(rig, creeping, path_of(creeping), RATE, adapt=True).play(8):
        found.append(one.path.largest_percent)
        rig._wait(1.5)
    assert found[1] > 0.1
    assert found[-1] < 0.1 * found[1]


def test_an_instrument_that_fails_is_brought_back(model):
    rig = rig_of()
    run, found = PathRun(rig, model, path_of(model), RATE, adapt=True), []
    with pytest.raises(RigError) as caught:
        for one in run.play(5):
            found.append(one)
            rig.instrument.axis.unplugged = True
    assert len(found) == 1
    assert "brought to" in " ".join(caught.value.__notes__)
    assert rig.instrument.axis.voltage == rig.safe


def test_a_listener_hears_each_wave(model):
    heard = Heard()
    run = PathRun(rig_of(), model, path_of(model), RATE)
    list(run.play(2, heard))
    assert heard.samples_of["repetition 1"] == heard.samples_of["repetition 2"] == 240


def test_what_cannot_be_followed_is_refused_before_anything_is_sent(model):
    low, high = model.reach
    cases = (
        (np.full(100, 5e-6), RecordError),
        (np.array([low, high]), RecordError),
        (1e3 * path_of(model), ModelError),
        ([np.nan] * 30, ModelError),
    )
    for path, error in cases:
        rig = rig_of()
        with pytest.raises(error):
            PathRun(rig, model, path, RATE)
        assert rig.instrument.axis.log.highest == 0
    with pytest.raises(ModelError):
        PathRun(rig_of(limits=(300, 400), device_limits=(0, 500)), model, path_of(model), RATE)


def test_the_rigs_temperature_is_used_in_the_loop_and_recorded(model):
    warming, thermal = AgeingCourse(gain=-7, seconds=12, kelvins=20), dehyst.Thermal(-0.07 / 20, 0.0, 20.0)
    _, unaware = lived(rig_of(warming), model, 20)
    aware = replace(model, thermal=thermal)
    for adapt in (False, True):
        run, found = lived(rig_of(warming), aware, 20, adapt=adapt)
        assert run.actuator.thermal == thermal
        assert found[-1].path.rms_percent < 0.4 * unaware[-1].path.rms_percent
        assert found[-1].record.temperature[-1] == pytest.approx(40.0)
        # What it warms along a repetition is planned too, and promised as long as it is not known.
        assert found[-1].path.rms_percent < 0.3
        assert all(np.abs(one.path.error).max() <= one.promised.bounds[1] for one in found)
        assert found[0].promised.bounds[1] > 1.5 * found[-1].promised.bounds[1]
    # Without a channel the reference is taken, or what is known of the path.
    warm = AgeingCourse(gain=-7, seconds=0.1)
    _, given = lived(rig_of(warm), aware, 2, temperature=np.full(240, 40.0))
    assert given[-1].path.rms_percent < 0.3
    _, given = lived(rig_of(replace(warm, kelvins=20)), aware, 2, temperature=np.full(240, -40.0))
    assert given[-1].path.rms_percent < 0.3
    _, blind = lived(rig_of(AgeingCourse(gain=-7, seconds=12)), aware, 20)
    assert blind[-1].path.rms_percent == pytest.approx(unaware[-1].path.rms_percent, rel=0.05)
    assert blind[-1].record.temperature is None


def test_what_an_aged_actuator_does_not_reach_any_more_is_promised(model):
    run = PathRun(
        rig_of(AgeingCourse(gain=-7, seconds=6)), model, path_of(model, (0.1, 0.99, 0.4, 0.7, 0.1)), RATE, adapt=True
    )
    found = list(run.play(20))
    for one in found[-5:]:
        missed = np.abs(one.path.error).max()
        assert one.clamped > 0
        assert 0.03 * run.stroke < missed <= one.promised.bounds[1] < 1.5 * missed


@pytest.mark.parametrize(
    ("others", "known"),
    [
        (("Chamber [degC]",), True),
        (("Temp_C",), True),
        (("load_N", "T_degF"), True),
        (("load_N",), False),
        (("attempts [%]",), False),
        (("temp_1_C", "temp_2_C"), False),
    ],
)
def test_a_temperature_is_found_as_in_records(model, others, known):
    rig = rig_of()
    rig.others = others
    assert PathRun(rig, model, path_of(model), RATE).measures_temperature == known
    record = dehyst.Record([0, 1], [0, 1], [0, 1], "", others={name: [20, 21] for name in others})
    assert (record.temperature is not None) == known


def test_what_the_sensor_shows_at_the_start_is_promised(model):
    """Creep from before the homing, and a zero that has moved: neither is in the errors on the records."""
    creeping = replace(model, creep=Creep([20.0], [0.05 * model.spring.slopes.mean()]))
    rig = SimulatedRig(creeping)
    rig.play(raised_cosine([200.0], cycles=1))
    rig.set_voltage(200.0)
    rig._wait(100.0)
    for one, truth in ((creeping, rig), (model, rig_of(AgeingCourse(offset=3, seconds=0.1)))):
        run = PathRun(truth, one, path_of(one), RATE)
        before, found = run.judged(), list(run.play(3))
        assert all(np.abs(one.path.error).max() <= one.promised.bounds[1] for one in found)
        assert found[0].promised.begins == "seen" != before.begins
    assert found[0].promised.start == pytest.approx(0.03 * model.stroke, rel=0.1)
    assert before.bounds[1] < 0.5 * np.abs(found[0].path.error).max()


@pytest.mark.parametrize("adapt", [False, True])
def test_errors_that_grow_with_age_are_promised_before_they_come(model, adapt):
    """Nine of ten repetitions keep the promise, which is not wide."""
    _, found = lived(rig_of(AgeingCourse(gain=6, width=20, seconds=30)), model, 24, adapt=adapt)
    missed = np.array([np.abs(one.path.error).max() for one in found])
    promised = np.array([one.promised.bounds[1] for one in found])
    assert np.count_nonzero(missed > promised) <= 2
    assert np.all(missed < 1.1 * promised)
    assert np.median(promised / missed) < 1.3
    rms = np.array([np.sqrt(np.mean(np.square(one.path.error))) for one in found])
    assert np.count_nonzero(rms > [one.promised.bounds[0] for one in found]) <= 2


def test_percentages_are_of_the_full_stroke(model):
    for limits in ((0.0, 200.0), (0.0, 150.0)):
        run = PathRun(rig_of(limits=limits), model, path_of(model, (0.1, 0.5, 0.1)), RATE)
        assert run.stroke == model.stroke == next(run.play(1)).path.stroke
    assert replace(model, identification=None).stroke == pytest.approx(np.ptp(model.reach))


def test_the_path_of_a_calibration_is_planned_at_the_measured_temperature(model):
    """While it warms by 20 K, by an eighth of that along the path."""
    truth = AgeingActuator(PlayActuator(seed=1), AgeingCourse(gain=-7, seconds=60, kelvins=20))
    rig, plan = SimulatedRig(truth), ExcitationPlan(0.0, 200.0, 400.0)
    rig._wait(30.0)
    planner = PathPlanner(plan.homing(), [rig.limits], plan.leg, ends=model.reach)
    aware, missed = replace(model, thermal=dehyst.Thermal(-0.07 / 20, 0.0, 20.0)), []
    for one in (model, aware):
        before = rig.play(planner.nominal(one).excitation)
        planned = planner.compensated(one, [before])
        reached = rig.play(planned.excitation)
        missed.append(TrackedPath.of(planned, reached, rig.rows(len(planned.excitation))).rms_percent)
    assert missed[0] > 1 and missed[1] < 0.25


def test_the_drift_of_a_temperature_goes_on_for_as_long_as_it_was_seen():
    time, noise = 0.1 * np.arange(100), np.random.default_rng(0).normal(0, 0.05, 100)
    for drift in (0.0, 0.2):
        degrees = 25 + drift * time + noise
        record = dehyst.Record(time, time, time, "", others={"temperature_C": degrees})
        seen = SeenTemperature.of(record)
        expected = degrees[-5:].mean() if not drift else 25 + drift * (9.9 + np.array([0.0, 5.0, 9.9, 9.9]))
        assert seen.after([0.0, 5.0, 9.9, 500.0]) == pytest.approx(expected, abs=0.1)
    assert SeenTemperature.of(dehyst.Record(time, time, time)) is None
