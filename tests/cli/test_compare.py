"""`dehyst compare` as a process: what it prints, what it writes, its exit status."""

import json
import re

import plain_records
import pytest
from command_line import run

from dehyst import IdentifyError
from dehyst.records import write_record


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    target = tmp_path_factory.mktemp("compare")
    plant = plain_records.plant()
    write_record(target / "tops.csv", plain_records.loops(plant, plain_records.DESCENDING_TOPS, name="tops"))
    write_record(target / "three.csv", plain_records.loops(plant, plain_records.THREE_LOOPS, name="three"))
    return target


@pytest.fixture(autouse=True)
def without_plugins(monkeypatch):
    """Models of packages that are installed here do not count."""
    monkeypatch.setattr("dehyst.trust.comparison._added", dict)


def test_compare_prints_a_table_and_writes_a_page(folder):
    words = ["compare", "tops.csv", "--validate", "three.csv"]
    status, out, err = run(*words, "--verbose", "--report", "page.html", cwd=folder)
    assert status == 0
    # A slow machine shows progress.
    assert all(line.startswith(("dehyst: fitting ", "dehyst: simulating ")) for line in err.splitlines())
    for name in ("dehyst", "two branches", "linear ratio"):
        assert re.search(rf"^{name} +(\d+\.\d+ +){{6}}\d+\.\d+$", out, re.M), out
    found = json.loads(run(*words, "--json", cwd=folder)[1])
    assert [model["model"] for model in found["models"]] == ["dehyst", "two branches", "linear ratio"]
    assert (found["training"], found["validation"], found["held_out_by_itself"]) == (["tops"], ["three"], False)
    assert out.splitlines()[0] == found["best"]["sentence"]
    assert (found["best"]["model"], found["best"]["next"]) == ("dehyst", "two branches")
    assert found["best"]["factor"] > 3 and found["best"]["line_rms_percent"] > found["best"]["next_rms_percent"]
    assert "Models compared" in (folder / "page.html").read_text()


def test_a_failure_of_the_model_of_dehyst_gives_status_1(folder, monkeypatch):
    def fails(*_, **__):
        raise IdentifyError("no model")

    monkeypatch.setattr("dehyst.trust.comparison.identify", fails)
    status, out, _ = run("compare", "three.csv", "--json", cwd=folder)
    assert status == 1
    assert json.loads(out)["models"][0]["said"] == "no model"
