"""Files on the command line: what a message prints works, `dehyst show`, scales in the model, the zero of a path."""

import json
import re
import shlex
from pathlib import Path

import laboratory_files
import numpy as np
import pytest
from command_line import result, run
from laboratory_files import FILES, N

from dehyst import Actuator
from dehyst.records import Record, read_table, write_record


def done(*words):
    """Return what a command prints that succeeds."""
    status, out, err = run(*words)
    assert status == 0, err
    return out


def printed_command(message):
    """The words of the command that a message printed, without the program's name."""
    (line,) = re.findall(r"^  (dehyst .*)$", message, re.MULTILINE)
    return shlex.split(line)[1:]


@pytest.mark.parametrize("name", FILES)
def test_the_printed_command_works(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write, words = FILES[name]
    write(tmp_path / name)
    given = ("--columns", words) if words else ()
    status, out, err = run("show", name, *given, "--json")
    assert status in (0, 2)
    seen = result(*printed_command(err))[1] if status else json.loads(out)
    assert seen["samples"] == N
    assert seen["cycles"] == 4
    assert seen["voltage_V"] == pytest.approx([0, 100], abs=0.01)
    assert seen["displacement_um"] == pytest.approx([0, 11.616], abs=0.01)


@pytest.fixture
def monitor(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    laboratory_files.monitor(tmp_path / "monitor.csv")
    laboratory_files.headerless(tmp_path / "bare.csv")
    rows = "".join(f"{k * 0.01:.2f},{5 - 4 * np.cos(k / 32):.6f}\n" for k in range(400))
    (tmp_path / "path.csv").write_text(f"time_s,displacement_um\n{rows}")
    return tmp_path


def test_show_prints_columns_and_ranges(monitor):
    columns = "voltage=Monitor [mV]*100, displacement=Sensor [V]*10um/V"
    shown = done("show", "monitor.csv", "--columns", columns)
    for line in ("1200 rows of 3 columns", "  Monitor [mV]  mV      0 to 1000", "0 to 2.398 s, 500 Hz"):
        assert line in shown
    assert "'Monitor [mV]', times 100  0 to 100 V, 4 cycles" in shown


def test_show_counts_the_values_of_a_column_that_are_not_finite(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rows = "".join(f"{i},{50 - 50 * np.cos(i)},{i % 7},{'nan' if i < 2 else i},nan\n" for i in range(40))
    Path("gaps.csv").write_text("time_s,voltage_V,displacement_um,gap_um,none_um\n" + rows)
    shown = done("show", "gaps.csv")
    assert "2 to 39, 2 values not finite" in shown and "40 values not finite" in shown and " nan" not in shown
    ranges = [column["range"] for column in result("show", "gaps.csv")[1]["file_columns"]]
    assert ranges[3:] == [[2.0, 39.0], []]


def test_four_commands_lead_from_monitor_and_sensor_voltages_to_a_model(monitor):
    """Semicolons, millivolts of a monitor of 1:100, and a sensor of 10 um/V."""
    identify = ["identify", "monitor.csv", "-o", "model.json", "--structure", "maxwell_slip"]
    status, _, err = run(*identify)
    command = printed_command(err)
    assert status == 2 and sum(word.count("*GAIN") for word in command) == 2
    assert run(*command)[0] == 2
    done(*(word.replace("*GAIN um/V", "*10 um/V").replace("*GAIN", "*100") for word in command))
    actuator = Actuator.load("model.json")
    assert actuator.limits == pytest.approx((0, 100), abs=0.01)
    assert "monitor.csv, voltage times 100, displacement 10 um/V" in (monitor / "model.json").read_text()
    done("compensate", "model.json", "path.csv", "-o", "voltage.csv")
    table = read_table("voltage.csv")
    played = actuator.simulate(table.column("voltage")).displacement
    path = table.columns[table.names.index("phase")].data == 2
    assert np.abs(played - table.column("displacement"))[path].max() < 1e-12


def test_commands_that_read_one_column_accept_its_scale(monitor):
    laboratory_files.lecroy(monitor / "known.csv")
    known = ("--columns", "time=Time:s, voltage=Ampl:V")
    run("identify", "known.csv", "-o", "model.json", "--structure", "maxwell_slip", *known)
    (monitor / "small.csv").write_text("time_s,monitor_mV\n0,100\n0.1,500\n0.2,200\n")
    scaled = ("--columns", "voltage=monitor_mV*0.1V/mV")
    done("simulate", "model.json", "small.csv", "-o", "out.csv", *scaled)
    assert read_table("out.csv").column("voltage") == pytest.approx([10, 50, 20])
    done("simulate", "model.json", "bare.csv", "-o", "out2.csv", "--columns", "time=1:s, voltage=2:V")
    assert read_table("out2.csv").column("voltage").max() == pytest.approx(100)


def test_an_unreachable_path_names_the_range_and_the_option(monitor):
    """The zero of the sensor is far away: the model reaches about -120 to -108 um."""
    record = Record(laboratory_files.T, laboratory_files.V, laboratory_files.Y - 120e-6, "far")
    write_record(monitor / "far.csv", record)
    done("identify", "far.csv", "-o", "far.json", "--structure", "maxwell_slip")
    status, _, err = run("compensate", "far.json", "path.csv", "-o", "voltage.csv")
    assert status == 2 and "-119.62 to -108.38" in err and "--zero -119 " in err
    done("compensate", "far.json", "path.csv", "-o", "voltage.csv", "--zero", "-119")
    table = read_table("voltage.csv")
    path = table.columns[table.names.index("phase")].data == 2
    wanted = read_table("path.csv").column("displacement")
    assert table.column("displacement")[path] == pytest.approx(wanted - 119e-6, abs=1e-12)


def test_columns_are_typed_once(monitor):
    columns = "voltage=Monitor [mV]*100, displacement=Sensor [V]*10 um/V"
    assert run("show", "monitor.csv", "--columns", columns, "--save", "kept.txt")[0] == 0
    first, second = (result("show", "monitor.csv", "--columns", text) for text in (columns, "@kept.txt"))
    assert first == second
    assert run("show", "monitor.csv", "--columns", columns, "--save", "kept.txt")[0] == 2
