"""What commands write and print: no file of others is replaced, and no stream or name ends in a traceback."""

import contextlib
import csv
import json
import os
import re
import signal
import socket
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import click
import command_line
import numpy as np
import plain_records
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

import dehyst.cli.registry
from dehyst import Compensator, FileFormatError, Record, write_record
from dehyst._io.json_files import write_json
from dehyst._io.marks import demand_own_folder, demand_replaceable, format_of, marked, written_by_dehyst
from dehyst._text import escaped
from dehyst.exports import SourceOnlyWarning, export_fmu
from dehyst.instruments import LinkError
from dehyst.records import read_table, write_columns
from dehyst.report.html import document
from dehyst.studies import demo

PROGRAM = [sys.executable, "-c", "from dehyst.cli.registry import main; main()"]
NASTY = "a\x1b]0;owned\x07\r\nb\u202ec"
SAID = r"a\x1b]0;owned\x07\r\nb\u202ec"
UNSAFE = re.compile("[\x00-\x09\x0b-\x1f\x7f-\x9f\u200b-\u200f\u2028-\u202e\u2066-\u2069]")
posix = pytest.mark.skipif(sys.platform == "win32", reason="devices, pipes and names of POSIX")


def run(*arguments, cwd=None, **options):
    """Status, standard output and standard error of a command as a process, which must not end in a traceback."""
    if not options:
        status, out, err = command_line.run(*map(os.fspath, arguments), cwd=cwd)
        assert "Exception ignored" not in err, err
        return status, out, err
    given = {
        "stdout": subprocess.PIPE,
        "stderr": subprocess.PIPE,
        "stdin": subprocess.DEVNULL,
        "timeout": 120,
        **options,
    }
    done = subprocess.run([*PROGRAM, *map(os.fspath, arguments)], cwd=cwd, check=False, **given)
    err = (done.stderr or b"").decode()
    assert "Traceback" not in err and "Exception ignored" not in err, err
    return done.returncode, (done.stdout or b"").decode(), err


@pytest.fixture(scope="module")
def model():
    return replace(plain_records.plant(4), limits=(-50.0, 250.0))


@pytest.fixture
def folder(tmp_path, model):
    """A model, a voltage and a path to follow."""
    model.save(tmp_path / "model.json")
    (tmp_path / "voltage.csv").write_text("time_s,voltage_V\n0,1\n0.1,2\n0.2,1\n")
    (tmp_path / "path.csv").write_text("time_s,displacement_um\n0,2\n0.1,5\n0.2,3\n")
    return tmp_path


# Recognising


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_the_mark_of_a_table_changes_no_bit(value):
    assert float(marked(repr(value))).hex() == value.hex()
    assert re.fullmatch(r"-?\d+\.\d+e0", marked(repr(value)))


@given(st.lists(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=2, max_size=2), min_size=1))
def test_a_table_of_a_command_is_known_and_a_record_is_not(tmp_path_factory, rows):
    path, (t, v) = tmp_path_factory.mktemp("t") / "a.csv", np.array(rows).T
    write_columns(path, {"time_s": t, "voltage_V": v})
    assert written_by_dehyst(path)
    assert np.array_equal(np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2).T, [t, v])
    with path.open(newline="") as stream:
        assert [[float(cell) for cell in row] for row in list(csv.reader(stream))[1:]] == rows
    path.write_text("time_s,voltage_V\n" + "\n".join(f"{a!r},{b!r}" for a, b in rows))
    assert not written_by_dehyst(path)


def test_other_readers_read_a_marked_table(tmp_path):
    pandas = pytest.importorskip("pandas")
    write_columns(tmp_path / "a.csv", {"time_s": [0.0, 0.1], "voltage_V": [1e-300, 2]})
    table = pandas.read_csv(tmp_path / "a.csv")
    assert list(table.columns) == ["time_s", "voltage_V"] and table["time_s"].tolist() == [0.0, 0.1]


def test_what_dehyst_wrote_is_known_by_its_content(tmp_path, model, monkeypatch):
    monkeypatch.setenv("CC", str(tmp_path / "absent" / "cc"))
    model.save(tmp_path / "model")
    (tmp_path / "report").write_text(document("A title", ["<p>text</p>"]))
    write_columns(tmp_path / "one.tsv", {"voltage_V": [1e16, 2]})
    with pytest.warns(SourceOnlyWarning):
        export_fmu(Compensator(model, (0, 1)), tmp_path / "x.fmu")
    for path in tmp_path.iterdir():
        assert written_by_dehyst(path), path
        demand_replaceable(path)


