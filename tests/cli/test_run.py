"""`dehyst run`: a path on a rig, what it writes and says, and its exit status."""

import json
from dataclasses import replace

import numpy as np
import pytest
from command_line import run

import dehyst
from dehyst.model import slew_rate_of_records
from dehyst.records import read_table, write_columns
from dehyst.virtual import PlayActuator

RIG = """
from dehyst.instruments.simulated import SimulatedRig
from dehyst.virtual import PlayActuator


def make(**options):
    return SimulatedRig(PlayActuator(), **options)
"""
# Four samples late.
LATE = """
import numpy as np
from dehyst.instruments.simulated import SimulatedRig
from dehyst.virtual import PlayActuator


class Late(PlayActuator):
    sent = np.zeros(4)

    def play(self, voltage, **options):
        sent = np.append(self.sent, voltage)
        self.sent = sent[-4:]
        return super().play(sent[:-4], **options)


def make(**options):
    return SimulatedRig(Late(), **options)
"""
WORDS = ("run", "rig.py:make", "--model", "model.json", "--path", "path.csv")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    target = tmp_path_factory.mktemp("run")
    time = 0.01 * np.arange(2400)
    tops = np.interp(time, np.arange(0, 26, 2), [0, 200, 0, 200, 0, 170, 0, 140, 0, 110, 0, 80, 0])
    record = dehyst.Record(time, tops, PlayActuator().play(tops, time=time))
    dehyst.identify(record, structure="maxwell_slip").actuator.save(target / "model.json")
    phase = 2 * np.pi * np.arange(200) / 200
    write_columns(target / "path.csv", {"time_s": 0.005 * np.arange(200), "displacement_um": 7 - 5 * np.cos(phase)})
    (target / "rig.py").write_text(RIG)
    return target


def test_the_path_is_followed_and_its_record_is_written(folder):
    status, out, _ = run(*WORDS, "-o", "run.csv", "--json", cwd=folder)
    found = json.loads(out)
    assert (status, found["clamped"]) == (0, 0)
    assert 0 < found["largest_m"] <= found["promise"]["largest_m"] + abs(found["mean_percent"]) / 100 * 15e-6
    assert found["largest_percent"] < 1
    columns = {one.name: one.data for one in read_table(folder / "run.csv").columns}
    wanted = read_table(folder / "path.csv").column("displacement")
    assert columns["wanted_um"] == pytest.approx(1e6 * wanted, abs=1e-9)
    record = dehyst.read(folder / "run.csv")
    assert len(record) == 200
    error = record.displacement - wanted
    assert np.abs(error).max() == pytest.approx(found["largest_m"], rel=1e-6)


def test_an_actuator_with_a_delay_is_on_the_path_in_time(folder):
    model = dehyst.Actuator.load(folder / "model.json")
    (folder / "late.py").write_text(LATE)
    errors = []
    for delay in (0.0, 0.02):
        replace(model, delay=delay).save(folder / "late.json")
        words = ("run", "late.py:make", "--model", "late.json", "--path", "path.csv", "--json")
        errors.append(json.loads(run(*words, cwd=folder)[1])["largest_percent"])
    assert errors[0] > 3
    assert errors[1] < 1


def test_the_promise_is_that_of_compensate_and_says_what_is_untested_before_anything_moves(folder):
    status, out, _ = run(*WORDS, "--json", cwd=folder)
    assert status == 0
    ran = json.loads(out)
    compensate = ("compensate", "model.json", "path.csv", "--home", "--slew-rate", "none", "-o", "volts.csv")
    planned = json.loads(run(*compensate, "--force", "--json", cwd=folder)[1])["promise"]
    assert ran["promise"]["path"] == planned["path"]
    assert ran["promise"]["untested"] == planned["untested"] != []
    for name in ("rms_m", "largest_m"):
        assert ran["promise"][name] == pytest.approx(planned[name], rel=1e-6)
    (folder / "never_moves.py").write_text(
        RIG + "\n\nclass Still(SimulatedRig):\n    def _wave(self, *_):\n        raise OSError('still')\n"
        "\n\ndef still(**options):\n    return Still(PlayActuator(), **options)\n"
    )
    status, out, err = run("run", "never_moves.py:still", *WORDS[2:], cwd=folder)
    promised = [ran["promise"]["sentence"], *(one["sentence"] for one in ran["promise"]["untested"])]
    assert (status, out.splitlines()[: len(promised)]) == (1, promised)
    assert "brought to 0 V" in err


