"""One promise: for one question each command gives the same number to the digit, for another one other words."""

import json
import re
import shlex
from dataclasses import replace

import coupled_stage
import numpy as np
import pytest
from command_line import result, run
from scipy.ndimage import shift

from dehyst import Actuator, Record, identify
from dehyst.model import Validity, with_identification
from dehyst.model.branches import ExciteCommand, branches_of, paces_of
from dehyst.model.promise import promise
from dehyst.operations.paths import reason_of
from dehyst.records import read_table, write_columns, write_record
from dehyst.trust import check, insight
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, descending_tops, raised_cosine, recommended, staircase
from examples import at_night

TOP = 100.0


def tops(drive):
    return descending_tops(TOP, steps=6, drive=drive)


def recommend(drive):
    return recommended(TOP, drive=drive)


# Excitation, creep of the actuator, and what happens to time [s] and displacement [m] on their way into the record.
MODELS = {
    "recommended": (recommend, 0.0, None),
    "one sine": (lambda drive: raised_cosine([TOP], cycles=3, drive=drive), 0.0, None),
    "growing loops": (lambda drive: raised_cosine([20, 40, 60, 80, TOP], cycles=1, drive=drive), 0.0, None),
    "creep": (lambda drive: staircase(TOP, steps=5, hold=12, back=True, drive=drive), 0.01, None),
    "creep, no holds": (tops, 0.02, None),
    "lag": (recommend, 0.0, lambda y: shift(y, 1.5, order=1, mode="nearest")),
    "tops": (tops, 0.0, None),
    "three heights": (lambda drive: raised_cosine([TOP, 60, 30], cycles=2, drive=drive), 0.0, None),
    "noise": (recommend, 0.0, lambda y: y + 3e-8 * np.sin(1e3 * np.arange(y.size) ** 2)),
    "drift": (recommend, 0.0, lambda y: y + np.linspace(0, 3e-7, y.size)),
    "coarse": (recommend, 0.0, lambda y: 2e-8 * np.round(y / 2e-8)),
}


def answer(*arguments, cwd):
    return result(*arguments, cwd=cwd)[1]


@pytest.mark.parametrize("name", [name if name in ("recommended", "creep") else at_night(name) for name in MODELS])
def test_five_commands_print_the_same_promise(name, tmp_path):
    excite, creep, disturbed = MODELS[name]
    made = excite(Sampling(0.1, sample_rate=8.0))
    truth = PlayActuator(highest=TOP, plays=40, noise=2e-9, creep=creep)
    y = (disturbed or np.asarray)(truth.play(made.voltage, time=made.time))
    for file, gain in (("r.csv", 1.0), ("other.csv", 1.0001)):
        write_record(tmp_path / file, Record(made.time, made.voltage, gain * y, "r"))
    time = np.arange(0, 40, 0.1)
    write_columns(tmp_path / "path.csv", {"time_s": time, "displacement_um": 8 - 2 * np.cos(2 * np.pi * time / 10)})
    found = answer("identify", "r.csv", "-o", "m.json", cwd=tmp_path)
    model = Actuator.load(tmp_path / "m.json")
    own = json.loads(json.dumps(model.promise().as_dict()))
    assert own["path"] == "any path like the records"
    assert found["verdict"]["promise"] == own
    assert (found["verdict"]["largest_m"], found["verdict"]["rms_m"]) == (own["largest_m"], own["rms_m"])
    seen = [answer("insight", "m.json", file, cwd=tmp_path) for file in ("r.csv", "other.csv")]
    assert all(each["promise"] == own for each in seen)
    assert not seen[0]["origin"] and (seen[1]["origin"] or seen[1]["warnings"])
    # This path from a homed or from an unknown start.
    there = answer("compensate", "m.json", "path.csv", "-o", "v.csv", cwd=tmp_path)["promise"]
    assert answer("insight", "m.json", "r.csv", "--trajectory", "path.csv", cwd=tmp_path)["promise"] == there
    for more in (("--slew-rate", "2"), ("--zero", "1.5")):
        other = answer("compensate", "m.json", "path.csv", "-o", "s.csv", *more, cwd=tmp_path)["promise"]
        seen = answer("insight", "m.json", "r.csv", "--trajectory", "path.csv", *more, cwd=tmp_path)["promise"]
        assert seen == other != there
    # Both give the same answer to whether the voltages can follow a path.
    write_columns(
        tmp_path / "far.csv", {"time_s": time, "displacement_um": np.linspace(5, 1.02e6 * y.max(), time.size)}
    )
    far = ("compensate", "m.json", "far.csv", "-o", "f.csv"), ("insight", "m.json", "r.csv", "--trajectory", "far.csv")
    assert {run(*words, cwd=tmp_path)[0] for words in far} == {0 if name == "lag" else 1}
    assert there["path"] in ("this path from a homed start", "this path from an unknown start")
    assert there["largest_m"] == pytest.approx(sum(there["parts"].values()))
    # The path of the record, from its fitted start.
    checked = answer("check", "m.json", "r.csv", cwd=tmp_path)
    fitted = checked["promise"]
    assert checked["stroke_m"] == fitted["stroke_m"] == own["stroke_m"] == there["stroke_m"]
    assert fitted["path"] == "the whole record"
    assert fitted["largest_m"] == model.promise(made.voltage, made.time).largest
    # Any path like the records, of the model after the update.
    new = answer("update", "m.json", "r.csv", "-o", "n.json", cwd=tmp_path)["promise"]
    assert new == json.loads(json.dumps(Actuator.load(tmp_path / "n.json").promise().as_dict()))