def test_files_of_others_are_known_too(tmp_path):
    write_record(tmp_path / "record.csv", Record([0, 0.1], [1, 2], [3e-6, 4e-6]))
    write_json(tmp_path / "other.json", {"format": "other", "note": '"format": "dehyst-actuator"'})
    (tmp_path / "page.html").write_text("<!DOCTYPE html>\n<html><body>dehyst</body></html>")
    (tmp_path / "every.csv").write_text("a,b\n0.0e0,1.5e0\n2.5e0,1.0e0\n")
    (tmp_path / "text").write_text("precious")
    (tmp_path / "binary").write_bytes(b"PK\3\4 no archive")
    with zipfile.ZipFile(tmp_path / "other.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", '<fmiModelDescription generationTool="other"/>')
    for path in tmp_path.iterdir():
        before = path.read_bytes()
        with pytest.raises(FileFormatError, match=f"{path.name}: is there already, and dehyst did not write it; give"):
            demand_replaceable(path)
        demand_replaceable(path, force=True)
        assert path.read_bytes() == before


def test_what_holds_nothing_may_be_replaced(tmp_path):
    (tmp_path / "empty").touch()
    demand_replaceable(tmp_path / "empty")
    demand_replaceable(tmp_path / "new")
    demand_replaceable(os.devnull)
    assert (tmp_path / "empty").read_bytes() == b""
    assert not (tmp_path / "new").exists()


def test_a_table_may_go_to_a_device_of_any_name(tmp_path):
    write_columns(os.devnull, {"time_s": [0.0, 1.0]})
    with pytest.raises(FileFormatError, match="text only"):
        write_columns(tmp_path / "table", {"time_s": [0.0, 1.0]})


# Every command


def commands(group=dehyst.cli.registry.main, names=()):
    """Names and object of every command."""
    for name, one in group.commands.items():
        if isinstance(one, click.Group):
            yield from commands(one, (*names, name))
        else:
            yield (*names, name), one


READ = {"records", "validate", "model", "voltage_file", "trajectory", "protocol", "file", "join"}
FOLDERS = {"demo", "paper", "calibrate", "export", "check"}


def writing():
    """Every command with each of its parameters that names a file or a folder and is not known to be read."""
    for names, one in commands():
        for parameter in one.params:
            if isinstance(parameter.type, click.Path) and parameter.name not in READ:
                yield pytest.param(names, one, parameter, id=f"{'-'.join(names)}-{parameter.name}")


def call(names, one, parameter, target):
    """Return arguments with which a command would write to the target if the records that it reads were there."""
    made = []
    for other in one.params:
        if other is parameter or not (other.required or isinstance(other, click.Argument)):
            continue
        value = {"FLOAT": "1", "PATH": f"absent-{other.name}"}.get(other.type.name.upper(), "sim://play")
        made += [value] if isinstance(other, click.Argument) else [other.opts[0], value]
    own = [str(target)] if isinstance(parameter, click.Argument) else [parameter.opts[0], str(target)]
    needs = {"cycle": ["--scan", "triangle"]}.get(parameter.name, [])
    if needs:
        made.remove("absent-trajectory")
    if names == ("insight",) and parameter.name == "output":
        needs = ["--trajectory", "absent-path"]
    if names == ("compensate",) and not needs:
        made = [word for word in made if word != "absent-trajectory"] + ["absent-trajectory"]
    return [*names, *made, *own, *needs]


def test_all_outputs_are_looked_at():
    found = {f"{' '.join(one.values[0])} {one.values[2].name}" for one in writing()}
    assert found >= {
        "identify output",
        "identify report",
        "simulate output",
        "compensate output",
        "compensate cycle",
        "insight output",
        "insight report",
        "compare output",
        "compare report",
        "demo output",
        "paper output",
        "calibrate output",
        "export directory",
        "check history",
        "excite staircase output",
        "excite homing output",
    }


