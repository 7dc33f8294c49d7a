"""Seconds of least absolute deviations at size: 1e5 rows, 60 and 100 columns, without and with 200 inequalities.

Columns are random numbers, or what slip elements and a spring do along swept loops; the inequalities hold the
coefficients far from what the rows ask for. One thread; the gap is over all rows. Writes `solver.json`.
"""

import json
import os
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import scipy.linalg
import scipy.optimize  # noqa: F401

from dehyst._native import slip_elongations
from dehyst._threads import one_thread
from dehyst.identification.solvers.program import solve
from dehyst.model.elements import parts_in_segments

ROWS = 100_000
SEEDS = 3
TARGET = {"seconds": 2.0, "gap": 1e-6}


def columns(kind: str, count: int, rng: np.random.Generator) -> np.ndarray:
    if kind == "random":
        return rng.normal(size=(ROWS, count))
    t, elements = np.linspace(0, 1, ROWS), count // 2
    y = (0.5 - 0.5 * np.cos(2 * np.pi * 60 * t)) * (1 - 0.8 * t) + 1e-4 * rng.normal(size=ROWS)
    slip, _ = slip_elongations(0.5 / elements * np.arange(1, elements + 1), np.zeros(elements), y)
    return np.hstack([slip, parts_in_segments(np.linspace(0, 1, count - elements + 1), y)])


def measure(kind: str, count: int, inequalities: int, noise: float, seed: int) -> dict[str, object]:
    rng = np.random.default_rng([seed, count, inequalities])
    a = columns(kind, count, rng)
    b = 0.3 + a @ rng.uniform(0, 1, count)
    b += noise * np.abs(b).mean() * rng.standard_t(2, ROWS)
    c = rng.normal(size=(inequalities, count))
    lower = c @ np.full(count, 0.5) - 0.3 * np.abs(rng.normal(size=inequalities))
    begun, used = time.perf_counter(), time.process_time()
    found = solve(np.ones((ROWS, 1)), a, b, norm="l1", constraints=(c, lower) if inequalities else None)
    return {
        "columns": f"{kind}, {count}",
        "inequalities": inequalities,
        "noise": noise,
        "seed": seed,
        "seconds": round(time.perf_counter() - begun, 2),
        "cpu_seconds": round(time.process_time() - used, 2),
        "gap": found.gap,
        "status": found.status,
    }


def main() -> None:
    found = []
    with one_thread():
        for kind in ("random", "slip elements and spring"):
            for count in (60, 100):
                for inequalities, noise in ((0, 0.1), (0, 1e-3), (200, 0.1), (200, 1e-3)):
                    for seed in range(SEEDS):
                        found.append(measure(kind, count, inequalities, noise, seed))
                        print(found[-1], flush=True)
    summary = {
        "largest_seconds": max(row["seconds"] for row in found),
        "largest_cpu_seconds": max(row["cpu_seconds"] for row in found),
        "largest_gap": max(row["gap"] for row in found),
        "target": TARGET,
    }
    print(summary)
    Path(__file__).with_suffix(".json").write_text(json.dumps({"summary": summary, "rows": found}, indent=1) + "\n")


if __name__ == "__main__":
    main()
