"""Identify actuators from records that begin, end or are cut by voltage steps which ring.

Four truths that no model has, each recorded at 5 kHz with rest, steps, ringing and sines of 1 Hz. Reported: the
transients that are named, what is expected of the model, what it reaches on a new path of the same kind of motion, and
CPU seconds. Writes `transients.json`.

    python benchmarks/transients.py [--samples N] [--only TRUTH/RECORD ...]
"""

from __future__ import annotations

import argparse
import json
import os
import time
from dataclasses import dataclass
from math import cos, exp, pi, sin, sqrt
from pathlib import Path

# Before NumPy loads its BLAS.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import dehyst
from dehyst import Record
from dehyst.records.cleaning import transients

Array = np.ndarray

RATE, SAMPLES = 5000.0, 50_000
HIGHEST, STROKE, NOISE = 150.0, 20e-6, 0.0011
RECORDS = ("step first", "step last", "staircase")


class Swing:
    """A resonance: ``y'' + 2 zeta omega y' + omega^2 y = omega^2 x``, exact for x that is linear between samples."""

    def __init__(self, frequency: float, damping: float) -> None:
        self.omega, self.zeta = 2 * pi * frequency, damping
        self.state = 0.0, 0.0, 0.0

    def play(self, x: Array) -> Array:
        """Return y (n,) at the samples of x (n,)."""
        omega, zeta, step = self.omega, self.zeta, 1 / RATE
        damped, lag, decay = omega * sqrt(1 - zeta**2), 2 * zeta / omega, exp(-zeta * omega * step)
        c, s = decay * cos(damped * step), decay * sin(damped * step) / damped
        (before, y, rate), reached = self.state, []
        for target in x.tolist():
            speed = (target - before) / step
            e, f = y - before + lag * speed, rate - speed
            y = target - lag * speed + e * (c + zeta * omega * s) + f * s
            rate = speed + f * (c - zeta * omega * s) - e * omega**2 * s
            before = target
            reached.append(y)
        self.state = before, y, rate
        return np.array(reached)


class RingingPlays:
    """Plays of u with an asymmetric map, before a resonance of 1 kHz."""

    frequency = 1000.0

    def __init__(self) -> None:
        self.radius = np.linspace(0.02, 0.9, 40)
        self.weight = np.exp(-1.5 * self.radius) / 40
        self.outputs = np.zeros(40)
        self.swing = Swing(self.frequency, 0.09)

    def play(self, u: Array) -> Array:
        """Return the displacement (n,) for u (n,), -1 to 1."""
        total = np.empty(u.size)
        for t, now in enumerate(u.tolist()):
            self.outputs = np.clip(self.outputs, now - self.radius, now + self.radius)
            total[t] = self.weight @ self.outputs
        w = 0.6 * u + total
        return self.swing.play(w + 0.1 * w**2 - 0.05 * w**3)


class RingingRelays:
    """Relays of a two-peaked density, before a resonance of 400 Hz that rings long."""

    frequency = 400.0

    def __init__(self) -> None:
        random = np.random.default_rng(3)
        wide = random.random(3000) < 0.4
        centre = np.where(wide, random.normal(0.3, 0.3, 3000), random.normal(-0.25, 0.35, 3000))
        half = np.where(wide, random.gamma(5.0, 0.06, 3000), random.gamma(2.0, 0.07, 3000))
        self.up_at, self.down_at = centre + half, centre - half
        self.up = self.up_at <= 0
        self.swing = Swing(self.frequency, 0.03)

    def play(self, u: Array) -> Array:
        """Return the displacement (n,) for u (n,), -1 to 1."""
        share = np.empty(u.size)
        for t, now in enumerate(u.tolist()):
            self.up |= self.up_at <= now
            self.up &= self.down_at < now
            share[t] = np.count_nonzero(self.up)
        return self.swing.play(0.65 * u - 0.06 * u**2 + 0.6 * share / self.up.size)


class MassOnFriction:
    """A mass that friction after Bouc and Wen holds: ``y'' / omega^2 + 2 zeta y' / omega + y + z(y) = u``."""

    frequency = 650.0
    damping, strength, length, finer = 0.04, 0.16, 0.3, 16

    def __init__(self) -> None:
        self.y = self.rate = self.z = self.u = 0.0

    def play(self, u: Array) -> Array:
        """Return the displacement (n,) for u (n,), -1 to 1."""
        step, reached = 1 / (RATE * self.finer), []
        omega, (y, rate, z) = 2 * pi * self.frequency, (self.y, self.rate, self.z)
        for before, now in zip([self.u, *u[:-1].tolist()], u.tolist(), strict=True):
            for k in range(1, self.finer + 1):
                drive = before + (now - before) * k / self.finer
                drive += 0.06 * drive**2
                rate += step * (omega**2 * (drive - y - z) - 2 * self.damping * omega * rate)
                y += step * rate
                change = step * rate / self.length
                z += change * self.strength - abs(change) * z
            reached.append(y)
        self.y, self.rate, self.z, self.u = y, rate, z, float(u[-1])
        return np.array(reached)


class CreepingSlip:
    """Maxwell's slip behind an amplifier that overshoots by a quarter; creeps by a logarithm of time."""

    frequency = 250.0

    def __init__(self) -> None:
        self.amplifier = Swing(self.frequency, 0.4)
        self.most = np.geomspace(0.01, 1.2, 15)
        self.weight = np.full(15, 0.35 / 15)
        self.force, self.last = np.zeros(15), 0.0
        self.keep = np.exp(-1 / (RATE * np.geomspace(0.02, 200.0, 9)))
        self.crept = np.zeros(9)

    def play(self, u: Array) -> Array:
        """Return the displacement (n,) for u (n,), -1 to 1."""
        reached = np.empty(u.size)
        for t, now in enumerate(self.amplifier.play(u).tolist()):
            self.force = np.clip(self.force + now - self.last, -self.most, self.most)
            self.last = now
            x = now + 0.05 * now**2 - float(self.weight @ self.force)
            self.crept = x + self.keep * (self.crept - x)
            reached[t] = x + 0.004 * self.crept.sum()
        return reached


