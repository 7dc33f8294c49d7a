"""The commands: what they print, what they write, their exit status."""

import json
import re

import numpy as np
import pytest
from command_line import result, run
from virtual_loops import record_loops

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


def test_the_measured_lag_is_said(folder):
    model = json.loads((folder / "model.json").read_text())
    (folder / "late.json").write_text(json.dumps({**model, "delay_s": 0.25}))
    status, _, err = run("simulate", "late.json", "loops.csv", "-o", "a.csv", cwd=folder)
    assert (status, "250 ms" in err) == (0, True)


def test_the_newcomers_trap_is_caught(folder):
    loops = read_table(folder / "loops.csv")
    rows = np.column_stack([loops.column("time"), loops.column("voltage"), loops.column("displacement") * 1e6])[:1200]
    np.savetxt(folder / "major.csv", rows, delimiter=",", header="time_s,voltage_V,displacement_um", comments="")
    out = run("identify", "major.csv", "-o", "major.json", "--verbose", cwd=folder)[1]
    assert "do not determine all stiffnesses" in out
    promise = result("compensate", "major.json", "path.csv", "-o", "v.csv", cwd=folder)[1]["promise"]
    shown = run("compensate", "major.json", "path.csv", "-o", "v.csv", cwd=folder)[1].splitlines()
    assert promise["largest_percent"] > 1 and shown[1] == promise["untested"][0]["sentence"]
    status, out, _ = run("insight", "major.json", "major.csv", "--trajectory", "path.csv", "--json", cwd=folder)
    found = json.loads(out)
    assert status == 1
    assert found["directions"]["determined"] == 5
    assert any("excite recommended" in command for command in found["record_next"])
