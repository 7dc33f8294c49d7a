"""Results that a change of structure must not move: write them once, and compare after each step.

Models along paths, compensators and snapshots, identifications by all norms and structures, a coupled stage,
exports, the paper's tables and a report's numbers. Everything is seeded. Arrays are equal bit by bit, or their
largest difference is printed as a part of their range; more than 1e-9 is an error.

    python tests/fuzz/frozen.py write FILE.npz [--only PREFIX ...]
    python tests/fuzz/frozen.py compare FILE.npz [--only PREFIX ...]
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import hashlib
import io
import re
import subprocess
import sys
import tempfile
import time
import warnings
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "support")]

import specimens
from truths import BoucWenActuator, PreisachActuator

import dehyst
from dehyst.control import plan_path
from dehyst.identification import Structure
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, descending_tops, staircase

TOLERANCE = 1e-9
NUMBER = re.compile(r"-?\d+\.\d+(?:e-?\d+)?")
STRUCTURES = {
    "transformer": Structure(elements=20, transformer=20),
    "graded": Structure(elements=20, grades=8),
    "smooth": Structure(elements=20, grades=3, transformer=10, smooth=True),
}


def records(truth: Any, rate: float = 40.0) -> list[dehyst.Record]:
    """Descending tops and a staircase, played into a truth."""
    drive = Sampling(0.2, sample_rate=rate, limits=(0.0, 100.0))
    found = []
    for name, excitation in (
        ("tops", descending_tops(100.0, steps=4, drive=drive)),
        ("stairs", staircase(100.0, steps=4, hold=8.0, drive=drive)),
    ):
        y = truth.play(excitation.voltage, time=np.arange(len(excitation.voltage)) / rate)
        found.append(dehyst.Record(np.arange(len(y)) / rate, excitation.voltage, y, name))
    return found


def truths() -> dict[str, Any]:
    """Three virtual actuators by other mechanisms than the model's."""
    return {
        "plays": PlayActuator(stroke=12e-6, highest=100.0, noise=3e-9),
        "relays": PreisachActuator(stroke=12e-6, highest=100.0, noise=3e-9),
        "bouc_wen": BoucWenActuator(stroke=12e-6, highest=100.0, noise=3e-9),
    }


def models() -> Iterator[tuple[str, Any]]:
    """Random actuators of all kinds along a random path and back, and compensators within limits."""
    for number, kind in enumerate(sorted(set(specimens.KINDS)) * 4):
        rng = np.random.default_rng([number, 26])
        actuator = specimens.random_model(rng, kind)
        low, high = actuator.spring.displacement[[0, -1]]
        clock = np.arange(400) * 1e-3
        path = (
            low
            + (high - low) * (0.5 - 0.4 * np.cos(40 * clock) * np.exp(-clock))
            + 0.01 * (high - low) * rng.random(400)
        )
        there = actuator.compensate(path, time=clock, extrapolate=True)
        back = actuator.simulate(there.voltage, time=clock, extrapolate=True)
        yield f"{kind} {number} voltage", there.voltage
        yield f"{kind} {number} displacement", back.displacement
        yield f"{kind} {number} carts", back.state.carts
        compensator = specimens.random_compensator(rng, kind)
        span = np.array(compensator.reach)
        wanted = span[0] + np.ptp(span) * (0.5 + 0.6 * np.sin(60 * clock))
        yield f"{kind} {number} run", compensator.run(wanted[:200])
        memory = compensator.snapshot()
        stepped = [compensator.step(float(y)) for y in wanted[200:]]
        compensator.restore(memory)
        yield f"{kind} {number} steps", np.array([stepped, compensator.run(wanted[200:])])


