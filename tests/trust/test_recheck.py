"""A model beside later records of its virtual actuator: each change is found and named, and nothing else is."""

import shlex
from dataclasses import replace

import checked_loops as loops
import coupled_stage
import numpy as np
import plain_records
import pytest
import structured_records as wide
from command_line import run

import dehyst
from dehyst import Actuator, IdentifyError, Record, RecordError
from dehyst.model import MaxwellSlip, Spring, with_identification
from dehyst.trust import insight
from dehyst.trust.recheck import Standing
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, raised_cosine, recommended
from examples import at_night

STROKE = 16.152e-6


def of(recheck, name):
    return next(change for change in recheck.changes if change.name == name)


def creeping(rate):
    """A logarithm of the time since a tenth of the first cycle, `rate` [m] a decade."""
    return lambda time: rate * np.log10(1 + (time - time[0]) / (0.1 * 100.0))


CHANGED = {
    "gain": ({"gain": loops.GAIN}, loops.GAIN),
    "narrower gain": ({"gain": -loops.GAIN}, -loops.GAIN),
    "width": ({"width": loops.WIDTH}, loops.WIDTH),
    "zero": ({"offset": loops.OFFSET}, loops.OFFSET),
    "lag": ({"delay": loops.DELAY}, loops.DELAY),
    "large lag": ({"delay": 20.0}, 20.0),
    "creep": ({"slow": creeping(0.02 * STROKE)}, 0.02 * STROKE),
}


def at_lines(record):
    """The record at the lines of a grating alone."""
    known = np.append(False, np.diff(np.floor(record.displacement / 0.5e-6)) != 0)
    return replace(record, displacement=np.where(known, record.displacement, np.nan), measured=known)


@pytest.mark.parametrize("case", ["same", "gain", "width"])
def test_a_record_of_events_gets_the_same_judgement_as_all_samples(case):
    whole = loops.later(**CHANGED.get(case, ({},))[0])
    records, (path, _) = (whole, at_lines(whole)), loops.record_loops()
    full, found = (dehyst.update(loops.model(), record) for record in records)
    assert found.recheck.standing is full.recheck.standing
    assert [change.name for change in found.recheck.changed] == [change.name for change in full.recheck.changed]
    assert abs(found.recheck.largest - full.recheck.largest) < 2e-3 * STROKE
    assert np.abs(np.subtract(found.held_out, full.held_out)).max() < 2e-3 * STROKE
    misfits, own = [insight(loops.model(), record).misfit for record in records], {"own": lambda _: loops.model()}
    scores = [dehyst.compare(path, validate=record, models=own).rows[0].worst("validation").rms for record in records]
    assert abs(np.diff(misfits)) < 2e-3 * STROKE and abs(np.diff(scores)) < 0.1


@pytest.mark.parametrize("case", CHANGED)
@pytest.mark.parametrize("seed", [1, at_night(2), at_night(3)])
def test_each_change_is_found_without_false_changes(case, seed):
    changes, size = CHANGED[case]
    recheck = dehyst.check(loops.model(), loops.later(seed, **changes))
    name = case.split()[-1]
    assert not recheck.mismatch and [change.name for change in recheck.changed if change.name != "shape"] == [name]
    found = of(recheck, name)
    assert abs(found.value - size) < 3 * found.error < 0.75 * abs(size)


def test_the_error_after_the_named_changes_is_stated():
    truth, record = PlayActuator(plays=loops.PLAYS), loops.later()
    truth._thresholds *= 1.15
    recheck = dehyst.check(loops.model(), replace(record, displacement=truth.play(record.voltage)))
    assert [change.name for change in recheck.changed] == ["width", "shape"]
    assert recheck.promise.rms < of(recheck, "shape").value < recheck.rms


def test_width_and_lag_are_not_distinguished_on_smooth_loops_of_one_height(tmp_path):
    recheck = dehyst.check(loops.model(), loops.later(tops=[200.0], width=0.6))
    assert {"width", "lag"} <= set(recheck.changed[0].parts) and len(recheck.changed) == 2
    assert recheck.to_record in recheck.change_sentences()[0]
    assert run(*shlex.split(recheck.to_record)[1:], cwd=tmp_path)[0] == 0


@pytest.mark.parametrize("seed", [*range(6), *map(at_night, range(6, 20))])
def test_an_unchanged_actuator_is_still_true(seed):
    recheck = dehyst.check(loops.model(), loops.later(100 + seed))
    assert recheck.standing is Standing.STILL_TRUE
    assert recheck.changed == ()
    assert recheck.without_noise < 1e-3 * STROKE


