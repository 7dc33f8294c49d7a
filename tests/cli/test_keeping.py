"""An identification that is stopped: what is on the disk, what is printed, and the exit status."""

import json
import os
import signal
import subprocess
import sys
import time

import plain_records
import pytest
from command_line import TIMEOUT, run
from virtual_loops import record_loops

import dehyst
from dehyst import Actuator
from dehyst.cli import command, terminal
from dehyst.identification import Deadline
from dehyst.operations.identify import _BestSoFar as BestSoFar
from dehyst.records import read, write_record

posix = pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
# Trials take long here, so that a test can stop between them.
SLOW = """
import signal, time
from dehyst.identification import search
# A shell's background job ignores Ctrl-C.
signal.signal(signal.SIGINT, signal.default_int_handler)
trial = search.fitted

def slow(*arguments):
    made = trial(*arguments)
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
    """A process that identifies, once the first model is on the disk."""
    process = subprocess.Popen(
        [sys.executable, "-c", SLOW.format(seconds=seconds), "identify", "loops.csv", "-o", "m.json", *arguments],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    until = time.monotonic() + TIMEOUT
    while not (folder / "m.json").exists():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < until
        time.sleep(0.01)
    return process


def is_provisional(folder):
    return Actuator.load(folder / "m.json").identification.provisional


@posix
def test_ctrl_c_leaves_the_best_model_so_far(folder):
    process = started(folder, "--report", "r.html", "--json")
    time.sleep(1.5)
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
    assert not is_provisional(folder)
    status, _, err = run("simulate", "m.json", "loops.csv", "-o", "s.csv", cwd=folder)
    assert (status, "provisional" in err) == (0, False)


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
    assert is_provisional(folder)


@posix
def test_ctrl_c_while_the_first_model_is_written_ends_the_search_only(tmp_path, monkeypatch, capfd):
    output, deadline = tmp_path / "m.json", Deadline(None)
    best, actuator = BestSoFar(output), plain_records.plant(4)
    save = Actuator.save

    def interrupted(self, path):
        save(self, path)
        os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(Actuator, "save", interrupted)
    with command.TerminalRun().ended_by(lambda: deadline.end("Ctrl-C"), lambda: best.usable):
        best.keep(actuator)
    assert deadline.ended
    assert output.exists()
    assert "press it again" in capfd.readouterr().err


@posix
def test_a_killed_process_leaves_a_provisional_model(folder):
    process = started(folder)
    process.kill()
    process.communicate(timeout=TIMEOUT)
    assert process.returncode == -signal.SIGKILL
    assert is_provisional(folder)
    status, _, err = run("simulate", "m.json", "loops.csv", "-o", "s.csv", cwd=folder)
    assert status == 0
    assert "m.json: is provisional" in err
    # The next identification replaces it.
    assert run("identify", "loops.csv", "-o", "m.json", "--time-limit", "0.01", cwd=folder)[0] == 0
    assert not is_provisional(folder)


def test_a_time_limit_ends_the_search(folder):
    status, out, err = run("identify", "loops.csv", "-o", "m.json", "--time-limit", "0.01", cwd=folder)
    assert status == 0, err
    assert "limit of 0.01 s ended" in out
    assert not is_provisional(folder)


def test_a_finished_model_stays_until_the_new_one_is_finished(folder):
    first = []
    fit = dehyst.identify(read(folder / "loops.csv"), structure="maxwell_slip", first_model=first.append)
    fit.actuator.save(folder / "m.json")
    best = BestSoFar(folder / "m.json")
    best.keep(first[0])
    assert not is_provisional(folder)
    best.remove()
    assert not is_provisional(folder)


def test_after_an_error_there_is_no_model(folder):
    """Status 2 is promised to write nothing."""
    code = (
        "import dehyst.identification.search as search\n"
        "from dehyst import IdentifyError\n"
        "def fails(*_):\n"
        "    from pathlib import Path\n"
        "    assert Path('m.json').exists()\n"
        "    raise IdentifyError('no way')\n"
        "search.static = fails\n"
        "from dehyst.cli import main; main()"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, "identify", "loops.csv", "-o", "m.json"],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=TIMEOUT,
        check=False,
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.endswith("dehyst: no way\n")
    assert not (folder / "m.json").exists()


def test_progress_beside_a_terminal_is_a_line_every_few_seconds(monkeypatch, capfd):
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