@pytest.mark.nightly
def test_commands_print_the_same_promise_for_coupled_axes(tmp_path):
    write_record(tmp_path / "r.csv", coupled_stage.excited()[0])
    found = answer("identify", "r.csv", "--columns", "x=vx_V:x_um, y=vy_V:y_um", "-o", "m.json", cwd=tmp_path)
    seen = answer("insight", "m.json", "r.csv", cwd=tmp_path)["insights"]
    for axis, own in seen.items():
        assert own["promise"] == found["fits"][axis]["verdict"]["promise"]


def test_an_unusable_model_has_a_remark_and_status_1(tmp_path):
    made = raised_cosine([TOP], cycles=3, drive=Sampling(0.1, sample_rate=8.0))
    record = Record(made.time, made.voltage, PlayActuator(highest=TOP, plays=40).play(made.voltage), "r")
    write_record(tmp_path / "r.csv", record)
    fit = identify(record)
    write_columns(tmp_path / "path.csv", {"time_s": np.arange(4.0), "displacement_um": np.array([6.0, 8, 10, 7])})
    for rms, status, remarks in ((1e-9, 0, 0), (1e-6, 1, 1)):
        validity = replace(fit.actuator.identification.validity, rms=rms, disagreement=rms)
        with_identification(fit.actuator, validity=validity).save(tmp_path / "m.json")
        found, told = result("compensate", "m.json", "path.csv", "-o", "v.csv", cwd=tmp_path)
        assert (found, sum("not usable" in warning for warning in told["warnings"])) == (status, remarks)
        state, told = result("insight", "m.json", "r.csv", cwd=tmp_path)
        assert state == 1 and told["warnings"]


def test_a_played_command_is_not_recommended_again(tmp_path):
    drive = Sampling(0.1, sample_rate=8.0)
    truth = PlayActuator(highest=TOP, plays=40, noise=2e-9)
    excitation = raised_cosine([TOP], cycles=3, drive=drive)
    records = [Record(excitation.time, excitation.voltage, truth.play(excitation.voltage), "sine")]
    model = identify(records).actuator
    asked = insight(model, records).record_next
    assert len(asked) == 2
    for k, command in enumerate(asked):
        # Each is a file of its own: no command is refused because of another.
        assert run(*shlex.split(command)[1:], "--sample-rate", "8", cwd=tmp_path, keep=True)[0] == 0
        table = read_table(tmp_path / shlex.split(command)[-1])
        time, voltage = (table.column(name) for name in ("time", "voltage"))
        records.append(Record(time, voltage, truth.play(voltage), f"asked-{k}"))
    model = identify(records).actuator
    assert insight(model, records).record_next == ()
    # A path that holds longer asks for such a hold, until it is recorded.
    clock = np.array([0.0, 10.0, 20.0, 1e3])
    longer = model.promise([0.0, 90.0, 40.0, 40.0], clock).untested
    assert [gap.what for gap in longer][-1] == "hold"
    assert run(*shlex.split(str(longer[-1].command))[1:], "--sample-rate", "8", cwd=tmp_path)[0] == 0
    # An error that grows with the speed asks for more samples of fast branches, within what is allowed.
    tested = model.identification.validity
    fast = with_identification(model, allowed_slew_rate=150.0, validity=replace(tested, growth=5e-7))
    (command,) = insight(fast, records).record_next
    assert 1 < insight(fast, records).as_dict()["few_samples"] < 16
    assert insight(with_identification(fast, goal=50.0), records).record_next == ()
    assert run(*shlex.split(command)[1:], cwd=tmp_path)[0] == 0
    table = read_table(tmp_path / shlex.split(command)[-1])
    time, voltage = (table.column(name) for name in ("time", "voltage"))
    assert "150" in shlex.split(command) and 100 < np.abs(np.diff(voltage) / np.diff(time)).max() <= 150 * (1 + 1e-6)
    records.append(Record(time, voltage, truth.play(voltage), "fine"))
    assert insight(fast, records).few_samples == 0 and insight(fast, records).record_next == ()
    coarse = replace(tested, rms=3e-8, disagreement=2e-8, growth=2.5e-8)
    (words,) = reason_of(coarse.anywhere, coarse)
    assert [*map(float, re.findall(r"([\d.]+) nm", words))] == [30, 20, 25]