@pytest.mark.parametrize(("names", "one", "parameter"), [one for one in writing() if one.values[0][0] not in FOLDERS])
def test_no_command_replaces_a_file_of_others(tmp_path, monkeypatch, names, one, parameter):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "precious.csv").write_text("mine")
    arguments = call(names, one, parameter, "precious.csv")
    done = CliRunner().invoke(dehyst.cli.registry.main, arguments)
    assert done.exit_code == 2, done.output
    assert "precious.csv: is there already, and dehyst did not write it" in done.stderr
    assert (tmp_path / "precious.csv").read_text() == "mine"
    forced = CliRunner().invoke(dehyst.cli.registry.main, [*arguments, "--force"])
    assert "did not write it" not in forced.stderr and "No such option" not in forced.stderr


@pytest.mark.parametrize(("names", "one", "parameter"), [one for one in writing() if one.values[0][0] in FOLDERS])
def test_no_command_writes_into_a_folder_of_others(folder, monkeypatch, names, one, parameter):
    monkeypatch.chdir(folder)
    target = folder / "precious"
    target.mkdir()
    (target / "report.html").write_text("mine")
    arguments = ["model.json" if word == "absent-model" else word for word in call(names, one, parameter, "precious")]
    done = CliRunner().invoke(dehyst.cli.registry.main, arguments)
    assert done.exit_code == 2, done.output
    assert re.search("holds other files .report.html|report.html: is there already", done.stderr), done.stderr
    assert [path.name for path in target.iterdir()] == ["report.html"]
    assert (target / "report.html").read_text() == "mine"


def test_an_fmu_of_others_is_not_replaced_and_an_own_one_is(folder, monkeypatch):
    monkeypatch.setenv("CC", str(folder / "absent" / "cc"))
    command = ["export", "model.json", "x.fmu", "--fmu", "--limits", "0", "100"]
    (folder / "x.fmu").write_text("mine")
    status, _, err = run(*command, cwd=folder)
    assert status == 2 and "dehyst did not write it" in err and (folder / "x.fmu").read_text() == "mine"
    assert run(*command, "--force", cwd=folder)[0] == 0
    assert zipfile.is_zipfile(folder / "x.fmu")
    assert run(*command, cwd=folder)[0] == 0


def test_own_outputs_are_replaced_without_a_question(folder):
    for command, output in (
        (["excite", "raised-cosine", "10", "-o", "o.csv"], "o.csv"),
        (["simulate", "model.json", "voltage.csv", "-o", "s.csv"], "s.csv"),
        (["compensate", "model.json", "path.csv", "-o", "c.csv"], "c.csv"),
    ):
        assert run(*command, cwd=folder)[0] == 0
        before = (folder / output).read_bytes()
        assert run(*command, cwd=folder)[0] == 0
        assert (folder / output).read_bytes() == before
    # The measured record that looks like what simulate writes.
    (folder / "s.csv").write_text("time_s,voltage_V,displacement_um\n0.0,1.0,2.0\n0.1,2.0,3.0\n")
    status, _, err = run("simulate", "model.json", "voltage.csv", "-o", "s.csv", cwd=folder)
    assert status == 2 and "s.csv: is there already" in err
    assert run("simulate", "model.json", "voltage.csv", "-o", "s.csv", "--force", cwd=folder)[0] == 0
    assert read_table(folder / "s.csv").column("voltage").tolist() == [1, 2, 1]


def test_force_replaces_no_input(folder):
    os.link(folder / "voltage.csv", folder / "link.csv")
    for name in ("voltage.csv", "link.csv"):
        status, _, err = run("simulate", "model.json", "voltage.csv", "-o", name, "--force", cwd=folder)
        assert status == 2 and "is also an input of this command" in err


def test_a_file_that_appears_while_a_command_computes_is_not_replaced(tmp_path, monkeypatch):
    from dehyst.waveforms import standard

    made, output = standard.raised_cosine, tmp_path / "v.csv"
    monkeypatch.setattr(standard, "raised_cosine", lambda *a, **k: output.write_text("mine") and made(*a, **k))
    done = CliRunner().invoke(dehyst.cli.registry.main, ["excite", "raised-cosine", "10", "-o", str(output)])
    assert done.exit_code == 2 and "dehyst did not write it" in done.stderr
    assert output.read_text() == "mine"


# Folders


@pytest.fixture(scope="module")
def journey():
    return demo.run()