def test_two_changes_are_distinguished():
    recheck = dehyst.check(loops.model(), loops.later(gain=loops.GAIN, offset=-loops.OFFSET, width=-loops.WIDTH))
    assert {change.name for change in recheck.changed} >= {"gain", "width"}
    assert "zero" in {part for change in recheck.changed for part in change.parts}
    for name, size in (("gain", loops.GAIN), ("zero", -loops.OFFSET), ("width", -loops.WIDTH)):
        assert abs(of(recheck, name).value - size) < 3 * of(recheck, name).error
    effects = [abs(change.effect) for change in recheck.changed]
    assert effects == sorted(effects, reverse=True)


def test_a_record_shorter_than_the_delay_is_refused_with_both_durations():
    with pytest.raises(IdentifyError, match=r"later-1.*1e\+04"):
        dehyst.check(replace(loops.model(), delay=1e4), loops.later())


@pytest.mark.parametrize("goal", [0.01, 1.0, 5.0])
@pytest.mark.parametrize(
    ("changes", "learnt"), [({}, False), ({"gain": loops.GAIN}, True), ({"delay": loops.DELAY}, False)]
)
def test_the_judgement_agrees_with_the_promise_and_the_advice_helps(changes, learnt, goal):
    recheck = dehyst.check(loops.model(), loops.later(**changes), goal=goal)
    kept = recheck.without_noise <= recheck.promise.largest and recheck.rms_without_noise <= recheck.promise.rms
    within = recheck.without_noise <= goal / 100 * recheck.stroke
    expected = {
        (True, True): Standing.STILL_TRUE,
        (True, False): Standing.WITHIN_GOAL,
        (False, True): Standing.NEVER_MET,
        (False, False): Standing.RECALIBRATE,
    }
    assert recheck.standing is expected[within, kept]
    assert (recheck.kept, recheck.good) == (kept, within)
    assert recheck.advises_update == (learnt and not kept)
    assert ("dehyst update" in recheck.sentence) == recheck.advises_update


def test_a_significant_change_gives_the_advice_even_if_the_promise_is_kept():
    recheck = dehyst.check(loops.model(), loops.later(gain=loops.GAIN))
    loose = replace(recheck.promise, largest=recheck.stroke, rms=recheck.stroke)
    kept = replace(recheck, promise=loose)
    assert kept.standing is Standing.NEVER_MET
    assert kept.advises_update
    assert not replace(kept, changes=()).advises_update
    for error in ("largest", "rms"):
        assert not replace(recheck, promise=replace(loose, **{error: recheck.rms_without_noise / 2.7})).kept


@pytest.mark.parametrize(("begin", "unjudged"), [(0, 50.0), (400, 0.0)])
def test_the_first_branch_is_judged_after_loops_through_the_range(begin, unjudged):
    record = loops.later(tops=[200.0, 200.0, 120.0])[begin:]
    wrong = 0.02 * STROKE * np.exp(-(((record.time - record.time[0] - 25) / 5) ** 2))
    recheck = dehyst.check(loops.model(), replace(record, displacement=record.displacement + wrong))
    assert (recheck.unjudged, recheck.as_dict()["kept"]) == (unjudged, unjudged > 0)


def test_the_goal_is_that_of_the_identification():
    model = loops.model()
    assert model.identification.goal == 1.0
    assert dehyst.check(model, loops.later()).goal == 1.0
    assert dehyst.check(with_identification(model, goal=2.5), loops.later()).goal == 2.5
    unknown = replace(model, identification=None)
    assert dehyst.check(unknown, loops.later(), goal=1e-3).standing is Standing.RECALIBRATE
    assert not of(dehyst.check(model, loops.later(gain=loops.GAIN), goal=10.0), "gain").counts


@pytest.mark.parametrize("name", ["plain", "graded", "transformer", "smooth", "all"])
def test_every_kind_of_model_is_still_true_on_its_own_record(name):
    plant = wide.plant(wide.STRUCTURES[name])
    record = plant.record(noise=1e-3 * plain_records.STROKE)
    recheck = dehyst.check(plant.actuator, record)
    assert recheck.standing is Standing.STILL_TRUE
    assert recheck.changed == ()
    record = replace(record, displacement=1.02 * record.displacement)
    found = of(dehyst.check(plant.actuator, record), "gain")
    assert found.counts and abs(found.value - 0.02) < 3 * found.error


@pytest.mark.parametrize("zero", [-1e-4, 1e-3, 1.0])
def test_a_distant_zero_of_the_sensor_is_accepted(zero):
    recheck = dehyst.check(loops.model(), loops.later(offset=zero))
    assert recheck.standing is Standing.STILL_TRUE
    assert [change.name for change in recheck.changed] == ["zero"]
    assert abs(of(recheck, "zero").value - zero) < 3 * of(recheck, "zero").error


