"""`dehyst check` as a process: what it prints, what it keeps, its exit status."""

import json
import re
import shutil

import checked_loops as loops
import pytest
from command_line import run

from dehyst.records import write_record


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    target = tmp_path_factory.mktemp("check")
    loops.model().save(target / "model.json")
    write_record(target / "same.csv", loops.later(1))
    write_record(target / "other.csv", loops.later(2))
    write_record(target / "gain.csv", loops.later(3, gain=loops.GAIN))
    write_record(target / "short.csv", loops.later(4)[:100])
    return target


def test_a_model_that_is_still_true(folder):
    status, out, err = run("check", "model.json", "same.csv", cwd=folder)
    assert (status, err) == (0, "")
    assert out.startswith("Still true: the largest error is 0.0")
    assert re.search(r"^width +[+-][\d.e-]+ ± [\d.]+ % +[+-]0\.\d{3}$", out, re.M), out
    assert "counts\n" not in out.split("(A change counts")[0]


def test_a_model_that_is_not(folder):
    status, out, err = run("check", "model.json", "gain.csv", cwd=folder)
    assert (status, err) == (1, "")
    assert out.startswith("Recalibrate: ")
    assert "risen by 2" in out
    assert re.search(r"^gain .*  counts$", out, re.M), out
    assert run("check", "model.json", "gain.csv", "--goal", "5", cwd=folder)[0] == 0


def test_json(folder):
    status, out, _ = run("check", "model.json", "gain.csv", "--json", cwd=folder)
    found = json.loads(out)
    assert (status, found["standing"], found["changed"]) == (1, "RECALIBRATE", ["gain"])
    assert "history" not in found


def test_a_history_is_kept_printed_and_drawn(folder):
    for count, name in enumerate(("same", "other", "gain", "gain"), 1):
        status, out, err = run("check", "model.json", f"{name}.csv", "--history", "checks", cwd=folder)
        assert (status, err) == (int(name == "gain"), "")
        assert f"Checks of this model in checks: {min(count, 3)};" in out
    assert "average or cumulative" in out
    assert re.search(r"^\d{4}-\d\d-\d\d gain +1\.\d{3} +\+\d+\.\d\d +\d+\.\d\d!", out, re.M), out
    assert "Picture: checks" in out
    assert (folder / "checks" / "history.html").read_text().startswith("<!DOCTYPE html>")
    _, out, _ = run("check", "model.json", "same.csv", "--history", "checks", "--json", cwd=folder)
    assert json.loads(out)["history"]["checks"] == 3
    data = json.loads(next((folder / "checks").glob("check-*.json")).read_text())
    assert (data["format"], data["version"]) == ("dehyst-check", 1)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["model.json", "short.csv"], "full cycle"),
        (["model.json", "same.csv", "--goal", "0"], "--goal: got 0.0, need"),
        (["model.json", "same.csv", "--history", "."], "holds other files"),
        (["model.json", "same.csv", "--history", "same.csv"], "cannot be made a folder"),
        (["same.csv", "model.json"], "same.csv"),
        (["model.json", "absent.csv"], "no such file"),
    ],
)
def test_wrong_input_is_named(folder, arguments, words):
    status, out, err = run("check", *arguments, cwd=folder)
    assert (status, out) == (2, "")
    assert words in err


@pytest.fixture
def kept(folder, tmp_path):
    """A folder with the model, records, and a history of two checks."""
    for name in ("model.json", "same.csv", "other.csv", "gain.csv"):
        shutil.copy(folder / name, tmp_path)
    for name in ("same", "other"):
        assert run("check", "model.json", f"{name}.csv", "--history", "checks", cwd=tmp_path)[0] == 0
    return tmp_path


def test_a_damaged_check_is_left_out_of_the_history(kept):
    first, second = sorted((kept / "checks").glob("check-*.json"))
    first.write_text(first.read_text()[:300])
    status, out, err = run("check", "model.json", "gain.csv", "--history", "checks", cwd=kept)
    assert status == 1 and out.startswith("Recalibrate: ")
    assert f"left out of the history: checks/{first.name}: line " in err and second.name not in err
    assert "checks: 2" in out and "Picture: checks" in out
    # The same record again mends its file.
    for name in ("same", "other"):
        status, out, err = run("check", "model.json", f"{name}.csv", "--history", "checks", cwd=kept)
    assert (status, err) == (0, "") and "checks: 3" in out


@pytest.mark.parametrize(("content", "words"), [(None, "is missing"), ("{}", "is damaged"), ("", "is damaged")])
def test_a_damaged_marker_of_a_history_is_named(kept, content, words):
    marker = kept / "checks" / "history.json"
    marker.unlink() if content is None else marker.write_text(content)
    status, out, err = run("check", "model.json", "gain.csv", "--history", "checks", cwd=kept)
    assert (status, out) == (2, "")
    assert f"checks/history.json: {words}, but the folder holds 2 checks; write {{" in err
    marker.write_text(re.search(r"write (\{.*?\}) into", err)[1])
    assert run("check", "model.json", "gain.csv", "--history", "checks", cwd=kept)[0] == 1


def test_a_picture_of_others_is_not_replaced(kept):
    picture = kept / "checks" / "history.html"
    picture.write_text("<!DOCTYPE html>\n<html><body>dehyst</body></html>")
    before = {path.name: path.read_bytes() for path in (kept / "checks").iterdir()}
    status, out, err = run("check", "model.json", "gain.csv", "--history", "checks", cwd=kept)
    assert (status, out) == (2, "")
    assert "history.html: is there already" in err and "--force" in err
    assert {path.name: path.read_bytes() for path in (kept / "checks").iterdir()} == before
    assert run("check", "model.json", "gain.csv", "--history", "checks", "--force", cwd=kept)[0] == 1
    assert (
        "dehyst" in picture.read_text()
        and run("check", "model.json", "same.csv", "--history", "checks", cwd=kept)[0] == 0
    )


@pytest.mark.parametrize("gain", [0.7, -0.6])
def test_a_record_of_another_actuator_is_not_kept(kept, gain):
    write_record(kept / "another.csv", loops.later(5, gain=gain))
    before = {path.name: path.read_bytes() for path in (kept / "checks").iterdir()}
    for goal in ((), ("--goal", 100)):
        status, out, err = run("check", "model.json", "another.csv", "--history", "checks", *goal, cwd=kept)
        assert (
            status == 1
            and out.startswith("Another actuator")
            and "effect" not in out
            and "Checks of this model" not in out
        )
        assert "another: is plainly not" in err and "gain differs" in err
        assert err.rstrip().endswith("It is not kept in checks")
    assert {path.name: path.read_bytes() for path in (kept / "checks").iterdir()} == before
    status, out, err = run("check", "model.json", "another.csv", "--history", "new", "--json", cwd=kept)
    assert status == 1 and not (kept / "new").exists()
    assert not json.loads(out)["good"] and "history" not in json.loads(out)
    status, _, err = run("check", "model.json", "another.csv", cwd=kept)
    assert status == 1 and "is plainly not a record" in err and "kept" not in err
