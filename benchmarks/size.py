"""Time and memory of `dehyst.identify` for records of 1e5, 1e6 and 1e7 samples.

Maxwell-slip, and the dictionary for an actuator with a transformer and creep. Each size runs in a process of its own,
whose peak memory counts without that of the imports; it includes the record.

And the instructions of the steps of an exported compensator of ten elements, plain and with all parts, on a Cortex-M4F
that QEMU emulates. `size.py firmware` measures that alone.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy.interpolate
import scipy.linalg
import scipy.optimize  # noqa: F401

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "support"))

import compiled_exports

import dehyst
from dehyst.model import GradedSlip, MaxwellSlip, Spring, Transformer, turned

SIZES = (100_000, 1_000_000, 10_000_000)
OUTPUT = Path(__file__).parent / "size.json"
STROKE, NOISE = 10e-6, 2e-9


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
    return replace(
        plain,
        transformer=bent,
        displacement_creep=dehyst.DisplacementCreep(np.geomspace(0.01, 10, 6), np.full(6, 0.02)),
    )


def record(samples: int, wide: bool) -> dehyst.Record:
    """Descending tops of a known actuator, noise on the sensor; made in pieces, which need little memory."""
    model = actuator(wide)
    turns = np.concatenate([[1, 0, 1], *([top, 0] for top in np.linspace(0.9, 0.2, 8)), [1, 0, 1, 0]])
    branch = samples // (turns.size - 1)
    n, state = branch * (turns.size - 1), turned(model, STROKE)
    voltage, displacement = np.empty(n), np.empty(n)
    rng = np.random.default_rng(1)
    shape = 0.5 - 0.5 * np.cos(np.pi * np.arange(branch + 1) / branch)
    # A longer record is slower: creep has the same share in all records.
    step = 40.0 / n if wide else 1e-4
    for k in range(turns.size - 1):
        span = slice(k * branch, (k + 1) * branch)
        y = STROKE * (turns[k] + (turns[k + 1] - turns[k]) * shape)
        motion = model.compensate(y, time=step * np.arange(branch + 1) if wide else None, state=state)
        voltage[span], state = motion.voltage[1:], motion.state
        displacement[span] = y[1:] + NOISE * rng.normal(size=branch)
    time_ = np.arange(n) * step
    for column in (time_, voltage, displacement):
        column.flags.writeable = False
    return dehyst.Record(time_, voltage, displacement, f"{n} samples")


def peak() -> float:
    """Largest resident memory so far [MiB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def measure(samples: int, structure: str) -> dict[str, object]:
    """Identify once; memory includes the record itself."""
    before = peak()
    made = record(samples, structure == "auto")
    begun, used = time.perf_counter(), time.process_time()

    def tell(words: str) -> None:
        seconds = round(time.perf_counter() - begun, 1)
        print(words, seconds, f"{peak() - before:.0f} MiB", file=sys.stderr, flush=True)

    fit = dehyst.identify(made, structure=structure, progress=tell)  # type: ignore[arg-type]
    error = fit.errors[0]
    return {
        "samples": len(made),
        "structure": structure,
        "seconds": round(time.perf_counter() - begun, 1),
        "cpu_seconds": round(time.process_time() - used, 1),
        "peak_MiB": round(peak() - before),
        "largest_percent": error.largest_percent,
        "rms_percent": 100 * error.rms / error.stroke,
    }


def small(wide: bool) -> dehyst.Compensator:
    """Ten elements; wide: in four grades, with a transformer, four creep branches, two smooth elements and a mass."""
    rho, knots = STROKE / 20 * np.arange(1, 11), np.linspace(0, STROKE, 11)
    spring = Spring.of_slopes(knots, 6e6 * (1 + 0.3 * np.cos(2 * knots[:-1] / STROKE)), 0.0)
    stiffness = np.linspace(1.5e6, 0.2e6, 10)
    if not wide:
        return dehyst.Compensator(dehyst.Actuator(MaxwellSlip(rho, stiffness), spring), (0, 100))
    volts = np.linspace(-20, 120, 8)
    graded = GradedSlip(rho, np.linspace(0, STROKE, 5), stiffness[:, None] * np.linspace(0.9, 1, 4))
    made = dehyst.Actuator(
        graded,
        spring,
        transformer=Transformer(volts, volts - 6 * np.sin(np.pi * volts / 100)),
        displacement_creep=dehyst.DisplacementCreep(np.geomspace(0.01, 10, 4), np.full(4, 0.02)),
        dynamics=dehyst.Dynamics(955.0, 0.05, 2e6),
        smooth=dehyst.model.SmoothSlip(STROKE * np.array([0.05, 0.2]), np.array([0.5, 0.8]), np.array([1e6, 5e5])),
    )
    return dehyst.Compensator(made, (0, 100), period=1e-4)


def steps() -> list[dict[str, object]]:
    """Instructions of a step in floats on an emulated Cortex-M4F: median without clamping, largest with it."""
    found: list[dict[str, object]] = []
    for structure in ("plain", "wide"):
        compensator = small(structure == "wide")
        low, high = compensator.reach
        far = 10 * (high - low)
        with tempfile.TemporaryDirectory() as work:
            folder = compiled_exports.written(Path(work) / "c", compensator, "float")
            swept = np.linspace(low, high, 500)
            _, followed = compiled_exports.emulated(folder, np.concatenate([swept, swept[::-1]]))
            _, clamped = compiled_exports.emulated(folder, [low - far, high + far] * 100)
        row = {"structure": structure, "followed": float(np.median(followed)), "clamped": float(clamped.max())}
        found.append({key: round(value) if isinstance(value, float) else value for key, value in row.items()})
        print(found[-1], flush=True)
    return found


def keep(section: str, found: object) -> None:
    """Write one section, and leave the other unchanged."""
    data = json.loads(OUTPUT.read_text()) if OUTPUT.exists() else {}
    OUTPUT.write_text(json.dumps({**data, section: found}, indent=1) + "\n")


def main() -> None:
    """Measure all, or the firmware alone, or the size and structure that are given as arguments."""
    if len(sys.argv) == 3:
        print(json.dumps(measure(int(sys.argv[1]), sys.argv[2])))
        return
    keep("instructions", steps())
    if sys.argv[1:] == ["firmware"]:
        return
    found = []
    for structure in ("maxwell_slip", "auto"):
        for samples in SIZES:
            command = [sys.executable, __file__, str(samples), structure]
            found.append(json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout))
            print(found[-1], flush=True)
    keep("identification", found)


if __name__ == "__main__":
    main()
