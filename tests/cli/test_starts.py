"""`--start` and `--home` as processes: what is known of the start, and what an unknown one leaves open."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import plain_records
import pytest
from command_line import WRITTEN, result, run

import dehyst
from dehyst import Actuator, Record
from dehyst.model import needs_time, stroke_of, with_identification
from dehyst.model.promise import Validity
from dehyst.records import read_table, write_columns, write_record
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, descending_tops


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a record, its model, one that creeps, and paths with and without time."""
    target = tmp_path_factory.mktemp("starts")
    truth = PlayActuator(plays=60)
    tops = descending_tops(truth.highest, drive=Sampling(sample_rate=4.0))
    training = Record(tops.time, tops.voltage, truth.play(tops.voltage), "loops")
    write_record(target / "loops.csv", training)
    plain = dehyst.identify(training, structure="maxwell_slip").actuator
    plain.save(target / "model.json")
    creep = dehyst.DisplacementCreep([0.1, 3.0], [0.01, 0.02])
    dehyst.Actuator(plain.slip, plain.spring, limits=plain.limits, displacement_creep=creep).save(target / "creep.json")
    time = np.arange(200) * 0.02
    wanted = 8 - 5 * np.cos(2 * np.pi * time / 2)
    write_columns(target / "path.csv", {"time_s": time, "displacement_um": wanted})
    write_columns(target / "timeless.csv", {"displacement_um": wanted})
    return target


def column(folder, file, name):
    data = {column.name: column.data for column in read_table(folder / file).columns}
    return data[name]


@pytest.mark.parametrize("model", ["model.json", "creep.json"])
def test_without_a_start_the_path_is_homed_first(folder, model):
    status, got = result("compensate", model, "path.csv", "-o", "v.csv", "--slew-rate", "none", cwd=folder)
    assert status == 0 and got["certified"] and got["start"]["name"] == "unknown"
    assert got["start"]["largest_difference_percent"] <= got["start"]["model_error_percent"]
    assert got["samples"] == got["homing_samples"] + 200
    phase, time = column(folder, "v.csv", "phase"), column(folder, "v.csv", "time_s")
    assert list(np.unique(phase)) == [0, 1, 2] and np.count_nonzero(phase < 2) == got["homing_samples"]
    assert time[got["homing_samples"]] == pytest.approx(got["homing_s"]) and np.all(np.diff(time) > 0)
    wanted = column(folder, "path.csv", "displacement_um")
    followed = column(folder, "v.csv", "displacement_um")[got["homing_samples"] :]
    np.testing.assert_allclose(followed, wanted, rtol=WRITTEN)


def test_without_a_homing_the_error_is_reported(folder):
    given = ("compensate", "model.json", "path.csv", "-o", "v.csv", "--no-home", "--slew-rate", "none")
    _, got = result(*given, cwd=folder)
    assert (got["samples"], got["homing_samples"], got["certified"]) == (200, 0, None)
    assert got["start"]["largest_difference_percent"] > 5 > got["start"]["model_error_percent"]
    assert "phase" not in read_table(folder / "v.csv").names


def test_a_simulation_from_an_unknown_start_is_bounded(folder):
    voltage = np.concatenate([np.linspace(40, 200, 100), np.linspace(200, 0, 100), np.linspace(0, 90, 50)])
    write_columns(folder / "drive.csv", {"time_s": np.arange(250) * 0.01, "voltage_V": voltage})
    _, got = result("simulate", "model.json", "drive.csv", "-o", "s.csv", cwd=folder)
    low, y, high = (column(folder, "s.csv", f"{name}_um") for name in ("lowest", "expected", "highest"))
    slack = 1e-9
    assert np.all((low - slack <= y) & (y <= high + slack))
    actuator = Actuator.load(folder / "model.json")
    for start in ("top", "bottom", "relaxed"):
        result("simulate", "model.json", "drive.csv", "-o", "known.csv", "--start", start, cwd=folder)
        known = column(folder, "known.csv", "expected_um")
        assert np.all((low - slack <= known) & (known <= high + slack)), start
        assert "lowest_um" not in read_table(folder / "known.csv").names
    stroke = 1e6 * stroke_of(actuator)
    assert got["start"]["largest_difference_percent"] == pytest.approx(100 * (high - low).max() / stroke)
    assert got["start"]["first_difference_percent"] == pytest.approx(100 * (high - low)[0] / stroke)


