"""What commands write: a file that exists, and a folder of others, are kept unless --force."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from command_line import commands, run, sample_words

from dehyst import FileFormatError
from dehyst.cli import main
from dehyst.operations import demo
from dehyst.operations.command import Role
from dehyst.records import read_table, write_columns


def test_a_table_may_go_to_a_device_of_any_name(tmp_path):
    write_columns(os.devnull, {"time_s": [0.0, 1.0]})
    with pytest.raises(FileFormatError, match="text only"):
        write_columns(tmp_path / "table", {"time_s": [0.0, 1.0]})


# Every command


def writing():
    """Every command with each of its parameters that names a file or a folder to write."""
    for name, command in commands():
        for each in command.params:
            if getattr(each.type, "role", Role.INPUT) is not Role.INPUT:
                yield pytest.param(name, command, each, id=f"{name}-{each.name}")


@pytest.mark.parametrize(("name", "command", "output"), list(writing()))
def test_no_command_replaces_a_file_or_writes_into_a_folder_of_others(folder, monkeypatch, name, command, output):
    monkeypatch.chdir(folder)
    assert run("scan", "triangle", "--low", 1, "--high", 2, "--frequency", 1, "-o", "scan.csv")[0] == 0
    role, precious = output.type.role, f"precious{getattr(output.type, 'suffix', '') or '.parquet'}"
    target = folder / precious
    if role is Role.OUTPUT or name in ("fleet", "check"):
        target.write_text("mine")
    else:
        target.mkdir()
        (target / "report.html").write_text("mine")
    there = {"absent-model": "model.json", "absent-directory": precious}
    there |= {"absent-records": "voltage.csv"} if name == "fleet" else {}
    there |= {"absent-trajectory": "scan.csv"} if output.name == "table" else {}
    words = sample_words(command, output, precious)
    done = CliRunner().invoke(main, [*name.split(), *(there.get(word, word) for word in words)])
    assert done.exit_code == 2, done.output
    assert precious in done.stderr
    assert role is not Role.OUTPUT or "--force" in done.stderr
    kept = target / "report.html" if target.is_dir() else target
    assert kept.read_text() == "mine"
    assert not target.is_dir() or [path.name for path in target.iterdir()] == ["report.html"]


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="a place where nobody may write")
@pytest.mark.parametrize(("name", "command", "output"), list(writing()))
def test_the_output_is_tested_before_the_work(folder, monkeypatch, name, command, output):
    """All inputs are absent: a command that did anything before would name one of them."""
    monkeypatch.chdir(folder)
    place = f"/proc/self/out{getattr(output.type, 'suffix', '')}"
    done = CliRunner().invoke(main, [*name.split(), *sample_words(command, output, place)])
    assert done.exit_code == 2
    assert place in done.stderr


def test_an_output_is_written_once_and_again_by_force(folder):
    for command, output in (
        (["excite", "raised-cosine", "10", "-o", "o.csv"], "o.csv"),
        (["simulate", "model.json", "voltage.csv", "-o", "s.csv"], "s.csv"),
        (["export", "model.json", "c", "--limits", "0", "100"], "c/piezo.c"),
        (["export", "model.json", "x.wasm", "--limits", "0", "100"], "x.js"),
    ):
        assert run(*command, cwd=folder)[0] == 0
        before = (folder / output).read_bytes()
        (folder / output).write_text("mine")
        assert run(*command, cwd=folder, keep=True)[0] == 2
        assert (folder / output).read_text() == "mine"
        assert run(*command, "--force", cwd=folder)[0] == 0
        assert (folder / output).read_bytes() == before


def test_force_replaces_no_input(folder):
    (folder / "link.csv").symlink_to("voltage.csv")
    before = (folder / "voltage.csv").read_bytes()
    for name in ("voltage.csv", "link.csv"):
        status, _, err = run("simulate", "model.json", "voltage.csv", "-o", name, "--force", cwd=folder)
        assert status == 2 and name in err and (folder / name).read_bytes() == before


# Folders


@pytest.fixture(scope="module")
def journey():
    return demo.journey()


def test_demo_writes_its_files_and_is_more_accurate_than_the_paper(journey, tmp_path, monkeypatch):
    monkeypatch.setattr(demo, "journey", lambda progress: journey)
    status, out, _ = run("demo", "-o", "d", "--json", cwd=tmp_path)
    numbers = json.loads(out)
    assert status == 0
    assert numbers["compensated"]["largest_percent"] <= 0.7
    assert numbers["linear"]["largest_percent"] > 10
    names = {"loops.csv", "other-loops.csv", "model.json", "tracking.csv", "report.html"}
    assert {path.name for path in (tmp_path / "d").iterdir()} == names
    tracking = read_table(tmp_path / "d" / "tracking.csv").columns
    data = {column.name: column.data for column in tracking}
    error = np.abs(data["compensated_um"] - data["wanted_um"]).max() / (1e6 * demo.PlayActuator().stroke) * 100
    assert error == pytest.approx(numbers["compensated"]["largest_percent"], rel=1e-6)


def test_demo_replaces_files_only_with_force(journey, tmp_path, monkeypatch):
    monkeypatch.setattr(demo, "journey", lambda progress: journey)
    (tmp_path / "loops.csv").write_text("mine")
    assert [run("demo", "-o", tmp_path, *more, keep=True)[0] for more in ((), ("--force",))] == [2, 0]
    assert (tmp_path / "loops.csv").read_text() != "mine"