def test_demo_writes_into_a_folder_that_is_new_empty_or_its_own(journey, tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty" / ".dehyst-01234567.tmp").write_text("left by a killed process")
    for name in ("new/deep", "empty"):
        for _ in range(2):
            written = demo.write(journey, tmp_path / name, report=False)
        assert all(path.is_file() for path in written)
        assert format_of(tmp_path / name / "demo.json") == "dehyst-demo"
    # One that was not finished.
    for path in (tmp_path / "empty").iterdir():
        if path.name != "demo.json":
            path.unlink()
    demo.write(journey, tmp_path / "empty", report=False)


def test_demo_leaves_other_folders_alone(journey, tmp_path):
    (tmp_path / "loops.csv").write_text("mine")
    with pytest.raises(FileFormatError, match=r"holds other files \(loops.csv\); give the name of a new or an empty"):
        demo.write(journey, tmp_path, report=False)
    assert [path.name for path in tmp_path.iterdir()] == ["loops.csv"]
    status, out, err = run("demo", "-o", tmp_path)
    assert (status, out) == (2, "") and "holds other files (loops.csv)" in err
    with pytest.raises(FileFormatError, match=r"cannot be made a folder \(it is a file\); give another"):
        demand_own_folder(tmp_path / "loops.csv", "demo.json", "dehyst-demo")


# Names and streams


@posix
def test_a_name_of_255_bytes_is_written_and_a_longer_one_refused(tmp_path):
    longest = "µ" * 125 + "x.csv"
    assert len(longest.encode()) == 255
    command = ["excite", "raised-cosine", "10", "-o"]
    for _ in range(2):
        assert run(*command, longest, cwd=tmp_path)[0] == 0
    status, out, err = run(*command, f"x{longest}", cwd=tmp_path)
    assert (status, out) == (2, "")
    assert "File name too long" in err and "give a shorter name" in err and err.count("\n") == 1
    status, _, err = run("simulate", f"x{longest}", "a.csv", "-o", "o.csv", cwd=tmp_path)
    assert status == 2 and err.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == [longest]


FULL = Path("/dev/full")
full = pytest.mark.skipif(not FULL.exists(), reason="there is no /dev/full")
PRINTING = [
    ["--help"],
    ["--version"],
    ["excite", "staircase", "--help"],
    ["excite", "raised-cosine", "10", "-o", "v.csv"],
    ["excite", "raised-cosine", "10", "-o", "v.csv", "--json"],
    ["simulate", "model.json", "voltage.csv", "-o", "o.csv"],
]


@full
@pytest.mark.parametrize("command", PRINTING, ids=" ".join)
def test_a_full_disk_under_standard_output_is_a_sentence(folder, command):
    with FULL.open("wb") as stream:
        status, _, err = run(*command, cwd=folder, stdout=stream)
    assert status == 1
    assert "dehyst: standard output cannot be written (No space left on device)" in err
    if "-o" in command:
        assert (folder / command[command.index("-o") + 1]).is_file()


@posix
@pytest.mark.parametrize("command", PRINTING, ids=" ".join)
def test_a_closed_standard_output_is_a_sentence(folder, command):
    status, _, err = run(*command, cwd=folder, stdout=None, preexec_fn=lambda: os.close(1))
    assert status == 1
    assert "dehyst: standard output cannot be written (Bad file descriptor)" in err
    if "-o" in command:
        assert read_table(folder / command[command.index("-o") + 1]).columns


@posix
@pytest.mark.parametrize("command", PRINTING, ids=" ".join)
def test_a_reader_that_has_gone_is_left_quietly(folder, command):
    read, write = os.pipe()
    os.close(read)
    status, _, err = run(*command, cwd=folder, stdout=write)
    os.close(write)
    assert (status, err) == (1, "")


@full
def test_a_standard_error_that_is_full_or_closed_changes_no_result(folder):
    command = ["compensate", "model.json", "path.csv", "-o", "o.csv", "--limits", "0", "0.5"]
    status, out, err = run(*command, cwd=folder)
    assert status == 1 and "CLAMPED" in err
    with FULL.open("wb") as stream:
        assert run(*command, cwd=folder, stderr=stream)[:2] == (status, out)
        assert run("simulate", "absent", "absent", "-o", "x.csv", cwd=folder, stderr=stream)[0] == 2
        assert run("--wrong", cwd=folder, stderr=stream)[0] == 2
        assert run("--help", stdout=stream, stderr=stream)[0] == 1
    assert run(*command, cwd=folder, stderr=None, preexec_fn=lambda: os.close(2))[:2] == (status, out)


@full
def test_a_full_device_as_output_is_a_sentence(folder):
    (folder / "full.csv").symlink_to(FULL)
    status, out, err = run("excite", "raised-cosine", "10", "-o", "full.csv", cwd=folder)
    assert (status, out) == (2, "")
    assert (
        err == "dehyst: full.csv: cannot be written (No space left on device); make room there, or name a place "
        "that has some\n"
    )
    assert (folder / "full.csv").is_symlink()


def test_ctrl_c_is_a_sentence():
    code = (
        "import os, signal, time, dehyst.studies.demo\n"
        "dehyst.studies.demo.run = lambda tell: os.kill(os.getpid(), signal.SIGINT) or time.sleep(60)\n"
        "from dehyst.cli.registry import main; main()"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, "demo"],
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "dehyst: stopped by Ctrl-C\n")


