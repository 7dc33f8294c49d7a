"""How long a record may be: seconds, memory and duality gap of `dehyst.identify` for 1e5, 1e6 and 1e7 samples.

Each size runs in a process of its own, whose peak memory counts above what the imports took: the record is in it.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from pathlib import Path

import highspy  # noqa: F401
import numpy as np
import scipy.interpolate
import scipy.linalg
import scipy.optimize  # noqa: F401

import dehyst
from dehyst.elements import MaxwellSlip, Spring

SIZES = (100_000, 1_000_000, 10_000_000)
OUTPUT = Path(__file__).parent / "size.json"
STROKE, NOISE = 10e-6, 2e-9


def record(samples: int) -> dehyst.Record:
    """Descending tops of a known actuator, noise on the sensor; made in pieces, so that its making takes no room."""
    rho = STROKE / 40 * np.arange(1, 21)
    stiffness = np.append(np.random.default_rng(0).uniform(0.2e6, 1.5e6, 19), 0.0)
    knots = np.linspace(0, STROKE, 21)
    slopes = 6e6 * (1 + 0.3 * np.cos(2 * knots[:-1] / STROKE))
    actuator = dehyst.Actuator(MaxwellSlip(rho, stiffness), Spring.of_slopes(knots, slopes, 0.0))
    turns = np.concatenate([[1, 0, 1], *([top, 0] for top in np.linspace(0.9, 0.2, 8)), [1, 0, 1, 0]])
    leg = samples // (turns.size - 1)
    n, state = leg * (turns.size - 1), actuator.turned(STROKE)
    voltage, displacement = np.empty(n), np.empty(n)
    rng = np.random.default_rng(1)
    shape = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, leg + 1) / leg)
    for k in range(turns.size - 1):
        span = slice(k * leg, (k + 1) * leg)
        y = STROKE * (turns[k] + (turns[k + 1] - turns[k]) * shape)
        motion = actuator.compensate(y, state=state)
        voltage[span], state = motion.voltage, motion.state
        displacement[span] = y + NOISE * rng.normal(size=leg)
    time_ = np.arange(n) / 10_000.0
    for column in (time_, voltage, displacement):
        column.flags.writeable = False
    return dehyst.Record(time_, voltage, displacement, f"{n} samples")


def peak() -> float:
    """Largest resident memory so far [MiB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def measure(samples: int, norm: str) -> dict[str, object]:
    """Identify once; memory includes the record itself."""
    before = peak()
    made = record(samples)
    begun, used = time.perf_counter(), time.process_time()
    fit = dehyst.identify(made, norm=norm, progress=lambda words: print(words, round(time.perf_counter() - begun, 1),
                          f"{peak() - before:.0f} MiB", file=sys.stderr, flush=True))  # type: ignore[arg-type] # fmt: skip
    error = fit.errors[0]
    return {"samples": len(made), "norm": norm, "seconds": round(time.perf_counter() - begun, 1),
            "cpu_seconds": round(time.process_time() - used, 1), "peak_MiB": round(peak() - before),
            "gap": fit.gap, "status": fit.status, "largest_percent": error.largest_percent,
            "rms_percent": 100 * error.rms / error.stroke}  # fmt: skip


def main() -> None:
    """Measure all sizes, or the one given as an argument with its norm."""
    if len(sys.argv) == 3:
        print(json.dumps(measure(int(sys.argv[1]), sys.argv[2])))
        return
    found = []
    for samples in SIZES:
        for norm in ("l1", "l2"):
            command = [sys.executable, __file__, str(samples), norm]
            found.append(json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout))
            print(found[-1], flush=True)
    OUTPUT.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
