"""Commands are thin: `compensate` writes what `plan_path` plans, and `simulate` what `plan_voltage` predicts."""

from dataclasses import replace

import numpy as np
import plain_records
import pytest
from command_line import WRITTEN, result

import dehyst
from dehyst.control import PossibleStart, plan_path, plan_voltage
from dehyst.model import Identification, Validity
from dehyst.records import Record, read_table, write_columns, write_record
from dehyst.trust import start_of

TIME = np.arange(300) * 0.01
PATH = 6 - 3 * np.cos(2 * np.pi * 0.5 * TIME)
DEGREES = np.linspace(20, 40, TIME.size)
WHOLE = 100 - 100 * np.cos(2 * np.pi * 0.5 * TIME)
VOLTAGE = np.round(90 - 60 * np.cos(2 * np.pi * TIME / 1.7), 6)
COUPLING = np.array([[1.0, 0.05], [-0.04, 1.0]])
CREEP = dehyst.DisplacementCreep([0.1, 3.0], [0.01, 0.02])
BARE = replace(plain_records.plant(6), limits=(0.0, 200.0))
NUMBERS = {"rms": 1e-8, "largest": 3e-8, "disagreement": 0.0, "stroke": 1.2e-5, "temperatures": (15.0, 45.0)}
KNOWN = Identification(validity=Validity.by_records([(TIME, WHOLE)], **NUMBERS), lag_of="actuator", slew_rate=400.0)
PLAIN = replace(BARE, identification=KNOWN, delay=0.02, thermal=dehyst.Thermal(-2.5e-3, 4e-9, 30.0))
MODELS = {
    "plain": PLAIN,
    "creep": replace(PLAIN, displacement_creep=CREEP, thermal=None, delay=0.0),
    "stage": dehyst.Stage((PLAIN, replace(PLAIN, delay=0.0)), COUPLING, ("x", "y")),
}


def record_of(actuator):
    """A record that the model misses by some volts, with numbers that a file holds exactly."""
    moved = actuator.simulate(VOLTAGE, time=TIME).displacement
    return Record(TIME, VOLTAGE, np.round(1e6 * (moved + 0.04 * (moved - moved.mean())), 6) / 1e6, "last.csv")


def records_of(stage):
    """The record of each actuator, as if it moved alone."""
    return [record_of(actuator) for actuator in stage.actuators]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("thin")
    for name, model in MODELS.items():
        model.save(place / f"{name}.json")
    for name in ("plain", "creep"):
        write_record(place / f"{name}-record.csv", record_of(MODELS[name]))
    volts, alone = {f"v{axis}_V": VOLTAGE for axis in "xy"}, records_of(MODELS["stage"])
    moved = 1e6 * np.column_stack([record.displacement for record in alone]) @ COUPLING.T
    columns = {"time_s": TIME, **volts, "x_um": moved[:, 0], "y_um": moved[:, 1]}
    write_columns(place / "stage-record.csv", columns)
    write_columns(place / "history.csv", {"time_s": TIME, "voltage_V": VOLTAGE})
    for name, columns in {
        "path": {},
        "warm": {"temperature_K": DEGREES + 273.15},
        "rooms": {"room_C": DEGREES - 10, "stage_C": DEGREES},
    }.items():
        write_columns(place / f"{name}.csv", {"time_s": TIME, "displacement_um": PATH, **columns})
        write_columns(place / f"{name}-axes.csv", {"time_s": TIME, "x_um": PATH, "y_um": PATH[::-1], **columns})
    return place


def starts(model, of):
    """The start of a model, or of each of its axes, by a function of an actuator."""
    return [of(each) for each in model.actuators] if isinstance(model, dehyst.Stage) else of(model)


def named(name):
    return lambda model: {"start": starts(model, lambda actuator: PossibleStart.named(actuator, name))}


def recorded(model):
    def begin(actuator):
        return start_of(actuator, record_of(actuator)).standing_at(actuator, float(VOLTAGE[-1]))

    return {"start": starts(model, begin)}


