"""What a command refuses: status 2, the parameter at fault, by its option in the sentence, and nothing written."""

import json
from dataclasses import replace

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
TABLE = "compensate model.json scan.csv -o out.csv --table t.csv"
FOLLOW = "follow never.py:make --model model.json -o out --path"
# A command line, the parameter that is refused, and a part of the sentence, by default the option.
REFUSED = {
    "identify absent.csv": ("", "absent.csv"),
    "identify loops.csv --columns voltage=drive_V": ("", "drive_V"),
    "identify loops.csv -o loops.csv": ("", "loops.csv"),
    "identify loops.csv -o no/such/out.json": ("", "no/such"),
    "identify loops.csv -o -": ("", "-"),
    "identify loops.csv --columns join=path.csv -o path.csv": ("", "path.csv"),
    "identify loops.csv --delay 1e9": "delay",
    "identify loops.csv --goal 1e6": "goal",
    "identify loops.csv --time-limit 0": "time_limit",
    "identify loops.csv --shared-zero": "shared_zero",
    "identify loops.csv --slew-rate 3": "slew_rate",
    "identify loops.csv -o out.json --slew-rate 0": "slew_rate",
    "identify loops.csv --report out.png": "report",
    "check model.json short.csv": ("", "full cycle"),
    "check model.json loops.csv --goal 0": "goal",
    "identify plan.csv": ("", "computed"),
    "check loops.csv model.json": ("", "loops.csv"),
    "update model.json loops.csv -o model.json": ("", "model.json"),
    "insight stage.json stage.csv --trajectory path.csv": ("", '"x=DISPLACEMENT"'),
    "show model.json -o out.csv": "output",
    "show loops.csv --columns @absent.txt": "columns",
    "show stage.csv --columns time=vx_V:x_um,y=vy_V:y_um": ("axes", "time"),
    "simulate loops.csv loops.csv -o out.csv": ("", "loops.csv"),
    "simulate model.json path.csv -o out.csv": ("", "voltage=NAME"),
    "simulate model.json loops.csv -o out.csv --start middle": "start",
    "simulate model.json loops.csv -o loops.csv --start loops.csv": ("", "loops.csv"),
    "simulate creep.json loops.csv -o out.csv --start timeless.csv": ("", "time"),
    "simulate model.json loops.csv -o out.csv --start volts.csv": ("", "200000 V"),
    "simulate model.json loops.csv -o out.csv --start odd.csv": ("", "odd.csv: displacement: got"),
    "compensate model.json path.csv -o out.csv --start odd.csv": ("", "odd.csv: displacement: got"),
    "compensate model.json loops.csv -o out.csv --limits 5 1": "limits",
    "compensate model.json loops.csv -o out.csv --limits 0 inf": "limits",
    "compensate model.json far.csv -o out.csv": ("displacement", "check the numbers"),
    "compensate model.json back.csv -o out.csv": ("", "sort the samples"),
    "simulate damaged.json loops.csv -o out.csv": ("", "damaged.json: validity rms:"),
    "compensate creep.json untimed.csv -o out.csv": ("", "--columns rate=HZ"),
    "compensate model.json path.csv -o out.csv --slew-rate -1": "slew_rate",
    "compensate model.json path.csv -o out.csv --slew-rate 1 --slew-rate 2": "slew_rate",
    "compensate stage.json axes.csv -o out.csv --slew-rate z=1": "slew_rate",
    "compensate stage.json axes.csv -o out.csv --columns x=x_um": ("axes", "axes"),
    "compensate stage.json axes.csv -o out.csv --present x=900": "present",
    "compensate stage.json scan.csv -o out.csv --table t.csv": "table",
    "compensate model.json path.csv -o out.csv --table t.csv": "table",
    "compensate model.json path.csv -o out.csv --start top --home": "start",
    "compensate model.json path.csv -o out.csv --start top --home-within 3": "home_within",
    "compensate model.json path.csv -o out.csv --present 900 --no-home": "present",
    "compensate model.json rooms.csv -o out.csv --columns temperature=room_temp_C": ("temperature", "temperature"),
    "compensate thermal.json rooms.csv -o out.csv": ("columns", "temperature=room_temp_C"),
    "compensate thermal.json rooms.csv -o out.csv --columns temperature=third": ("", "third"),
    "compensate thermal.json hole.csv -o out.csv": ("", "temperature"),
    f"{TABLE} --present 900": "present",
    f"{TABLE} --start-up -1": ("cycles", "--start-up"),
    f"{TABLE} --late": ("on_time", "--late"),
    "compensate model.json path.csv -o out.csv --home --no-home": ("home", "--home/--no-home"),
    "identify loops.csv --goal 1 --goal 2": "goal",
    "compensate thermal.json warm.csv -o out.csv --table t.csv": "table",
    "compensate model.json untimed.csv -o out.csv --table t.csv": "columns",
    "compensate model.json gap.csv -o out.csv --table t.csv": ("displacement", "displacement"),
    "compensate model.json scan.csv -o out.csv --table out.csv": ("", "out.csv"),
    "compensate model.json scan.csv -o out.csv --table model.json": ("", "model.json"),
    f"{TRIANGLE} -o out.csv --cycles 0": "cycles",
    f"{TRIANGLE} -o out.csv --lines 3": ("lines", "--lines"),
    f"{TRIANGLE} -o out.csv --acceleration 1000": "acceleration",
    f"{TRIANGLE} -o out.csv --sample-rate 20": "sample_rate",
    f"{TRIANGLE} -o out.csv --sample-rate 1e8": "cycles",
    "scan triangle --low 12 --high 2 --frequency 10 -o out.csv": ("low, high", "--low, --high"),
    "scan triangle --low 2 --high 12e6 --frequency 10 -o out.csv": "high",
    "scan triangle --low 2 --high 12 -o out.csv": "frequency",
    "scan steps --levels 2,2 --dwell 0.1 --edge 1 -o out.csv": "levels",
    "scan steps --levels 2,6 --dwell 0.1 -o out.csv": "edge",
    "scan steps --levels 2,6 --dwell 0.1 --edge 1e-3 --acceleration 10 -o out.csv": "edge",
    "excite raised-cosine 0 -o out.csv": ("peaks", "PEAKS"),
    "excite raised-cosine -20 100 -o out.csv --count=10": ("count", "--count"),
    "excite recommended 1e9 -o out.csv": ("highest", "HIGHEST"),
    "excite recommended 100 -o out.csv --base 130": ("base", "--limits LOW HIGH"),
    "excite staircase 100 -o out.csv --sample-rate 0.01": "sample_rate",
    "excite stage 100 -o out.csv": ("highest", "HIGHEST"),
    "export creep.json out": ("", "--period"),
    "export model.json out --period -1": "period",
    "export stage.json out.fmu --kind actuator": "kind",
    "export model.json out.mm": ("", ".wasm or .fmu"),
    "export model.json out --kind actuator": "kind",
    "export model.json out --period 1 --preview": "preview",
    "compensate model.json path.csv -o out.csv --on-time": "on_time",
    "excite stage 100 50 -o out.csv --axes a,a": "axes",
    "calibrate sim:// --dry-run --slew-rate 1=100": "slew_rate",
    "calibrate never.py:alone --dry-run --axes 1,2": ("", "has the axes 1, but 1, 2 were requested"),
    f"{FOLLOW} path.csv --learn --feedback": ("learn, feedback", "--feedback"),
    "scan steps --levels a,b --dwell 0.1 --edge 1 -o out.csv": "levels",
    "scan rastr -o out.csv": ("", "Did you mean 'raster'?"),
    "identify loops.csv --columns volt=voltage_V": ("axes", "--columns: got 'volt=voltage_V'"),
    "compensate model.json path.csv -o out.csv --limits 100 0": ("limits", "got 100 and 0,"),
    f"{TRIANGLE} -o out.csv --acceleration -3": ("acceleration", "got -3,"),
    "insight stage.json loops.csv": ("", 'Give the axis as "x=VOLTAGE:DISPLACEMENT" (--columns'),
    f"{FOLLOW} path.csv --repeat 0": "repeat",
    f"{FOLLOW} untimed.csv": "columns",
    f"{FOLLOW} point.csv": ("", "1 sample"),
}


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
    error = refused(*line.split(), cwd=folder)
    own = REFUSED[line]
    argument, said = own if isinstance(own, tuple) else (own, f"--{own}".replace("_", "-"))
    assert error["argument"] == argument, error
    assert said in f"{error['message']} {error.get('hint', '')}"
    assert {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()} == before
    assert not (folder / "out").exists()
