"""Many actuators at once: nanoseconds an actuator and sample, ratios to `numpy.interp`, bits, threads, and a mirror.

A bank of 1000 actuators of 10 elements and a spring of 21 knots (as `speed.py` has), and one with a spring of 2 knots,
on random motion; the same on two threads; the bits of 1e7 steps beside the scalar core, and beside a compiled export;
and a deformable mirror of 5316 actuators, of which every step of 1e5 is timed. Times of one thread are the processor's;
scaling and the mirror's steps are by the wall clock. Repeats are interleaved. Writes `banks.json`.
"""

import argparse
import json
import os
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import dehyst
from dehyst import Actuator, Bank, Compensator, Creep, MaxwellSlip, Spring, Transformer
from dehyst._native import has_avx2

ACTUATORS, SAMPLES, REPEATS = 1000, 1000, 9
MIRROR, MIRROR_STEPS, MIRROR_RATE = 5316, 100_000, 1000
STEPS = 10_000_000
LIMITS = (-1e9, 1e9)
TARGETS = {"compensate": 5.0, "simulate": 35.0, "mirror step [us]": 100.0, "two threads": 1.8}
_DRIVER = r"""
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include "piezo.h"

int main(int argc, char **argv)
{
    static piezo p;
    static double block[4096];
    FILE *in = fopen(argv[1], "rb"), *out = fopen(argv[2], "wb");
    size_t n, i;
    if (argc < 3 || !in || !out || piezo_begin(&p) != DEHYST_OK) return 1;
    while ((n = fread(block, sizeof *block, 4096, in)) > 0) {
        for (i = 0; i < n; i++) block[i] = piezo_step(&p, block[i]);
        fwrite(block, sizeof *block, n, out);
    }
    return fclose(out);
}
"""


def actuator(seed: int, knots: int, elements: int = 10, **parts: object) -> Actuator:
    """Return an actuator of a micrometre and a hundred volts, with hysteresis of some 15 %."""
    random = np.random.default_rng(seed)
    rho = 0.5e-6 / elements * np.arange(1, elements + 1) * random.uniform(0.9, 1.1)
    at = np.linspace(0, 1, knots)
    spring = Spring(1e-6 * at, 80 * (at + 0.1 * random.uniform(0.5, 1.5) * at**2))
    return Actuator(MaxwellSlip(rho, 1e8 * random.random(elements) / elements), spring, limits=LIMITS, **parts)


def classes() -> dict[str, list[Actuator]]:
    """Every class that is computed in lanes."""
    volts = np.linspace(-50, 150, 11)
    tau = Transformer(volts, volts + 2 * np.sin(volts / 20))
    creep = Creep(np.geomspace(1e-3, 10, 8), np.full(8, 1e6))
    return {
        "21 knots": [actuator(i, 21) for i in range(ACTUATORS)],
        "2 knots": [actuator(i, 2) for i in range(ACTUATORS)],
        "100 elements": [actuator(i, 21, 100) for i in range(ACTUATORS)],
        "transformer and 8 creep": [actuator(i, 21, transformer=tau, creep=creep) for i in range(ACTUATORS)],
    }


def least(jobs: dict[str, Callable[[], object]], clock: Callable[[], float], repeats: int) -> dict[str, float]:
    """Least seconds of each job, one job after another, again and again."""
    seconds = dict.fromkeys(jobs, np.inf)
    for _ in range(repeats):
        for name, job in jobs.items():
            start = clock()
            job()
            seconds[name] = min(seconds[name], clock() - start)
    return seconds


