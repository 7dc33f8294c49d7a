"""An identification that is stopped: what is on the disk, what is printed, and the exit status."""

import json
import os
import signal
import subprocess
import sys

import pytest
from command_line import TIMEOUT, run
from virtual_loops import record_loops

from dehyst import Actuator
from dehyst.cli import terminal
from dehyst.records import write_record

posix = pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
# Trials take long here, so that a test can stop between them.
SLOW = """
import signal, sys, time
from dehyst.identification import search
# A shell's background job ignores Ctrl-C.
signal.signal(signal.SIGINT, signal.default_int_handler)
trial = search.fitted

def slow(*arguments):
    made = trial(*arguments)
    print("a trial has ended", file=sys.stderr, flush=True)
    time.sleep({seconds})
    return made

search.fitted = slow
from dehyst.cli import main; main()
"""


@pytest.fixture
def folder(tmp_path):
    write_record(tmp_path / "loops.csv", record_loops()[0])
    return tmp_path


def started(folder, *arguments, seconds=1.0):
    """A process that identifies, once its first trial has ended."""
    process = subprocess.Popen(
        [sys.executable, "-c", SLOW.format(seconds=seconds), "identify", "loops.csv", "-o", "m.json", *arguments],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert any("a trial has ended" in line for line in process.stderr)
    return process


@posix
def test_ctrl_c_leaves_the_best_model_so_far(folder):
    process = started(folder, "--report", "r.html", "--json")
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=TIMEOUT)
    assert process.returncode == 1, err
    # A slow machine shows progress between the two.
    lines = err.splitlines()
    assert "dehyst: Ctrl-C: completing the best model so far; press it again to stop at once" in lines
    assert lines[-1] == "dehyst: stopped by Ctrl-C; the best model so far is in m.json"
    remark = json.loads(out)["remarks"][0]
    assert remark.startswith("Ctrl-C ended ") and "the model is the best so far" in remark
    assert "Ctrl-C ended" in (folder / "r.html").read_text()
    assert Actuator.load(folder / "m.json").identification.outcome is not None


@posix
def test_a_second_ctrl_c_stops_at_once(folder):
    process = started(folder)
    process.send_signal(signal.SIGINT)
    line = process.stderr.readline()
    assert "press it again" in line
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=TIMEOUT)
    assert process.returncode == 130
    assert err.splitlines()[-1] == "dehyst: stopped by Ctrl-C"
    assert [path.name for path in folder.iterdir()] == ["loops.csv"]


@posix
def test_a_killed_process_leaves_nothing(folder):
    process = started(folder)
    process.kill()
    process.communicate(timeout=TIMEOUT)
    assert process.returncode == -signal.SIGKILL
    assert [path.name for path in folder.iterdir()] == ["loops.csv"]


def test_a_time_limit_ends_the_search(folder):
    status, out, err = run("identify", "loops.csv", "-o", "m.json", "--time-limit", "0.01", cwd=folder)
    assert status == 0, err
    assert "limit of 0.01 s ended" in out


def test_progress_without_a_terminal_is_a_line_every_few_seconds(monkeypatch, capfd):
    now = [0.0]
    monkeypatch.setattr(terminal.time, "monotonic", lambda: now[0])
    progress = terminal.progress_line()
    for second in range(12):
        now[0] = float(second)
        progress(f"trial {second}")
    progress("")
    assert capfd.readouterr().err == "dehyst: trial 5\ndehyst: trial 10\n"


def test_progress_on_a_terminal_stays_on_one_line(monkeypatch, capfd):
    monkeypatch.setattr(terminal.sys.stderr, "isatty", lambda: True, raising=False)
    monkeypatch.setenv("COLUMNS", "40")
    progress = terminal.progress_line()
    progress("trial 7 (of up to 18): 20 elements and 9 creep branches; 3 s so far")
    progress("short")
    long, short = capfd.readouterr().err.split("\r\033[K")[1:]
    assert long.startswith("trial 7 (of up") and len(long) < 40
    assert short == "short ..."
