"""Streams, devices and long names: a command ends with a sentence, never with a traceback."""

import contextlib
import os
import re
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import run_as_process as run

import dehyst.cli.commands
import dehyst.operations

posix = pytest.mark.skipif(sys.platform == "win32", reason="devices, pipes and names of POSIX")


FULL = Path("/dev/full")
full = pytest.mark.skipif(not FULL.exists(), reason="there is no /dev/full")
PRINTING = [["--help"], ["excite", "raised-cosine", "10", "-o", "v.csv", "--json"]]


@full
@pytest.mark.parametrize("command", PRINTING, ids=" ".join)
def test_a_full_disk_for_standard_output_is_reported(folder, command):
    with FULL.open("wb") as stream:
        status, _, err = run(*command, cwd=folder, stdout=stream)
    assert status == 1
    assert "dehyst: standard output cannot be written (No space left on device)" in err
    if "-o" in command:
        assert (folder / command[command.index("-o") + 1]).is_file()


@posix
@pytest.mark.parametrize("command", PRINTING, ids=" ".join)
def test_a_closed_pipe_ends_the_command_silently(folder, command):
    read, write = os.pipe()
    os.close(read)
    status, _, err = run(*command, cwd=folder, stdout=write)
    os.close(write)
    assert (status, err) == (1, "")


@full
def test_a_full_or_closed_standard_error_does_not_change_the_result(folder):
    command = ["compensate", "model.json", "path.csv", "-o", "o.csv", "--limits", "0", "0.5", "--force"]
    status, out, err = run(*command, cwd=folder)
    assert status == 1 and "CLAMPED" in err
    with FULL.open("wb") as stream:
        assert run(*command, cwd=folder, stderr=stream)[:2] == (status, out)
        assert run("simulate", "absent", "absent", "-o", "x.csv", cwd=folder, stderr=stream)[0] == 2
    assert run(*command, cwd=folder, stderr=None, preexec_fn=lambda: os.close(2))[:2] == (status, out)


@full
def test_a_full_device_as_output_is_reported(folder):
    (folder / "full.csv").symlink_to(FULL)
    status, out, err = run("excite", "raised-cosine", "10", "-o", "full.csv", cwd=folder)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert "full.csv: cannot be written (No space left on device)" in err
    assert (folder / "full.csv").is_symlink()


# Modules whose loading is interrupted: of the command line, of the command, and none, so that it runs.
@pytest.mark.parametrize("module", ["click", "dehyst.cli.command", "numpy", "its work"])
def test_ctrl_c_is_reported(module, tmp_path):
    stop = "os.kill(os.getpid(), signal.SIGINT) or time.sleep(60)"
    code = (
        f"import builtins, os, signal, sys, time, types\nload, work = builtins.__import__, {module == 'its work'}\n"
        f"builtins.__import__ = lambda name, *rest: {stop} if name == {module!r} else load(name, *rest)\n"
        f"if work: import dehyst.operations.demo as demo; demo.journey = lambda tell: {stop}\n"
        "from dehyst.cli import main; main()"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, "demo"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "dehyst: stopped by Ctrl-C\n")


# Standard input as a model


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


def test_a_model_of_gigabytes_is_refused_by_its_size(folder):
    with (folder / "huge.json").open("wb") as stream:
        stream.truncate(4_000_000_000)
    status, _, err = run("simulate", "huge.json", "voltage.csv", "-o", "o.csv", cwd=folder)
    assert status == 2 and "has 4000 MB" in err


def test_only_one_module_prints():
    rooms = Path(dehyst.cli.commands.__file__).parent, Path(dehyst.operations.__file__).parent
    paths = {path for room in rooms for path in room.glob("*.py")} - {rooms[0] / "terminal.py"}
    assert len(paths) > 8
    for path in paths:
        assert not re.search(r"click\.s?echo|\bprint\(|sys\.std(out|err)\.write", path.read_text()), path.name
