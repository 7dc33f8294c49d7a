"""How long a record may be: seconds, memory and duality gap of `dehyst.identify` for 1e5, 1e6 and 1e7 samples.

The paper's class, and a wider one: 20 elements, a transformer of 10 segments and 8 branches of creep. Each size runs in
a process of its own, whose peak memory counts above what the imports took: the record is in it.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import highspy  # noqa: F401
import numpy as np
import scipy.interpolate
import scipy.linalg
import scipy.optimize  # noqa: F401

import dehyst
from dehyst.elements import MaxwellSlip, Spring, Transformer
from dehyst.structure import Structure

SIZES = (100_000, 1_000_000, 10_000_000)
OUTPUT = Path(__file__).parent / "size.json"
STROKE, NOISE = 10e-6, 2e-9


# Neighbouring stiffnesses of the actuator below are unlike: little smoothing.
WIDE = Structure(elements=20, knots=21, transformer=10, creep=8, smoothing=1e-3)


def actuator(wide: bool) -> dehyst.Actuator:
    rho = STROKE / 40 * np.arange(1, 21)
    stiffness = np.append(np.random.default_rng(0).uniform(0.2e6, 1.5e6, 19), 0.0)
    knots = np.linspace(0, STROKE, 21)
    slopes = 6e6 * (1 + 0.3 * np.cos(2 * knots[:-1] / STROKE))
    plain = dehyst.Actuator(MaxwellSlip(rho, stiffness), Spring.of_slopes(knots, slopes, 0.0))
    if not wide:
        return plain
    volts = np.linspace(-20, 120, 29)
    bent = Transformer(volts, volts - 6 * np.sin(np.pi * volts / 100))
    return replace(plain, transformer=bent, creep=dehyst.Creep(np.geomspace(0.01, 10, 6), np.full(6, 2e5)))


def record(samples: int, wide: bool) -> dehyst.Record:
    """Descending tops of a known actuator, noise on the sensor; made in pieces, so that its making takes no room."""
    model = actuator(wide)
    turns = np.concatenate([[1, 0, 1], *([top, 0] for top in np.linspace(0.9, 0.2, 8)), [1, 0, 1, 0]])
    leg = samples // (turns.size - 1)
    n, state = leg * (turns.size - 1), model.turned(STROKE)
    voltage, displacement = np.empty(n), np.empty(n)
    rng = np.random.default_rng(1)
    shape = 0.5 - 0.5 * np.cos(np.pi * np.arange(leg + 1) / leg)
    # The longer the record, the slower: creep has the same share in all.
    step = 40.0 / n if wide else 1e-4
    for k in range(turns.size - 1):
        span = slice(k * leg, (k + 1) * leg)
        y = STROKE * (turns[k] + (turns[k + 1] - turns[k]) * shape)
        motion = model.compensate(y, time=step * np.arange(leg + 1) if wide else None, state=state)
        voltage[span], state = motion.voltage[1:], motion.state
        displacement[span] = y[1:] + NOISE * rng.normal(size=leg)
    time_ = np.arange(n) * step
    for column in (time_, voltage, displacement):
        column.flags.writeable = False
    return dehyst.Record(time_, voltage, displacement, f"{n} samples")


def peak() -> float:
    """Largest resident memory so far [MiB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def measure(samples: int, norm: str, structure: str) -> dict[str, object]:
    """Identify once; memory includes the record itself."""
    before, wide = peak(), structure == "wide"
    made = record(samples, wide)
    begun, used = time.perf_counter(), time.process_time()

    def tell(words: str) -> None:
        seconds = round(time.perf_counter() - begun, 1)
        print(words, seconds, f"{peak() - before:.0f} MiB", file=sys.stderr, flush=True)

    fit = dehyst.identify(made, norm=norm, structure=WIDE if wide else "paper", progress=tell)  # type: ignore[arg-type]
    error = fit.errors[0]
    return {"samples": len(made), "structure": structure, "norm": norm,
            "seconds": round(time.perf_counter() - begun, 1), "cpu_seconds": round(time.process_time() - used, 1),
            "peak_MiB": round(peak() - before), "gap": fit.gap, "status": fit.status,
            "largest_percent": error.largest_percent, "rms_percent": 100 * error.rms / error.stroke}  # fmt: skip


def main() -> None:
    """Measure all sizes, or the one given as an argument with its norm and structure."""
    if len(sys.argv) == 4:
        print(json.dumps(measure(int(sys.argv[1]), sys.argv[2], sys.argv[3])))
        return
    found = []
    for structure in ("paper", "wide"):
        for samples in SIZES:
            for norm in ("l1", "l2"):
                command = [sys.executable, __file__, str(samples), norm, structure]
                found.append(json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout))
                print(found[-1], flush=True)
    OUTPUT.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