# What is read as a model


@contextlib.contextmanager
def strangers(folder):
    """Paths that are no files."""
    os.mkfifo(folder / "fifo")
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(os.fspath(folder / "socket"))
        yield ["/dev/zero", "/dev/null", "/dev/stdin", folder / "fifo", folder / "socket"]


@posix
def test_a_model_that_is_no_file_is_refused_at_once(folder, monkeypatch):
    monkeypatch.chdir(folder)
    read, write = os.pipe()
    with strangers(Path()) as paths:
        for path in paths:
            status, out, err = run("simulate", path, "voltage.csv", "-o", "o.csv", stdin=read, timeout=60)
            assert (status, out) == (2, "")
            assert err == f"dehyst: {path}: is a device, a pipe or a socket; give the name of a file\n"
    os.close(read)
    os.close(write)
    status, _, err = run("simulate", folder, "voltage.csv", "-o", "o.csv")
    assert status == 2 and "this is a folder" in err


@posix
def test_every_command_refuses_a_device_as_its_model(folder, monkeypatch):
    monkeypatch.chdir(folder)
    (folder / "r.csv").write_text("time_s,voltage_V,displacement_um\n0,1,1\n1,2,2\n")
    for command in (
        ["compensate", "/dev/zero", "path.csv", "-o", "o.csv"],
        ["insight", "/dev/zero", "r.csv"],
        ["export", "/dev/zero", "c"],
        ["excite", "homing", "--model", "/dev/zero", "-o", "o.csv"],
    ):
        done = CliRunner().invoke(dehyst.cli.registry.main, command)
        assert done.exit_code == 2 and "/dev/zero: is a device, a pipe or a socket" in done.stderr, command


def test_a_model_of_gigabytes_is_refused_by_its_size(folder):
    with (folder / "huge.json").open("wb") as stream:
        stream.truncate(4_000_000_000)
    status, _, err = run("simulate", "huge.json", "voltage.csv", "-o", "o.csv", cwd=folder)
    assert status == 2 and "huge.json: has 4000 MB, need 100 MB at most" in err


# Names


def test_text_is_escaped_where_a_terminal_would_obey_it():
    assert escaped(NASTY) == SAID
    assert escaped(escaped(NASTY)) == escaped(NASTY)
    plain = "Aktor Ä, µm, \u00a0пьезо, 圧電 100 %"
    assert escaped(plain) == plain
    assert escaped("\x9b31m \u2028 \udcff \ufeff") == r"\x9b31m \u2028 \udcff \ufeff"


# Not st.text(): its first draw takes seconds on a cold machine.
@given(st.lists(st.integers(0, 0x10FFFF) | st.integers(0, 0x2100)))
def test_nothing_escaped_is_obeyed(codes):
    text = "".join(map(chr, codes))
    assert not UNSAFE.search(escaped(text)) and "\n" not in escaped(text)
    escaped(text).encode()


def test_errors_are_one_line():
    assert str(FileFormatError(f"{NASTY}: wrong")) == f"{SAID}: wrong"
    assert str(LinkError(NASTY)) == SAID