def test_a_measured_cycle_has_a_round_frequency():
    found = [ExciteCommand(TOP, 0.0).with_cycle(cycle).frequency for cycle in (10.01, 9.93, 30.2, 7.0, 96.0)]
    assert found == [0.1, 0.1, 0.033, 0.143, 0.0104]


@pytest.mark.parametrize("seed", [0, 1, *map(at_night, range(2, 12))])
def test_everything_that_is_not_tested_has_a_command_that_tests_it(seed, tmp_path):
    rng = np.random.default_rng(seed)
    turns = TOP * rng.uniform(0, 1, rng.integers(3, 12))
    time = np.cumsum(rng.uniform(0.5, 5, turns.size))
    clock = np.arange(time[0], time[-1], 0.01)
    records = [(clock, np.interp(clock, time, turns))]
    path = np.repeat(1.2 * TOP * rng.uniform(0, 1, 8), 2)
    when = np.cumsum(rng.uniform(0.02, 2, path.size) * rng.choice([0.01, 1, 20]))
    played, errors = set(), {"rms": 1e-8, "largest": 2e-8, "disagreement": 1e-8, "stroke": 1e-5}
    for _ in range(3):
        asked = promise(Validity.by_records(records, new=(0.1, 0.1), **errors), path, when).untested
        assert all(gap.command for gap in asked)
        assert played.isdisjoint(str(gap.command) for gap in asked)
        for command in dict.fromkeys(str(gap.command) for gap in asked):
            assert run(*shlex.split(command)[1:], "--force", cwd=tmp_path)[0] == 0
            table = read_table(tmp_path / shlex.split(command)[-1])
            records.append((table.column("time"), table.column("voltage")))
            played.add(command)
    assert asked == ()


@pytest.mark.parametrize(("stroke", "width", "moved"), [(14.4e-6, 0.4, 0.0), (10.8e-6, 0.55, 0.0), (12e-6, 0.55, 6e-6)])
def test_records_of_two_stages_are_named_and_do_not_lower_the_promise(stroke, width, moved):
    excitation = recommend(Sampling(0.1, sample_rate=8.0))
    stages = [PlayActuator(12e-6, TOP, plays=40), PlayActuator(stroke, TOP, width, plays=40, seed=1)]
    records = [
        Record(excitation.time, excitation.voltage, stage.play(excitation.voltage) + zero, name)
        for stage, zero, name in zip(stages, (0.0, moved), ("first", "second"), strict=True)
    ]
    fit = identify(records)
    reached = max(check(fit.actuator, record).without_noise for record in records)
    assert reached <= fit.promise.largest
    # A sensor that was zeroed anew is no other stage, and widens nothing.
    apart = bool(fit.promise.reasons) and any(f"on {record.name} " in fit.promise.reasons[0] for record in records)
    assert apart == (fit.promise.largest_percent > 1) == (not moved)
    assert any(abs(error.zero) > 0.1 * error.stroke for error in fit.errors)
    assert "zero of its sensor" in fit.remarks[0]


def test_later_commands_use_the_hold_of_the_records():
    """Its records lead by half a sample: a model that forgot this would miss its own records."""
    made = recommend(Sampling(0.1, sample_rate=8.0))
    half = 0.5 / made.sample_rate
    played = PlayActuator(highest=TOP, plays=30).play(np.interp(made.time + half, made.time, made.voltage))
    record = Record(made.time, made.voltage, played, "held")
    model = identify(record).actuator
    assert model.identification.lead == pytest.approx(half, rel=0.2)
    assert insight(model, record).misfit == pytest.approx(model.identification.largest_error, rel=0.1)


def test_a_turn_at_the_end_of_a_path_does_not_raise_its_rate_of_turns():
    time = np.arange(0, 0.203, 0.001)
    voltage = 50 - 40 * np.cos(2 * np.pi * 20 * time)
    rate = paces_of(time, voltage, branches_of(voltage, 100.0))[:, 1]
    assert rate.max() == pytest.approx(40, rel=0.1)
