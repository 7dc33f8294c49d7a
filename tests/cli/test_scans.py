"""`dehyst scan`, and `dehyst compensate` with the path of a scan: files, errors, exit status."""

from dataclasses import replace

import numpy as np
import plain_records
import pytest
from command_line import WRITTEN, result, run

from dehyst import Actuator, DisplacementCreep, wave_table
from dehyst.control import PossibleStart
from dehyst.model import evaluator_of, turned
from dehyst.waveforms import Triangle

TRIANGLE = ("triangle", "--low", 2, "--high", 12, "--frequency", 10)
TOP = ("--start", "top")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a plain model, two that creep, a path, and the path of a scan."""
    target = tmp_path_factory.mktemp("scans")
    plain = replace(plain_records.plant(10), limits=(-50.0, 250.0))
    plain.save(target / "model.json")
    replace(plain, displacement_creep=DisplacementCreep([0.05, 0.4], [0.1, 0.15])).save(target / "creep.json")
    replace(plain, displacement_creep=DisplacementCreep([5.0, 50.0], [0.02, 0.02])).save(target / "slow.json")
    (target / "path.csv").write_text("time_s,displacement_um\n0,2\n0.1,5\n0.2,3\n")
    assert run("scan", *TRIANGLE, "-o", "scan.csv", cwd=target)[0] == 0
    return target


def rows(path):
    return np.loadtxt(path, delimiter=",", skiprows=1).T


@pytest.mark.parametrize("model", ["model.json", "creep.json"])
def test_a_wave_table_its_start_up_and_its_homing_make_the_actuator_follow(folder, model):
    given = ("--home", "--present", 20, "--table", "table.csv", "-o", "o.csv")
    status, told = result("compensate", model, "scan.csv", *given, cwd=folder)
    assert status == 0 and told["clamped"] == 0 and told["frequency_Hz"] == pytest.approx(10)
    table = rows(folder / "table.csv")
    assert (folder / "o.csv").read_text().startswith("time_s,phase,displacement_um,voltage_V,expected_um\n")
    assert (folder / "table.csv").read_text().startswith("time_s,displacement_um,voltage_V,expected_um\n")
    time, phase, wanted, voltage, _ = rows(folder / "o.csv")
    assert int((phase == 2).sum()) == (told["start_up_cycles"] + 1) * 400 and phase.size == told["samples"]
    assert phase[0] == 0
    assert np.all(np.diff(phase) >= 0) and voltage[0] == 20
    np.testing.assert_allclose(voltage[-400:], table[2], rtol=2 * WRITTEN)
    np.testing.assert_allclose(wanted[-400:], table[1], rtol=2 * WRITTEN)
    actuator = Actuator.load(folder / model)
    # It begins elsewhere than the file takes for granted: the homing is there for that.
    state = turned(actuator, evaluator_of(actuator).core.spring_inverse(20.0), rising=False)
    voltage, wanted = np.append(voltage, np.tile(table[2], 59)), np.append(wanted, np.tile(table[1], 59))
    time = np.append(time, time[-1] + np.arange(1, 59 * 400 + 1) / 4000)
    made = actuator.simulate(voltage, time=time if model == "creep.json" else None, state=state).displacement * 1e6
    assert np.abs(made - wanted)[-400:].max() <= max(1.05 * told["error_um"], 1e-9)


def test_an_axis_of_a_raster_and_steps(folder):
    plane = ("raster", "--low", 2, "--high", 12, "--frequency", 10, "--lines", 4, "--y-low", 3, "--y-high", 6)
    assert run("scan", *plane, "-o", "raster.csv", cwd=folder)[0] == 0
    for axis, ends in {"x": (2, 12), "y": (3, 6)}.items():
        column = ("--columns", f"displacement={axis}_um")
        assert run("compensate", "model.json", "raster.csv", *column, *TOP, "-o", "r.csv", cwd=folder)[0] == 0
        y = rows(folder / "r.csv")[1]
        assert (y.min(), y.max()) == (pytest.approx(ends[0]), pytest.approx(ends[1]))
    steps = ("steps", "--levels", "2,6,10", "--dwell", 0.01, "--edge", "0.02")
    assert run("scan", *steps, "-o", "steps.csv", cwd=folder)[0] == 0
    assert run("compensate", "model.json", "steps.csv", *TOP, "-o", "s.csv", cwd=folder)[0] == 0
    # A scan is replaced by another one.
    assert run("scan", *steps, "--cycles", 2, "-o", "raster.csv", cwd=folder)[0] == 0


def test_the_table_of_rows_is_that_of_the_scan(folder):
    result("compensate", "model.json", "scan.csv", *TOP, "--table", "t.csv", "-o", "o.csv", cwd=folder)
    actuator = Actuator.load(folder / "model.json")
    start = PossibleStart.named(actuator, "top")
    table = wave_table(actuator, Triangle(2e-6, 12e-6, frequency=10).path(), start=start)
    np.testing.assert_allclose(rows(folder / "t.csv")[2], table.cycle.voltage, rtol=4 * WRITTEN)


def test_what_is_not_settled_ends_with_status_1(folder):
    given = ("scan.csv", "--table", "t.csv", "--start", "relaxed")
    status, told = result("compensate", "slow.json", *given, "--start-up", "1", "-o", "o.csv", cwd=folder)
    assert (status, told["settled"], told["clamped"]) == (1, False, 0)
    assert sum("NOT SETTLED" in warning for warning in told["warnings"]) == 1
    assert not any("cycles=" in warning for warning in told["warnings"])
