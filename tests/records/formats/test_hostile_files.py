"""Hostile and damaged text and numbers: nothing hangs."""

import re
import time as clock

import numpy as np
import places
import pytest
from laboratory_files import text

import dehyst
from dehyst._errors import RecordError
from dehyst.records import Record, read
from examples import at_night

N = 200
T = np.arange(N) * 1e-3
V = np.abs(50.0 - np.arange(N) % 100)
Y = V * 1e-7
NAMED = {"time_s": T, "voltage_V": V, "displacement_um": Y * 1e6}
HEAD = "time_s,voltage_V,displacement_um"
BODY = "\n".join(",".join(map(repr, row)) for row in zip(*(x.tolist() for x in NAMED.values()), strict=True)) + "\n"
SECONDS = 3.0


RUNS = [mark * 20_000 for mark in (" ", "_", "[", "(", "]", "\t", " _", "[ ", "]]", ") ", "\n" * 10)]


@pytest.mark.parametrize("run", RUNS, ids=lambda run: repr(run[:2]))
def test_hostile_cells_are_read_fast(tmp_path, run):
    began = clock.process_time()
    for content in (
        f"{HEAD},x [{run}y\n" + BODY.replace("\n", ",0\n"),
        f"time_s voltage_V{run}x\n1 2\n",
        f"{HEAD},{run}\n" + BODY.replace("\n", f",{run}\n", 3),
        f"{HEAD}\n{run}\n{run}%\n{BODY}",
        f"{HEAD}\n" + "\n".join([run] * 20) + "%",
        f"{HEAD}\n{BODY}{run}% end\n",
    ):
        try:
            count = len(read(text(tmp_path, content)))
        except dehyst.DehystError as error:
            assert len(str(error)) < 3000  # a message is read by a person
            count = 0
    assert clock.process_time() - began < SECONDS
    # Blank lines before a comment.
    assert run.strip() or "\n" not in run or count == N


@pytest.mark.parametrize("column", ["time", "voltage", "displacement"])
@pytest.mark.parametrize("value", [1e308, -1e308, 1e200, 1e31])
def test_implausible_numbers_are_refused(column, value):
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


def test_implausibly_short_time_steps_are_refused():
    time = T.copy()
    time[1] = 5e-324
    with pytest.raises(RecordError, match=r"steps of 4.94e-324 s"):
        Record(time, V, Y)


@pytest.mark.parametrize("count", [120, at_night(1000), pytest.param(10_000, marks=pytest.mark.fuzz)])
def test_mutated_files_are_read_or_refused(monkeypatch, count):
    monkeypatch.syspath_prepend(places.FUZZ)
    import files

    found = files.attack(seed=14, count=count)
    assert found["cases"] == count
    assert found["findings"] == []
    assert found["counts"]["prepared"] > count / 20
