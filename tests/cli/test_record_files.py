"""Files on the command line: what a message prints works, `dehyst show`, scales in the model, the zero of a path."""

import json
import math
import os
import re
import shlex
import threading
from pathlib import Path

import laboratory_files
import numpy as np
import pytest
from click.testing import CliRunner
from laboratory_files import FILES, N, options_of

from dehyst import Actuator
from dehyst.cli import main
from dehyst.operations.files import Columns
from dehyst.records import Record, read, read_table, write_record


def run(*words):
    return CliRunner().invoke(main, list(words))


def printed_command(message):
    """The words of the command that a message printed, without the program's name."""
    (line,) = re.findall(r"^  (dehyst .*)$", message, re.MULTILINE)
    return shlex.split(line)[1:]


@pytest.mark.parametrize("name", FILES)
def test_the_printed_command_works(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write, words = FILES[name]
    write(tmp_path / name)
    given = ("--columns", str(Columns.of_options(options_of(words)))) if words else ()
    done = run("show", name, *given, "--json")
    if done.exit_code:
        assert done.exit_code == 2
        done = run(*printed_command(done.stderr), "--json")
    assert done.exit_code == 0, done.stderr
    seen = json.loads(done.stdout)
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


def test_show_prints_and_draws(monitor):
    columns = "voltage=Monitor [mV]*100, displacement=Sensor [V]*10um/V"
    done = run("show", "monitor.csv", "--columns", columns, "--report", "page.html")
    assert done.exit_code == 0, done.stderr
    for line in ("1200 samples of 3 columns", "  Monitor [mV]  mV      0 to 1000", "0 to 2.398 s, 500 Hz"):
        assert line in done.stdout
    assert "'Monitor [mV]', 100 V/V  0 to 100 V, 4 cycles" in done.stdout
    assert sum("*" in line for line in done.stdout.split("\n")) == 16
    page = (monitor / "page.html").read_text()
    assert page.count("data-chart=") == 3
    assert "100 V/V" in page


def test_show_prints_the_ends_of_columns_and_marks_guesses(monitor):
    (monitor / "regler.csv").write_text(
        "Zeit [ms];Ausgang Regler [mV];weg\n" + "".join(f"{2 * k};{12 + k},5;{k % 9}\n" for k in range(40))
    )
    options = ["--columns", "voltage=Ausgang Regler [mV]*15, displacement=weg:um?"]
    shown = run("show", "regler.csv", *options)
    assert shown.exit_code == 0, shown.stderr
    assert "  Ausgang Regler [mV]: 12,5 ... 51,5 -> 0.1875 ... 0.7725 V\n" in shown.stdout
    assert "  Zeit [ms]: 0 ... 78 -> 0 ... 0.078 s\n" in shown.stdout
    assert "  weg: 0 ... 3 -> 0 ... 3 um (guessed, verify)\n" in shown.stdout
    seen = json.loads(run("show", "regler.csv", *options, "--json").stdout)
    assert seen["guesses"].keys() == {"displacement"}
    (monitor / "kept.csv").unlink(missing_ok=True)
    run("show", "regler.csv", *options, "-o", "kept.csv")
    assert "guessed, verify" in run("show", "kept.csv").stdout


def test_show_lists_further_channels(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rows = "".join(f"{k / 10},{50 - 50 * math.cos(k / 10)},{k % 9},{20 + k / 100},{k}\n" for k in range(200))
    Path("a.csv").write_text("time_s,voltage_V,displacement_um,temperature_C,spare_N\n" + rows)
    assert "temperature:  'temperature_C'    20 to 21.99 degC\n" in run("show", "a.csv").stdout
    assert json.loads(run("show", "a.csv", "--json").stdout)["others"] == {"temperature_C": [20.0, 21.99]}
    assert "temperature" not in run("show", "a.csv", "--columns", "time:s,voltage:V,displacement:um,-,-").stdout


def test_a_column_that_is_nowhere_may_be_in_a_second_file(monitor):
    laboratory_files.two_files(monitor / "drive.csv")
    done = run("show", "drive.csv")
    assert done.exit_code == 2
    assert "second file" in done.stderr


def test_show_names_what_no_identification_takes(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rows = "".join(f"{i},5,{i % 7}\n" for i in range(40))
    Path("flat.csv").write_text("time_s,voltage_V,displacement_um\n" + rows)
    shown = run("show", "flat.csv")
    assert shown.exit_code == 0 and "No problems found" not in shown.output
    assert "Not usable" in shown.output and "constant" in shown.output


def test_show_counts_the_values_of_a_column_that_are_not_finite(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rows = "".join(f"{i},{50 - 50 * np.cos(i)},{i % 7},{'nan' if i < 2 else i},nan\n" for i in range(40))
    Path("gaps.csv").write_text("time_s,voltage_V,displacement_um,gap_um,none_um\n" + rows)
    shown = run("show", "gaps.csv").stdout
    assert "2 to 39, 2 values not finite" in shown and "40 values not finite" in shown and " nan" not in shown
    ranges = [one["range"] for one in json.loads(run("show", "gaps.csv", "--json").stdout)["file_columns"]]
    assert ranges[3:] == [[2.0, 39.0], []]


def test_show_lists_the_columns_of_a_file_that_is_no_record(monitor):
    (monitor / "other.csv").write_text("time_s,state,load_N\n0,on,1\n1,off,2\n")
    done = run("show", "other.csv")
    assert done.exit_code == 2
    assert "  load_N  N       1 to 2" in done.stdout
    assert "holds 'on'" in done.stdout
    assert "voltage" in done.stderr and "displacement" in done.stderr
    assert "try:" not in done.stderr


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="named pipes of POSIX")
def test_show_reads_a_pipe_once(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    laboratory_files.semicolons(tmp_path / "zeit.csv")
    os.mkfifo("pipe.csv")
    writer = threading.Thread(target=lambda: (tmp_path / "pipe.csv").write_bytes((tmp_path / "zeit.csv").read_bytes()))
    writer.start()
    done = run("show", "pipe.csv")
    writer.join()
    assert done.exit_code == 0, done.stderr


def test_a_scale_that_contradicts_the_file_is_in_no_command(monitor):
    """A message prints no command that fails in the same way."""
    (monitor / "plain.csv").write_text("time_s,voltage_V,displacement_um\n0,0,0\n1,1,1\n2,0,0\n")
    done = run("show", "plain.csv", "--columns", "displacement=*10 um/V")
    assert done.exit_code == 2
    assert "the scale 10 um/V" in done.stderr
    assert "try:" not in done.stderr
    # Nor if another column is to be selected, too.
    (monitor / "plain.csv").write_text("time_s,ch1_V,ch2_um\n0,0,0\n1,1,1\n2,0,0\n")
    done = run("show", "plain.csv", "--columns", "voltage=*1, displacement=ch2_um*1um/V")
    assert done.exit_code == 2
    assert "try:" not in done.stderr


def test_leaving_out_all_columns_is_refused(monitor):
    done = run("show", "bare.csv", "--columns", "names=-|-|-")
    assert done.exit_code == 2
    assert "leaves out all columns" in done.stderr


@pytest.mark.parametrize(
    ("scale", "said"), [("1e400 V/V", "finite and not 0"), ("1 kg/V", "first unit must be one of")]
)
def test_a_scale_that_is_no_number_is_explained(monitor, scale, said):
    done = run("show", "monitor.csv", "--columns", f"voltage=Monitor [mV]*{scale}")
    assert done.exit_code == 2
    assert said in done.stderr


def test_german_words_for_units(monitor):
    (monitor / "zeit.csv").write_text("Zeit in Millisekunden;Spannung in Volt;Weg in Mikrometer\n0;0;0\n1;1;1\n2;0;0\n")
    record = read("zeit.csv")
    assert record.time == pytest.approx([0, 1e-3, 2e-3])
    assert record.displacement == pytest.approx([0, 1e-6, 0])


def test_a_joined_file_is_not_replaced(monitor):
    laboratory_files.two_files(monitor / "drive.csv")
    before = (monitor / "sensor.csv").read_bytes()
    done = run("identify", "drive.csv", "--columns", "join=sensor.csv", "-o", "sensor.csv", "--force")
    assert done.exit_code == 2 and "sensor.csv" in done.stderr
    assert (monitor / "sensor.csv").read_bytes() == before


def test_a_monitor_and_a_sensor_in_four_commands(monitor):
    """Semicolons, millivolts of a monitor of 1:100, and a sensor of 10 um/V."""
    identify = ["identify", "monitor.csv", "-o", "model.json", "--structure", "maxwell_slip"]
    first = run(*identify)
    assert first.exit_code == 2
    command = printed_command(first.stderr)
    assert sum(word.count("*GAIN") for word in command) == 2
    assert run(*command).exit_code == 2
    second = run(*(word.replace("*GAIN um/V", "*10 um/V").replace("*GAIN", "*100") for word in command))
    assert second.exit_code == 0, second.stderr
    actuator = Actuator.load("model.json")
    assert actuator.limits == pytest.approx((0, 100), abs=0.01)
    assert "monitor.csv, voltage 100 V/V, displacement 10 um/V" in (monitor / "model.json").read_text()
    third = run("compensate", "model.json", "path.csv", "-o", "voltage.csv")
    assert third.exit_code == 0, third.stderr
    table = read_table("voltage.csv")
    played = actuator.simulate(table.column("voltage")).displacement
    path = table.columns[table.names.index("phase")].data == 2
    assert np.abs(played - table.column("displacement"))[path].max() < 1e-12


def test_scales_for_commands_that_read_one_column(monitor):
    laboratory_files.lecroy(monitor / "known.csv")
    known = ("--columns", "time=Time:s, voltage=Ampl:V")
    run("identify", "known.csv", "-o", "model.json", "--structure", "maxwell_slip", *known)
    (monitor / "small.csv").write_text("time_s,monitor_mV\n0,100\n0.1,500\n0.2,200\n")
    scaled = ("--columns", "voltage=monitor_mV*0.1V/mV")
    done = run("simulate", "model.json", "small.csv", "-o", "out.csv", *scaled)
    assert done.exit_code == 0, done.stderr
    assert read_table("out.csv").column("voltage") == pytest.approx([10, 50, 20])
    done = run("simulate", "model.json", "bare.csv", "-o", "out2.csv", "--columns", "time=1:s, voltage=2:V")
    assert done.exit_code == 0, done.stderr
    assert read_table("out2.csv").column("voltage").max() == pytest.approx(100)


# The zero


@pytest.fixture
def far(monitor):
    """A model whose sensor has its zero far away: it reaches about -120 to -108 um."""
    record = Record(laboratory_files.T, laboratory_files.V, laboratory_files.Y - 120e-6, "far")
    write_record(monitor / "far.csv", record)
    done = run("identify", "far.csv", "-o", "far.json", "--structure", "maxwell_slip")
    assert done.exit_code == 0, done.stderr
    return monitor


def test_an_unreachable_path_names_the_range_and_the_option(far):
    done = run("compensate", "far.json", "path.csv", "-o", "voltage.csv")
    assert done.exit_code == 2
    assert "model reaches -119.6 to -108.4" in done.stderr
    assert "--zero bottom counts" in done.stderr
    done = run("compensate", "far.json", "path.csv", "-o", "voltage.csv", "--zero", "bottom")
    assert done.exit_code == 0, done.stderr
    assert "counted from -119.6" in done.stderr
    low = Actuator.load("far.json").major_loop((0, 100))[0]
    table = read_table("voltage.csv")
    path = table.columns[table.names.index("phase")].data == 2
    wanted = read_table("path.csv").column("displacement")
    assert table.column("displacement")[path] == pytest.approx(wanted + low, abs=1e-12)


def test_a_path_that_is_somewhat_outside_names_the_range_too(far):
    rows = "".join(f"{k * 0.01:.2f},{-110 + 4 * np.sin(k / 32):.6f}\n" for k in range(400))
    (far / "high.csv").write_text(f"time_s,displacement_um\n{rows}")
    done = run("compensate", "far.json", "high.csv", "-o", "voltage.csv")
    assert done.exit_code == 1
    assert "model reaches -119.6 to -108.4 um with 0 to 100" in done.stderr
    (value,) = re.findall(r"--zero (\S+) puts the path into the middle", done.stderr)
    assert run("compensate", "far.json", "high.csv", "-o", "voltage.csv", "--zero", value).exit_code == 0


@pytest.mark.parametrize("more", [(), ("--table", "table.csv")])
def test_a_scan_is_counted_from_the_zero(far, more):
    run("scan", "triangle", "--low", "2", "--high", "8", "--frequency", "1", "-o", "scan.csv")
    scan = ["compensate", "far.json", "scan.csv", *more]
    done = run(*scan, "-o", "out.csv")
    assert done.exit_code == 2
    assert "--zero bottom" in done.stderr
    done = run(*scan, "-o", "out.csv", "--zero", "bottom")
    assert done.exit_code == 0, done.stderr
    low = Actuator.load("far.json").major_loop((0, 100))[0]
    assert read_table("out.csv").column("displacement")[-1] == pytest.approx(low + 2e-6, abs=0.2e-6)


def test_the_middle_and_the_start_as_zero(far):
    (far / "around.csv").write_text("time_s,displacement_um\n" + "".join(f"{k},{np.sin(k):.6f}\n" for k in range(9)))
    done = run("compensate", "far.json", "around.csv", "-o", "out.csv")
    assert "--zero mean counts" in done.stderr
    done = run("compensate", "far.json", "around.csv", "-o", "out.csv", "--zero", "mean", "--no-home")
    low, high = Actuator.load("far.json").major_loop((0, 100))
    assert read_table("out.csv").column("displacement")[0] == pytest.approx((low + high) / 2)
    done = run(
        "compensate",
        "far.json",
        "path.csv",
        "-o",
        "out2.csv",
        "--zero",
        "first",
        "--start",
        "bottom",
        "--slew-rate",
        "none",
    )
    assert done.exit_code == 0, done.stderr
    first, wanted = read_table("out2.csv").column("displacement"), read_table("path.csv").column("displacement")
    assert first - wanted == pytest.approx(low, abs=1e-9)
    done = run("compensate", "far.json", "around.csv", "-o", "out.csv", "--zero", "top")
    assert done.exit_code == 2
    assert "bottom, first" in done.stderr


def test_the_trajectory_of_an_assessment_names_the_range(far):
    asked = ["insight", "far.json", "far.csv", "--trajectory", "path.csv"]
    assert "--zero bottom counts" in run(*asked).stderr
    done = run(*asked, "--zero", "bottom", "-o", "band.csv")
    assert "--zero" not in done.stderr
    assert read_table("band.csv").column("time").size == 400


@pytest.mark.parametrize("zero", ["bottom", "first", "mean", "-120"])
def test_identify_places_the_zero(far, zero):
    known = read("far.csv")
    place = {"bottom": known.displacement.min(), "first": known.displacement[0], "mean": known.displacement.mean()}
    done = run("identify", "far.csv", "-o", "moved.json", "--structure", "maxwell_slip", "--zero", zero)
    assert done.exit_code == 0, done.stderr
    before, after = (Actuator.load(name) for name in ("far.json", "moved.json"))
    shift = place.get(zero, -120e-6)
    assert np.array(after.major_loop((0, 100))) == pytest.approx(
        np.array(before.major_loop((0, 100))) - shift, abs=1e-10
    )
    assert f"zero at {shift * 1e6:.6g} um" in (far / "moved.json").read_text()


@pytest.mark.nightly
def test_the_commands_that_are_printed_for_an_unknown_decimal_sign_work(far):
    rows = "".join(f"{k}\t-{112 + k % 4},{k:03d}\n" for k in range(1, 40))
    (far / "path.txt").write_text(f"time_s\tdisplacement_um\n{rows}")
    (far / "before.txt").write_text("time_s\tvoltage_V\n0\t1,000\n1\t50,500\n2\t10,250\n")
    (far / "records").mkdir()
    (far / "records" / "a.txt").write_text(
        "time_s\tvoltage_V\tdisplacement_um\n"
        + "".join(f"{k}\t{50 - 40 * np.cos(k / 9):.3f}\t{9 - 4 * np.cos(k / 9):.3f}\n" for k in range(80)).replace(
            ".", ","
        )
    )
    for words in (
        ["compensate", "far.json", "path.txt", "-o", "out.csv"],
        ["compensate", "far.json", "path.csv", "-o", "out2.csv", "--zero", "bottom", "--start", "before.txt"],
        ["insight", "far.json", "far.csv", "--trajectory", "path.txt"],
        ["simulate", "far.json", "before.txt", "-o", "out3.csv"],
        ["simulate", "far.json", "far.csv", "-o", "out4.csv", "--start", "before.txt"],
    ):
        done = run(*words)
        assert done.exit_code == 2
        assert "decimal=point" in done.stderr and "decimal=comma" in done.stderr
        done = run(*words, "--columns", "decimal=comma")
        assert done.exit_code in (0, 1), done.stderr
        assert done.stdout
    path = read_table("out.csv").column("displacement")
    assert path[-1] == pytest.approx(-115.039e-6, abs=1e-9)


def test_the_advice_for_a_bad_cell_and_for_a_rate_that_is_a_word(far):
    (far / "bad.csv").write_text("time_s,voltage_V,displacement_um\n0,1,2\n1,x,3\n2,2,4\n")
    done = run("show", "bad.csv")
    assert done.exit_code == 2
    assert "line 3" in done.stderr
    assert "in a second file" not in done.stderr
    (far / "lacks.csv").write_text("time_s,displacement_um\n0,2\n1,3\n2,4\n")
    assert "second file" in run("show", "lacks.csv").stderr
    done = run("show", "far.csv", "--columns", "rate=HZ")
    assert "samples a second" in done.stderr
    np.save(far / "square.npy", np.eye(3))
    assert "(3, 3)" in run("show", "square.npy").stderr
