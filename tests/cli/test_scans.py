"""`dehyst scan`, and `dehyst compensate` with the path of a scan: files, errors, exit status."""

from dataclasses import replace

import numpy as np
import plain_records
import pytest
from command_line import WRITTEN, result, run

from dehyst import Actuator, DisplacementCreep, wave_table
from dehyst.control import PossibleStart
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
@pytest.mark.parametrize("start", ["", "top"])
def test_both_files_have_the_rows_of_the_wave_table(folder, model, start):
    given = TOP if start else ("--home", "--present", 20)
    status, told = result("compensate", model, "scan.csv", *given, "--table", "t.csv", "-o", "o.csv", cwd=folder)
    actuator = Actuator.load(folder / model)
    options = {"start": PossibleStart.named(actuator, start)} if start else {"present": 20.0}
    table = wave_table(actuator, Triangle(2e-6, 12e-6, frequency=10).path(), **options)
    plan, cycle = table.plan, table.cycle
    # The cycle begins with the last sample of the plan.
    before = (plan.time, plan.phase, 1e6 * plan.displacement, plan.voltage, 1e6 * plan.expected)
    for name, columns in {
        "o.csv": [column[:-1] for column in before],
        "t.csv": (cycle.time, 1e6 * cycle.displacement, cycle.voltage, 1e6 * cycle.expected),
    }.items():
        np.testing.assert_allclose(rows(folder / name), columns, rtol=4 * WRITTEN, atol=1e-9)
    assert (status, told["clamped"], told["samples"]) == (0, 0, plan.time.size - 1)
    assert told["frequency_Hz"] == pytest.approx(10) and told["start_up_cycles"] == table.cycles
    assert (folder / "o.csv").read_text().startswith("time_s,phase,displacement_um,voltage_V,expected_um\n")


def test_an_axis_of_a_raster_and_steps_are_compensated(folder):
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


def test_a_table_that_is_not_settled_gives_status_1(folder):
    given = ("scan.csv", "--table", "t.csv", "--start", "relaxed")
    status, told = result("compensate", "slow.json", *given, "--start-up", "1", "-o", "o.csv", cwd=folder)
    assert (status, told["settled"], told["clamped"]) == (1, False, 0)
    assert sum("NOT SETTLED" in warning for warning in told["warnings"]) == 1
    assert not any("cycles=" in warning for warning in told["warnings"])
