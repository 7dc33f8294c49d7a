"""The documents keep their word: links lead somewhere, code and commands run and print the numbers of the page."""

import os
import re
import shlex
import shutil
import subprocess
import sys
import time
import tomllib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import places
import plain_records
import pytest
import structured_records
from command_line import run
from virtual_loops import record_loops

import dehyst
from dehyst import Compensator, read
from dehyst.instruments import open_rig
from dehyst.records import write_record
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, raised_cosine
from examples import at_night

DOCS = places.DOCS
# Tutorials whose commands are run, and their numbers compared.
PLAYED = ("measured_stage", "first_stage", "scan", "firmware", "learning_scan", "first_calibration")
MY_LAB = """
from dehyst.virtual import PlayActuator
truth, sent = PlayActuator(), [0.0]
def write_volts(v): sent.append(v)
def read_volts(): return sent[-1]
def read_micrometres(): return 1e6 * float(truth.play(sent[-1:])[0])
def disconnect(): sent.append(None)
"""


def blocks(page):
    return re.findall(r"```python\n(.*?)```", (DOCS / page).read_text(), re.DOTALL)


@pytest.fixture
def my_rig(tmp_path, monkeypatch):
    """The rig of fifty lines, in a file of its own beside the laboratory's."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    for name in ("my_rig", "my_lab"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    (tmp_path / "my_lab.py").write_text(MY_LAB)
    code = next(block for block in blocks("how_to/instruments.md") if "class MyRig" in block)
    assert len(code.splitlines()) <= 50
    (tmp_path / "my_rig.py").write_text(code)
    return f"{tmp_path / 'my_rig.py'}:make"


def test_a_rig_of_fifty_lines_plays_and_keeps_its_limits(my_rig):
    with open_rig(my_rig, limits=(0, 100), slew_rate=400) as rig:
        lab = sys.modules["my_lab"]
        drive = Sampling(frequency=2, sample_rate=rig.nearest_rate(400), limits=(0, 100), slew_rate=rig.slew_rate)
        excitation = raised_cosine([100.0, 50.0], drive=drive)
        put, times = rig._put, []

        def timed(volts):
            put(volts)
            times.append(time.monotonic())

        rig._put = timed
        record = rig.play(excitation)
        played = lab.sent[-len(times) :]
        rig._put = put
        rig.retreat()
    sent = lab.sent[:-1]
    assert lab.sent[-1] is None
    assert len(record) == len(excitation)
    assert (min(sent), max(sent), sent[-1]) == (0, 100, 0)
    alone = PlayActuator(noise=0.0)
    np.testing.assert_allclose(record.displacement, alone.play(excitation.voltage), atol=20e-9)
    # By the times at which they were sent: a reading may come late, and the next one not.
    assert np.abs(np.diff(played) / np.diff(times)).max() <= 400


def test_the_first_code_on_the_page_runs():
    code = next(block for block in blocks("how_to/instruments.md") if "sim://" in block)
    space = {}
    exec(code, space)
    assert len(space["record"]) > 1000
    assert space["rig"].safe == 0


@pytest.mark.nightly
@pytest.mark.parametrize("readback", ["stuck", "right"])
def test_the_test_of_a_rig_on_the_page_finds_a_planted_fault(readback, my_rig):
    folder = Path(my_rig.partition(":")[0]).parent
    test = next(block for block in blocks("how_to/instruments.md") if "class TestMyRig" in block)
    (folder / "test_my_rig.py").write_text(test)
    code, read = (folder / "my_rig.py").read_text(), "my_lab.read_volts()"
    assert read in code
    (folder / "my_rig.py").write_text(code.replace(read, "0.0") if readback == "stuck" else code)
    command = [sys.executable, "-m", "pytest", "-qx", "-n", "0", "-c", os.devnull, "--rootdir", ".", "test_my_rig.py"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == (1 if readback == "stuck" else 0), done.stdout[-2000:]


@pytest.mark.nightly
def test_the_calibration_in_python_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    space = {}
    exec(blocks("tutorials/first_calibration.md")[0], space)
    assert space["found"].good
    assert len(read(tmp_path / "stage-1" / "records" / "recommended.csv")) > 1000


def test_the_table_of_a_fleet_shows_what_is_odd_and_what_drifts(tmp_path, monkeypatch):
    pandas = pytest.importorskip("pandas", reason="pandas is not installed")
    monkeypatch.chdir(tmp_path)
    random = np.random.default_rng(0)
    numbers = {"promise_percent": 0.2, "stroke_um": 10.0, "loop_width_um": 1.5, "noise_nm": 2.0}
    spread = {"promise_percent": 0.1, "stroke_um": 0.001, "loop_width_um": 0.005, "noise_nm": 0.05}
    names = [f"S{k:02}/{session}.csv" for k in range(40) for session in (1, 2)]
    table = pandas.DataFrame({"record": names, "reason": "", "model": "{}"})
    for name, value in numbers.items():
        table[name] = value * (1 + spread[name] * random.uniform(-1, 1, len(names)))
    table.loc[names.index("S03/1.csv"), "noise_nm"] = 9.0
    table.loc[names.index("S05/2.csv"), "stroke_um"] *= 0.96
    table.loc[names.index("S07/1.csv"), ["reason", *numbers]] = ["dead", *[np.nan] * 4]
    table.to_parquet("fleet.parquet")
    space, (code,) = {}, blocks("how_to/fleet.md")
    exec(code, space)
    assert list(space["refused"]["record"]) == ["S07/1.csv"]
    assert "S03/1.csv" in space["odd"].index
    assert len(space["odd"]) <= 2
    assert list(space["drifting"].index) == ["S05"]


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    folder = tmp_path_factory.mktemp("demo")
    assert run("demo", "-o", "stage", cwd=folder)[0] == 0
    return folder / "stage"


def steps(page):
    """Yield the code and the commands of a page in order, each command with the numbers printed below it."""
    command, numbers = None, []
    for code, line in re.findall(
        r"```python\n(.*?)```|^ {4}(\S[^\n]*)$", (DOCS / page).read_text(), re.DOTALL | re.MULTILINE
    ):
        if code or re.match(r"dehyst [a-z]|cd |make |pip ", line):
            yield command, numbers
            command, numbers = code or shlex.split(line, comments=True), []
        else:
            numbers += numbers_of(line)
    yield command, numbers


def numbers_of(text):
    return [float(number) for number in re.findall(r"(?<![\w.-])-?\d+(?:\.\d+)?(?:e-?\d+)?\b", text)]


@pytest.mark.nightly
@pytest.mark.parametrize("page", PLAYED)
def test_the_commands_of_a_tutorial_print_the_text_of_the_page(page, demo, tmp_path, monkeypatch):
    """Numbers may differ by a tenth: other processors round otherwise."""
    shutil.copytree(demo, tmp_path / "stage")
    shutil.copytree(places.EXAMPLES / "measured", tmp_path / "examples" / "measured")
    monkeypatch.chdir(tmp_path)
    for command, numbers in steps(f"tutorials/{page}.md"):
        if isinstance(command, str):
            exec(command, {})
        elif command and command[0] == "cd":
            os.chdir(command[1])
        elif command and command[0] == "dehyst":
            status, *texts = run(*command[1:], keep=command[1] != "demo")
            assert status in (0, 1), (command, texts)
            printed = iter(numbers_of("\n".join(texts)))
            for number in numbers:
                assert any(value == pytest.approx(number, rel=0.1) for value in printed), (command, number, texts)


PAGES = sorted(DOCS.rglob("*.md"))
# Pages whose code runs in a test of its own; that of all others runs in a folder with the files that they name.
RUN_ELSEWHERE = (
    "how_to/control.md",
    "how_to/fleet.md",
    "how_to/instruments.md",
    "how_to/simulink.md",
    "tutorials/first_calibration.md",
)
WITH_CODE = {page.relative_to(DOCS).as_posix() for page in PAGES if "```python" in page.read_text()}


def named(page):
    return page.relative_to(places.ROOT).as_posix()


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_the_links_of_a_page_exist(page):
    for target in re.findall(r"\]\(([^)#\s]+)", page.read_text()):
        path = page.parent / target
        if path.parent.name == "gallery":  # written by the build
            path = (places.EXAMPLES / "gallery" / target.rpartition("/")[2]).with_suffix(".py")
            assert path.exists() or path.stem == "index", target
        else:
            assert "://" in target or path.exists(), target


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


@pytest.mark.parametrize(
    "page", [at_night(page) if page == "how_to/python.md" else page for page in sorted(WITH_CODE - {*RUN_ELSEWHERE})]
)
def test_the_code_of_a_page_runs(page, laboratory, tmp_path, monkeypatch):
    shutil.copytree(laboratory, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    # Files that the code of a page needs.
    actuator = dehyst.Actuator.load("model.json")
    device = SimpleNamespace(write=lambda voltage: None, read=lambda: 5e-6)
    space = {"actuator": actuator, "path": [5e-6, 6e-6], "dac": device, "sensor": device}
    for code in blocks(page):
        exec(code, space)
    if page == "how_to/scans.md":
        assert space["table"].settled and not space["table"].plan.clamped.any()
    if page == "how_to/python.md":
        assert space["plan"].units == "um" and len(space["same"]) == len(space["record"])
    if page == "tutorials/no_sensor.md":
        assert not space["record"].measured.all() and space["fit"].good
        assert dehyst.check(space["fit"].actuator, space["record"]).kept
    if page == "tutorials/learning_scan.md":
        assert space["repetition"].errors[-1] < 0.1 * space["repetition"].errors[0]
    if page == "tutorials/first_stage.md":
        assert np.loadtxt("path.csv", delimiter=",", skiprows=1).shape == (400, 2)


@pytest.mark.nightly
def test_the_notebook_runs_and_its_stored_output_is_current():
    pytest.importorskip("matplotlib")
    nbformat, notebooks = pytest.importorskip("nbformat"), pytest.importorskip("notebooks")
    notebook = places.EXAMPLES / "first_steps.ipynb"

    def kinds(made):
        return [
            [sorted(output.get("data", {output.output_type: None})) for output in cell.get("outputs", [])]
            for cell in made.cells
        ]

    stored = nbformat.read(notebook, as_version=4)
    nbformat.validate(stored)
    assert kinds(notebooks.run(notebook)) == kinds(stored)
    assert sum("image/png" in kind for shown in kinds(stored) for kind in shown) >= 4


ROOT = places.ROOT


def test_the_conda_recipe_requires_what_the_package_requires():
    listed = set(re.findall(r"^    - ([\w-]+ >=[\d.]+)$", (ROOT / "recipe" / "recipe.yaml").read_text(), re.M))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    needed = [*project["project"]["dependencies"], *project["build-system"]["requires"]]
    python = "python " + project["project"]["requires-python"]
    assert listed - {"cmake >=3.18"} == {python, *(requirement.replace(">=", " >=") for requirement in needed)}


PAGE = places.DOCS / "how_to" / "control.md"


def test_the_code_for_the_browser_runs(tmp_path, monkeypatch):
    made = structured_records.plant(structured_records.STRUCTURES["all"])
    actuator = replace(made.actuator, limits=(0.0, 250.0))
    actuator.save(tmp_path / "model.json")
    monkeypatch.chdir(tmp_path)
    names = {}
    for code in re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL):
        exec(code, names)
    compensator = names["compensator"]
    assert compensator.clamps == (0, 0)
    first = compensator._clone()
    time = 1e-3 * np.arange(names["sent"].size + 1)
    y = actuator.simulate(np.append(first.voltage, names["sent"]), time=time, state=first.state).displacement[1:]
    plain_records.assert_close(y, names["wanted"], 1e-12 * plain_records.STROKE)
    assert names["feedback"].believed and abs(names["feedback"].correction) < 1e-3 * plain_records.STROKE
    repetition = names["repetition"]
    assert repetition.believed and repetition.errors[-1] <= repetition.errors[0] < 1e-2 * plain_records.STROKE
    assert len(names["table"].cycle) == len(names["wanted"])
    written = []

    def write(voltage):
        if len(written) == 1:
            written.append(None)
            raise OSError("the converter is asleep")
        written.append(voltage)

    compensator = Compensator(actuator, (0, 200), period=1e-3)
    device, other = names["Stage"](compensator, write), Compensator(actuator, (0, 200), period=1e-3)
    device.set(5e-6)
    with pytest.raises(OSError, match="asleep"):
        device.set(9e-6)
    device.set(6e-6)
    assert [written[0], written[2]] == [other.step(5e-6), other.step(6e-6)]
    assert device.read() == {"displacement": 6e-6, "voltage": written[2]}
