"""Nanoseconds a sample and ratios to `numpy.interp` on the same array, in one run on one core.

Compensate and simulate, on the stack of reversals and on clipped elements, for N = 10, 100 and 1000 and three paths:
slow (swept loops of falling height), noisy (the same with sensor noise: every other sample reverses) and random
(uniformly distributed samples); beside them the same elements with a transformer and 8 branches of creep. On the slow
path, other parts of the wider class are timed too: 20 graded elements of 8 segments, and a mass; time is even. Repeats
alternate, and the least processor time counts. Writes `speed.json`.
"""

import json
import os
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from dehyst import Actuator, DisplacementCreep, Dynamics, MaxwellSlip, Spring
from dehyst.model import GradedSlip, SmoothSlip, Transformer

SAMPLES = 1_000_000
REPEATS = 15
KNOTS = np.linspace(0, 1, 21)
VOLTAGES = KNOTS + 0.1 * KNOTS**2
TARGETS = {"compensate": 2.0, "simulate": 6.0, "compensate with transformer and 8 creep": 6.0}
COUNTS = (10, 100, 1000)
WIDER = "with transformer and 8 creep"
TIME = np.linspace(0, 10, SAMPLES)


def paths() -> dict[str, np.ndarray]:
    t = np.linspace(0, 1, SAMPLES)
    random = np.random.default_rng(1)
    slow = (0.5 - 0.5 * np.cos(2 * np.pi * 20 * t)) * (1 - 0.8 * t)
    return {"slow": slow, "noisy": slow + random.normal(0, 1e-4, SAMPLES), "random": random.random(SAMPLES)}


def actuator(elements: int) -> Actuator:
    random = np.random.default_rng(elements)
    rho = 0.5 / elements * np.arange(1, elements + 1)
    return Actuator(MaxwellSlip(rho, random.random(elements) / elements), Spring(KNOTS, VOLTAGES))


def transformer() -> Transformer:
    volts = np.linspace(-1, 3, 11)
    return Transformer(volts, volts + 0.05 * np.sin(volts))


def creep() -> DisplacementCreep:
    return DisplacementCreep(np.geomspace(1e-3, 10, 8), 0.1 * np.random.default_rng(8).random(8))


def least(jobs: dict[str, Callable[[], object]]) -> dict[str, float]:
    """Least nanoseconds a sample of each job; one job after another, again and again."""
    times = dict.fromkeys(jobs, np.inf)
    for _ in range(REPEATS):
        for name, job in jobs.items():
            start = time.thread_time()
            job()
            times[name] = min(times[name], time.thread_time() - start)
    return {name: 1e9 * seconds / SAMPLES for name, seconds in times.items()}


def measure(path: np.ndarray) -> dict[str, dict[str, float]]:
    jobs: dict[str, Callable[[], object]] = {"interp": lambda: np.interp(path, KNOTS, VOLTAGES)}
    for elements in COUNTS:
        model = actuator(elements)
        voltage = model.compensate(path).voltage
        jobs[f"compensate {elements}"] = lambda model=model: model.compensate(path)
        jobs[f"simulate {elements}"] = lambda model=model, voltage=voltage: model.simulate(voltage)
        wide = replace(model, transformer=transformer(), displacement_creep=creep())
        voltage = wide.compensate(path, time=TIME).voltage
        jobs[f"compensate {WIDER} {elements}"] = lambda model=wide: model.compensate(path, time=TIME)
        jobs[f"simulate {WIDER} {elements}"] = lambda model=wide, v=voltage: model.simulate(v, time=TIME)
    times = least(jobs)
    return {name: {"ns": ns, "ratio": ns / times["interp"]} for name, ns in times.items()}


