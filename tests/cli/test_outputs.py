"""What commands write: a file that begins otherwise and a folder of others are not replaced, and own outputs are."""

import json
import os
import re
import zipfile
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from command_line import run

from dehyst import Actuator, Compensator, FileFormatError, MaxwellSlip, Record, Spring, write_record
from dehyst._io import demand_alike, demand_own_folder, format_of, protecting, write_atomically, write_json
from dehyst.cli import main
from dehyst.exports import SourceOnlyWarning, export_fmu, export_wasm
from dehyst.operations import demo
from dehyst.operations.declaration import Role
from dehyst.operations.registry import ENTRIES, find
from dehyst.records import read_table, write_columns
from dehyst.report.html import document


def outputs(model, folder):
    """Write a file of every kind."""
    model.save(folder / "model")
    (folder / "report").write_text(document("A title", ["<p>text</p>"]))
    write_columns(folder / "table.tsv", {"time_s": [0.0, 1.0], "voltage_V": [1e16, 2]})
    write_record(folder / "record.csv", Record([0, 0.1], [1, 2], [3e-6, 4e-6]))
    write_record(folder / "record.npz", Record([0, 0.1], [1, 2], [3e-6, 4e-6]))
    export_wasm(Compensator(model, (0, 1)), folder / "x.wasm")
    with pytest.warns(SourceOnlyWarning):
        export_fmu(Compensator(model, (0, 1)), folder / "x.fmu")


def test_a_file_that_begins_as_the_new_one_is_replaced(tmp_path, model, monkeypatch):
    monkeypatch.setenv("CC", str(tmp_path / "absent" / "cc"))
    outputs(model, tmp_path)
    contents = {path: path.read_bytes() for path in tmp_path.iterdir()}
    assert len(contents) == 9
    with protecting(force=False):
        for path, content in contents.items():
            demand_alike(path)
            demand_alike(path, content)
            write_atomically(path, content)
            others = [one for one in contents if one != path and one.suffix not in (".npz", ".wasm", ".fmu", "")]
            for other in others:
                with pytest.raises(FileFormatError):
                    write_atomically(path, contents[other])
            assert path.read_bytes() == content
    outputs(model, tmp_path)


def test_files_that_begin_otherwise_are_replaced_by_force_only(tmp_path):
    write_json(tmp_path / "other.json", {"format": "other", "note": '"format": "dehyst-actuator"'})
    (tmp_path / "page.html").write_text("<!DOCTYPE html>\n<html><body>dehyst</body></html>")
    (tmp_path / "plain.csv").write_text("a,b\n0.0,1.5\n2.5,1.0\n")
    (tmp_path / "text").write_text("precious")
    (tmp_path / "binary").write_bytes(b"PK\3\4 no archive")
    with zipfile.ZipFile(tmp_path / "other.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", '<fmiModelDescription generationTool="other"/>')
    for path in tmp_path.iterdir():
        before = path.read_bytes()
        for content in (None, b'{"format": "dehyst-actuator"}', b"time_s,voltage_V\n0.0,1.0\n"):
            with protecting(force=False), pytest.raises(FileFormatError):
                demand_alike(path, content)
        with protecting(force=True):
            demand_alike(path)
        demand_alike(path)
        assert path.read_bytes() == before


def test_what_holds_nothing_may_be_replaced(tmp_path):
    (tmp_path / "empty").touch()
    with protecting(force=False):
        for path in (tmp_path / "empty", tmp_path / "new", os.devnull):
            demand_alike(path)
            demand_alike(path, b"anything")
    assert not (tmp_path / "new").exists()


def test_a_table_may_go_to_a_device_of_any_name(tmp_path):
    write_columns(os.devnull, {"time_s": [0.0, 1.0]})
    with pytest.raises(FileFormatError, match="text only"):
        write_columns(tmp_path / "table", {"time_s": [0.0, 1.0]})


# Every command


FOLDERS = {"demo", "paper", "calibrate", "export"}


def writing():
    """Every operation with each of its parameters that names a file or a folder to write."""
    for name in ENTRIES:
        operation = find(name)
        for one in operation.parameters:
            if one.kind.type is Path and one.kind.role is not Role.INPUT:
                yield pytest.param(operation, one.name, id=f"{name}-{one.name}")