def motions(bank: Bank, samples: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Random displacements, and random voltages over what these need."""
    random = np.random.default_rng(seed)
    wanted = random.uniform(0, 1e-6, (samples, len(bank)))
    needed = bank.compensate(wanted)
    bank.reset()
    return wanted, random.uniform(needed.min(), needed.max(), wanted.shape)


def speed() -> dict[str, dict[str, float]]:
    knots, random = np.linspace(0, 1e-6, 21), np.random.default_rng(0)
    path = random.uniform(0, 1e-6, ACTUATORS * SAMPLES)
    jobs: dict[str, Callable[[], object]] = {"interp": lambda: np.interp(path, knots, knots)}
    sizes = {"interp": path.size}
    for name, actuators in classes().items():
        bank = Bank(actuators, period=1e-3)
        wanted, played = motions(bank, SAMPLES // 5 if name == "100 elements" else SAMPLES, 1)
        out = np.empty(wanted.shape)
        for build in ("avx2", "baseline") if has_avx2() else ("baseline",):
            for plays, values in ((False, wanted), (True, played)):
                label = f"{'simulate' if plays else 'compensate'} {name}, {build}"
                jobs[label] = lambda b=bank, x=values, o=out, p=plays, k=build: b._run(x, o, plays=p, build=k)
                sizes[label] = out.size
    seconds = least(jobs, time.thread_time, REPEATS)
    interp = seconds["interp"] / path.size
    return {
        label: {"ns": 1e9 * one / sizes[label], "ratio": one / sizes[label] / interp} for label, one in seconds.items()
    }


def scaling() -> dict[str, float]:
    """How many times two threads are as fast as one."""
    actuators = classes()["21 knots"]
    banks = [Bank(actuators, threads=n) for n in (1, 2)]
    wanted, played = motions(banks[0], 2 * SAMPLES, 2)
    out = np.empty(wanted.shape)
    jobs = {
        f"{name} {n}": lambda b=bank, x=x, p=p: b._run(x, out, plays=p)
        for n, bank in zip((1, 2), banks, strict=True)
        for name, x, p in (("compensate", wanted, False), ("simulate", played, True))
    }
    seconds = least(jobs, time.perf_counter, REPEATS)
    return {name: seconds[f"{name} 1"] / seconds[f"{name} 2"] for name in ("compensate", "simulate")}


def bits() -> dict[str, int]:
    """Numbers of 1e7 steps that differ from the scalar core's, and from those of a compiled export."""
    count = 40
    random = np.random.default_rng(3)
    creep = Creep([1e-3, 0.1], [1e6, 2e6])
    made = [actuator(i, int(random.integers(2, 30)), int(random.integers(1, 30)), creep=creep) for i in range(count)]
    actuators = [dehyst.Actuator(one.slip, one.spring, creep=one.creep, limits=(5.0, 95.0)) for one in made]
    wanted = random.uniform(0, 1e-6, (STEPS // count, count))
    options = {"limits": (5.0, 95.0), "slew_rate": 6e4, "period": 1e-3}
    bank = Bank(actuators, **options)
    voltage = np.empty(wanted.shape)
    bank._run(wanted, voltage, plays=False)
    played = random.uniform(0, 100, wanted.shape)
    shown = np.empty(wanted.shape)
    bank._run(played, shown, plays=True)
    wrong, wrong_simulated = 0, 0
    for i, one in enumerate(actuators):
        loop = Compensator(one, **options)._loop
        expected, displacement = np.empty(wanted.shape), np.empty(wanted.shape)
        loop.run_column(wanted, expected, i, False)
        loop.run_column(played, displacement, i, True)
        wrong += int(np.count_nonzero(expected[:, i] != voltage[:, i]))
        wrong_simulated += int(np.count_nonzero(displacement[:, i] != shown[:, i]))
    return {
        "steps": int(voltage.size),
        "clamped": int(sum(one.sum() for one in bank.clamps)),
        "compensate, other than the scalar core": wrong,
        "simulate, other than the scalar core": wrong_simulated,
        "compensate, other than the compiled export": exported(actuators[0], options),
    }


def exported(one: Actuator, options: dict) -> int:
    """Numbers of 1e7 steps of one actuator that differ from those of its compiled export."""
    wanted = np.random.default_rng(4).uniform(0, 1e-6, (STEPS, 1))
    voltage = np.empty(wanted.shape)
    Bank([one], **options)._run(wanted, voltage, plays=False)
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        dehyst.export(Compensator(one, **options), place / "c", measure=False)
        (place / "main.c").write_text(_DRIVER)
        wanted.tofile(place / "in")
        sources = [place / "main.c", *(place / "c" / part for part in ("dehyst.c", "piezo.c"))]
        flags = ["-std=c99", "-O2", "-ffp-contract=off", f"-I{place / 'c'}"]
        subprocess.run(["cc", *flags, *map(str, sources), "-o", place / "run"], check=True)
        subprocess.run([place / "run", place / "in", place / "out"], check=True)
        return int(np.count_nonzero(np.fromfile(place / "out") != voltage[:, 0]))


def mirror() -> dict[str, dict[str, float]]:
    """Time deformable mirrors, of actuators with springs of 2 and of 21 knots."""
    return {f"{knots} knots": mirror_of(knots) for knots in (2, 21)}


def mirror_of(knots: int) -> dict[str, float]:
    """Microseconds of every step of a mirror, by the wall clock and of the processor."""
    actuators = [actuator(i, knots) for i in range(MIRROR)]
    bank = Bank(actuators, slew_rate=1e6, period=1 / MIRROR_RATE)
    random = np.random.default_rng(5)
    # Smooth turbulence and noise: 64 rows, played forth and back.
    rows = 0.5e-6 + 0.2e-6 * np.sin(np.linspace(0, 20, 64)[:, None] + random.uniform(0, 6, MIRROR))
    rows += random.normal(0, 0.05e-6, rows.shape)
    out = np.empty(MIRROR)
    seconds = np.empty(MIRROR_STEPS)
    for row in rows:
        bank.step(row, out=out)
    begin = time.process_time()
    for k in range(MIRROR_STEPS):
        row = rows[k % 64 if k // 64 % 2 else 63 - k % 64]
        start = time.perf_counter()
        bank.step(row, out=out)
        seconds[k] = time.perf_counter() - start
    used = time.process_time() - begin
    median, high, worst = (1e6 * float(np.quantile(seconds, q)) for q in (0.5, 0.999, 1.0))
    return {
        "actuators": MIRROR,
        "steps": MIRROR_STEPS,
        "median us": median,
        "99.9 % us": high,
        "worst us": worst,
        "processor us": 1e6 * used / MIRROR_STEPS,
        f"cores at {MIRROR_RATE} Hz": used / MIRROR_STEPS * MIRROR_RATE,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=Path(__file__).with_suffix(".json"))
    options = parser.parse_args()
    results = {"targets": TARGETS, "avx2": has_avx2()}
    for name, part in (("speed", speed), ("scaling", scaling), ("mirror", mirror), ("bits", bits)):
        results[name] = part()
        print(name, json.dumps(results[name], indent=1))
    options.output.write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
