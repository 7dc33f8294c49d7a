"""Time of a step of Python's `Compensator.step`, of the exported C, and of a run per sample; N = 10, 21 knots.

Ratios are to `numpy.interp` per sample on the same path in the same run. Two paths: the first reverses at every step,
with branches of random lengths; the second is swept slowly. A clock around single steps also measures other work of the
machine: the time of the clock alone is measured too. Writes `latency.json`.
"""

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from speed import KNOTS, VOLTAGES, actuator, creep, transformer

from dehyst import Actuator, Compensator
from dehyst.exports import export

OUTPUT = Path(__file__).parent / "latency.json"
SAMPLES, REPEATS, C_STEPS = 200_000, 15, 10_000_000
LOW, HIGH = 0.02, 0.98
QUANTILES = ("median", "one_in_100", "one_in_10000", "worst")


def models() -> dict[str, Actuator]:
    return {
        "plain": actuator(10),
        "with transformer and 8 creep": replace(actuator(10), transformer=transformer(), displacement_creep=creep()),
    }


def paths() -> dict[str, np.ndarray]:
    u = np.random.default_rng(1).random(SAMPLES)
    side = np.where(np.arange(SAMPLES) % 2, 1.0, -1.0)
    swept = np.interp(np.arange(SAMPLES) % 20000, [0, 10000, 20000], [LOW, HIGH, LOW])
    return {"reversing": 0.5 + 0.5 * (HIGH - LOW) * side * u, "swept": swept}


def timed(job: Callable[[], object]) -> float:
    """Nanoseconds a sample, by the processor's time: the median of repeats."""
    found = []
    for _ in range(REPEATS):
        begin = time.thread_time()
        job()
        found.append(1e9 * (time.thread_time() - begin) / SAMPLES)
    return statistics.median(found)


def stepped(compensator: Compensator, path: list[float]) -> None:
    step = compensator.step
    for y in path:
        step(y)


def in_python(model: Actuator, path: np.ndarray) -> dict[str, float]:
    compensator = Compensator(model, (-10.0, 10.0), period=1e-3)
    one_by_one = path.tolist()
    return {
        "interp_ns": timed(lambda: np.interp(path, KNOTS, VOLTAGES)),
        "run_ns": timed(lambda: compensator.run(path)),
        "step_ns": timed(lambda: stepped(compensator, one_by_one)),
    }


def in_c(model: Actuator) -> dict[str, dict[str, float]]:
    """Time [ns] of a step of the exported files, built by the system's compiler."""
    with tempfile.TemporaryDirectory() as folder:
        where = export(Compensator(model, (-10.0, 10.0), period=1e-3), Path(folder) / "c")
        sources = sorted(path for path in where.glob("*.c") if path.name != "check.c")
        flags = ["-std=c99", "-D_POSIX_C_SOURCE=199309L", "-O3", "-ffp-contract=off", f"-I{where}"]
        program = Path(folder) / "latency"
        subprocess.run(["cc", *flags, Path(__file__).with_suffix(".c"), *sources, "-o", program], check=True)
        arguments = [program, str(LOW), str(HIGH), str(C_STEPS)]
        said = subprocess.run(arguments, check=True, capture_output=True, text=True).stdout
    lines = (line.split() for line in said.splitlines())
    return {name: dict(zip(QUANTILES, map(float, values), strict=True)) for name, *values in lines}


def main() -> None:
    result = {}
    for name, model in models().items():
        found = {path: in_python(model, values) for path, values in paths().items()}
        c = in_c(model)
        for path, times in found.items():
            times["c_step_ns"] = c[path]["median"]
            times["c_ratio"] = times["c_step_ns"] / times["interp_ns"]
            times["run_ratio"] = times["run_ns"] / times["interp_ns"]
            print(f"{name}, {path}: " + ", ".join(f"{key} {value:.1f}" for key, value in times.items()))
        print(
            f"  single steps in C, of {C_STEPS:.0e}: {c['single']}; of the clock alone: {c['clock']}", file=sys.stderr
        )
        result[name] = {"paths": found, "c": c}
    OUTPUT.write_text(json.dumps({"steps_in_c": C_STEPS, **result}, indent=1) + "\n")


if __name__ == "__main__":
    main()