def played(model):
    found = PossibleStart.after(model, VOLTAGE, time=TIME, limits=model.limits, name="history.csv")
    return {"start": found.standing_at(model, float(VOLTAGE[-1]))}


# Path and options of the command, and the arguments of the library that mean the same: of any model, of one axis ...
EACH = {
    "path": {},
    "path --limits 5 150": {"limits": (5, 150)},
    "path --slew-rate 300": {"slew_rate": 300.0},
    "path --slew-rate 300 --home --present 20": {"slew_rate": 300.0, "home": True, "present": 20.0},
    "path --home --home-within 100": {"home": True, "home_within": 100.0},
    "path --no-home": {"home": False},
    "path --no-home --present 90": {"home": False, "present": 90.0},
    "path --start top": named("top"),
    "path --start MODEL-record.csv": recorded,
    "path --start bottom --limits 0 100": lambda model: {**named("bottom")(model), "limits": (0, 100)},
}
ALONE = {
    "path --start history.csv": played,
    "path --start history.csv --present 70": lambda model: {
        "start": played(model)["start"].standing_at(model, 70.0),
        "present": 70.0,
    },
}
WARM = {"warm": {"temperature": DEGREES}, "path --late": {"on_time": False}}
OWN = {
    "path --limits x=0 150 --limits 0 190": {"limits": [(0, 150), (0, 190)]},
    "path --slew-rate x=200 --slew-rate 300": {"slew_rate": [200.0, 300.0]},
    "path --home --present y=30": {"home": True, "present": [0.0, 30.0]},
    "path --no-home --present 30 --present x=20": {"home": False, "present": [20.0, 30.0]},
}
CASES = [
    *((name, words) for name in MODELS for words in EACH),
    *((name, words) for name in ("plain", "creep") for words in ALONE),
    *((name, words) for name in ("plain", "stage") for words in WARM),
    *(("stage", words) for words in OWN),
    ("plain", "rooms --columns temperature=stage_C"),
]
GIVEN = {**EACH, **ALONE, **WARM, **OWN, "rooms --columns temperature=stage_C": {"temperature": DEGREES}}


def columns_of(path, names):
    table = {column.name: column.data for column in read_table(path).columns}
    return np.column_stack([table[name] for name in names]).squeeze()


def assert_equal_columns(written, expected):
    # A record of coupled axes is rounded where it is written, and decoupled again.
    np.testing.assert_allclose(written, expected, rtol=2 * WRITTEN, atol=1e-8)


@pytest.mark.parametrize(("name", "words"), CASES)
def test_compensate_writes_what_the_library_plans(folder, name, words):
    model, (path, *options) = MODELS[name], words.replace("MODEL", name).split()
    several = name == "stage"
    file = f"{path}-axes.csv" if several else f"{path}.csv"
    status, told = result("compensate", f"{name}.json", file, "-o", "out.csv", *options, cwd=folder)
    given = GIVEN[words](model) if callable(GIVEN[words]) else GIVEN[words]
    wanted = np.column_stack([PATH, PATH[::-1]]) if several else PATH
    plan = plan_path(model, 1e-6 * wanted, time=TIME, **given)
    each, axes = plan.each or (plan,), ["x", "y"] if several else [""]
    assert_equal_columns(columns_of(folder / "out.csv", ["vx_V", "vy_V"] if several else ["voltage_V"]), plan.voltage)
    names = [f"{axis}_expected_um" for axis in axes] if several else ["expected_um"]
    assert_equal_columns(columns_of(folder / "out.csv", names), 1e6 * plan.expected)
    if plan.first:
        assert_equal_columns(
            columns_of(folder / "out.csv", ["time_s", "phase"]), np.column_stack([plan.time, plan.phase])
        )
    fields = {axis: {key: told[key][axis] if several else told[key] for key in ("promise", "clamped")} for axis in axes}
    for axis, own in zip(axes, each, strict=True):
        assert fields[axis]["clamped"] == own.clamped[own.first :].sum()
        assert fields[axis]["promise"]["largest_m"] == pytest.approx(own.promise.largest, rel=1e-9)
        assert {*own.promise.lines()[1:]} <= {warning.removeprefix(f"{axis}: ") for warning in told["warnings"]}
    assert {*plan.warnings} <= {*told["warnings"]}
    small = all(own.promise.largest <= 0.05 * own.promise.stroke for own in each)
    assert status == (0 if small and not plan.failure else 1)