@pytest.mark.parametrize("model", ["model.json", "creep.json"])
def test_a_record_is_a_start(folder, model):
    """The second half of a record, predicted from the first."""
    actuator = Actuator.load(folder / model)
    voltage = np.concatenate([np.linspace(0, 200, 200), np.linspace(200, 0, 200), np.linspace(0, 120, 150)])
    time = np.arange(550) * 0.05
    y = actuator.simulate(voltage, time=time).displacement
    write_record(folder / "first.csv", dehyst.Record(time[:480], voltage[:480], y[:480]))
    write_columns(folder / "next.csv", {"time_s": time[479:], "voltage_V": voltage[479:]})
    status, out, _ = run("simulate", model, "next.csv", "-o", "s.csv", "--start", "first.csv", cwd=folder)
    assert status == 0 and "start: first.csv" in out
    came = column(folder, "s.csv", "expected_um")
    assert np.abs(1e-6 * came - y[479:]).max() < 2e-3 * np.ptp(y)


@pytest.mark.parametrize("model", ["model.json", "creep.json"])
def test_a_record_is_a_start_as_it_began(folder, model):
    """What a record measured follows from its voltages and the state in which it began, which no name describes."""
    actuator = Actuator.load(folder / model)
    before = np.concatenate([np.linspace(0, 200, 200), np.linspace(200, 50, 200), np.linspace(50, 120, 150)])
    ends = [120, 20, 180, 20, 180, 60, 120]
    voltage = np.concatenate([np.linspace(start, end, 100) for start, end in pairwise(ends)])
    timed = needs_time(actuator)
    lead = actuator.simulate(before, time=np.arange(550) * 0.05 if timed else None).state
    time = np.arange(600) * 0.05
    y = actuator.simulate(voltage, time=time if timed else None, state=lead).displacement
    write_record(folder / "began.csv", dehyst.Record(time, voltage, y))
    write_columns(folder / "same.csv", {"time_s": time, "voltage_V": voltage})
    missed = {}
    for start in ("as:began.csv", "top", "bottom"):
        status, _, err = run("simulate", model, "same.csv", "-o", "s.csv", "--start", start, cwd=folder)
        assert status == 0, err
        missed[start] = np.abs(1e-6 * column(folder, "s.csv", "expected_um") - y).max() / np.ptp(y)
    assert missed["as:began.csv"] < 2e-3 and min(missed["top"], missed["bottom"]) > 5e-3
    write_columns(folder / "wish.csv", {"time_s": time[:100], "displacement_um": 1e6 * y[:100]})
    given = ("compensate", model, "wish.csv", "-o", "v.csv", "--start", "as:began.csv", "--slew-rate", "none")
    _, got = result(*given, cwd=folder)
    assert got["start"]["name"] == "as:began.csv" and got["homing_samples"] == 0
    assert np.abs(column(folder, "v.csv", "voltage_V") - voltage[:100]).max() < 0.01 * 200
    status, _, err = run("simulate", model, "same.csv", "-o", "s.csv", "--start", "as:same.csv", cwd=folder)
    assert status == 2, err


def test_voltages_alone_are_a_start_as_far_as_they_determine_it(folder):
    write_columns(folder / "next.csv", {"time_s": np.arange(50.0), "voltage_V": np.linspace(30, 100, 50)})
    for turns, open_ in (([0.0, 40.0, 10.0, 30.0], True), ([0.0, 200.0, 0.0, 30.0], False)):
        write_columns(folder / "history.csv", {"voltage_V": np.array(turns)})
        given = ("simulate", "model.json", "next.csv", "-o", "s.csv", "--start", "history.csv")
        _, got = result(*given, cwd=folder)
        assert got["start"]["name"] == "history.csv"
        share = got["start"]["largest_difference_percent"] / got["start"]["model_error_percent"]
        assert (share > 1) == open_
    # A model that creeps needs to know when.
    given = ("simulate", "creep.json", "next.csv", "-o", "s.csv", "--start", "history.csv")
    status, _, err = run(*given, cwd=folder)
    assert status == 2 and "time column" in err


