"""What a command refuses: status 2, the parameter at fault, by its option in the sentence, and nothing written."""

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import plain_records
import pytest
from command_line import refused, run
from virtual_loops import record_loops

import dehyst
from dehyst.model import Identification
from dehyst.model.promise import Validity
from dehyst.records import write_columns, write_record

TRIANGLE = "scan triangle --low 2 --high 12 --frequency 10"
MARKS = {
    "<TRIANGLE>": TRIANGLE,
    "<TABLE>": "compensate model.json scan.csv -o out.csv --table t.csv",
    "<FOLLOW>": "follow never.py:make --model model.json -o out --path",
}
REFUSED = tomllib.loads(Path(__file__).with_name("refusals.toml").read_text("utf-8"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Models and files that some command refuses."""
    place = tmp_path_factory.mktemp("refused")
    model = replace(plain_records.plant(6), limits=(0.0, 200.0))
    model.save(place / "model.json")
    thermal = replace(model, thermal=dehyst.Thermal(-2.5e-3, 4e-9, 30.0))
    thermal.save(place / "thermal.json")
    replace(model, displacement_creep=dehyst.DisplacementCreep([0.1], [0.01])).save(place / "creep.json")
    tested = Validity(1e-8, 1e-7, 0.0, 1.2e-5, limits=(0.0, 200.0))
    given = replace(model, identification=Identification(validity=tested)).as_dict()
    given["identification"]["validity"]["rms_m"] = -1.0
    (place / "damaged.json").write_text(json.dumps(given))
    dehyst.Stage((model, model), np.eye(2), ("x", "y")).save(place / "stage.json")
    training = record_loops()[0]
    write_record(place / "loops.csv", training)
    write_record(place / "short.csv", training[:100])
    write_record(place / "odd.csv", replace(training, displacement=10 * training.displacement))
    time, path = 0.01 * np.arange(400), 6 - 3 * np.cos(np.arange(400) / 30)
    tables = {
        "path": {"displacement_um": path},
        "far": {"displacement_um": 1000 * path},
        "axes": {"x_um": path, "y_um": path},
        "stage": {"vx_V": path, "x_um": path, "vy_V": path, "y_um": path},
        "plan": {"displacement_um": path, "voltage_V": 10 * path, "expected_um": path},
        "rooms": {"displacement_um": path, "room_temp_C": 20 + path, "temperature_C": 20 + path},
        "warm": {"displacement_um": path, "temperature_C": 20 + path},
        "hole": {"displacement_um": path, "temperature_C": np.where(time == 0.5, 4000.0, 20)},
    }
    for name, columns in tables.items():
        write_columns(place / f"{name}.csv", {"time_s": time, **columns})
    (place / "gap.csv").write_text("time_s,displacement_um\n0,3\n1,\n2,3\n")
    write_columns(place / "untimed.csv", {"displacement_um": path})
    write_columns(place / "timeless.csv", {"voltage_V": 10 * path})
    write_columns(place / "volts.csv", {"voltage_V": np.array([0.0, 2e5, 3e4])})
    write_columns(place / "back.csv", {"time_s": np.roll(time, 1), "displacement_um": path})
    write_columns(place / "point.csv", {"time_s": np.zeros(1), "displacement_um": np.ones(1)})
    rigs = "from dehyst.instruments.simulated import SimulatedRig\nfrom dehyst.virtual import PlayActuator\n"
    rigs += "def alone(**options):\n    return SimulatedRig(PlayActuator(), **options)\n"
    (place / "never.py").write_text(f"{rigs}def make(**options):\n    raise SystemError\n")
    assert run(*TRIANGLE.split(), "-o", "scan.csv", cwd=place)[0] == 0
    return place


@pytest.mark.parametrize("line", REFUSED)
def test_a_wrong_parameter_is_named_and_nothing_is_written(folder, line):
    before = {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}
    words = [word for part in line.split() for word in MARKS.get(part, part).split()]
    error, argument = refused(*words, cwd=folder), REFUSED[line].get("argument", "")
    assert error["argument"] == argument, error
    option = f"--{argument}".replace("_", "-")
    assert REFUSED[line].get("says", option) in f"{error['message']} {error.get('hint', '')}"
    assert {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()} == before
    assert not (folder / "out").exists()
