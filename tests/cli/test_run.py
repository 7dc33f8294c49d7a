"""`dehyst run`: a path on a rig that ages, what it writes and says, and its exit status."""

import gc
import json
import signal
import subprocess
import sys
import weakref
from dataclasses import replace

import numpy as np
import pytest
from command_line import DEHYST, run

import dehyst
from dehyst import Actuator, Spring
from dehyst.calibration import PathRun, TrackedPath
from dehyst.instruments import open_rig
from dehyst.operations.registry import find
from dehyst.operations.run import Run, perform
from dehyst.records import read_table, salvage, write_columns
from dehyst.virtual import AgeingCourse, PlayActuator

RIG = """
from dehyst.instruments.simulated import SimulatedRig
from dehyst.virtual import AgeingCourse, AgeingActuator, PlayActuator


def make(**options):
    return SimulatedRig(AgeingActuator(PlayActuator(), AgeingCourse(gain=-7, width=25, seconds=15)), **options)
"""


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


def test_the_model_is_kept_true_and_written(folder):
    words = ("run", "rig.py:make", "--model", "model.json", "--path", "path.csv", "--cycles", "25", "--json")
    status, out, _ = run(*words, cwd=folder)
    frozen = json.loads(out)
    assert status == 0
    status, out, _ = run(*words, "--adapt", "-o", "run.csv", "--updated", "new.json", cwd=folder)
    adapted = json.loads(out)
    assert status == 0
    assert adapted["exchanges"] > 3
    assert adapted["cycles"][-1]["rms_percent"] < 0.4 * frozen["cycles"][-1]["rms_percent"]
    assert adapted["cycles"][-1]["gain_percent"] == pytest.approx(-7, abs=4)
    assert len(dehyst.read(folder / "run.csv")) == 25 * 200
    checked = json.loads(run("check", "new.json", "run.csv", "--json", cwd=folder)[1])
    assert not [words for words in checked["remarks"] if "gap" in words]
    new, old = (dehyst.Actuator.load(folder / name) for name in ("new.json", "model.json"))
    assert new.slip.breakaway.tolist() == old.slip.breakaway.tolist()
    assert new.slip.stiffness.tolist() != old.slip.stiffness.tolist()
    # It promises no less than what its last repetition reached.
    reached = 0.01 * adapted["cycles"][-1]["largest_percent"] * 1e-6 * adapted["stroke_um"]
    assert new.identification.expected_largest >= max(reached, old.identification.expected_largest)


def test_the_promise_is_that_of_compensate_and_says_what_is_untested_before_anything_moves(folder):
    words = ("run", "rig.py:make", "--model", "model.json", "--path", "path.csv", "--cycles", "2")
    status, out, _ = run(*words, "--json", cwd=folder)
    assert status == 0
    ran = json.loads(out)
    compensate = ("compensate", "model.json", "path.csv", "--home", "--slew-rate", "none", "-o", "volts.csv")
    planned = json.loads(run(*compensate, "--force", "--json", cwd=folder)[1])["judgement"]
    assert ran["judgement"]["begins"] == planned["begins"] == "homed"
    assert ran["judgement"]["untested"] == planned["untested"] != []
    for name in ("rms_m", "largest_m"):
        assert ran["judgement"][name] == pytest.approx(planned[name], rel=1e-6)
    (folder / "never_moves.py").write_text(
        RIG + "\n\nclass Still(SimulatedRig):\n    def _wave(self, *_):\n        raise OSError('still')\n"
        "\n\ndef still(**options):\n    return Still(PlayActuator(), **options)\n"
    )
    _, out, err = run("run", "never_moves.py:still", *words[2:], cwd=folder)
    assert out.splitlines()[:2] == ran["promise"][:2], err


def test_a_table_says_how_it_went_and_the_status_that_it_was_clamped(folder):
    words = ("run", "rig.py:make", "--model", "model.json", "--path", "path.csv", "--cycles", "2")
    status, out, _ = run(*words, "--adapt", cwd=folder)
    assert status == 0
    assert "offset" in out
    status, out, _ = run(*words, "--limits", "0", "90", cwd=folder)
    assert status == 1
    assert "clamped" in out