def test_the_reach_depends_on_the_temperature_of_the_path(tmp_path):
    """The reach at 60 degC ends lower than at the reference, at 30 degC."""
    replace(BARE, thermal=PLAIN.thermal).save(tmp_path / "model.json")
    low, high = (1e6 * PLAIN.thermal.warmed(np.array(BARE.reach), 60.0)).tolist()
    path = {"time_s": TIME, "displacement_um": high - 1.9 + 2 * np.cos(np.pi * TIME)}
    said = []
    for degrees in (30, 60):
        write_columns(tmp_path / "path.csv", path | {"temperature_C": np.full(TIME.size, float(degrees))})
        told = result("compensate", "model.json", "path.csv", "-o", "out.csv", "--start", "top", cwd=tmp_path)[1]
        said.append([warning for warning in told["warnings"] if "the path covers" in warning])
    assert said[0] == [] and told["missed_um"] == pytest.approx(0.1, rel=1e-3)
    assert f"{low:.4g} to {high:.4g} um" in said[1][0] and f"to {high + 0.1:.6g} um" in said[1][0]


def test_a_model_without_temperature_ignores_the_column_and_says_so(folder):
    BARE.save(folder / "bare.json")
    said, written = [], []
    for path in ("path.csv", "warm.csv"):
        told = result("compensate", "bare.json", path, "-o", "out.csv", "--start", "bottom", cwd=folder)[1]
        said.append({*told["warnings"]})
        written.append((folder / "out.csv").read_bytes())
    (more,) = said[1] - said[0]
    assert "temperature_K" in more and written[0] == written[1]


def test_a_path_is_counted_from_its_zero(folder):
    words = ("path.csv", "-o", "out.csv", "--zero", "1.5", "--start", "bottom")
    result("compensate", "plain.json", *words, cwd=folder)
    start = PossibleStart.named(PLAIN, "bottom")
    plan = plan_path(PLAIN, 1e-6 * PATH + 1.5e-6, time=TIME, start=start)
    assert_equal_columns(columns_of(folder / "out.csv", ["voltage_V"]), plan.voltage)


def played_before(model, start):
    """The start of a voltage that is given as it is: the actuator need not stand there any more."""
    if start in ("", "top"):
        return named(start)(model)["start"] if start else None
    if start == "history.csv":
        return PossibleStart.after(model, VOLTAGE, time=TIME, limits=model.limits)
    return starts(model, lambda actuator: start_of(actuator, record_of(actuator), limits=actuator.limits))


@pytest.mark.parametrize(
    ("name", "start"),
    [
        *((name, start) for name in MODELS for start in ("", "top", "MODEL-record.csv")),
        *((name, "history.csv") for name in ("plain", "creep")),
    ],
)
def test_simulate_writes_what_the_library_predicts(folder, name, start):
    model, several = MODELS[name], name == "stage"
    options = ["--start", start.replace("MODEL", name)] if start else []
    file = "stage-record.csv" if several else "history.csv"
    result("simulate", f"{name}.json", file, "-o", "s.csv", *options, cwd=folder)
    played = np.column_stack([VOLTAGE, VOLTAGE]) if several else VOLTAGE
    plan = plan_voltage(model, played, time=TIME, start=played_before(model, start))
    axes = ["x_", "y_"] if several else [""]
    assert_equal_columns(columns_of(folder / "s.csv", [f"{axis}expected_um" for axis in axes]), 1e6 * plan.expected)