@pytest.fixture(scope="module")
def loops(tmp_path_factory):
    """The text of a record that a model can be identified from quickly."""
    path = tmp_path_factory.mktemp("loops") / "loops.csv"
    write_record(path, demo.record_loops(dehyst.virtual.PlayActuator(plays=60))[0])
    return path.read_text()


@posix
def test_a_name_that_a_terminal_would_obey_is_escaped_wherever_it_is_shown(tmp_path, loops):
    name = f"{NASTY}.csv"
    (tmp_path / name).write_text(loops)
    quick = ["--structure", "paper", "--norm", "l2", "--elements", "6"]
    status, out, err = run("identify", name, "-o", "m.json", "--report", "r.html", *quick, cwd=tmp_path)
    assert status == 0
    assert SAID in out and not UNSAFE.search(out + err)
    page = (tmp_path / "r.html").read_text()
    assert SAID in page and not UNSAFE.search(page)
    status, out, err = run("identify", f"{NASTY} absent.csv", cwd=tmp_path)
    assert status == 2 and err.count("\n") == 1 and not UNSAFE.search(err)
    status, out, err = run("identify", "--\x1b[31m", cwd=tmp_path)
    assert status == 2 and not UNSAFE.search(err)


@posix
def test_a_model_with_such_a_name_is_escaped_in_every_output(tmp_path, loops, model):
    given = json.loads(json.dumps(model.as_dict()))
    given["name"], given["provenance"] = NASTY, {"source": NASTY, "outcome": NASTY}
    write_json(tmp_path / "m.json", given)
    (tmp_path / "voltage.csv").write_text("time_s,voltage_V\n0,1\n0.1,2\n0.2,1\n")
    (tmp_path / "loops.csv").write_text(loops)
    for command in (
        ["simulate", "m.json", "voltage.csv", "-o", "s.csv"],
        ["insight", "m.json", "loops.csv", "--repeats", "0", "--report", "i.html"],
        ["export", "m.json", "c", "--no-measure", "--limits", "0", "100"],
        ["export", "m.json", "x.fmu", "--fmu", "--limits", "0", "100"],
    ):
        status, out, err = run(*command, cwd=tmp_path)
        assert status in (0, 1), err
        assert not UNSAFE.search(out + err), command
    for path in (*(tmp_path / "c").iterdir(), tmp_path / "i.html"):
        # A Makefile needs its tabs.
        assert not UNSAFE.search(path.read_text().replace("\t", " ")), path
    with zipfile.ZipFile(tmp_path / "x.fmu") as archive:
        text = archive.read("modelDescription.xml").decode()
    assert ElementTree.fromstring(text).get("modelName") and not UNSAFE.search(text)


@pytest.mark.skipif(sys.platform != "linux", reason="names of any bytes")
def test_names_that_are_no_utf8_and_streams_of_ascii(tmp_path, loops):
    name = os.fsdecode(b"caf\xe9 \xc2\xb5.csv")
    (tmp_path / name).write_text(loops)
    quick = ["--structure", "paper", "--norm", "l2", "--elements", "6", "-o", "m.json", "--report", "r.html"]
    ascii_only = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "PYTHONIOENCODING": "ascii"}
    for more in ({}, ascii_only):
        status, out, err = run("identify", name, *quick, cwd=tmp_path, env={**os.environ, **more})
        assert status == 0 and r"caf\udce9" in out, err
        assert r"caf\udce9" in (tmp_path / "r.html").read_text()
        assert out.isascii() or not more
        assert run("identify", f"absent {name}", cwd=tmp_path, env={**os.environ, **more})[0] == 2


def test_commands_print_by_one_door():
    source = Path(dehyst.cli.registry.__file__).parent
    paths = sorted(set(source.glob("*.py")) - {source / "terminal.py", source / "live.py"})
    assert len(paths) > 8
    for path in paths:
        assert not re.search(r"click\.s?echo|\bprint\(|sys\.std(out|err)\.write", path.read_text()), path.name


def test_a_dash_is_no_name_of_an_output(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "loops.csv").write_text("time_s,voltage_V,displacement_um\n0,0,0\n1,1,1\n")
    done = CliRunner().invoke(dehyst.cli.registry.main, ["identify", "loops.csv", "-o", "-"])
    assert done.exit_code == 2
    assert "-: is no name of a file" in done.stderr
    assert not (tmp_path / "-").exists()
