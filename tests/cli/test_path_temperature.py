"""Path files with a temperature: used sample by sample, given as a constant, or missing, which has a stated cost."""

import json
from dataclasses import replace

import numpy as np
import plain_records
import pytest
from command_line import run

import dehyst
from dehyst.control import PossibleStart, plan_path
from dehyst.model import Identification, Validity, turned, with_identification
from dehyst.records import read_table, write_columns

COLD = replace(plain_records.plant(6), limits=(0.0, 200.0))
THERMAL = dehyst.Thermal(-2.5e-3, 4e-9, 30.0)
TIME = np.arange(300) * 0.01
PATH = 6 - 3 * np.cos(2 * np.pi * 0.5 * TIME)
DEGREES = np.linspace(20, 40, TIME.size)
COUPLING = np.array([[1.0, 0.05], [-0.04, 1.0]])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    target = tmp_path_factory.mktemp("temperature")
    stroke = float(np.ptp(COLD.reach))
    numbers = {"rms": 1e-8, "largest": 3e-8, "disagreement": 0.0, "stroke": stroke, "temperatures": (15.0, 45.0)}
    volts = 100 - 100 * np.cos(2 * np.pi * 0.5 * TIME)
    known = Identification(largest_error=3e-8, validity=Validity.by_records([(TIME, volts)], **numbers))
    replace(COLD, thermal=THERMAL, identification=known).save(target / "model.json")
    COLD.save(target / "cold.json")
    other = replace(COLD, thermal=dehyst.Thermal(1e-3, 0.0, 25.0))
    dehyst.Stage((dehyst.Actuator.load(target / "model.json"), other), COUPLING, ("x", "y")).save(target / "stage.json")
    dehyst.Stage((COLD, COLD), COUPLING, ("x", "y")).save(target / "cold_stage.json")
    both = {"time_s": TIME, "x_um": PATH, "y_um": PATH[::-1]}
    write_columns(target / "warm_axes.csv", both | {"temperature_F": 32 + 1.8 * DEGREES})
    columns = {"time_s": TIME, "displacement_um": PATH}
    write_columns(target / "path.csv", columns)
    write_columns(target / "warm.csv", columns | {"temperature_K": DEGREES + 273.15})
    write_columns(target / "two.csv", columns | {"room_C": DEGREES - 10, "stage_C": DEGREES})
    write_columns(target / "rooms.csv", columns | {"room_temp_C": DEGREES - 10, "temperature_C": DEGREES})
    write_columns(target / "hole.csv", columns | {"temperature_C": np.where(TIME == 0.5, 4000.0, DEGREES)})
    return target


def follow(folder, *words, status=0):
    found, out, _ = run("compensate", *words, "-o", "out.csv", "--start", "bottom", "--json", "--force", cwd=folder)
    assert status in (None, found), out
    return json.loads(out), read_table(folder / "out.csv")


def test_a_column_is_used_sample_by_sample(folder):
    _, table = follow(folder, "model.json", "warm.csv")
    voltage, warmth = table.column("voltage"), DEGREES
    after = np.flatnonzero(np.diff(table.column("time"), prepend=-1) > 0)[-TIME.size :]
    actuator = dehyst.Actuator.load(folder / "model.json")
    start = turned(actuator, float(actuator.spring.displacement[0]), rising=False)
    whole = np.concatenate([np.full(voltage.size - TIME.size, warmth[0]), warmth])
    moved = 1e6 * actuator.simulate(voltage, temperature=whole, state=start).displacement
    np.testing.assert_allclose(moved[after], PATH, atol=1e-6)
    _, named = follow(folder, "model.json", "two.csv", "--columns", "temperature=stage_C")
    np.testing.assert_allclose(named.column("voltage"), voltage, atol=1e-9)
    assert run("simulate", "model.json", "out.csv", "--start", "bottom", "-o", "back.csv", cwd=folder)[0] == 0
    back = read_table(folder / "back.csv")
    np.testing.assert_allclose(1e6 * back.column("displacement", "expected_um")[after], PATH, atol=1e-6)


def test_an_unknown_or_untested_temperature_costs_a_stated_part_of_the_promise(folder):
    stroke = float(np.ptp(COLD.reach))
    kelvin = 2.5e-3 * stroke + 4e-9
    tested, _ = follow(folder, "model.json", "warm.csv")
    unknown, _ = follow(folder, "model.json", "path.csv")
    hot, _ = follow(folder, "model.json", "path.csv", "--temperature", "50")
    assert "temperature_m" not in tested["promise"]["parts"]
    for found, cost in ((unknown, 15 * kelvin), (hot, 5 * kelvin)):
        judged = found["promise"]
        assert judged["parts"]["temperature_m"] == pytest.approx(cost)
        assert judged["largest_m"] > tested["promise"]["largest_m"] + 0.9 * cost
        assert any("degC" in gap["sentence"] for gap in judged["untested"])
    _, out, _ = run("simulate", "model.json", "out.csv", "--temperature", "50", "--json", "-o", "x.csv", cwd=folder)
    assert json.loads(out)["temperature_cost_um"] == pytest.approx(5e6 * kelvin)


