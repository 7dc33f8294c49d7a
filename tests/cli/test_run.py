"""`dehyst run`: a path on a rig that ages, what it writes and says, and its exit status."""

import json
from dataclasses import replace

import numpy as np
import pytest
from command_line import run

import dehyst
from dehyst import Actuator, Spring
from dehyst.instruments import open_rig
from dehyst.operations.registry import find
from dehyst.operations.run import Run, perform
from dehyst.records import write_columns
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