def call(operation, name, target):
    """Return the words of a command that would write to the target if what it reads were there."""
    values = {name: Path(target)}
    for one in operation.parameters:
        if one.required and one.name != name:
            texts = {Path: f"absent-{one.name}", float: "1", str: "sim://play"}
            made = one.kind.parse(one.kind.choices[0] if one.kind.choices else texts[one.kind.type])
            values[one.name] = (made,) if one.kind.several else made
    if operation.name == "excite":
        values["volts"] = (10.0,)
    if operation.name == "scan":
        values |= {"low": 1.0, "high": 2.0, "frequency": 1.0}
    if operation.name == "insight" and name == "output":
        values["trajectory"] = Path("absent-path")
    if operation.name == "compensate" and name == "table":
        values["trajectory"] = Path("scan.csv")
    return operation.command(values)[1:]


def test_all_outputs_are_looked_at():
    found = {f"{one.values[0].name} {one.values[1]}" for one in writing()}
    assert found >= {
        "identify output",
        "identify report",
        "simulate output",
        "compensate output",
        "compensate table",
        "insight output",
        "insight report",
        "compare output",
        "compare report",
        "demo output",
        "paper output",
        "calibrate output",
        "export directory",
        "check log",
        "excite output",
        "scan output",
    }


@pytest.mark.parametrize(("operation", "name"), [one for one in writing() if one.values[0].name not in FOLDERS])
def test_no_command_replaces_a_file_of_others(tmp_path, monkeypatch, operation, name):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "precious.csv").write_text("mine")
    assert run("scan", "triangle", "--low", 1, "--high", 2, "--frequency", 1, "-o", "scan.csv")[0] == 0
    arguments = call(operation, name, "precious.csv")
    done = CliRunner().invoke(main, arguments)
    assert done.exit_code == 2, done.output
    assert "precious.csv" in done.stderr
    assert (tmp_path / "precious.csv").read_text() == "mine"
    forced = CliRunner().invoke(main, [*arguments, "--force"])
    assert "is there already" not in forced.stderr and "No such option" not in forced.stderr


@pytest.mark.parametrize(("operation", "name"), [one for one in writing() if one.values[0].name in FOLDERS])
def test_no_command_writes_into_a_folder_of_others(folder, monkeypatch, operation, name):
    monkeypatch.chdir(folder)
    target = folder / "precious"
    target.mkdir()
    (target / "report.html").write_text("mine")
    arguments = ["model.json" if word == "absent-model" else word for word in call(operation, name, "precious")]
    done = CliRunner().invoke(main, arguments)
    assert done.exit_code == 2, done.output
    assert re.search("holds other files .report.html|report.html: is there already", done.stderr), done.stderr
    assert [path.name for path in target.iterdir()] == ["report.html"]
    assert (target / "report.html").read_text() == "mine"


def test_an_fmu_of_others_is_not_replaced_and_an_own_one_is(folder, monkeypatch):
    monkeypatch.setenv("CC", str(folder / "absent" / "cc"))
    command = ["export", "model.json", "x.fmu", "--limits", "0", "100"]
    (folder / "x.fmu").write_text("mine")
    status, _, err = run(*command, cwd=folder)
    assert status == 2 and "is there already" in err and (folder / "x.fmu").read_text() == "mine"
    assert run(*command, "--force", cwd=folder)[0] == 0
    assert zipfile.is_zipfile(folder / "x.fmu")
    assert run(*command, cwd=folder)[0] == 0


def test_own_outputs_are_replaced_without_a_question(folder):
    for command, output in (
        (["excite", "raised-cosine", "10", "-o", "o.csv"], "o.csv"),
        (["simulate", "model.json", "voltage.csv", "-o", "s.csv"], "s.csv"),
        (["compensate", "model.json", "path.csv", "-o", "c.csv"], "c.csv"),
    ):
        assert run(*command, cwd=folder)[0] == 0
        before = (folder / output).read_bytes()
        assert run(*command, cwd=folder)[0] == 0
        assert (folder / output).read_bytes() == before
    # A measured record.
    (folder / "s.csv").write_text("time_s,voltage_V,displacement_um\n0.0,1.0,2.0\n0.1,2.0,3.0\n")
    status, _, err = run("simulate", "model.json", "voltage.csv", "-o", "s.csv", cwd=folder)
    assert status == 2 and "s.csv" in err and "--force" in err
    assert run("simulate", "model.json", "voltage.csv", "-o", "s.csv", "--force", cwd=folder)[0] == 0
    assert read_table(folder / "s.csv").names == ("time_s", "voltage_V", "expected_um", "lowest_um", "highest_um")


