"""The commands: what they print, what they write, their exit status."""

import json
import os
import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import places
import pytest
from command_line import commands, result, run
from virtual_loops import record_loops

from dehyst.cli import main
from dehyst.operations.registry import ENTRIES
from dehyst.records import read_table, write_record

PLAIN = "--structure", "maxwell_slip"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with two records, a model of the structure they ask for, one of the paper's, and a path."""
    target = tmp_path_factory.mktemp("cli")
    training, validation = record_loops()
    write_record(target / "loops.csv", training)
    write_record(target / "other.csv", validation)
    result("identify", "loops.csv", "--validate", "other.csv", "-o", "model.json", cwd=target)
    path = np.concatenate([np.linspace(2, 14, 50), np.linspace(14, 5, 40)])
    rows = "\n".join(f"{i * 0.1:.1f},{y!r}" for i, y in enumerate(path.tolist()))
    (target / "path.csv").write_text(f"time_s,displacement_um\n{rows}\n")
    return target


def test_identify_prints_a_table_and_writes_a_report(folder):
    status, out, err = run("identify", "loops.csv", *PLAIN, "--report", "r.html", "--verbose", cwd=folder)
    assert status == 0
    assert re.search(r"loops +training +\d+ +\d+ +\d\.\d+ % +\d\.\d+ %", out)
    verdict, *_ = out.splitlines()
    assert re.match(r"(Ready|Usable, with care): .*\d\.\d+ %", verdict)
    assert "data-chart=" in (folder / "r.html").read_text()
    brief = run("identify", "loops.csv", *PLAIN, cwd=folder)[1].splitlines()
    assert len(brief) <= 12 < len(out.splitlines()) and re.search(r"\d\.\d+ %", brief[0])
    assert err == ""  # beside a terminal, progress is for longer work only


def test_every_command_prints_the_same_range_and_stroke_of_a_model(folder):
    record = record_loops()[0]
    noisy = replace(record, voltage=record.voltage + np.random.default_rng(1).normal(0, 2e-3, len(record)))
    write_record(folder / "noisy.csv", noisy)
    made = run("identify", "noisy.csv", *PLAIN, "-o", "noisy.json", cwd=folder)[1]
    plan = "compensate noisy.json path.csv -o v.csv --home"
    shown, planned = (run(*words.split(), cwd=folder)[1] for words in ("show noisy.json", plan))
    err = run("simulate", "noisy.json", "noisy.csv", "-o", "s.csv", "--start", "noisy.csv", cwd=folder)[2]
    compared = run("compare", "noisy.csv", "--validate", "loops.csv", "--verbose", cwd=folder)[1]
    assert all(" 0 to 200 V" in text for text in (made, shown, planned))
    assert "outside" not in err
    assert re.search(r"stroke ([\d.]+ um)", shown)[1] in compared


def test_the_lag_of_a_model_is_printed(folder):
    model = json.loads((folder / "model.json").read_text())
    (folder / "late.json").write_text(json.dumps({**model, "delay_s": 0.25}))
    status, _, err = run("simulate", "late.json", "loops.csv", "-o", "a.csv", cwd=folder)
    assert (status, "250 ms" in err) == (0, True)


def test_a_model_of_the_major_loop_alone_has_a_warning(folder):
    loops = read_table(folder / "loops.csv")
    rows = np.column_stack([loops.column("time"), loops.column("voltage"), loops.column("displacement") * 1e6])[:1200]
    np.savetxt(folder / "major.csv", rows, delimiter=",", header="time_s,voltage_V,displacement_um", comments="")
    out = run("identify", "major.csv", "-o", "major.json", "--verbose", cwd=folder)[1]
    assert "do not determine all stiffnesses" in out
    promise = result("compensate", "major.json", "path.csv", "-o", "v.csv", cwd=folder)[1]["promise"]
    err = run("compensate", "major.json", "path.csv", "-o", "v.csv", cwd=folder)[2]
    assert promise["largest_percent"] > 1 and promise["untested"][0]["sentence"] in err
    status, found = result("insight", "major.json", "major.csv", "--trajectory", "path.csv", cwd=folder)
    assert status == 1
    assert found["directions"]["determined"] == 5
    assert any("excite recommended" in command for command in found["record_next"])


def test_insight_and_compensate_read_a_path_alike(folder):
    rows = (folder / "path.csv").read_text().splitlines()[1:]
    (folder / "line.csv").write_text("\n".join(["time_s,x_um", *rows]))
    (folder / "plane.csv").write_text("\n".join(["time_s,x_um,y_um", *(f"{row},7" for row in rows)]))
    for path, columns in {"line.csv": "voltage=voltage_V", "plane.csv": "displacement=x_um"}.items():
        own = ["--columns", columns] * (path == "plane.csv")
        planned = result("compensate", "model.json", path, "-o", "v.csv", *own, cwd=folder)[1]
        seen = result("insight", "model.json", "loops.csv", "--trajectory", path, "--columns", columns, cwd=folder)[1]
        assert seen["promise"] == planned["promise"]


def test_help_has_every_command_once_under_a_heading_on_one_screen():
    status, out, err = run("--help")
    assert status == 0 and len(out.splitlines()) <= 40 and run() == (status, out, err)
    listed = re.findall(r"^  ([a-z]+(?: [a-z]+)?)  +(\S.*)$", out, re.M)
    names = [name for entries in main.journey.values() for name in entries]
    assert [name for name, _ in listed] == names and {*ENTRIES} < {*names}
    assert names.index("excite") < names.index("identify") < names.index("compensate") < names.index("export")
    assert [heading for heading in main.journey if f"\n{heading}:\n" in out] == list(main.journey)


@pytest.mark.parametrize("name", dict(commands()))
def test_help_of_a_command_is_one_screen_with_its_options_alone(name):
    out = run(*name.split(), "--help")[1]
    assert len(out.splitlines()) <= 40
    own = {each.opts[-1] for each in dict(commands())[name].params if each.opts[-1][0] == "-"}
    assert {*re.findall(r"^  (?:-\w, )?(--[\w-]+)", out, re.M)} == {"--help", *own}


def test_help_loads_no_numpy():
    program = "import sys; from dehyst.cli import main; main(['-h'], standalone_mode=False); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    assert "numpy" not in done.stdout.splitlines()[-1].split()


@pytest.mark.parametrize(
    ("arguments", "suggestion"),
    [
        (["identfy", "loops.csv"], "identify"),
        (["simulation"], "simulate"),
        (["identify", "--outptu", "3", "loops.csv"], "--output"),
    ],
)
def test_a_mistyped_name_gets_a_suggestion(arguments, suggestion):
    status, out, err = run(*arguments)
    assert (status, out) == (2, "")
    assert re.search(rf"[Dd]id you mean.*'{suggestion}'", err)


def test_the_documented_completion_script_is_printed():
    page = (places.DOCS / "how_to" / "command_line.md").read_text()
    variable = re.search(r"(_DEHYST_COMPLETE)=bash_source", page)[1]
    environment = {**os.environ, variable: "zsh_source"}
    command = [sys.executable, "-c", "from dehyst.cli import main; main(prog_name='dehyst')"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=60)
    assert "#compdef dehyst" in done.stdout