@pytest.mark.parametrize("file", ["path.csv", "timeless.csv"])
def test_of_an_output_only_the_voltages_are_a_start(folder, file):
    """The wanted displacement of an earlier path is no measurement, even where the path was not followed."""
    wanted = {column.name: column.data for column in read_table(folder / file).columns}
    write_columns(folder / "wanted.csv", wanted | {"displacement_um": wanted["displacement_um"] + 3})
    status, _, err = run(
        *("compensate", "model.json", "wanted.csv", "-o", "earlier.csv", "--home", "--limits", 0, 150), cwd=folder
    )
    assert status in (0, 1), err
    write_columns(folder / "bare.csv", {"voltage_V": column(folder, "earlier.csv", "voltage_V")})
    ends = {}
    for start in ("earlier.csv", "bare.csv"):
        given = ("compensate", "model.json", "path.csv", "-o", "v.csv", "--start", start)
        _, ends[start] = result(*given, cwd=folder)
        err = run(*given, cwd=folder)[2]
        assert ("earlier.csv: " in err) == (start != "bare.csv")
    assert ends["earlier.csv"]["state"] == ends["bare.csv"]["state"]


@pytest.mark.parametrize("command", ["simulate", "compensate"])
def test_a_start_of_another_unit_or_actuator_is_refused(folder, command):
    """Voltages and displacements far from the model's lead to no state of it."""
    write_columns(folder / "next.csv", {"time_s": np.arange(50.0), "voltage_V": np.linspace(30, 100, 50)})
    file = "next.csv" if command == "simulate" else "path.csv"
    given = (command, "model.json", file, "-o", "x.csv", "--start", "history.csv")
    write_columns(folder / "history.csv", {"voltage_V": np.array([0.0, 2e5, 3e4])})
    status, _, err = run(*given, cwd=folder)
    assert status == 2 and "200000 V" in err
    time, voltage = np.arange(400.0), 100 - 100 * np.cos(np.arange(400) / 30)
    write_record(folder / "history.csv", dehyst.Record(time, voltage, 2e-6 * voltage))
    status, _, err = run(*given, cwd=folder)
    assert status == 2 and "history.csv: displacement: got" in err
    # Somewhat outside is a remark.
    write_columns(folder / "history.csv", {"voltage_V": np.array([0.0, 230.0, 30.0])})
    status, _, err = run(*given, cwd=folder)
    assert status in (0, 1) and "history.csv: 1 of 3 voltages" in err


def test_a_homing_that_leaves_the_start_open_has_one_status_however_it_was_asked_for(folder):
    replace(plain_records.plant(6), limits=(0.0, 100.0)).save(folder / "narrow.json")
    write_columns(folder / "low.csv", {"time_s": [0, 1, 2], "displacement_um": [3, 4, 3]})
    words = ("compensate", "narrow.json", "low.csv", "-o", "v.csv")
    found = [result(*words, *more, cwd=folder) for more in ((), ("--home",), ("--home-within", 200))]
    assert [(status, told["certified"], told["clamped"]) for status, told in found] == 3 * [(1, False, 0)]
    assert result(*words, "--no-home", cwd=folder)[0] == 0


def test_the_answer_comes_first_and_the_rest_by_verbose(folder):
    tested = Validity(1e-8, 1e-7, 0.0, 1.2e-5, limits=(0.0, 200.0), speeds=(1.0, 50.0))
    model = with_identification(replace(plain_records.plant(6), limits=(0.0, 200.0)), validity=tested)
    model.save(folder / "tested.json")
    words = ("compensate", "tested.json", "path.csv", "-o", "v.csv", "--plot", "p.html")
    (status, brief, remarks), (_, whole, _) = (run(*words, *more, cwd=folder) for more in ((), ("--verbose",)))
    assert status == 0 and brief.startswith("Expect this path ") and whole.startswith(brief.splitlines()[0])
    assert len(brief.splitlines()) == 5 and len(remarks.splitlines()) <= 1
    assert (folder / "p.html").read_text().count("data-chart=") == 3
    assert run(*words, cwd=folder, keep=True)[0] == 2
