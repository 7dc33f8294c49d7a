"""A path is followed at its own speed; what leads to it keeps to that of the records, and a faster one is remarked."""

from dataclasses import replace

import numpy as np
import plain_records
import pytest
from command_line import result, run
from virtual_loops import record_loops

from dehyst.model import Stage, with_identification
from dehyst.records import read_table, write_columns, write_record

SPEED = 50.0
PLAIN = with_identification(replace(plain_records.plant(6), limits=(0.0, 200.0)), slew_rate=SPEED)
SCAN = ("triangle", "--low", 3, "--high", 9, "--sample-rate", 100, "--frequency", 0.1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A model that knows the speed of its records, a stage, and paths."""
    target = tmp_path_factory.mktemp("slew")
    PLAIN.save(target / "model.json")
    Stage((PLAIN, with_identification(PLAIN, slew_rate=2 * SPEED)), np.eye(2), ("x", "y")).save(target / "stage.json")
    time = np.arange(400) * 0.01
    wanted = 6 - 3 * np.cos(2 * np.pi * 0.1 * time)
    write_columns(target / "slow.csv", {"time_s": time, "displacement_um": wanted})
    write_columns(target / "slow_axes.csv", {"time_s": time, "x_um": wanted, "y_um": wanted})
    assert run("scan", *SCAN, "-o", "scan.csv", cwd=target)[0] == 0
    return target


@pytest.mark.parametrize("model", ["model", "stage"])
def test_an_export_says_which_slew_rate_it_has(folder, model):
    words = ("export", f"{model}.json", f"c-{model}", "--force")
    for options, expected in {(): None, ("--slew-rate", 4000.0): 4000.0, ("--slew-rate", "none"): None}.items():
        status, made = result(*words, "--period", 1e-3, *options, cwd=folder)
        assert status == 0 and made["slew_V_per_s"] == (dict.fromkeys("xy", expected) if model == "stage" else expected)


def jumps(result):
    return [warning for warning in result["warnings"] if "ramp there" in warning]


@pytest.mark.parametrize(
    ("model", "path"),
    [("model", ("slow.csv",)), ("stage", ("slow_axes.csv",)), ("model", ("scan.csv", "--table", "table.csv"))],
)
def test_a_jump_is_remarked_and_a_given_voltage_gets_a_way(folder, model, path):
    words, axes = ("compensate", f"{model}.json", *path, "--no-home", "-o", "v.csv"), 2 if model == "stage" else 1
    assert len(jumps(result(*words, cwd=folder)[1])) == axes
    status, found = result(*words, "--present", 90, cwd=folder)
    assert status == 0 and not jumps(found)
    table = read_table(folder / "v.csv")
    begins = [column.data[0] for column in table.columns if column.name.endswith("_V")]
    assert len(begins) == axes and begins == pytest.approx([90] * axes, abs=SPEED * 0.01)


@pytest.mark.parametrize("limit", [(), ("--slew-rate", 50)])
def test_an_excitation_states_the_speed_that_it_needs(tmp_path, limit):
    _, made = result("excite", "recommended", 100, *limit, "-o", "v.csv", cwd=tmp_path)
    time, voltage = np.loadtxt(tmp_path / "v.csv", delimiter=",", skiprows=1).T
    assert made["slew_rate_V_per_s"] == pytest.approx(np.abs(np.diff(voltage) / np.diff(time)).max(), rel=1e-3)
    assert made["slew_rate_V_per_s"] < (50.1 if limit else 800)


KEPT = "voltage=Monitor:V*15, displacement=Sensor:um"


def test_later_commands_use_the_columns_and_the_slew_rate_of_the_model(tmp_path):
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
    for more, expected in {(): 30, ("--slew-rate", 40): 40, ("--slew-rate", "none"): None}.items():
        found = result("compensate", "model.json", "path.csv", "-o", "v.csv", *more, cwd=tmp_path)[1]
        assert found["slew_V_per_s"] == expected
        made = result("export", "model.json", "firmware", "--period", 1e-3, *more, "--force", cwd=tmp_path)[1]
        assert made["slew_V_per_s"] == expected
    assert "which the model keeps" in run("compensate", "model.json", "path.csv", "-o", "v.csv", cwd=tmp_path)[2]