def test_limits_and_slew_rate_in_force_are_fields_and_notes_if_others_were_given(folder):
    words = ("run", "rig.py:make", "--model", "model.json", "--path", "path.csv", "--cycles", "1", "--json")
    notes = {}
    for given in ((), ("--limits", "-50", "400"), ("--slew-rate", "1e9"), ("--limits", "0", "190")):
        _, out, err = run(*words, *given, cwd=folder)
        found = json.loads(out)
        assert found["limits_V"] == ([0, 190] if "190" in given else [0, 200])
        # By default the whole range in 0.1 s.
        assert found["slew_V_per_s"] == (1e9 if "1e9" in given else pytest.approx(10 * found["limits_V"][1]))
        notes[given] = [line for line in err.splitlines() if "limits" in line or "slew rate" in line]
    recorded = dehyst.Actuator.load(folder / "model.json").recorded_slew_rate
    for given, rate in (((), 2000), (("--slew-rate", "1e9"), 1e9), (("--limits", "0", "190"), 1900)):
        (note,) = notes[given]
        assert f"{rate / recorded:.3g} times" in note
    assert len(notes["--limits", "-50", "400"]) == 2
    slow = run(*words, "--slew-rate", f"{0.9 * recorded}", cwd=folder)[2]
    assert " times " not in slow


def test_what_has_no_effect_or_cannot_be_followed_is_refused(folder):
    words = ("run", "sim://play", "--model", "model.json", "--path", "path.csv")
    assert run(*words, "--options", '{"memory": 3}', cwd=folder)[0] == 2
    assert run(*words, "--cycles", "0", cwd=folder)[0] == 2
    write_columns(folder / "untimed.csv", {"displacement_um": np.arange(5.0)})
    status, _, err = run("run", "sim://play", "--model", "model.json", "--path", "untimed.csv", cwd=folder)
    assert status == 2
    assert "rate" in err
    write_columns(folder / "point.csv", {"time_s": np.zeros(1), "displacement_um": np.ones(1)})
    status, _, err = run("run", "sim://play", "--model", "model.json", "--path", "point.csv", cwd=folder)
    assert status == 2
    assert "1 sample" in err


@pytest.mark.parametrize("name", ["run.json", "run.h5", "run"])
def test_a_record_that_cannot_be_written_is_refused_before_anything_moves(folder, name):
    (folder / "never.py").write_text("def make(**options):\n    raise SystemError\n")
    words = ("run", "never.py:make", "--model", "model.json", "--path", "path.csv", "-o", name)
    status, _, err = run(*words, cwd=folder)
    assert status == 2
    assert ".csv" in err


def test_a_model_of_another_actuator_ends_the_run_and_the_record_is_kept(folder):
    model = dehyst.Actuator.load(folder / "model.json")
    spring = model.spring
    other = Spring.of_slopes(spring.displacement + 20e-6, spring.slopes, float(spring.voltage[0]))
    Actuator(model.slip, other, limits=model.limits).save(folder / "other.json")
    phase = 2 * np.pi * np.arange(200) / 200
    write_columns(folder / "far.csv", {"time_s": 0.005 * np.arange(200), "displacement_um": 27 - 5 * np.cos(phase)})
    words = ("run", "rig.py:make", "--model", "other.json", "--path", "far.csv", "--cycles", "5", "-o", "one.csv")
    status, _, err = run(*words, cwd=folder)
    assert status == 2
    assert "--model" in err
    assert len(dehyst.read(folder / "one.csv")) == 200


# A rig that measures a temperature and ends in the middle of wave number `END`, after 60 samples, as `HOW` says. It
# notes how many samples it had handed over.
CUT = """
import os, signal
from pathlib import Path
from dehyst.instruments.simulated import SimulatedRig
from dehyst.virtual import AgeingActuator, AgeingCourse, PlayActuator

HERE = Path(__file__).parent


class Cut(SimulatedRig):
    waves = 0

    def _wave(self, voltage, rate):
        self.waves, count = self.waves + 1, 0
        for samples in super()._wave(voltage, rate):
            yield samples
            # The next samples are requested: these are on the disk.
            count += samples.time.size
            if self.waves == END and count >= 60:
                (HERE / "count").write_text(str(count))
                HOW


def make(**options):
    return Cut(AgeingActuator(PlayActuator(), AgeingCourse(kelvins=5, seconds=60)), **options)
"""
FOLLOW = ("run", "cut.py:make", "--model", "model.json", "--path", "path.csv", "--cycles", "4", "-o", "run.csv")
KILL, FAIL, STOP = "os.kill(os.getpid(), signal.SIGKILL)", "raise OSError('cut')", "raise KeyboardInterrupt"