def test_limits_and_slew_rate_in_force_are_fields_and_notes_if_others_were_given(folder):
    notes = {}
    for given in ((), ("--limits", "-50", "400"), ("--slew-rate", "1e9"), ("--limits", "0", "190")):
        _, out, err = run(*WORDS, "--json", *given, cwd=folder)
        found = json.loads(out)
        assert found["limits_V"] == ([0, 190] if "190" in given else [0, 200])
        # By default the whole range in 0.1 s.
        assert found["slew_V_per_s"] == (1e9 if "1e9" in given else pytest.approx(10 * found["limits_V"][1]))
        notes[given] = [line for line in err.splitlines() if "limits" in line or "slew rate" in line]
    recorded = slew_rate_of_records(dehyst.Actuator.load(folder / "model.json"))
    for given, rate in (((), 2000), (("--slew-rate", "1e9"), 1e9), (("--limits", "0", "190"), 1900)):
        (note,) = notes[given]
        assert f"{rate / recorded:.3g} times" in note
    assert len(notes["--limits", "-50", "400"]) == 2
    slow = run(*WORDS, "--json", "--slew-rate", f"{0.9 * recorded}", cwd=folder)[2]
    assert " times " not in slow


def test_the_status_of_a_clamped_path_is_1(folder):
    status, out, _ = run(*WORDS, "--limits", "0", "90", "--json", cwd=folder)
    assert status == 1
    assert json.loads(out)["clamped"] > 0


def test_what_cannot_be_followed_is_refused(folder):
    words = ("run", "sim://", "--model", "model.json", "--path")
    write_columns(folder / "untimed.csv", {"displacement_um": np.arange(5.0)})
    status, _, err = run(*words, "untimed.csv", cwd=folder)
    assert status == 2
    assert "rate" in err
    write_columns(folder / "point.csv", {"time_s": np.zeros(1), "displacement_um": np.ones(1)})
    status, _, err = run(*words, "point.csv", cwd=folder)
    assert status == 2
    assert "1 sample" in err
    write_columns(folder / "far.csv", {"time_s": 0.005 * np.arange(200), "displacement_um": np.linspace(0, 5e3, 200)})
    assert run(*words, "far.csv", cwd=folder)[0] == 2


@pytest.mark.parametrize("name", ["run.json", "run"])
def test_a_record_that_cannot_be_written_is_refused_before_anything_moves(folder, name):
    (folder / "never.py").write_text("def make(**options):\n    raise SystemError\n")
    status, _, err = run("run", "never.py:make", *WORDS[2:], "-o", name, cwd=folder)
    assert status == 2
    assert ".csv" in err


def test_the_temperature_of_a_path_counts(folder):
    model = dehyst.Actuator.load(folder / "model.json")
    replace(model, thermal=dehyst.Thermal(-0.07 / 20, 0.0, 20.0)).save(folder / "thermal.json")
    phase = 2 * np.pi * np.arange(200) / 200
    columns = {"time_s": 0.005 * np.arange(200), "displacement_um": 7 - 5 * np.cos(phase)}
    write_columns(folder / "warm.csv", {**columns, "temperature_C": np.full(200, 40.0)})
    (folder / "aged.py").write_text(
        "from dehyst.instruments.simulated import SimulatedRig\nfrom dehyst.virtual import PlayActuator\n"
        "def make(**options):\n    return SimulatedRig(PlayActuator(stroke=0.93 * PlayActuator().stroke), **options)\n"
    )
    rig, errors = "aged.py:make", []
    for path in ("path.csv", "warm.csv"):
        status, out, _ = run("run", rig, "--model", "thermal.json", "--path", path, "--json", cwd=folder)
        assert status == 0
        errors.append(json.loads(out)["rms_percent"])
    assert errors[0] > 2
    assert errors[1] < 0.5
    words = ("run", "sim://", "--model", "model.json", "--path", "warm.csv")
    status, _, err = run(*words, "--columns", "temperature=temperature_C", cwd=folder)
    assert status == 2 and "temperature" in err
