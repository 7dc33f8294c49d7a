"""`dehyst check` and `dehyst update`: what they print, log and write, their exit status."""

import csv
import json

import checked_loops as loops
import pytest
from command_line import run

import dehyst
from dehyst.records import write_record


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    target = tmp_path_factory.mktemp("check")
    loops.model().save(target / "model.json")
    write_record(target / "same.csv", loops.later(1))
    write_record(target / "other.csv", loops.later(2))
    write_record(target / "gain.csv", loops.later(3, gain=loops.GAIN))
    write_record(target / "again.csv", loops.later(5, gain=loops.GAIN))
    return target


def test_a_model_that_is_still_true(folder):
    status, out, err = run("check", "model.json", "same.csv", cwd=folder)
    assert (status, err) == (0, "")
    assert out.startswith("Still true: the largest error is 0.0")
    assert out.count("\n") <= 3


def test_a_model_that_is_not(folder):
    status, out, err = run("check", "model.json", "gain.csv", cwd=folder)
    assert (status, err) == (1, "")
    assert out.startswith("Recalibrate: ")
    assert "risen by 2" in out
    assert run("check", "model.json", "gain.csv", "--goal", "5", cwd=folder)[0] == 0


def test_each_check_is_a_row_of_the_log_and_another_table_is_unchanged(folder):
    for name in ("same", "gain"):
        assert run("check", "model.json", f"{name}.csv", "--log", "log.csv", cwd=folder)[0] == int(name == "gain")
    with (folder / "log.csv").open(newline="") as stream:
        first, second = csv.DictReader(stream)
    assert (first["standing"], second["standing"]) == ("still true", "recalibrate")
    assert (first["promise_kept"], second["goal_percent"]) == ("yes", "1")
    assert (first["record"], second["record"]) == ("same", "gain")
    assert first["changes"] == "" and second["changes"].startswith("gain +")
    before = (folder / "other.csv").read_bytes()
    status, out, err = run("check", "model.json", "same.csv", "--log", "other.csv", cwd=folder)
    assert (status, out) == (2, "") and "promise_kept" in err
    assert (folder / "other.csv").read_bytes() == before


def test_a_model_that_has_changed_is_true_again(folder):
    assert run("check", "model.json", "again.csv", cwd=folder)[0] == 1
    status, out, err = run("update", "model.json", "gain.csv", "-o", "new.json", cwd=folder)
    assert (status, err) == (0, "")
    assert out.startswith("Updated: ")
    status, out, _ = run("check", "new.json", "again.csv", "--json", cwd=folder)
    checked = json.loads(out)
    assert status == 0
    assert checked["without_noise_percent"] <= 100 * checked["promise"]["largest_m"] / checked["stroke_m"]
    known = dehyst.Actuator.load(folder / "new.json").identification
    assert known.validity.rms > 0


def test_json_holds_the_changes_and_the_promise(folder):
    status, out, _ = run("update", "model.json", "gain.csv", "-o", "n.json", "--json", cwd=folder)
    found = json.loads(out)
    assert (status, found["used"], found["good"], found["output"]) == (0, True, True, "n.json")
    (gain,) = [change for change in found["changes"] if change["name"] == "gain"]
    assert gain["counts"]
    assert found["promise"]["largest_m"] >= found["promise"]["rms_m"] > 0
