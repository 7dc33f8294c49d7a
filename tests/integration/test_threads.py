"""BLAS runs on one thread while dehyst solves, whichever library it comes from and whoever asks first."""

import json
import os
import subprocess
import sys

import places
import pytest

from examples import at_night

# Looks at every BLAS library from inside the solvers, whenever a function of linear algebra is called.
WATCH = """
import json, sys, time
import numpy as np, threadpoolctl
most, looks = {}, 0

def look():
    global looks
    for library in threadpoolctl.threadpool_info():
        if library["user_api"] == "blas":
            name = library["filepath"].rsplit("/", 1)[1]
            most[name] = max(most.get(name, 0), library["num_threads"])
    looks += 1

def watch(frame, event, _, last=[0.0]):
    path = frame.f_code.co_filename
    solver = event == "call" and ("/linalg/" in path or "/scipy/optimize/" in path)
    if solver and time.monotonic() - last[0] > 0.02 and not importing(frame):
        look()
        last[0] = time.monotonic()

def importing(frame):
    while frame and "importlib" not in frame.f_code.co_filename:
        frame = frame.f_back
    return frame is not None

import plain_records, dehyst
%s
sys.setprofile(watch)
%s
sys.setprofile(None)
print(json.dumps({"looks": looks, "threads": most}))
"""
SETUP = """
from dehyst.trust.comparison import compare, contenders
from dehyst.trust import insight
from dehyst import Structure
from dehyst.operations import demo
actuator = plain_records.plant(6)
record = plain_records.loops(actuator, plain_records.DESCENDING_TOPS)
"""
SOLVERS = {
    "a structure": "dehyst.identify(record, structure=Structure(elements=8, knots=9, transformer=4))",
    "plain, insight": "insight(dehyst.identify(record, structure='maxwell_slip').actuator, record)",
    "compare": "compare(record, models={'linear': contenders()['linear ratio'], 'ours': contenders()['dehyst']})",
}
FREE = {key: value for key, value in os.environ.items() if not key.endswith("_NUM_THREADS")}


def answer(program):
    """What a fresh process prints that is free to use as many threads as it likes."""
    done = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        timeout=300,
        env={**FREE, "PYTHONPATH": str(places.SUPPORT)},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.skipif(os.cpu_count() == 1, reason="one processor: BLAS has one thread without a limit, too")
@pytest.mark.parametrize("solver", ["a structure", at_night("plain, insight"), at_night("compare")])
def test_every_blas_library_has_one_thread_inside_a_solver(solver):
    seen = answer(WATCH % (SETUP, SOLVERS[solver]))
    assert seen["looks"] > 5
    assert len(seen["threads"]) >= 2, "NumPy's and SciPy's own"
    assert set(seen["threads"].values()) == {1}


COUNTS = """
import json, threading
import scipy.linalg, threadpoolctl
from dehyst._threads import one_thread
counts = lambda: sorted(library["num_threads"] for library in threadpoolctl.threadpool_info())
seen = [counts()]
first, second = one_thread(), one_thread()
with one_thread():
    with one_thread():
        seen.append(counts())
    seen.append(counts())
seen.append(counts())
first.__enter__()
second.__enter__()
first.__exit__(None, None, None)
seen.append(counts())
second.__exit__(None, None, None)
seen.append(counts())
try:
    with one_thread():
        raise ValueError
except ValueError:
    seen.append(counts())
print(json.dumps(seen))
"""


def test_the_limit_holds_until_the_last_solver_has_ended_or_failed():
    before, nested, outer, after, overlapping, finally_, failed = answer(COUNTS)
    assert set(nested) == set(outer) == set(overlapping) == {1}
    assert before == after == finally_ == failed
