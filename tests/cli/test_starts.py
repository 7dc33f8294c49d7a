"""`--start` and `--home` as processes: what is known of the start, and what an unknown one leaves open."""

from dataclasses import replace

import numpy as np
import plain_records
import pytest
from command_line import result, run

import dehyst
from dehyst import Record
from dehyst.model import with_identification
from dehyst.model.promise import Validity
from dehyst.records import read_table, write_columns, write_record
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, descending_tops


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a record, its model, one that creeps, and paths with and without time."""
    target = tmp_path_factory.mktemp("starts")
    truth = PlayActuator(plays=60)
    tops = descending_tops(truth.highest, drive=Sampling(sample_rate=4.0))
    training = Record(tops.time, tops.voltage, truth.play(tops.voltage), "loops")
    write_record(target / "loops.csv", training)
    plain = dehyst.identify(training, structure="maxwell_slip").actuator
    plain.save(target / "model.json")
    creep = dehyst.DisplacementCreep([0.1, 3.0], [0.01, 0.02])
    dehyst.Actuator(plain.slip, plain.spring, limits=plain.limits, displacement_creep=creep).save(target / "creep.json")
    time = np.arange(200) * 0.02
    wanted = 8 - 5 * np.cos(2 * np.pi * time / 2)
    write_columns(target / "path.csv", {"time_s": time, "displacement_um": wanted})
    write_columns(target / "timeless.csv", {"displacement_um": wanted})
    return target


def column(folder, file, name):
    data = {column.name: column.data for column in read_table(folder / file).columns}
    return data[name]


@pytest.mark.parametrize("file", ["path.csv", "timeless.csv"])
def test_a_file_of_compensate_is_a_start_only_by_its_voltages(folder, file):
    """The wanted displacement of an earlier path is no measurement, even where the path was not followed."""
    wanted = {column.name: column.data for column in read_table(folder / file).columns}
    write_columns(folder / "wanted.csv", wanted | {"displacement_um": wanted["displacement_um"] + 3})
    status, _, err = run(
        *("compensate", "model.json", "wanted.csv", "-o", "earlier.csv", "--home", "--limits", 0, 150), cwd=folder
    )
    assert status in (0, 1), err
    write_columns(folder / "bare.csv", {"voltage_V": column(folder, "earlier.csv", "voltage_V")})
    ends = {}
    for start in ("earlier.csv", "bare.csv"):
        given = ("compensate", "model.json", "path.csv", "-o", "v.csv", "--start", start)
        _, ends[start] = result(*given, cwd=folder)
        err = run(*given, cwd=folder)[2]
        assert ("earlier.csv: " in err) == (start != "bare.csv")
    assert ends["earlier.csv"]["state"] == ends["bare.csv"]["state"]


@pytest.mark.parametrize(("command", "file"), [("simulate", "loops.csv"), ("compensate", "path.csv")])
def test_a_start_somewhat_outside_the_limits_is_remarked(folder, command, file):
    write_columns(folder / "history.csv", {"voltage_V": np.array([0.0, 230.0, 30.0])})
    status, _, err = run(command, "model.json", file, "-o", "x.csv", "--start", "history.csv", cwd=folder)
    assert status in (0, 1) and "history.csv: 1 of 3 voltages" in err


def test_an_insufficient_homing_has_the_same_status_with_every_option(folder):
    replace(plain_records.plant(6), limits=(0.0, 100.0)).save(folder / "narrow.json")
    write_columns(folder / "low.csv", {"time_s": [0, 1, 2], "displacement_um": [3, 4, 3]})
    words = ("compensate", "narrow.json", "low.csv", "-o", "v.csv")
    found = [result(*words, *more, cwd=folder) for more in ((), ("--home",), ("--home-within", 200))]
    assert [(status, told["certified"], told["clamped"]) for status, told in found] == 3 * [(1, False, 0)]
    assert result(*words, "--no-home", cwd=folder)[0] == 0


def test_details_are_printed_only_with_verbose(folder):
    tested = Validity(1e-8, 1e-7, 0.0, 1.2e-5, limits=(0.0, 200.0), speeds=(1.0, 50.0))
    model = with_identification(replace(plain_records.plant(6), limits=(0.0, 200.0)), validity=tested)
    model.save(folder / "tested.json")
    words = ("compensate", "tested.json", "path.csv", "-o", "v.csv", "--plot", "p.html")
    (status, brief, remarks), (_, whole, _) = (run(*words, *more, cwd=folder) for more in ((), ("--verbose",)))
    assert status == 0 and brief.startswith("Expect this path ") and whole.startswith(brief.splitlines()[0])
    assert len(brief.splitlines()) == 5 and len(remarks.splitlines()) <= 1
    assert (folder / "p.html").read_text().count("data-chart=") == 3
    assert run(*words, cwd=folder, keep=True)[0] == 2


def test_a_path_completely_beyond_a_limit_has_status_1(folder):
    """Far beyond the records, the promise is larger than the miss."""
    write_columns(folder / "beyond.csv", {"time_s": np.arange(50) * 0.1, "displacement_um": np.linspace(25, 27, 50)})
    words = ("compensate", "model.json", "beyond.csv", "-o", "v.csv", "--start", "top", "--limits", 0)
    for limit, clamped in ((270, 50), (300, 0)):
        found, told = result(*words, limit, cwd=folder)
        assert (found, told["clamped"]) == (1, clamped)
        assert any("CLAMPED" in words for words in told["warnings"]) == (clamped > 0)
        assert told["missed_um"] < 1e6 * (told["promise"]["largest_m"] - told["promise"]["parts"].get("missed_m", 0.0))


@pytest.mark.parametrize("words", [("excite", "recommended", 150), ("compensate", "model.json", "path.csv")])
def test_inputs_of_an_amplifier_are_the_voltages_over_its_gain(folder, words):
    result(*words, "-o", "plain.csv", cwd=folder)
    result(*words, "-o", "v.csv", "--gain", 15, cwd=folder)
    voltage, inputs = column(folder, "v.csv", "voltage_V"), column(folder, "v.csv", "voltage_input_V")
    np.testing.assert_allclose(inputs, voltage / 15, rtol=1e-11)
    np.testing.assert_array_equal(voltage, column(folder, "plain.csv", "voltage_V"))
    assert run(*words, "-o", "v.csv", "--gain", 0, cwd=folder)[0] == 2


def test_the_printed_duration_of_a_homing_excludes_the_way(folder):
    words = ("compensate", "creep.json", "path.csv", "-o", "v.csv", "--home-within", 5)
    _, told = result(*words, cwd=folder)
    time, phase = column(folder, "v.csv", "time_s"), column(folder, "v.csv", "phase")
    assert (
        told["homing_s"] == pytest.approx(time[phase == 1][0], abs=1e-9) and 4 < told["homing_s"] < time[phase == 2][0]
    )
    assert f"homed first from 0 V in {told['homing_s']:.4g} s" in run(*words, cwd=folder)[1]
