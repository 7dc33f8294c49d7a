"""Models of installed packages: rows of a comparison, which cannot take a name of dehyst, and fail alone."""

import json
import subprocess
import sys

from command_line import run

import dehyst
from dehyst.trust.comparison import OURS, contenders
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, descending_tops

FITS = """
from dehyst.trust.baselines import Linear

flat = Linear.fit

def broken(records):
    raise KeyError("slope")
"""
ENTRIES = "flat = rival:flat\nbroken = rival:broken\nabsent = no_such_module:fit\nlinear ratio = rival:broken"


def test_a_library_that_is_imported_looks_for_no_entry_point():
    code = "import sys, dehyst; assert 'importlib.metadata' not in sys.modules"
    done = subprocess.run([sys.executable, "-S", "-c", f"import sys; sys.path[:] = {sys.path!r}; {code}"], check=False)
    assert done.returncode == 0


def test_a_model_of_a_package_is_a_row_and_a_faulty_one_fails_alone(tmp_path, monkeypatch):
    information = tmp_path / "rival-1.0.dist-info"
    information.mkdir()
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: rival\nVersion: 1.0\n")
    (information / "entry_points.txt").write_text(f"[dehyst.baselines]\n{ENTRIES}\n")
    (tmp_path / "rival.py").write_text(FITS)
    monkeypatch.syspath_prepend(tmp_path)
    assert list(contenders())[:3] == [OURS, "two branches", "linear ratio"]
    excitation = descending_tops(100.0, steps=4, drive=Sampling(sample_rate=50.0))
    measured = PlayActuator(highest=100.0).play(excitation.voltage)
    dehyst.write_record(tmp_path / "a.csv", dehyst.Record(excitation.time, excitation.voltage, measured))
    names = ("flat", "linear ratio", "broken", "absent")
    chosen = [word for name in names for word in ("--only", name)]
    status, out, _ = run("compare", tmp_path / "a.csv", "--json", *chosen)
    rows = {row["model"]: row for row in json.loads(out)["models"]}
    assert status == 0
    assert rows["flat"]["errors"] == rows["linear ratio"]["errors"] != []
    assert {name for name, row in rows.items() if row["said"]} == {"broken", "absent"}