def test_no_zero_is_stated_if_earlier_creep_moves_it():
    twice = raised_cosine([100.0], cycles=2, drive=Sampling(0.1, sample_rate=20.0))
    excitation = recommended(100.0, drive=Sampling(0.1, sample_rate=20.0))
    voltage = np.append(twice.voltage, excitation.voltage)
    time, truth = np.arange(voltage.size) / 20.0, PlayActuator(highest=100.0, plays=40, creep=0.01, seed=1)
    driven = Record(time, voltage, truth.play(voltage, time=time))[twice.voltage.size :]
    model = dehyst.identify(driven).actuator
    rested = PlayActuator(highest=100.0, plays=40, creep=0.01, seed=2).play(twice.voltage, time=twice.time)
    assert dehyst.check(model, Record(twice.time, twice.voltage, rested)).changed == ()


def test_a_narrow_record_gives_an_uncertain_zero():
    recheck = dehyst.check(loops.model(), loops.later(offset=loops.OFFSET, tops=[60.0, 40.0]))
    assert of(recheck, "zero").error > 3 * of(dehyst.check(loops.model(), loops.later()), "zero").error
    assert any("covers 30" in remark for remark in recheck.remarks)


@pytest.mark.parametrize(
    ("record", "options", "error"),
    [
        (loops.later()[:10], {}, RecordError),
        (loops.later()[:150], {}, RecordError),
        (replace(loops.later(), displacement=np.zeros(len(loops.later()))), {}, RecordError),
        ("record.csv", {}, IdentifyError),
        (loops.later(), {"goal": 0}, IdentifyError),
    ],
    ids=["few samples", "no cycle", "still", "a name", "no goal"],
)
def test_an_unusable_record_or_option_is_refused(record, options, error):
    with pytest.raises(error):
        dehyst.check(loops.model(), record, **options)


def test_a_check_as_json_has_all_numbers_and_no_traces():
    data = dehyst.check(loops.model(), record := loops.later(gain=loops.GAIN)).as_dict()
    assert data["standing"] == "RECALIBRATE"
    assert data["changed"] == ["gain"]
    assert data["changes"][0]["name"] == "gain"
    farthest = np.abs(record.displacement - record.displacement.mean()).max()
    assert data["changes"][0]["effect_percent"] == pytest.approx(100 * loops.GAIN * farthest / STROKE, rel=0.05)
    assert "trace" not in data


def test_a_record_of_no_actuator_has_changes_in_numbers():
    """A delay that would shift the loops out of the record is bounded."""
    time = 0.02 * np.arange(2000)
    voltage = np.round(50 + 45 * np.sin(2 * np.pi * time / 10))
    model = Actuator(MaxwellSlip([1e-7, 5e-7], [2e6, 1e6]), Spring([-2e-6, 0, 1.1e-5], [-20, 0.1, 95]), limits=(0, 90))
    recheck = dehyst.check(model, Record(time, voltage, 4e-5 * (50 + 45 * np.sin(2 * np.pi * time / 10))))
    assert recheck.mismatch
    assert all(np.isfinite([change.value, change.effect]).all() for change in recheck.changes)


TRAINING, _ = coupled_stage.excited()
OTHER = np.array([[0.0, 0.02], [0.0, 0.0]])


@pytest.fixture(scope="module")
def stage():
    return dehyst.identify(TRAINING, structure="maxwell_slip").stage


@pytest.mark.parametrize("gains", [(1.0, 1.0), (1.06, 0.95)])
def test_only_a_changed_coupling_is_reported(stage, gains):
    for coupling, count in ((coupled_stage.COUPLING, 0), (coupled_stage.COUPLING + OTHER, 1)):
        record, _ = coupled_stage.excited(5, coupling=coupling * np.array(gains))
        found = dehyst.check(stage, record)
        assert len(found.changes) == count
        assert np.all(np.abs(found.coupling - coupling) <= 3 * found.uncertainty)


def test_axes_that_move_together_do_not_determine_the_coupling(stage):
    both = TRAINING.voltage[:, :1] * np.array([1.0, 1.2])
    found = dehyst.check(stage, coupled_stage.played(TRAINING.time, both))
    assert np.all(np.isinf(found.uncertainty)) and found.changes == ()


def test_the_intervals_contain_the_coupling(stage):
    found = insight(stage, TRAINING)
    assert np.all((found.low <= coupled_stage.COUPLING) & (found.high >= coupled_stage.COUPLING))
    assert np.all(found.high - found.low < 0.002)
    assert not any("coupling" in remark and "known to" in remark for remark in found.remarks)