def test_force_replaces_no_input(folder):
    os.link(folder / "voltage.csv", folder / "link.csv")
    before = (folder / "voltage.csv").read_bytes()
    for name in ("voltage.csv", "link.csv"):
        status, _, err = run("simulate", "model.json", "voltage.csv", "-o", name, "--force", cwd=folder)
        assert status == 2 and name in err and (folder / name).read_bytes() == before


def test_a_file_that_appears_while_a_command_computes_is_not_replaced(tmp_path, monkeypatch):
    from dehyst.waveforms import standard

    made, output = standard.raised_cosine, tmp_path / "v.csv"
    mine = {"raised-cosine": lambda *a, **k: output.write_text("mine") and made(*a, **k)}
    monkeypatch.setattr("dehyst.operations.waves.EXCITATIONS", mine)
    done = CliRunner().invoke(main, ["excite", "raised-cosine", "10", "-o", str(output)])
    assert done.exit_code == 2 and "is there already" in done.stderr
    assert output.read_text() == "mine"


# Folders


@pytest.fixture(scope="module")
def journey():
    return demo.journey()


def test_demo_leaves_its_files_and_beats_the_paper(journey, tmp_path, monkeypatch):
    monkeypatch.setattr(demo, "journey", lambda progress: journey)
    status, out, _ = run("demo", "-o", "d", "--json", cwd=tmp_path)
    numbers = json.loads(out)
    assert status == 0
    assert numbers["compensated"]["largest_percent"] <= 0.7
    assert numbers["linear"]["largest_percent"] > 10
    names = {"loops.csv", "other-loops.csv", "model.json", "tracking.csv", "demo.json", "report.html"}
    assert {path.name for path in (tmp_path / "d").iterdir()} == names
    tracking = read_table(tmp_path / "d" / "tracking.csv").columns
    data = {column.name: column.data for column in tracking}
    error = np.abs(data["compensated_um"] - data["wanted_um"]).max() / numbers["stroke_um"] * 100
    assert error == pytest.approx(numbers["compensated"]["largest_percent"], rel=1e-6)


def test_demo_writes_into_a_folder_that_is_new_empty_or_its_own(journey, tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty" / ".dehyst-01234567.tmp").write_text("left by a killed process")
    for name in ("new/deep", "empty"):
        for _ in range(2):
            written = demo.write(journey, tmp_path / name, report=False)
        assert all(path.is_file() for path in written)
        assert format_of(tmp_path / name / "demo.json") == "dehyst-demo"
    # One that was not finished.
    for path in (tmp_path / "empty").iterdir():
        if path.name != "demo.json":
            path.unlink()
    demo.write(journey, tmp_path / "empty", report=False)


def test_demo_leaves_other_folders_alone(journey, tmp_path):
    (tmp_path / "loops.csv").write_text("mine")
    with pytest.raises(FileFormatError, match=r"files \(loops.csv\)"):
        demo.write(journey, tmp_path, report=False)
    assert [path.name for path in tmp_path.iterdir()] == ["loops.csv"]
    status, out, err = run("demo", "-o", tmp_path)
    assert (status, out) == (2, "") and "files (loops.csv)" in err
    with pytest.raises(FileFormatError, match=r"made a folder"):
        demand_own_folder(tmp_path / "loops.csv", "demo.json", "dehyst-demo")


def test_a_dash_is_no_name_of_an_output(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "loops.csv").write_text("time_s,voltage_V,displacement_um\n0,0,0\n1,1,1\n")
    done = CliRunner().invoke(main, ["identify", "loops.csv", "-o", "-"])
    assert done.exit_code == 2
    assert "-: is no name" in done.stderr
    assert not (tmp_path / "-").exists()


def test_a_suffix_that_is_no_export_is_no_folder(tmp_path):
    model = tmp_path / "model.json"
    Actuator(MaxwellSlip([1e-6], [1e6]), Spring([0, 1e-5], [0, 80]), limits=(0, 90)).save(model)
    status, _, err = run("export", model, tmp_path / "stage.mm")
    assert (status, ".wasm or .fmu" in err) == (2, True)
    assert not (tmp_path / "stage.mm").exists()
    (tmp_path / "stage.mm").mkdir()
    for name in ("stage.mm", "piezo-1.5"):
        assert run("export", model, tmp_path / name)[0] == 0
