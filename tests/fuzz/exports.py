"""Exports of random compensators, compiled under sanitizers and given hostile numbers, 20 000 calls each."""

import shutil
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "support")]

import batches
import numpy as np
import specimens
from compiled_exports import STRICT
from sanitized import SANITIZE

from dehyst import DehystError
from dehyst.exports.firmware import SOURCES, code

STEPS = 20_000


def missing():
    """What is not installed that this fuzzer needs, or nothing."""
    return None if shutil.which("gcc") else "gcc"


def play(seed, case, note, steps=STEPS):
    """One export, in double or float."""
    rng = np.random.default_rng([seed, case])
    number, kind = str(rng.choice(["double", "float"])), str(rng.choice(specimens.KINDS))
    try:
        compensator = specimens.random_compensator(rng, kind)
        files = code(compensator, number)
    except DehystError:
        note("refused at once")
        return []
    note(f"{kind}, {number}")
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name, text in files.items():
            (Path(folder) / name).write_text(text)
        shutil.copy(HERE / "exports.c", folder)
        change = compensator._tables()["loop"][2]
        span = np.ptp(compensator.actuator.spring.displacement)
        defines = [f"-DCHANGE={float(change)!r}", f"-DSPAN={float(span)!r}"]
        built = _run(
            ["gcc", *STRICT, "-O1", *SANITIZE, *defines, "exports.c", *SOURCES, "-lm", "-o", "exports"], folder
        )
        if built.returncode:
            return [f"does not compile: {built.stderr[-1500:]}"]
        done = _run(["./exports", str(seed * 1_000_003 + case), str(steps)], folder)
    for _ in range(steps // 1000):
        note("thousands of calls")
    if done.returncode:
        return [f"{kind}, {number}, status {done.returncode}: {done.stdout[-300:]}{done.stderr[-1500:]}"]
    return []


def _run(command, folder):
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=600)


if __name__ == "__main__":
    batches.main("exports", play)
