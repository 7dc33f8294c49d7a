"""Baselines of other distributions: what they add, what they may not replace, and that a broken one fails alone."""

import importlib
import json
import subprocess
import sys

import numpy as np
import pytest
from command_line import run
from plugged_in import plugged_in, write_distribution

import dehyst
from dehyst._errors import MissingExtraError, PluginError
from dehyst.baselines import BASELINES
from dehyst.baselines.comparison import OURS, contenders
from dehyst.baselines.registry import PluginWarning
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, descending_tops

FITS = """
from dehyst.baselines import BASELINES

def flat(records):
    return BASELINES["linear ratio"](records)

def broken(records):
    raise KeyError("slope")

def leaving(records):
    raise SystemExit(0)

word = "no"
"""


def loops(top=100.0):
    excitation = descending_tops(top, steps=4, drive=Sampling(sample_rate=50.0))
    time = np.arange(len(excitation.voltage)) / 50.0
    return dehyst.Record(time, excitation.voltage, PlayActuator(highest=top).play(excitation.voltage))


def test_a_library_that_is_imported_looks_for_no_plug_in():
    code = "import sys, dehyst; assert 'importlib.metadata' not in sys.modules"
    done = subprocess.run([sys.executable, "-S", "-c", f"import sys; sys.path[:] = {sys.path!r}; {code}"], check=False)
    assert done.returncode == 0


def test_a_baseline_of_another_distribution_is_compared(tmp_path):
    write_distribution(tmp_path, "rival", {"baselines": "flat = rival:flat\nbroken = rival:broken"}, FITS)
    dehyst.write_record(tmp_path / "a.csv", loops())
    chosen = [word for name in ("flat", "linear ratio", "broken") for word in ("--only", name)]
    with plugged_in(tmp_path):
        status, out, _ = run("compare", tmp_path / "a.csv", "--json", *chosen)
        flat, linear, broken = json.loads(out)["models"]
    assert status == 0
    assert (flat["model"], linear["model"]) == ("flat", "linear ratio")
    assert flat["errors"] == linear["errors"]
    assert broken["said"].startswith("broken: a plug-in raised KeyError: 'slope'")


@pytest.mark.parametrize("entry", ["dehyst = greedy:flat", "linear RATIO = greedy:flat", "flat = greedy:word"])
def test_a_baseline_that_takes_a_name_of_dehyst_or_is_no_function_is_left_out(tmp_path, entry):
    write_distribution(tmp_path, "greedy", {"baselines": entry}, FITS)
    with plugged_in(tmp_path), pytest.warns(PluginWarning, match=r"greedy 1\.0"):
        names = list(contenders())
    assert names[:3] == [OURS, *BASELINES.own]
    assert {name.casefold() for name in names[3:]}.isdisjoint({OURS, "linear ratio", "flat"})


def test_two_baselines_of_one_name_are_both_refused(tmp_path):
    for name in ("one", "other"):
        write_distribution(tmp_path / name, name, {"baselines": f"flat = {name}:flat"}, FITS)
    refused = pytest.raises(PluginError, match=r"one 1\.0 .*other 1\.0")
    with plugged_in(tmp_path / "one", tmp_path / "other"), pytest.warns(PluginWarning), refused:
        BASELINES["flat"]


def test_a_distribution_that_fails_is_named_and_the_others_work(tmp_path):
    write_distribution(tmp_path, "fails", {"baselines": "bad = fails:read"}, "raise SystemExit('no licence')")
    write_distribution(tmp_path, "works", {"baselines": "flat = works:flat\nleaving = works:leaving"}, FITS)
    with plugged_in(tmp_path):
        with pytest.warns(PluginWarning, match=r"fails 1\.0 .*no licence"):
            assert {*BASELINES} - {"bad"} >= {*BASELINES.own, "flat", "leaving"}
        with pytest.raises(PluginError, match=r"'bad' of fails 1\.0"):
            BASELINES["bad"]
        with pytest.raises(PluginError, match=r"leaving: .*SystemExit: 0"):
            BASELINES["leaving"]([loops()])


def test_without_pytest_the_contracts_name_their_extra(monkeypatch):
    for name in [name for name in sys.modules if name.startswith("dehyst.testing")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "pytest", None)
    with pytest.raises(MissingExtraError, match="pip install pytest"):
        importlib.import_module("dehyst.testing")
