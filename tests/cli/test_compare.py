"""`dehyst compare` as a process: what it prints, what it writes, its exit status."""

import json
import re

import plain_records
import pytest
from command_line import run

from dehyst.records import write_record


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    target = tmp_path_factory.mktemp("compare")
    plant = plain_records.plant()
    write_record(target / "tops.csv", plain_records.loops(plant, plain_records.DESCENDING_TOPS, name="tops"))
    write_record(target / "three.csv", plain_records.loops(plant, plain_records.THREE_LOOPS, name="three"))
    return target


def test_a_table_the_figures_and_a_page(folder):
    status, out, err = run(
        "compare",
        "tops.csv",
        "--validate",
        "three.csv",
        "--only",
        "dehyst",
        "--only",
        "duhem",
        "--only",
        "Linear Ratio",
        "-o",
        "all.json",
        "--report",
        "page.html",
        cwd=folder,
    )
    assert status == 0
    # A slow machine shows progress.
    assert all(line.startswith(("dehyst: fitting ", "dehyst: simulating ")) for line in err.splitlines())
    for name in ("dehyst", "Duhem", "linear ratio"):
        assert re.search(rf"^{name} +\d+\.\d+ +\d+\.\d+ +\d+\.\d+ +\d+\.\d+ .* \d+$", out, re.M), out
    assert "the stroke, 16" in out
    found = json.loads((folder / "all.json").read_text())
    assert [one["model"] for one in found["models"]] == ["dehyst", "Duhem", "linear ratio"]
    assert found["validation"] == ["three"]
    assert "Models compared" in (folder / "page.html").read_text()


def test_the_use_of_a_lead_in_is_stated(folder):
    arguments = ["compare", "tops.csv", "--validate", "three.csv", "--only", "linear ratio"]
    for options, said in (([], False), (["--lead", "6"], True)):
        status, out, _ = run(*arguments, *options, cwd=folder)
        assert status == 0
        assert ("first 6 s" in out) is said


def test_json_and_a_baseline_that_fails(folder):
    status, out, _ = run("compare", "three.csv", "--only", "preisach, reversal curves", "--json", cwd=folder)
    assert status == 0
    model = json.loads(out)["models"][0]
    assert "dehyst excite" in (model["said"] or "") or model["errors"]
    status, out, _ = run("compare", "major.csv", cwd=folder)
    assert status == 2


def test_a_virtual_actuator_needs_no_record(folder):
    status, out, _ = run("compare", "--truths", "play", "--only", "linear ratio", "--json", cwd=folder)
    assert status == 0
    found = json.loads(out)
    assert found["truths"] == ["play"]
    assert 5 < found["models"][0]["tracking"]["play"]["largest_percent"] < 20


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "neither records nor a virtual actuator"),
        (["tops.csv", "--only", "crystal"], "--only: no model 'crystal'; try 'dehyst'"),
        (["tops.csv", "--validate", "three.csv", "--lead", "-2"], "lead: got -2"),
        (["tops.csv", "-o", "tops.csv"], "is also an input of this command"),
        (["tops.csv", "--truths", "glass"], "got 'glass', need play"),
    ],
)
def test_wrong_input_is_named(folder, arguments, said):
    status, _, err = run("compare", *arguments, cwd=folder)
    assert status == 2
    assert said in err


@pytest.mark.parametrize(
    "words",
    [
        ["--truths", "play", "--columns", "decimal=point"],
        ["--truths", "play", "--lead", "3"],
        ["tops.csv", "--lead", "3"],
    ],
)
def test_an_option_without_an_effect_is_refused(folder, words):
    status, out, err = run("compare", *words, "--only", "linear ratio", cwd=folder)
    assert (status, out) == (2, "")
    assert words[-2] in err