@pytest.fixture
def cut(folder, tmp_path):
    """Return a function that runs in a folder of its own, in which the rig ends in the middle of wave `end`."""

    def ended(end, how, *, process=False):
        for name in ("model.json", "path.csv"):
            (tmp_path / name).write_bytes((folder / name).read_bytes())
        (tmp_path / "cut.py").write_text(CUT.replace("END", str(end)).replace("HOW", how))
        if not process:
            return tmp_path, run(*FOLLOW, cwd=tmp_path)
        done = subprocess.run([*DEHYST, *FOLLOW], cwd=tmp_path, capture_output=True, timeout=120, check=False)
        return tmp_path, (done.returncode, done.stdout.decode(), done.stderr.decode())

    return ended


def columns_in(path):
    return {one.name: one.data for one in read_table(path).columns}


@pytest.mark.parametrize(("how", "status"), [(FAIL, 1), (STOP, 130)])
def test_a_repetition_that_is_cut_short_is_in_the_record(cut, how, status):
    folder, (found, _, err) = cut(3, how)
    assert found == status
    assert "run.csv" in err and "brought to 0 V" in err
    columns = columns_in(folder / "run.csv")
    count = int((folder / "count").read_text())
    assert columns["repetition"].tolist() == [1] * 200 + [2] * count
    assert count < 200
    wanted = columns_in(folder / "path.csv")["displacement_um"]
    assert columns["wanted_um"] == pytest.approx(np.concatenate([wanted, wanted[:count]]), abs=1e-9)
    assert np.abs(columns["displacement_um"] - columns["wanted_um"]).max() < 0.2
    record = dehyst.read(folder / "run.csv")
    assert record.temperature.size == len(record) == 200 + count
    # Nothing else is left.
    assert sorted(path.suffix for path in folder.iterdir() if path.stem.startswith("run")) == [".csv"]


def test_a_homing_that_is_cut_short_is_in_the_record(cut):
    folder, (status, _, err) = cut(1, FAIL)
    assert status == 1 and "run.csv" in err
    assert set(columns_in(folder / "run.csv")["repetition"]) == {0}
    assert len(dehyst.read(folder / "run.csv")) == int((folder / "count").read_text())


@pytest.mark.skipif(sys.platform == "win32", reason="SIGKILL of POSIX")
def test_a_killed_run_loses_no_sample_and_the_next_one_makes_a_record_of_them(cut):
    folder, (status, _, _) = cut(3, KILL, process=True)
    assert status == -signal.SIGKILL
    assert not (folder / "run.csv").exists()
    count = int((folder / "count").read_text())
    # The journal is a table that can be read as it is.
    journal = columns_in(folder / "run.h5.part.csv")
    assert np.count_nonzero(journal["repetition_1"] == 2) == count
    folder, (status, _, err) = cut(0, FAIL)
    assert status == 0 and "run.h5" in err
    record = dehyst.read(folder / "run.h5")
    assert record.meta["complete"] is False and record.temperature is not None
    others = {one.name: one.values for one in record.others}
    number = others["repetition"]
    assert [np.count_nonzero(number == k) for k in (1, 2)] == [200, count]
    wanted = 1e-6 * columns_in(folder / "path.csv")["displacement_um"]
    assert others["wanted"][number == 2] == pytest.approx(wanted[:count], abs=1e-15)
    assert len(dehyst.read(folder / "run.csv")) == 4 * 200
    assert not list(folder.glob("*.part.csv"))


def test_a_record_that_cannot_be_written_is_left_beside_it(cut, monkeypatch):
    def full(path, _):
        raise dehyst.FileFormatError(f"{path}: full")

    monkeypatch.setattr("dehyst.operations.path_run.write_table", full)
    for end, status, kept in ((3, 1, 200), (0, 2, 800)):
        folder, (found, _, err) = cut(end, FAIL)
        assert found == status
        (left,) = folder.glob("run*.h5")
        assert left.name in err and "run.csv" in err
        record = dehyst.read(left)
        number = next(one.values for one in record.others if one.name == "repetition")
        assert np.count_nonzero(number) >= kept and record.meta["complete"] is False
        left.unlink()
    assert salvage(folder) == []