def numbers_of(fit: dehyst.Fit) -> Iterator[tuple[str, Any]]:
    """What a user sees of an identification, and its model along a path."""
    actuator = fit.actuator
    yield "errors", np.array([[one.rms, one.largest] for one in fit.errors])
    volts = np.linspace(*actuator.limits, 50)
    path = np.concatenate([volts, volts[::-1], volts[:30], volts[30:10:-1]])
    clock = np.arange(path.size) * 0.05
    yield "simulated", actuator.simulate(path, time=clock).displacement
    yield "delay", np.array([actuator.delay, actuator.lag])
    yield "summary", fit.summary(full=True)


def identifications() -> Iterator[tuple[str, Any]]:
    """Plain class in both norms, given structures, the structure searched."""
    for truth_name, truth in truths().items():
        tops, stairs = records(truth)
        for norm in ("l1", "l2"):
            fit = dehyst.identify(tops, validate=stairs, structure="maxwell_slip", norm=norm)
            yield from ((f"{truth_name} plain {norm} {name}", value) for name, value in numbers_of(fit))
        for name, structure in STRUCTURES.items():
            fit = dehyst.identify([tops, stairs], structure=structure, norm="l2")
            yield from ((f"{truth_name} {name} {what}", value) for what, value in numbers_of(fit))
        fit = dehyst.identify([tops, stairs])
        yield from ((f"{truth_name} auto {name}", value) for name, value in numbers_of(fit))


def trust() -> Iterator[tuple[str, Any]]:
    """The assessment of a plain and of a structured model, and a check by a new record."""
    tops, stairs = records(truths()["plays"])
    for name, structure in (("plain", "maxwell_slip"), ("structured", STRUCTURES["graded"])):
        fit = dehyst.identify(tops, structure=structure)
        path = np.linspace(2e-6, 8e-6, 200)
        plan = plan_path(dehyst.Compensator(fit.actuator), path)
        yield f"insight {name}", dehyst.insight(fit.actuator, [tops], plan=plan).summary(full=True)
        yield f"check {name}", str(dehyst.check(fit.actuator, stairs).as_dict())


def stage() -> Iterator[tuple[str, Any]]:
    """Two coupled axes: the coupling, the errors, voltages of a path."""
    import coupled_stage

    record, _ = coupled_stage.excited(steps=4, cycles=4)
    fit = dehyst.identify_stage(record)
    yield "coupling", fit.stage.coupling
    clock = np.arange(300) * 0.02
    path = 1e-6 * np.column_stack([6 + 3 * np.sin(clock), 8 + 4 * np.cos(clock)])
    yield "voltage", fit.stage.compensate(path, time=clock).voltage
    steps = dehyst.StageCompensator(
        fit.stage, limits=[(0.0, 100.0), (0.0, 120.0)], slew_rate=[500.0, 500.0], period=0.02
    )
    yield "steps", np.array([steps.step(point) for point in path])


def exports() -> Iterator[tuple[str, Any]]:
    """Every file of C, FMU and WebAssembly exports, by its hash but for comments and dates."""
    for kind in ("plain", "wide", "all"):
        actuator = specimens.random_model(np.random.default_rng([3, len(kind)]), kind)
        low, high = float(actuator.spring.voltage[0]), float(actuator.spring.voltage[-1])
        compensator = dehyst.Compensator(actuator, (low, high), (high - low) * 10, period=1e-3)
        with tempfile.TemporaryDirectory() as folder:
            dehyst.export(compensator, Path(folder) / "c")
            built = subprocess.run(["make", "-s", "-C", f"{folder}/c", "check"], capture_output=True, check=False)
            yield f"{kind} c check", f"{built.returncode}"
            trace = sorted(Path(folder, "c").rglob("*golden*")) + sorted(Path(folder, "c").rglob("*trace*"))
            yield f"{kind} c trace", _digest(b"".join(path.read_bytes() for path in trace if path.is_file()))
            dehyst.export(compensator, Path(folder) / "w.wasm")
            yield f"{kind} wasm", _digest(Path(folder, "w.wasm").read_bytes())
            dehyst.export(compensator, Path(folder) / "m.fmu")
            with zipfile.ZipFile(Path(folder) / "m.fmu") as fmu:
                yield f"{kind} fmu", " ".join(sorted(fmu.namelist()))


