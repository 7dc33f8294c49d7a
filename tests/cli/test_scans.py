"""`dehyst compensate --scan` as a process: files, messages, exit status."""

import json
from dataclasses import replace

import numpy as np
import plain_records
import pytest
from command_line import WRITTEN, run

from dehyst import Actuator, Creep

TRIANGLE = ("--scan", "triangle", "--low", 2, "--high", 12, "--frequency", 10)
TOP = ("--start", "top")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a plain model, one that creeps, and a path."""
    target = tmp_path_factory.mktemp("scans")
    plain = replace(plain_records.plant(10), limits=(-50.0, 250.0))
    plain.save(target / "model.json")
    replace(plain, creep=Creep([0.05, 0.4], [1e6, 1.5e6])).save(target / "creep.json")
    replace(plain, creep=Creep([5.0, 50.0], [2e5, 2e5])).save(target / "slow.json")
    (target / "path.csv").write_text("time_s,displacement_um\n0,2\n0.1,5\n0.2,3\n")
    return target


def test_a_named_scan_takes_the_place_of_a_file(folder):
    given = ("--turns", 0.2, "--cycles", 2, "--start", "top")
    status, out, err = run("compensate", "model.json", *TRIANGLE, *given, "-o", "out.csv", cwd=folder)
    assert status == 0 and out.startswith("801 samples, ")
    assert "ramp there slowly before you play the file" in err
    header, *rows = (folder / "out.csv").read_text().splitlines()
    assert header == "time_s,displacement_um,voltage_V,expected_um" and len(rows) == 801
    values = np.array([row.split(",") for row in rows], dtype=float).T
    assert (values[1].min(), values[1].max()) == (pytest.approx(2), pytest.approx(12))
    actuator = Actuator.load(folder / "model.json")
    top = actuator.turned(float(actuator.spring.displacement[-1]))
    assert np.allclose(actuator.simulate(values[2], state=top).displacement * 1e6, values[1], rtol=0, atol=1e-9)


@pytest.mark.parametrize("model", ["model.json", "creep.json"])
def test_a_wave_table_its_start_up_and_its_homing_make_the_actuator_follow(folder, model):
    status, out, _ = run(
        "compensate",
        model,
        *TRIANGLE,
        "--homing",
        "--present",
        20,
        "--cycle",
        "table.csv",
        "--cycles",
        60,
        "-o",
        "o.csv",
        "--json",
        cwd=folder,
    )
    told = json.loads(out)
    assert status == 0 and told["clamped"] == 0 and told["frequency_Hz"] == pytest.approx(10)
    rows = np.loadtxt(folder / "o.csv", delimiter=",", skiprows=1).T
    table = np.loadtxt(folder / "table.csv", delimiter=",", skiprows=1).T
    assert (folder / "o.csv").read_text().startswith("time_s,phase,displacement_um,voltage_V,expected_um\n")
    assert (folder / "table.csv").read_text().startswith("time_s,displacement_um,voltage_V,expected_um\n")
    time, phase, wanted, voltage = rows[:4]
    assert [int((phase == k).sum()) for k in (0, 1, 2)] == [told["homing_samples"], told["start_up_samples"], 60 * 400]
    assert np.all(np.diff(phase) >= 0) and voltage[0] == 20
    np.testing.assert_allclose(voltage[-400:], table[2], rtol=WRITTEN)
    np.testing.assert_allclose(wanted[-400:], table[1], rtol=WRITTEN)
    actuator = Actuator.load(folder / model)
    # It begins elsewhere than the file takes for granted: the homing is there for that.
    state = actuator.turned(actuator.core.spring_inverse(20.0), rising=False)
    made = actuator.simulate(voltage, time=time if model == "creep.json" else None, state=state).displacement * 1e6
    assert np.abs(made - wanted)[-400:].max() <= (1e-7 if model == "creep.json" else 1e-9)


def test_an_axis_of_a_raster_and_steps(folder):
    plane = ("--scan", "raster", "--low", 2, "--high", 12, "--frequency", 10, "--lines", 4, "--y-low", 3, "--y-high", 6)
    for axis, ends in (("x", (2, 12)), ("y", (3, 6))):
        assert run("compensate", "model.json", *plane, "--axis", axis, *TOP, "-o", "r.csv", cwd=folder)[0] == 0
        y = np.loadtxt(folder / "r.csv", delimiter=",", skiprows=1)[:, 1]
        assert (y.min(), y.max()) == (pytest.approx(ends[0]), pytest.approx(ends[1]))
    steps = ("--scan", "steps", "--levels", "2,6,10", "--dwell", 0.01, "--edge", 0.02, "--shape", "trapezoid")
    assert run("compensate", "model.json", *steps, *TOP, "-o", "s.csv", cwd=folder)[0] == 0


@pytest.mark.parametrize(
    "kind",
    [
        ("spiral", "--frequency", 1, "--revolutions", 3, "--constant", "angular", "--y-low", 1, "--y-high", 11),
        ("lissajous", "--frequency", 2, "--ratio", 3, 4, "--phase", 0, "--y-low", 5, "--y-high", 6),
    ],
)
def test_two_axes_in_the_middle_of_what_is_given(folder, kind):
    name, *more = kind
    given = ("--scan", name, "--low", 2, "--high", 12, *more, "--axis", "y")
    assert run("compensate", "model.json", *given, *TOP, "-o", "p.csv", cwd=folder)[0] == 0
    y = np.loadtxt(folder / "p.csv", delimiter=",", skiprows=1)[:, 1]
    low, high = more[-3], more[-1]
    assert y[0] == pytest.approx(0.5 * (low + high)) and y.max() == pytest.approx(high, abs=0.01)


def test_what_is_clamped_ends_with_status_1(folder):
    given = (*TRIANGLE, "--limits", 0, 100, "--cycle", "t.csv", "--start", "relaxed")
    status, _, err = run("compensate", "model.json", *given, "-o", "o.csv", cwd=folder)
    assert status == 1
    assert "CLAMPED: the steady cycle cannot be reached within the limits" in err


@pytest.mark.parametrize(
    "arguments, said",
    [
        ((), "compensate: got neither of TRAJECTORY and --scan, need one"),
        (("path.csv", *TRIANGLE), "compensate: got both of TRAJECTORY and --scan"),
        (("path.csv", "--low", 2), "--low: has no effect with a TRAJECTORY"),
        (("path.csv", "--approach", 1), "--approach: has no effect with a TRAJECTORY"),
        ((*TRIANGLE, "--time", "t"), "--time: has no effect with --scan"),
        ((*TRIANGLE, "--approach", 1), "--approach: has no effect with --scan without --cycle"),
        ((*TRIANGLE, "--cycle", "t.csv", "--present", 900, *TOP), "--present: got 900 V"),
        (("path.csv", "--present", 3, "--no-home"), "--present: got it with --no-home, without a homing"),
        ((*TRIANGLE, "--cycle", "t.csv", "--homing", *TOP), "--start: got it with --home"),
        (("path.csv", "--home", *TOP), "--start: got it with --home"),
        ((*TRIANGLE, "--cycle", "o.csv"), "is the name of two outputs"),
        ((*TRIANGLE, "--cycle", "model.json"), "is also an input of this command"),
        ((*TRIANGLE, "--lines", 3), "--lines: got 3 with --scan triangle, which takes --low"),
        ((*TRIANGLE[:-2],), "--scan triangle: got no --frequency, need --low, --high, --frequency"),
        ((*TRIANGLE, "--axis", "y"), "--axis: got 'y', need 'x'"),
        ((*TRIANGLE, "--cycles", 0, "--turns", 2), "--turns: got 2, need a share"),
        ((*TRIANGLE, "--acceleration", 1000), "--acceleration: got 1000 um/s^2, with which 10 um take"),
        (("--scan", "triangle", "--low", 12, "--high", 2, "--frequency", 10), "--low, --high: got 12 and 2 um, need"),
        (
            ("--scan", "triangle", "--low", 2, "--high", 12e6, "--frequency", 10),
            "--high: got 1.2e+07 um, need 1e+06 um at most; check its unit",
        ),
        (("--scan", "steps", "--levels", "2,2", "--dwell", 0.1, "--edge", 1), "--levels: got 2 um twice in a row"),
        (
            ("--scan", "steps", "--levels", "2", "--dwell", 0.1, "--edge", 1),
            "--levels: got 1 value, need two",
        ),
        (("--scan", "steps", "--levels", "2,6", "--dwell", 0.1), "--edge: got none, and no acceleration"),
        (
            ("--scan", "steps", "--levels", "2,6", "--dwell", 0.1, "--edge", 1e-3, "--acceleration", 10),
            "--edge: got 0.001 s for 4 um, which takes 1.52 s at least within 10 um/s^2; try",
        ),
        (
            ("--scan", "lissajous", "--low", 2, "--high", 12, "--frequency", 1, "--phase", 1e9),
            "--phase: got 17453292.5",
        ),
        ((*TRIANGLE, "--sample-rate", 20), "--sample-rate: got 20 Hz, 1 sample for 0.05 s"),
        (
            (*TRIANGLE, "--sample-rate", 1e8),
            "--scan: got 10000000 rows a period at 1e+08 Hz, need at most 5e+06; try a",
        ),
        ((*TRIANGLE, "--limits", 5, 2), "--limits: got (5.0, 2.0), need"),
        (
            ("--scan", "raster", "--low", 2, "--high", 12, "--frequency", 10, "--lines", 100_000),
            "--scan: got 40000400 rows a period at 4000 Hz, need at most 5e+06; try a lower --sample-rate, or a scan",
        ),
        ((*TRIANGLE, "--slew", -2), "--slew: got -2.0, need"),
        ((*TRIANGLE, "--cycles", -1), "--cycles: got -1, need a whole number, 0 or more"),
        ((*TRIANGLE, "--cycle", "t.csv", "--start-up", -1), "--start-up: got -1, need a whole number from 0 to"),
        ((*TRIANGLE, "--cycle", "t.csv", "--tolerance", -1), "--tolerance: got -1, need a length above 0 in um"),
        ((*TRIANGLE, "--cycle", "t.csv", "--approach", -1), "--approach: got -1, need a number above 0"),
        ((*TRIANGLE, "--cycle", "t.csv", "--homing", "--present", 900), "--present: got 900 V"),
        (("--scan", "steps", "--levels", "2,x", "--dwell", 1), "--levels: could not convert string to float: 'x'"),
        (
            ("--scan", "spiral", "--low", 2, "--high", 12, "--frequency", 1, "--revolutions", 3, "--y-high", 20),
            "--y-low, --y-high: got a range of 18 um, but x has 10 um",
        ),
    ],
)
def test_wrong_options_end_with_status_2_and_a_sentence(folder, arguments, said):
    before = (folder / "model.json").read_bytes()
    status, out, err = run("compensate", "model.json", *arguments, "-o", "o.csv", cwd=folder)
    assert status == 2 and out == "" and said in err
    assert (folder / "model.json").read_bytes() == before


def test_a_long_homing_is_told_before_it_is_written(folder):
    given = (*TRIANGLE, "--homing", "--cycle", "t.csv", "-o", "long.csv")
    _, out, err = run("compensate", "slow.json", *given, "--json", cwd=folder)
    told, rows = json.loads(out), np.loadtxt(folder / "long.csv", delimiter=",", skiprows=1)
    assert f"s of start-up, 0.1 s of cycles: {told['samples']} rows" in err
    assert f"the homing has {told['homing_samples']} rows" in err and "play it by its time column" in err
    assert told["samples"] == len(rows) < 5e5 and told["homing_s"] > 200
    first = rows[rows[:, 1] == 1][0]
    assert first[0] == pytest.approx(told["homing_s"], abs=1e-9)


@pytest.mark.parametrize(
    "arguments, said",
    [
        (("--start-up", 10_000_000), "--start-up: got 10000000, 4e+09 samples of start-up, need 12500 at most"),
        (("--cycles", 100_000_000), "--cycles: got 100000000, 4e+10 rows, need at most 12500"),
        (("--cycles", 12_500), "at most 5e+06 rows; try a lower --sample-rate"),
    ],
)
def test_files_that_no_one_can_use_are_not_written(folder, arguments, said):
    table = () if "--cycles" in arguments and arguments[1] > 12_500 else ("--cycle", "no-table.csv")
    status, out, err = run("compensate", "model.json", *TRIANGLE, *table, *arguments, "-o", "no.csv", cwd=folder)
    assert status == 2 and said in err and out == ""
    assert not (folder / "no.csv").exists() and not (folder / "no-table.csv").exists()


def test_what_is_not_settled_ends_with_status_1(folder):
    given = (*TRIANGLE, "--cycle", "t.csv", "--start", "relaxed", "--json")
    for more, wanted in (("--start-up", 1), 1), (("--start-up", 1, "--tolerance", 5), 0):
        status, out, err = run("compensate", "slow.json", *given, *more, "-o", "o.csv", cwd=folder)
        told = json.loads(out)
        assert (status, told["settled"], told["clamped"]) == (wanted, not wanted, 0)
        assert ("NOT SETTLED: after 1 cycle of start-up" in err) == bool(wanted)
        assert "cycles=" not in err and ("; give a start-up of " in err) == bool(wanted)
