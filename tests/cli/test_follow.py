"""`dehyst follow`: a path on a rig, what it writes and says, what it learns, and its exit status."""

import json
from dataclasses import replace

import numpy as np
import pytest
from command_line import refused, result, run_as_process
from command_line import run as run_command
from emulated_stage import COUPLING, HIGHEST, served

import dehyst
from dehyst.calibration.following import FollowedPath
from dehyst.control import Clamps
from dehyst.model import Stage
from dehyst.records import read_table, write_columns
from dehyst.virtual import PlayActuator, VirtualStage

# Rigs with a fault each, by the function that makes them.
RIGS = """
import os
from pathlib import Path
import numpy as np
from dehyst.instruments.simulated import SimulatedRig
from dehyst.virtual import PlayActuator

STROKE = PlayActuator().stroke


class Late(PlayActuator):
    sent = np.zeros(4)

    def play(self, voltage, **options):
        sent = np.append(self.sent, voltage)
        self.sent = sent[-4:]
        return super().play(sent[:-4], **options)


class Killed(SimulatedRig):
    given = waves = 0

    def _wave(self, voltage, rate):
        self.waves += 1
        for samples in super()._wave(voltage, rate):
            if self.waves == 3 and self.given > 1700:
                Path("given").write_text(str(self.given))
                os.kill(os.getpid(), 9)
            yield samples
            self.given += samples.time.size


class Still(SimulatedRig):
    def _wave(self, *_):
        raise OSError("still")


class Blind(SimulatedRig):
    def _read(self):
        return (0.0, 0.0, float("nan"))

    def _put(self, _):
        raise SystemError


def of(actuator=PlayActuator, rig=SimulatedRig, **numbers):
    return lambda **options: rig(actuator(**numbers), **options)


make, late, killed, still, blind = of(), of(Late), of(rig=Killed), of(rig=Still), of(rig=Blind)
aged, noisy, larger = of(stroke=0.93 * STROKE), of(noise=60e-9), of(noise=2e-9, stroke=1.03 * STROKE)
"""


def words(rig="make", path="path", model="model"):
    """A command that follows a path on a rig, each by its name."""
    return "follow", f"rig.py:{rig}", "--model", f"{model}.json", "--path", f"{path}.csv"


def run(*words, cwd):
    """Return exit status and JSON result of a command that replaces what an earlier one wrote."""
    return result(*words, "--force", cwd=cwd)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    target = tmp_path_factory.mktemp("run")
    time = 0.01 * np.arange(2400)
    tops = np.interp(time, np.arange(0, 26, 2), [0, 200, 0, 200, 0, 170, 0, 140, 0, 110, 0, 80, 0])
    record = dehyst.Record(time, tops, PlayActuator().play(tops, time=time))
    dehyst.identify(record, structure="maxwell_slip").actuator.save(target / "model.json")
    phase = 2 * np.pi * np.arange(200) / 200
    write_columns(target / "path.csv", {"time_s": 0.005 * np.arange(200), "displacement_um": 7 - 5 * np.cos(phase)})
    (target / "rig.py").write_text(RIGS)
    return target


def test_the_path_is_followed_and_its_record_is_written(folder):
    status, found = run(*words(), "-o", "once", cwd=folder)
    assert (status, found["clamped"], found["kept"]) == (0, 0, True)
    assert 0 < found["largest_m"] <= found["promise"]["largest_m"] + abs(found["mean_percent"]) / 100 * 15e-6
    wanted = read_table(folder / "path.csv").column("displacement")
    record = dehyst.read(folder / "once" / "record.csv")
    # The homing is in it too.
    assert len(record) > 400
    assert record.others[0].values[-200:] == pytest.approx(1e6 * wanted, abs=1e-9)
    error = record.displacement[-200:] - wanted
    assert np.abs(error).max() == pytest.approx(found["largest_m"], rel=1e-6)
    assert "Measured along a path" in (folder / "once" / "report.html").read_text()


def test_the_noise_of_the_sensor_does_not_break_the_promise(folder):
    for rig, noise, kept in (("noisy", 60e-9, True), ("larger", 2e-9, False)):
        status, found = run(*words(rig), cwd=folder)
        assert found["largest_m"] > found["promise"]["largest_m"]
        assert (status, found["kept"]) == (0 if kept else 1, kept)
        assert found["noise_m"] == pytest.approx(noise, rel=0.2)


def test_a_path_that_is_missed_is_refused_before_anything_moves(folder):
    moved = 7 - 12 * np.cos(2 * np.pi * np.arange(200) / 200)
    write_columns(folder / "wide.csv", {"time_s": 0.005 * np.arange(200), "displacement_um": moved})
    given = (*words(path="wide"), "-o", "wide")
    status, _, err = run_command(*given, keep=True, cwd=folder)
    assert status == 2 and "CLAMPED" in err and "nothing was moved" in err
    assert not (folder / "wide" / "record.csv").exists() and run(*given, cwd=folder)[0] == 1