def paper() -> Iterator[tuple[str, Any]]:
    """The tables of the paper's experiment."""
    from dehyst.paper import run

    yield "tables", repr(run.run().as_dict())


def report() -> Iterator[tuple[str, Any]]:
    """The numbers of a report, in order."""
    from dehyst.report import write_report

    tops, stairs = records(truths()["plays"])
    fit = dehyst.identify(tops, validate=stairs, structure="maxwell_slip")
    with tempfile.TemporaryDirectory() as folder:
        write_report(Path(folder) / "r.html", fit)
        text = re.sub(r"(?s)<script.*?</script>|<svg.*?</svg>", "", Path(folder, "r.html").read_text())
    yield "text", re.sub(r"<[^>]*>", " ", text)


GROUPS: dict[str, Callable[[], Iterator[tuple[str, Any]]]] = {
    "models": models,
    "identify": identifications,
    "trust": trust,
    "stage": stage,
    "exports": exports,
    "paper": paper,
    "report": report,
}


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]


def _stored(value: Any) -> np.ndarray:
    """Return an array: of numbers, or of the text without numbers that depend on the clock."""
    return np.asarray(value, dtype=np.float64) if isinstance(value, np.ndarray) else np.asarray(str(value))


def collect(only: list[str]) -> dict[str, np.ndarray]:
    """Compute all results of the groups that are asked for."""
    found = {}
    for group, results in GROUPS.items():
        if only and group not in only:
            continue
        begin = time.process_time()
        found.update({f"{group}/{name}": _stored(value) for name, value in results()})
        print(f"{group}: {time.process_time() - begin:.1f} CPU s", flush=True)
    return found


def difference(before: np.ndarray, after: np.ndarray) -> float:
    """Largest difference as a part of the range; of texts, that of their numbers, infinite if the words differ."""
    if before.dtype.kind == "U":
        texts = [re.sub(r"\d+(\.\d+)? (CPU )?s\b", "T s", str(text)) for text in (before, after)]
        words = [NUMBER.sub("#", text) for text in texts]
        if words[0] != words[1]:
            return np.inf
        before, after = (np.array([float(n) for n in NUMBER.findall(text)]) for text in texts)
    if before.shape != after.shape:
        return np.inf
    if not before.size or np.array_equal(before, after, equal_nan=True):
        return 0.0
    if not np.array_equal(np.isfinite(before), np.isfinite(after)):
        return np.inf
    scale = float(np.nanmax(np.abs(before)))
    return float(np.nanmax(np.abs(before - after))) / (scale or 1.0)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("action", choices=["write", "compare"])
    parser.add_argument("file", type=Path)
    parser.add_argument("--only", nargs="*", default=[], choices=sorted(GROUPS))
    options = parser.parse_args()
    warnings.simplefilter("ignore", dehyst.ClampWarning)
    found = collect(options.only)
    if options.action == "write":
        buffer = io.BytesIO()
        np.savez_compressed(buffer, **found)
        options.file.write_bytes(buffer.getvalue())
        print(f"wrote {len(found)} results")
        return 0
    with np.load(options.file) as archive:
        before = {
            name: archive[name] for name in archive.files if not options.only or name.split("/")[0] in options.only
        }
    worst, equal = 0.0, 0
    for name in sorted(before.keys() | found.keys()):
        apart = difference(before[name], found[name]) if name in before and name in found else np.inf
        equal += apart == 0
        worst = max(worst, apart)
        if apart > TOLERANCE:
            print(f"DIFFERENT {name}: {apart:.3g}")
    print(f"{equal} of {len(before)} results are the same bits; largest difference {worst:.3g}")
    return int(worst > TOLERANCE)


if __name__ == "__main__":
    sys.exit(main())
