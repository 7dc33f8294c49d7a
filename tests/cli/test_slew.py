"""A path is followed at its own speed; what leads to it keeps to that of the records, and a faster one is remarked."""

import json
from dataclasses import replace

import numpy as np
import plain_records
import pytest
from command_line import refused, result, run
from virtual_loops import record_loops

import dehyst
from dehyst.model import Identification, Stage, slew_rate_of_records, turned, with_identification
from dehyst.model.promise import Validity
from dehyst.records import read_table, write_columns, write_record

SPEED = 50.0
PLAIN = with_identification(replace(plain_records.plant(6), limits=(0.0, 200.0)), slew_rate=SPEED)
SCAN = ("triangle", "--low", 3, "--high", 9, "--sample-rate", 100)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Models that know the speed of their records and not, a stage, and paths of 30 and 240 V/s, about."""
    target = tmp_path_factory.mktemp("slew")
    PLAIN.save(target / "model.json")
    with_identification(PLAIN, slew_rate=None).save(target / "old.json")
    Stage((PLAIN, with_identification(PLAIN, slew_rate=2 * SPEED)), np.eye(2), ("x", "y")).save(target / "stage.json")
    time = np.arange(400) * 0.01
    for name, frequency in (("slow", 0.1), ("fast", 0.8)):
        wanted = 6 - 3 * np.cos(2 * np.pi * frequency * time)
        write_columns(target / f"{name}.csv", {"time_s": time, "displacement_um": wanted})
        write_columns(target / f"{name}_axes.csv", {"time_s": time, "x_um": wanted, "y_um": wanted})
    write_columns(target / "timeless.csv", {"displacement_um": wanted})
    for frequency in (0.1, 2):
        words = (*SCAN, "--frequency", frequency, "-o", f"scan-{frequency}.csv")
        assert run("scan", *words, cwd=target)[0] == 0
    return target


def compensated(folder, *words, model="model.json"):
    output = f"{model}.csv"
    status, out, err = run("compensate", model, *words, "-o", output, "--json", cwd=folder)
    assert status in (0, 1), err
    return status, json.loads(out), read_table(folder / output)


def steepest(table, name="voltage_V"):
    columns = {column.name: column.data for column in table.columns}
    return float(np.abs(np.diff(columns[name]) / np.diff(columns["time_s"])).max())


@pytest.mark.parametrize("limits", [[0, 1000], [210, 215]])
def test_no_voltage_of_a_model_with_limits_that_no_record_has_shown_is_sent(folder, limits):
    tested = Validity(1e-8, 1e-7, 0.0, 1.2e-5, limits=(0.0, 200.0), speeds=(1.0, SPEED))
    model = replace(PLAIN, identification=Identification(validity=tested)).as_dict()
    (folder / "edited.json").write_text(json.dumps(model | {"limits_V": limits}))
    refused("compensate", "edited.json", "slow.csv", "-o", "edited.csv", cwd=folder)
    assert not (folder / "edited.csv").exists()


@pytest.mark.parametrize("model", ["model", "stage"])
def test_an_export_says_which_slew_rate_it_has(folder, model):
    words = ("export", f"{model}.json", f"c-{model}", "--force")
    given = {
        (): (None, "default"),
        ("--slew-rate", 4000.0): (4000.0, "option"),
        ("--slew-rate", "none"): (None, "none"),
    }
    for options, expected in given.items():
        status, out, err = run(*words, "--period", 1e-3, *options, "--json", cwd=folder)
        assert status == 0, err
        found = [json.loads(out)[key] for key in ("slew_V_per_s", "slew_from")]
        assert found == ([dict.fromkeys("xy", largest) for largest in expected] if model == "stage" else [*expected])


@pytest.mark.parametrize("words", [("slow.csv",), ("scan-0.1.csv", "--table", "table.csv")])
@pytest.mark.parametrize("columns", ["record", "voltages"])
def test_a_path_begins_at_the_last_voltage_of_a_file(folder, columns, words):
    """Also where the model needs another voltage to be where the record ends, and for voltages that leave it open."""
    time = np.arange(400) * 0.05
    voltage = 90 - 60 * np.cos(2 * np.pi * time / 8)
    wanted = PLAIN.simulate(voltage, state=turned(PLAIN, 0.0, rising=False)).displacement
    # The model misses the record by some volts at its end.
    wanted += 0.04 * (wanted - wanted.mean())
    if columns == "record":
        write_record(folder / "last.csv", dehyst.Record(time, voltage, wanted))
    else:
        write_columns(folder / "last.csv", {"time_s": time, "voltage_V": voltage})
    for more, begin in (((), voltage[-1]), (("--present", 70), 70.0)):
        status, result, out = compensated(folder, *words, "--start", "last.csv", *more)
        assert status == 0 and result["clamped"] == 0
        assert abs(out.column("voltage")[0] - begin) <= SPEED * 0.01 * (1 + 1e-6)
        assert steepest(out) <= SPEED * (1 + 1e-6)
    status, result, out = compensated(folder, *words, "--start", "bottom", "--present", 7)
    assert status == 0 and abs(out.column("voltage")[0] - 7) <= SPEED * 0.01 * (1 + 1e-6)


def jumps(result):
    return [warning for warning in result["warnings"] if "ramp there" in warning]


@pytest.mark.parametrize(
    ("model", "path"),
    [("model", ("slow.csv",)), ("stage", ("slow_axes.csv",)), ("model", ("scan-0.1.csv", "--table", "table.csv"))],
)
def test_without_a_homing_the_way_from_a_given_voltage_is_in_the_file_and_that_from_an_unknown_one_is_named(
    folder, model, path
):
    names = ("--columns", "x=x_um, y=y_um") if model == "stage" else ()
    words, voltages = (*path, *names, "--no-home"), ("vx_V", "vy_V") if model == "stage" else ("voltage_V",)
    _, result, table = compensated(folder, *words, model=f"{model}.json")
    starts = {column.name: column.data[0] for column in table.columns}
    assert len(jumps(result)) == len(voltages) and min(starts[name] for name in voltages) > 10
    status, result, table = compensated(folder, *words, "--present", 90, model=f"{model}.json")
    assert status == 0 and not jumps(result)
    for name in voltages:
        begin = {column.name: column.data for column in table.columns}[name][0]
        assert abs(begin - 90) <= SPEED * 0.01 and steepest(table, name) <= 2 * SPEED * (1 + 1e-6)


@pytest.mark.parametrize("more", [("--home",), ("--no-home",), ("--start", "bottom")])
def test_each_axis_has_a_present_voltage_of_its_own(folder, more):
    words = ("slow_axes.csv", "--columns", "x=x_um, y=y_um", *more)
    for given, begins in (
        (("--present", 20), (20, 20)),
        (("--present", "x=20", "--present", "y=30"), (20, 30)),
        (("--present", 30, "--present", "x=20"), (20, 30)),
        (("--present", "y=30"), (0, 30)),
    ):
        status, result, table = compensated(folder, *words, *given, model="stage.json")
        columns = {column.name: column.data for column in table.columns}
        assert status == 0 and not jumps(result)
        for name, begin in zip(("vx_V", "vy_V"), begins, strict=True):
            assert columns[name][0] == pytest.approx(begin, abs=1e-9)
    for wrong in ("z=3", "x=a", "x=900"):
        status, _, err = run("compensate", "stage.json", *words, "-o", "o.csv", "--present", wrong, cwd=folder)
        assert status == 2 and "--present" in err


def test_an_identification_stores_the_speed_of_its_records():
    time = np.arange(2000) * 0.02
    voltage = np.interp(time, np.linspace(0, 40, 9), [0, 100, 0, 80, 0, 60, 0, 40, 0])
    truth = turned(plain_records.plant(6), 0.0, rising=False)
    record = dehyst.Record(time, voltage, plain_records.plant(6).simulate(voltage, state=truth).displacement)
    fit = dehyst.identify(record, structure="maxwell_slip")
    assert slew_rate_of_records(fit.actuator) == pytest.approx(1.05 * 20, rel=0.02)


@pytest.mark.parametrize("limit", [(), ("--slew-rate", 50)])
def test_an_excitation_states_the_speed_that_it_needs(tmp_path, limit):
    _, made = result("excite", "recommended", 100, *limit, "-o", "v.csv", cwd=tmp_path)
    time, voltage = np.loadtxt(tmp_path / "v.csv", delimiter=",", skiprows=1).T
    assert made["slew_rate_V_per_s"] == pytest.approx(np.abs(np.diff(voltage) / np.diff(time)).max(), rel=1e-3)
    assert made["slew_rate_V_per_s"] < (50.1 if limit else 800)


KEPT = "voltage=Monitor:V*15, displacement=Sensor:um"


def test_later_commands_read_and_move_as_the_model_keeps_it(tmp_path):
    record = record_loops()[0]
    columns = {"time_s": record.time, "Monitor": record.voltage / 15, "Sensor": 1e6 * record.displacement}
    write_columns(tmp_path / "own.csv", columns)
    write_record(tmp_path / "usual.csv", record)
    words = ("--structure", "maxwell_slip", "--columns", KEPT, "-o", "model.json")
    assert run("identify", "own.csv", *words, "--slew-rate", 30, cwd=tmp_path)[0] == 0
    given = [run("check", "model.json", name, cwd=tmp_path) for name in ("own.csv", "usual.csv")]
    assert given[0][1].replace(" own:", " usual:") == given[1][1]
    assert [KEPT in err for _, _, err in given] == [True, False]
    time = np.arange(400) * 0.01
    write_columns(tmp_path / "path.csv", {"time_s": time, "displacement_um": 8 - 3 * np.cos(5 * time)})
    for more, expected in (
        ((), (30, "model")),
        (("--slew-rate", 40), (40, "option")),
        (("--slew-rate", "none"), (None, "none")),
    ):
        found = result("compensate", "model.json", "path.csv", "-o", "v.csv", *more, cwd=tmp_path)[1]
        assert (found["slew_V_per_s"], found["slew_from"]) == expected
        made = result("export", "model.json", "firmware", "--period", 1e-3, *more, "--force", cwd=tmp_path)[1]
        assert (made["slew_V_per_s"], made["slew_from"]) == expected
    assert "which the model keeps" in run("compensate", "model.json", "path.csv", "-o", "v.csv", cwd=tmp_path)[1]
    wrong = run("identify", "own.csv", *words, "--slew-rate", 0, cwd=tmp_path)
    assert wrong[0] == 2 and "--slew-rate: got 0" in wrong[2]
