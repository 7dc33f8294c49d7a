"""Hostile and damaged text, pipes and numbers: nothing hangs, and no memory is taken."""

import os
import re
import resource
import time as clock

import numpy as np
import places
import pytest

import dehyst
from dehyst._errors import FileFormatError, RecordError
from dehyst.records import Record, read

N = 200
T = np.arange(N) * 1e-3
V = np.abs(50.0 - np.arange(N) % 100)
Y = V * 1e-7
NAMED = {"time_s": T, "voltage_V": V, "displacement_um": Y * 1e6}
HEAD = "time_s,voltage_V,displacement_um"
BODY = "\n".join(",".join(map(repr, row)) for row in zip(*(x.tolist() for x in NAMED.values()), strict=True)) + "\n"
SECONDS = 3.0
# Memory that a refusal may take: with the libraries, less than any of the files declares.
KILOBYTES = 400_000


def refused(path, match, columns=None):
    """Refuse a file quickly, and before memory is taken."""
    began, peak = clock.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(FileFormatError, match=match):
        read(path, columns)
    assert clock.process_time() - began < SECONDS
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak < KILOBYTES


def text(tmp_path, content, name="a.csv"):
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


# For ever


@pytest.mark.parametrize(
    "content",
    [
        "time_s," + "x" * 2_000_000 + "\n1,2\n",
        HEAD + "\n" + "1" * 3_000_000,
        '"' * 2_000_000 + "\n" + BODY,
        "#" * 5_000_000,
    ],
)
def test_endless_lines(tmp_path, content):
    refused(text(tmp_path, content), r"row \d is longer than 1000000 characters")


RUNS = [mark * 20_000 for mark in (" ", "_", "[", "(", "]", "\t", " _", "[ ", "]]", ") ")]


@pytest.mark.parametrize("run", RUNS, ids=lambda run: repr(run[:2]))
def test_hostile_cells_take_no_time(tmp_path, run):
    began = clock.process_time()
    for content in (
        f"{HEAD},x [{run}y\n" + BODY.replace("\n", ",0\n"),
        f"time_s voltage_V{run}x\n1 2\n",
        f"{HEAD},{run}\n" + BODY.replace("\n", f",{run}\n", 3),
        f"{HEAD}\n{run}\n{run}%\n{BODY}",
        f"{HEAD}\n" + "\n".join([run] * 20) + "%",
    ):
        try:
            read(text(tmp_path, content))
        except dehyst.DehystError as error:
            assert len(str(error)) < 3000  # a message is read by a person
    assert clock.process_time() - began < SECONDS


def test_many_blank_lines_before_a_comment(tmp_path):
    began = clock.process_time()
    assert len(read(text(tmp_path, f"{HEAD}\n{BODY}" + "\n" * 200_000 + "% end\n"))) == N
    assert clock.process_time() - began < SECONDS


@pytest.mark.parametrize("cell", ["5_0", "\u0665\u0660", "\u22125"])
def test_numbers_that_only_python_writes(tmp_path, cell):
    refused(text(tmp_path, f"{HEAD}\n{BODY.replace('50.0', cell, 1)}"), f"row 2 holds '{cell}', which is no number")


# Once


@pytest.mark.parametrize("device", ["/dev/zero", "/dev/null", "/dev/random"])
def test_devices_are_refused(tmp_path, device):
    (tmp_path / "a.csv").symlink_to(device)
    refused(tmp_path / "a.csv", r"a\.csv: is a device, a pipe or a socket")


def test_a_pipe_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "a.csv")
    refused(tmp_path / "a.csv", r"a\.csv: is a device, a pipe or a socket")


# Numbers


@pytest.mark.parametrize("column", ["time", "voltage", "displacement"])
@pytest.mark.parametrize("value", [1e308, -1e308, 1e200, 1e31])
def test_numbers_that_are_no_measurement(column, value):
    columns = {"time": T.copy(), "voltage": V.copy(), "displacement": Y.copy()}
    at = 0 if column == "time" and value < 0 else N - 1
    columns[column][at] = value
    unit = {"time": "s", "voltage": "V", "displacement": "m"}[column]
    with pytest.raises(
        RecordError, match=rf"'r': {column}\[{at}\] = {re.escape(f'{value:.6g}')} {unit} is no {column}"
    ):
        Record(**columns, name="r")
    columns[column][at] = value / abs(value) * 1e30
    record = Record(**columns)
    record.problems(), record.cycles(), repr(record)


def test_times_that_no_clock_tells_apart():
    time = T.copy()
    time[1] = 5e-324
    with pytest.raises(RecordError, match=r"steps of 4.94e-324 s"):
        Record(time, V, Y)


def test_a_stroke_below_a_nucleus_is_constant():
    with pytest.raises(RecordError, match="is constant"):
        Record(T, V, Y * 1e-200).check_usable()


# By dice


def test_mutated_files(monkeypatch):
    """A small share of `python tests/fuzz/files.py`."""
    monkeypatch.syspath_prepend(places.FUZZ)
    import files

    found = files.attack(seed=14, count=400)
    assert found["cases"] == 400
    assert found["findings"] == []
    assert found["counts"]["prepared"] > 20


@pytest.mark.fuzz
def test_ten_thousand_mutated_files(monkeypatch):
    monkeypatch.syspath_prepend(places.FUZZ)
    import files

    assert files.attack(seed=1, count=10_000)["findings"] == []