def test_no_work_on_a_repetition_is_repeated_and_none_is_kept(folder, monkeypatch):
    made, counted = [], []
    repeat, fields = PathRun._repeat, TrackedPath.as_dict

    def repeated(*arguments):
        gc.collect()
        counted.append(sum(one() is not None for one in made))
        found = repeat(*arguments)
        made.append(weakref.ref(found[0]))
        return found

    calls = []
    monkeypatch.setattr(PathRun, "_repeat", repeated)
    monkeypatch.setattr(TrackedPath, "as_dict", lambda self: calls.append(self.time.size) or fields(self))
    words = ("run", "rig.py:make", "--model", "model.json", "--path", "path.csv", "--cycles", "6", "--adapt", "--json")
    status, out, _ = run(*words, "-o", "kept.csv", "--updated", "kept.json", cwd=folder)
    assert status == 0 and len(json.loads(out)["cycles"]) == 6
    assert len(calls) == 6
    assert counted == [0, 1, 1, 1, 1, 1]


def test_an_offset_that_is_not_corrected_is_mentioned(folder):
    old = RIG.replace("seconds=15", "seconds=0.1")
    (folder / "old.py").write_text(old)
    words = ("run", "old.py:make", "--model", "model.json", "--path", "path.csv", "--cycles", "20", "--adapt")
    held, trusted = (run(*words, *more, cwd=folder) for more in ((), ("--options", '{"zero_drifts": false}')))
    assert "zero_drifts" in held[1] and "zero_drifts" not in trusted[1]
    largest = [float(out.split("largest")[1].split("%")[0]) for _, out, _ in (held, trusted)]
    assert largest[1] < 0.5 * largest[0]


def test_the_temperature_of_a_path_counts_unless_the_rig_measures_it(folder):
    model = dehyst.Actuator.load(folder / "model.json")
    replace(model, thermal=dehyst.Thermal(-0.07 / 20, 0.0, 20.0)).save(folder / "thermal.json")
    phase = 2 * np.pi * np.arange(200) / 200
    columns = {"time_s": 0.005 * np.arange(200), "displacement_um": 7 - 5 * np.cos(phase)}
    write_columns(folder / "warm.csv", {**columns, "temperature_C": np.full(200, 40.0)})
    errors = {}
    for kelvins in (0, 20):
        rig = f"sim://play?gain=-7,seconds=0.1,kelvins={kelvins}"
        for path in ("path.csv", "warm.csv"):
            words = ("run", rig, "--model", "thermal.json", "--path", path, "--cycles", "2", "--json")
            status, out, err = run(*words, cwd=folder)
            assert status == 0
            errors[kelvins, path] = json.loads(out)["cycles"][-1]["rms_percent"]
            assert ("measures the temperature" in err) == (kelvins > 0 and path == "warm.csv")
    assert errors.pop((0, "path.csv")) > 2
    assert max(errors.values()) < 0.5
    words = (
        "run",
        "sim://play",
        "--model",
        "model.json",
        "--path",
        "warm.csv",
        "--columns",
        "temperature=temperature_C",
    )
    status, _, err = run(*words, cwd=folder)
    assert status == 2 and "temperature" in err


def test_an_error_that_the_sensor_shows_before_a_repetition_is_printed_and_expected(folder):
    rig = "sim://play?offset=3,seconds=0.1"
    words = ("run", rig, "--model", "model.json", "--path", "path.csv", "--cycles", "3")
    _, out, _ = run(*words, "--json", cwd=folder)
    found = json.loads(out)
    assert all(one["largest_percent"] <= one["promised_percent"] for one in found["cycles"])
    assert (
        found["judgement"]["largest_m"] * 1e6 / found["stroke_um"] < 0.01 < 0.01 * found["cycles"][0]["largest_percent"]
    )
    more = next(line for line in found["promise"] if "From now on" in line)
    assert more in run(*words, cwd=folder)[1]


def test_an_instrument_that_records_no_temperature_refuses_kelvins():
    """The way out that the error names has the channel."""
    ageing = AgeingCourse(-7, kelvins=20)
    with pytest.raises(dehyst.RigError) as refused:
        perform(find("rig serve"), {"port": 0, "seconds": 0.0, "ageing": ageing}, Run())
    assert refused.value.argument == "ageing"
    (address,) = (word for word in str(refused.value).split() if word.startswith("sim://"))
    with open_rig(address) as rig:
        assert rig.others == ("temperature_C",)
