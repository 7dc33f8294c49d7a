"""`--start` and `--home` as processes: what is known of the start, and what an unknown one leaves open."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import plain_records
import pytest
from command_line import result, run

import dehyst
from dehyst import Actuator, Record
from dehyst.control import PossibleStart, plan_voltage
from dehyst.model import with_identification
from dehyst.model.promise import Validity
from dehyst.records import read_table, write_columns, write_record
from dehyst.trust import start_of
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


def test_without_a_homing_the_error_is_reported(folder):
    given = ("compensate", "model.json", "path.csv", "-o", "v.csv", "--no-home", "--slew-rate", "none")
    _, got = result(*given, cwd=folder)
    assert (got["samples"], got["homing_samples"], got["certified"]) == (200, 0, None)
    assert got["start"]["largest_difference_percent"] > 5 > got["start"]["model_error_percent"]
    assert "phase" not in read_table(folder / "v.csv").names


@pytest.mark.parametrize("model", ["model.json", "creep.json"])
def test_a_record_determines_where_it_began_and_where_it_ends(folder, model):
    """What was measured before and after follows from the state, which no name describes."""
    actuator = Actuator.load(folder / model)
    ends = [0, 200, 50, 120, 20, 180, 20, 180, 60, 120, 40, 90]
    voltage = np.concatenate([np.linspace(start, end, 100) for start, end in pairwise(ends)])
    time = np.arange(voltage.size) * 0.05
    y = actuator.simulate(voltage, time=time).displacement
    inner = slice(300, 900)
    record = Record(time[inner], voltage[inner], y[inner])
    for began, part in ((True, inner), (False, slice(899, None))):
        missed = {}
        for name in ("record", "top", "bottom"):
            start = start_of(actuator, record, began=began) if name == "record" else PossibleStart.named(actuator, name)
            plan = plan_voltage(actuator, voltage[part], time=time[part], start=start)
            missed[name] = np.abs(plan.expected - y[part]).max() / np.ptp(y)
        assert missed["record"] < 2e-3 and min(missed["top"], missed["bottom"]) > 5e-3


@pytest.mark.parametrize("file", ["path.csv", "timeless.csv"])
def test_of_an_output_only_the_voltages_are_a_start(folder, file):
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


@pytest.mark.parametrize("command", ["simulate", "compensate"])
def test_a_start_of_another_unit_or_actuator_is_refused(folder, command):
    """Voltages and displacements far from the model's lead to no state of it."""
    write_columns(folder / "next.csv", {"time_s": np.arange(50.0), "voltage_V": np.linspace(30, 100, 50)})
    file = "next.csv" if command == "simulate" else "path.csv"
    given = (command, "model.json", file, "-o", "x.csv", "--start", "history.csv")
    write_columns(folder / "history.csv", {"voltage_V": np.array([0.0, 2e5, 3e4])})
    status, _, err = run(*given, cwd=folder)
    assert status == 2 and "200000 V" in err
    time, voltage = np.arange(400.0), 100 - 100 * np.cos(np.arange(400) / 30)
    write_record(folder / "history.csv", dehyst.Record(time, voltage, 2e-6 * voltage))
    status, _, err = run(*given, cwd=folder)
    assert status == 2 and "history.csv: displacement: got" in err
    # Somewhat outside is a remark.
    write_columns(folder / "history.csv", {"voltage_V": np.array([0.0, 230.0, 30.0])})
    status, _, err = run(*given, cwd=folder)
    assert status in (0, 1) and "history.csv: 1 of 3 voltages" in err


def test_a_homing_that_leaves_the_start_open_has_one_status_however_it_was_asked_for(folder):
    replace(plain_records.plant(6), limits=(0.0, 100.0)).save(folder / "narrow.json")
    write_columns(folder / "low.csv", {"time_s": [0, 1, 2], "displacement_um": [3, 4, 3]})
    words = ("compensate", "narrow.json", "low.csv", "-o", "v.csv")
    found = [result(*words, *more, cwd=folder) for more in ((), ("--home",), ("--home-within", 200))]
    assert [(status, told["certified"], told["clamped"]) for status, told in found] == 3 * [(1, False, 0)]
    assert result(*words, "--no-home", cwd=folder)[0] == 0


def test_the_answer_comes_first_and_the_rest_by_verbose(folder):
    tested = Validity(1e-8, 1e-7, 0.0, 1.2e-5, limits=(0.0, 200.0), speeds=(1.0, 50.0))
    model = with_identification(replace(plain_records.plant(6), limits=(0.0, 200.0)), validity=tested)
    model.save(folder / "tested.json")
    words = ("compensate", "tested.json", "path.csv", "-o", "v.csv", "--plot", "p.html")
    (status, brief, remarks), (_, whole, _) = (run(*words, *more, cwd=folder) for more in ((), ("--verbose",)))
    assert status == 0 and brief.startswith("Expect this path ") and whole.startswith(brief.splitlines()[0])
    assert len(brief.splitlines()) == 5 and len(remarks.splitlines()) <= 1
    assert (folder / "p.html").read_text().count("data-chart=") == 3
    assert run(*words, cwd=folder, keep=True)[0] == 2
