"""`dehyst check` and `dehyst update`: what they print, log and write, their exit status."""

import csv

import checked_loops as loops
import pytest
from command_line import result, run

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


@pytest.mark.parametrize(("record", "goal", "good"), [("same", "1", True), ("gain", "1", False), ("gain", "4", True)])
def test_the_status_says_whether_a_model_is_still_true(folder, record, goal, good):
    status, out, err = run("check", "model.json", f"{record}.csv", "--goal", goal, cwd=folder)
    assert (status, err) == (int(not good), "")
    assert ("gain has risen" in out) is (record == "gain") and out.count("\n") <= 4
    assert out.startswith("Recalibrate: ") is not good


def test_each_check_adds_a_row_to_the_log_and_another_table_is_refused(folder):
    for name in ("same", "gain"):
        assert run("check", "model.json", f"{name}.csv", "--log", "log.csv", cwd=folder)[0] == int(name == "gain")
    with (folder / "log.csv").open(newline="") as stream:
        first, second = csv.DictReader(stream)
    assert (first["standing"], second["standing"]) == ("still true", "recalibrate")
    assert (first["promise_kept"], second["goal_percent"]) == ("yes", "1")
    assert (first["record"], second["record"]) == ("same", "gain")
    assert first["changes"] == "" and second["changes"].startswith("gain +")
    for log, *force in (["other.csv"], ["other.csv", "--force"], ["same.csv", "--force"]):
        before = (folder / log).read_bytes()
        assert run("check", "model.json", "same.csv", "--log", log, *force, cwd=folder)[:2] == (2, "")
        assert (folder / log).read_bytes() == before


def test_an_updated_model_is_still_true(folder):
    assert run("check", "model.json", "again.csv", cwd=folder)[0] == 1
    status, found = result("update", "model.json", "gain.csv", "-o", "new.json", cwd=folder)
    assert (status, found["used"], found["good"]) == (0, True, True)
    assert [change["counts"] for change in found["changes"] if change["name"] == "gain"] == [True]
    assert found["promise"]["largest_m"] >= found["promise"]["rms_m"] > 0
    status, found = result("check", "new.json", "again.csv", cwd=folder)
    assert status == 0 and found["without_noise_percent"] <= 100 * found["promise"]["largest_m"] / found["stroke_m"]
    assert dehyst.Actuator.load(folder / "new.json").identification.validity.lag_error > 0
