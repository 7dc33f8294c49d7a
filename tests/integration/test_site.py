"""The site keeps its word: its links lead somewhere and its code runs."""

import re
import shutil
from types import SimpleNamespace

import numpy as np
import places
import pytest
from virtual_loops import record_loops

import dehyst
from dehyst.records import write_record
from examples import at_night

PAGES = sorted(places.DOCS.rglob("*.md"))
# Pages whose code runs here; that of the others runs in the tests of what they are about.
RUN_HERE = (
    "tutorials/first_stage.md",
    "how_to/creep.md",
    "how_to/keep_true.md",
    "how_to/check.md",
    "how_to/coupled_axes.md",
    "how_to/many_actuators.md",
    "how_to/python.md",
    "how_to/scans.md",
    "how_to/start_states.md",
)
RUN_ELSEWHERE = (
    "how_to/control.md",
    "how_to/fleet.md",
    "how_to/instruments.md",
    "how_to/simulink.md",
    "tutorials/first_calibration.md",
    "tutorials/learning_scan.md",
    "tutorials/no_sensor.md",
)


def named(page):
    return page.relative_to(places.ROOT).as_posix()


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_what_a_page_refers_to_is_there(page):
    for target in re.findall(r"\]\(([^)#\s]+)", page.read_text()):
        path = page.parent / target
        if path.parent.name == "gallery":  # written by the build
            path = (places.EXAMPLES / "gallery" / target.rpartition("/")[2]).with_suffix(".py")
            assert path.exists() or path.stem == "index", target
        else:
            assert "://" in target or path.exists(), target


def test_the_code_of_every_page_runs_somewhere():
    with_code = {page.relative_to(places.DOCS).as_posix() for page in PAGES if "```python" in page.read_text()}
    assert with_code == {*RUN_HERE, *RUN_ELSEWHERE}


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory):
    """A folder with the files that the pages name."""
    folder = tmp_path_factory.mktemp("laboratory")
    record, other = record_loops()
    write_record(folder / "loops.csv", record)
    write_record(folder / "new.csv", other)
    write_record(folder / "today.csv", record)
    actuator = dehyst.identify(record, structure="maxwell_slip").actuator
    actuator.save(folder / "model.json")
    dehyst.Stage((actuator, actuator), [[1, 0.04], [0.03, 1]]).save(folder / "stage.json")
    return folder


@pytest.mark.parametrize("page", [at_night(page) if page == "how_to/python.md" else page for page in RUN_HERE])
def test_the_code_of_a_page_runs(page, laboratory, tmp_path, monkeypatch):
    shutil.copytree(laboratory, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    # Files that the code of a page needs.
    actuator = dehyst.Actuator.load("model.json")
    device = SimpleNamespace(write=lambda voltage: None, read=lambda: 5e-6)
    space = {"actuator": actuator, "path": [5e-6, 6e-6], "dac": device, "sensor": device}
    for code in re.findall(r"```python\n(.*?)```", (places.DOCS / page).read_text(), re.DOTALL):
        exec(code, space)
    if page == "how_to/scans.md":
        assert space["table"].settled and not space["table"].plan.clamped.any()
    if page == "how_to/python.md":
        assert space["plan"].units == "um" and len(space["same"]) == len(space["record"])
    if page == "tutorials/first_stage.md":
        assert np.loadtxt("path.csv", delimiter=",", skiprows=1).shape == (400, 2)