def test_the_reach_of_a_path_is_that_at_its_temperature(folder):
    """The reach at 60 degC ends lower than at the reference; a constant and a column give the same remark."""
    low, high = (1e6 * float(end) for end in THERMAL.warmed(np.array(COLD.reach), 60.0))
    assert high + 0.2 < 1e6 * COLD.reach[1]
    top = high + 0.1
    columns = {"time_s": TIME, "displacement_um": top - 2 + 2 * np.cos(np.pi * TIME)}
    write_columns(folder / "high.csv", columns)
    write_columns(folder / "high_hot.csv", columns | {"temperature_C": np.full(TIME.size, 60.0)})
    start = ("-o", "out.csv", "--start", "top", "--json", "--force")
    said = {}
    for path, *more in (("high.csv",), ("high.csv", "--temperature", "60"), ("high_hot.csv",)):
        found = json.loads(run("compensate", "model.json", path, *more, *start, cwd=folder)[1])
        said[path, *more] = [warning for warning in found["warnings"] if "the path covers" in warning]
        missed = found["missed_um"]
    cold, constant, column = said.values()
    assert cold == []
    assert constant == column and len(column) == 1
    assert f"{low:.4g} to {high:.4g} um" in column[0] and f"to {top:.6g} um" in column[0]
    assert missed == pytest.approx(0.1, rel=1e-3)


def test_a_constant_that_is_used_instead_of_the_column_is_reported(folder):
    """Voltages are those of the constant; the column, under its name, is in one more warning."""
    constant = ("--temperature", "30")
    (both, used), (alone, expected) = (
        follow(folder, "model.json", path, *constant) for path in ("warm.csv", "path.csv")
    )
    np.testing.assert_array_equal(used.column("voltage"), expected.column("voltage"))
    (more,) = set(both["warnings"]) - set(alone["warnings"])
    assert "temperature_K" in more and len(both["warnings"]) == len(alone["warnings"]) + 1
    words = ("simulate", "model.json", "out.csv", "-o", "x.csv", "--force", "--json")
    given, own = (json.loads(run(*words, *more, cwd=folder)[1])["warnings"] for more in (constant, ()))
    assert len([name for name in given if "temperature_C" in name]) == 1
    assert not [name for name in own if "temperature_C" in name]


def test_a_model_without_the_part_ignores_the_column_and_says_so(folder):
    (warned, warm), (known, plain) = (follow(folder, "cold.json", path) for path in ("warm.csv", "path.csv"))
    np.testing.assert_array_equal(warm.column("voltage"), plain.column("voltage"))
    (more,) = set(warned["warnings"]) - set(known["warnings"])
    assert "temperature_K" in more


def test_a_column_is_used_by_all_of_several_axes(folder):
    """The path comes out again, whose rows are those of each actuator at its temperature."""
    result, table = follow(folder, "stage.json", "warm_axes.csv")
    assert not any(result["clamped"].values())
    assert not any("temperature" in sentence for sentence in result["warnings"] if sentence.startswith("x: "))
    written = {column.name: column.data for column in table.columns}
    after = slice(len(table.columns[0].data) - TIME.size, None)
    np.testing.assert_allclose(written["temperature_C"][after], DEGREES, atol=1e-9)
    stage = dehyst.Stage.load(folder / "stage.json")
    states = [turned(actuator, float(actuator.spring.displacement[0]), rising=False) for actuator in stage.actuators]
    volts = np.column_stack([written["vx_V"], written["vy_V"]])
    moved = 1e6 * stage.simulate(volts, temperature=written["temperature_C"], states=states).displacement
    np.testing.assert_allclose(moved[after], np.column_stack([PATH, PATH[::-1]]), atol=1e-6)
    assert run("simulate", "stage.json", "out.csv", "--start", "bottom", "-o", "axes.csv", cwd=folder)[0] == 0
    back = {column.name: column.data for column in read_table(folder / "axes.csv").columns}
    np.testing.assert_allclose(back["x_expected_um"][after], PATH, atol=1e-6)
    constant, _ = follow(folder, "stage.json", "warm_axes.csv", "--columns", "x=x_um, y=y_um", "--temperature", "50")
    assert constant["promise"]["x"]["parts"]["temperature_m"] > 0
    assert any("50 degC" in sentence for sentence in constant["warnings"])


def test_a_planned_path_warns_as_the_command_does(folder):
    actuator = with_identification(dehyst.Actuator.load(folder / "model.json"), slew_rate=50.0)
    actuator.save(folder / "fast.json")
    result, _ = follow(folder, "fast.json", "path.csv", "--temperature", "50", "--slew-rate", "none")
    start = PossibleStart.named(actuator, "bottom")
    planned = plan_path(dehyst.Compensator(actuator, units="um"), PATH, time=TIME, temperature=50.0, start=start)
    assert any("50 degC" in warning for warning in planned.warnings)
    assert set(planned.warnings) <= set(result["warnings"])
    assert set(planned.promise.lines[1:]) <= set(planned.warnings)