def wider() -> dict[str, Actuator]:
    plain, spring = actuator(10), Spring(KNOTS, VOLTAGES)
    grades = (1 + 0.1 * np.random.default_rng(9).random((20, 8))) / 20
    graded = GradedSlip(0.025 * np.arange(1, 21), np.linspace(0, 1, 9), grades)
    return {
        "10, transformer": replace(plain, transformer=transformer()),
        "20 x 8 graded": Actuator(graded, spring),
        "20 x 8 graded, transformer, 8 creep": Actuator(
            graded, spring, transformer=transformer(), displacement_creep=creep()
        ),
        "10, mass": replace(plain, dynamics=Dynamics(318.0, 0.1, 0.2)),
    }


def measure_wider(path: np.ndarray) -> dict[str, dict[str, float]]:
    jobs: dict[str, Callable[[], object]] = {"interp": lambda: np.interp(path, KNOTS, VOLTAGES)}
    for name, model in wider().items():
        along = {"time": TIME}
        voltage = actuator(10).compensate(path).voltage if model.dynamics else model.compensate(path, **along).voltage
        if not model.dynamics:
            jobs[f"compensate {name}"] = lambda model=model, along=along: model.compensate(path, **along)
        jobs[f"simulate {name}"] = lambda model=model, v=voltage, along=along: model.simulate(v, **along)
    times = least(jobs)
    return {name: {"ns": ns, "ratio": ns / times["interp"]} for name, ns in times.items()}


def clips(path: np.ndarray) -> dict[str, float]:
    """Time the constant-time evaluator once, for comparison: nanoseconds a sample."""
    short = path[: SAMPLES // 20]
    found = {}
    for elements in COUNTS:
        model = actuator(elements)
        start = time.thread_time()
        model.compensate(short, stack=False)
        found[f"compensate {elements}"] = 1e9 * (time.thread_time() - start) / short.size
    return found


def smooth(path: np.ndarray) -> dict[str, float]:
    """Ten elements beside three smooth ones: nanoseconds a sample."""
    short, plain = path[: SAMPLES // 20], actuator(10)
    model = Actuator(plain.slip, plain.spring, smooth=SmoothSlip([0.02, 0.1, 0.4], [1, 0.5, 0.8], [0.3, 0.2, 0.1]))
    voltage = model.compensate(short).voltage
    times = least({"compensate": lambda: model.compensate(short), "simulate": lambda: model.simulate(voltage)})
    return {name: ns * SAMPLES / short.size for name, ns in times.items()}


def main() -> None:
    results = {}
    for name, path in paths().items():
        results[name] = measure(path)
        print(f"\n{name} path, {SAMPLES} samples                              ns   times np.interp")
        for job, row in results[name].items():
            print(f"  {job:<48}{row['ns']:8.2f}{row['ratio']:12.2f}")
    results["wider, slow"] = measure_wider(paths()["slow"])
    print("\nwider class, slow path                   ns   times np.interp")
    for job, row in results["wider, slow"].items():
        print(f"  {job:<48}{row['ns']:8.2f}{row['ratio']:12.2f}")
    results["clips, slow"] = clips(paths()["slow"])
    results["smooth, slow"] = smooth(paths()["slow"])
    print(f"\n10 elements and 3 smooth ones, slow path: {results['smooth, slow']}")
    summary = {}
    for job, target in TARGETS.items():
        ratios = [results["slow"][f"{job} {n}"]["ratio"] for n in COUNTS]
        noisy = max(results["noisy"][f"{job} {n}"]["ratio"] for n in COUNTS)
        spread = 100 * (max(ratios) / min(ratios) - 1)
        summary[job] = {"largest_ratio": max(ratios), "target": target, "spread_percent": spread, "noisy_ratio": noisy}
        print(
            f"\n{job}: at most {max(ratios):.2f} times np.interp (target {target:g}), {noisy:.2f} on the noisy path; "
            f"N = 10, 100, 1000 within {spread:.0f} % of one another (target 25)"
        )
    Path(__file__).with_suffix(".json").write_text(json.dumps({"summary": summary, "paths": results}, indent=1) + "\n")


if __name__ == "__main__":
    main()