def test_a_repeated_path_has_a_way_back_and_an_error_each_time(folder):
    write_columns(folder / "ramp.csv", {"time_s": 0.005 * np.arange(200), "displacement_um": 3 + 0.04 * np.arange(200)})
    found = run(*words(path="ramp"), "--repeat", "3", cwd=folder)[1]
    assert len(found["repetitions"]) == 3
    assert max(repetition["largest_percent"] for repetition in found["repetitions"]) < 1


def test_a_path_is_learnt_to_the_noise_and_its_voltages_play_again(folder):
    status, found = run(*words(), "--learn", "-o", "learnt", cwd=folder)
    errors = [repetition["rms_percent"] for repetition in found["repetitions"]]
    assert status == 0
    assert 3 < len(errors) <= 21
    assert found["rms_percent"] == min(errors) < 0.3 * errors[0]
    voltage = read_table(folder / "learnt" / "voltages.csv").column("voltage")
    truth, home = PlayActuator(), np.interp(np.arange(800), np.arange(0, 1000, 200), [0, 200, 0, 200, 0])
    sent = np.concatenate([home, np.tile(voltage, 3)])
    played = truth.play(sent, time=0.005 * np.arange(sent.size), measured=False)[-voltage.size :]
    wanted = read_table(folder / "path.csv").column("displacement")
    error = 100 * (played - wanted) / truth.stroke
    assert np.sqrt(np.mean(error**2)) < 0.5 * errors[0]


def test_several_axes_are_learnt_together(tmp_path):
    time, widths = 0.01 * np.arange(2400), (16e-6, 20e-6, 12e-6)
    truths = [PlayActuator(plays=60, highest=high, stroke=w) for high, w in zip(HIGHEST, widths, strict=True)]
    stage = VirtualStage(truths, COUPLING, noise=2e-9)
    actuators = []
    for truth, high in zip(truths, HIGHEST, strict=True):
        tops = np.interp(time, np.arange(0, 26, 2), high * np.array([0, 1, 0, 1, 0, 0.8, 0, 0.6, 0, 0.4, 0, 0.2, 0]))
        record = dehyst.Record(time, tops, truth.play(tops, time=time, measured=False))
        actuators.append(dehyst.identify(record, structure="maxwell_slip").actuator)
        truth.relax()
    Stage(tuple(actuators), COUPLING, axes=("1", "2", "3")).save(tmp_path / "stage.json")
    phase = 2 * np.pi * np.arange(400) / 400
    path = {f"{axis}_um": 6 - 3 * np.cos(phase + axis) for axis in (1, 2, 3)}
    write_columns(tmp_path / "path.csv", {"time_s": 0.005 * np.arange(400), **path})
    with served(stage=stage, speed=40.0) as (server, bench):
        rig = f"pi://127.0.0.1:{server.port}/1,2,3"
        found = run("follow", rig, *words(model="stage")[2:], "--learn", "--repeat", "4", cwd=tmp_path)[1]
        assert [single.voltage for single in bench.axes] == [0, 0, 0]
    first, last = found["repetitions"][0], found["repetitions"][-1]
    assert {*first} == {"1", "2", "3"}
    assert all(last[axis]["rms_percent"] < max(0.6 * first[axis]["rms_percent"], 0.05) for axis in first)
    assert len(read_table(tmp_path / "dehyst-follow" / "voltages.csv").column("voltage", "v2_V")) == 400


def test_feedback_corrects_a_model_that_is_wrong(folder):
    model = dehyst.Actuator.load(folder / "model.json")
    replace(model, spring=replace(model.spring, displacement=1.04 * model.spring.displacement)).save(
        folder / "off.json"
    )
    slow = {"time_s": 0.02 * np.arange(200), "displacement_um": 7 - 3 * np.cos(2 * np.pi * np.arange(200) / 200)}
    write_columns(folder / "slow.csv", slow)
    given = (*words(path="slow", model="off"), "--repeat", "2")
    errors = [run(*given, *more, cwd=folder)[1]["rms_percent"] for more in ((), ("--feedback",))]
    assert errors[1] < 0.5 * errors[0]


def test_samples_before_a_kill_are_in_the_file(folder):
    """Killed without a warning in a learnt path: each sample that the rig gave is in the record."""
    assert run_as_process(*words("killed"), "--learn", "-o", "killed", "--force", cwd=folder)[0] == -9
    rows = (folder / "killed" / "record.csv").read_text().splitlines()[2:]
    assert len(rows) == int((folder / "given").read_text()) > 1500


def test_a_path_is_on_time_despite_a_delay(folder):
    model = dehyst.Actuator.load(folder / "model.json")
    errors = []
    for delay in (0.0, 0.02):
        replace(model, delay=delay).save(folder / "late.json")
        errors.append(run(*words("late", model="late"), cwd=folder)[1]["largest_percent"])
    assert errors[0] > 3
    assert errors[1] < 1