TRUTHS = {"plays": RingingPlays, "relays": RingingRelays, "mass": MassOnFriction, "slip": CreepingSlip}


def sines(seconds: float, seed: int, before: float = 0.0) -> Array:
    """Return voltages (n,) [V] of cycles of 1 s and random heights, the first two of the full one, from `before`."""
    random = np.random.default_rng(seed)
    heights = np.concatenate([np.ones(2), random.uniform(0.25, 1.0, round(seconds) + 1)])
    levels = np.concatenate([[before], np.outer(heights, [HIGHEST, -HIGHEST]).ravel()])
    half = np.arange(round(seconds * RATE)) * 2 / RATE
    leg = half.astype(int)
    return levels[leg] + (levels[leg + 1] - levels[leg]) * (0.5 - 0.5 * np.cos(np.pi * (half - leg)))


def voltage(kind: str, samples: int = SAMPLES, seed: int = 1) -> Array:
    """Return the voltages (n,) [V] of a record of a kind."""
    rest = np.zeros(round(0.33 * samples))
    step = -87.0
    if kind == "step first":
        return np.concatenate([rest, sines((samples - rest.size) / RATE, seed, step)])
    if kind == "step last":
        moving = sines((samples - rest.size) / RATE, seed)
        return np.concatenate([moving, np.zeros(rest.size)])
    levels = np.array([0.0, 60.0, 120.0, 75.0, -30.0, -120.0, -60.0, 0.0])
    stairs = np.repeat(levels, round(0.06 * samples))
    return np.concatenate([stairs, sines((samples - stairs.size) / RATE, seed)])


@dataclass(frozen=True)
class Result:
    """The fit of a record, its CPU seconds, and the errors on a new path [% of the stroke]."""

    fit: dehyst.Fit
    seconds: float
    largest: float
    rms: float


def record_of(name: str, kind: str, samples: int = SAMPLES, seed: int = 1) -> tuple[Record, Array, Array]:
    """Return a record of a truth, and a new path of voltages after it with the displacements it causes [V], [m]."""
    actuator, v = TRUTHS[name](), voltage(kind, samples, seed)
    path = sines(8.0, seed + 100, v[-1])
    # It was in use before: one cycle, to rest at 0 V.
    used = 0.5 - 0.5 * np.cos(np.pi * np.arange(2500) / 2500)
    actuator.play(np.concatenate([used, 1 - 2 * used, used - 1, np.zeros(2000)]))
    y = actuator.play(np.append(v, path) / HIGHEST)
    y = y * STROKE / float(np.ptp(y[v.size :]))
    noisy = y[: v.size] + np.random.default_rng(seed).normal(0, NOISE * STROKE, v.size)
    return Record(np.arange(v.size) / RATE, v, noisy, f"{name}, {kind}"), path, y[v.size :]


def run(name: str, kind: str, samples: int = SAMPLES, seed: int = 1) -> Result:
    """Identify one record and simulate a new path after it."""
    record, path, reached = record_of(name, kind, samples, seed)
    begin = time.process_time()
    fit = dehyst.identify(record)
    seconds = time.process_time() - begin
    both = np.append(record.voltage, path)
    times = np.arange(both.size) / RATE
    acting = np.interp(times - fit.actuator.delay, times, both)
    clock = times
    moved = fit.actuator.simulate(acting, time=clock, extrapolate=True).displacement[record.voltage.size :]
    # The first cycle leads both into the same loops; a constant is the sensor's zero.
    error = 100 * (moved - reached)[round(RATE) :] / fit.errors[0].stroke
    error = error - error.mean()
    return Result(fit, seconds, float(np.abs(error).max()), float(np.sqrt(np.mean(error**2))))


def row(name: str, kind: str, samples: int = SAMPLES) -> dict:
    """Return the JSON values of one case."""
    found = run(name, kind, samples)
    expected, error = found.fit.promise, found.fit.errors[0]
    record, _, _ = record_of(name, kind, samples)
    named = transients(record)
    return {
        "truth": name,
        "record": kind,
        "samples": samples,
        "true_frequency_hz": TRUTHS[name].frequency,
        "transients": [{"time_s": float(record.time[jump]), "samples": stop - start} for start, jump, stop in named],
        "set_aside": error.left_out,
        "expected_largest_percent": expected.largest_percent,
        "expected_rms_percent": 100 * expected.rms / error.stroke,
        "reached_largest_percent": found.largest,
        "reached_rms_percent": found.rms,
        "verdict": expected.readiness.value,
        "basis": expected.basis,
        "structure": found.fit.actuator.provenance.get("structure"),
        "cpu_seconds": found.seconds,
    }


def main() -> None:
    """Run the cases and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=SAMPLES)
    parser.add_argument("--only", nargs="*", default=[f"{name}/{kind}" for name in TRUTHS for kind in RECORDS])
    options = parser.parse_args()
    rows = []
    for case in options.only:
        rows.append(row(*case.split("/"), samples=options.samples))
        last = rows[-1]
        print(
            f"{case:<20} {len(last['transients'])} transients, expected {last['expected_largest_percent']:.2f} / "
            f"{last['expected_rms_percent']:.3f}, reached {last['reached_largest_percent']:.2f} / "
            f"{last['reached_rms_percent']:.3f} %, {last['verdict']}, {last['cpu_seconds']:.1f} s"
        )
    Path(__file__).with_suffix(".json").write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