def test_follow_prints_the_promise_of_compensate_before_it_moves(folder):
    status, ran = run(*words(), cwd=folder)
    assert status == 0
    compensate = ("compensate", "model.json", "path.csv", "--home", "--slew-rate", "none", "-o", "volts.csv")
    planned = run(*compensate, cwd=folder)[1]["promise"]
    assert ran["promise"]["path"] == planned["path"]
    assert ran["promise"]["untested"] == planned["untested"] != []
    for name in ("rms_m", "largest_m"):
        assert ran["promise"][name] == pytest.approx(planned[name], rel=1e-6)
    status, out, err = run_command(*words("still"), "--force", cwd=folder)
    promised = [ran["promise"]["sentence"], *(gap["sentence"] for gap in ran["promise"]["untested"])]
    assert (status, out.splitlines()[: len(promised)]) == (1, promised)
    assert "brought to 0 V" in err


def test_limits_and_slew_rate_in_force_are_fields_and_notes_if_others_were_given(folder):
    notes = {}
    for given in ((), ("--limits", "-50", "400"), ("--slew-rate", "1e9"), ("--limits", "0", "190")):
        _, out, err = run_command(*words(), "--json", "--force", *given, cwd=folder)
        found = json.loads(out)
        assert found["limits_V"] == ([0, 190] if "190" in given else [0, 200])
        # By default the whole range in 0.1 s.
        assert found["slew_V_per_s"] == (1e9 if "1e9" in given else pytest.approx(10 * found["limits_V"][1]))
        notes[given] = [line for line in err.splitlines() if "limits" in line or "slew rate" in line]
    assert [len(found) for found in notes.values()] == [0, 1, 0, 0]


def test_the_integral_does_not_wind_up_while_a_stage_with_delay_is_slewed(folder):
    wanted, errors = np.repeat([3.0, 8, 4, 9, 5, 11], 100), []
    write_columns(folder / "steps.csv", {"time_s": 0.01 * np.arange(600), "displacement_um": wanted})
    for more in ((), ("--feedback",)):
        status, found = run(*words("late", "steps"), "--slew-rate", "400", *more, "-o", "steps", cwd=folder)
        assert status == 1 and found["clamped"] > 50
        record = dehyst.read(folder / "steps" / "record.csv")
        errors.append(np.std((record.displacement[-600:] - 1e-6 * wanted).reshape(6, 100)[:, 60:]))
    assert errors[1] < 2 * errors[0]


def test_a_path_keeps_its_duration_at_the_rate_of_the_rig(folder):
    wanted = 7 - 3 * np.cos(2 * np.pi * np.arange(801) / 800)
    write_columns(folder / "fine.csv", {"time_s": 0.0025 * np.arange(801), "displacement_um": wanted})
    run(*words(path="fine"), "--feedback", "-o", "fine", cwd=folder)
    record = dehyst.read(folder / "fine" / "record.csv")
    assert 1e6 * record.displacement[-401:] == pytest.approx(wanted[::2], abs=0.05)
    assert np.ptp(record.time[-401:]) == pytest.approx(2.0, rel=0.01)


def test_an_error_above_the_promise_has_a_cause(folder):
    followed = FollowedPath(None, dehyst.Actuator.load(folder / "model.json"), [], 50.0, np.zeros((2, 1)), 2)
    cases = {"slew": ((0, 3), 0.1), "limits": ((3, 0), 0.1), "late": ((0, 0), 0.1), "stage": ((0, 0), 0.0)}
    for word, (clamps, late) in cases.items():
        followed.clamps, followed.late = Clamps(*clamps), late
        assert word in followed.cause


def test_a_sensor_without_a_reading_is_refused_before_anything_moves(folder):
    status, _, err = run_command(*words("blind"), "--force", cwd=folder)
    assert (status, "finite" in err, "SystemError" in err) == (1, True, False)


def test_the_temperature_of_a_path_is_used(folder):
    model = dehyst.Actuator.load(folder / "model.json")
    replace(model, thermal=dehyst.Thermal(-0.07 / 20, 0.0, 20.0)).save(folder / "thermal.json")
    phase = 2 * np.pi * np.arange(200) / 200
    columns = {"time_s": 0.005 * np.arange(200), "displacement_um": 7 - 5 * np.cos(phase)}
    write_columns(folder / "warm.csv", {**columns, "temperature_C": np.full(200, 40.0)})
    errors = []
    for path in ("path", "warm"):
        status, found = run(*words("aged", path, "thermal"), cwd=folder)
        # One that does not know the temperature misses the path by more than was promised.
        assert status == (path == "path")
        errors.append(found["rms_percent"])
    assert errors[0] > 2
    assert errors[1] < 0.5
    given = ("--columns", "temperature=temperature_C", "--force")
    assert refused(*words(path="warm"), *given, cwd=folder)["argument"] == "temperature"
