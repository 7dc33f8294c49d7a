"""Repeated paths, feedback of sensors, and faulty sensors. Writes `learning.json`.

Four plants of mechanisms that dehyst does not have, each identified from its records: plays of the voltage behind a
cubic map, with creep (1.2 % a decade), a resonance (800 Hz, quality 25), thresholds that grow with speed, or noise of
0.2 %. A rounded triangle of 60 % of the stroke at 20 Hz is repeated at 10 kHz. Errors are the true ones in % of the
stroke.

    python benchmarks/learning.py [--seed N]
"""

from __future__ import annotations

import argparse
import json
import warnings
from itertools import pairwise, product
from pathlib import Path

import numpy as np

import dehyst
from dehyst.model import simulated, turned

OUTPUT = Path(__file__).with_suffix(".json")
PERIOD, SAMPLES, CYCLES = 1e-4, 500, 30
HIGHEST, STROKE = 100.0, 13e-6
LIMITS = (-10.0, 110.0)
PLANTS = ("creep", "resonance", "rate", "noise")
# The cycle in which a sensor becomes faulty, and the number of all cycles.
FAULTY_FROM, FAULTY_CYCLES = 4, 16


class Plant:
    """Fifteen plays of the voltage behind a cubic map; a voltage is held for a period."""

    def __init__(self, kind: str, seed: int = 0, resonance: tuple[float, float] = (800.0, 0.02)) -> None:
        rng = np.random.default_rng(seed)
        self.kind, self.rng = kind, rng
        self.threshold = 30 * np.sort(rng.random(15)) ** 1.3 + 0.3
        self.weight = rng.random(15) / 15 * 0.5
        self.play, self.before, self.rate = np.zeros(15), 0.0, 0.0
        self.creeping = np.zeros(4)
        self.noise = 2e-3 if kind == "noise" else 1e-4
        omega, zeta = 2 * np.pi * resonance[0], resonance[1]
        self.pole = omega * complex(-zeta, np.sqrt(1 - zeta**2))
        self.swing = 0j

    def step(self, voltage: float, period: float = PERIOD) -> float:
        """Hold a voltage for a period, and return the true displacement at its end [m]."""
        # A threshold follows the speed within a millisecond.
        self.rate += (1 - np.exp(-period / 1e-3)) * (abs(voltage - self.before) / period - self.rate)
        faster = 1 + (0.05 * np.log10(1 + self.rate / 10) if self.kind == "rate" else 0.0)
        self.play = np.clip(self.play, voltage - faster * self.threshold, voltage + faster * self.threshold)
        x = (voltage + self.weight @ self.play) / (HIGHEST * (1 + self.weight.sum()))
        y, self.before = x + 0.12 * x * (1 - x) * (0.6 - x), voltage
        if self.kind == "creep":
            self.creeping += (1 - np.exp(-period / np.geomspace(0.05, 50, 4))) * (y - self.creeping)
            y += 0.012 * self.creeping.sum()
        if self.kind == "resonance":
            # The ringing is the sum of decaying oscillations; each begins with a change of the pushed displacement.
            self.swing += (y - getattr(self, "pushed", 0.0)) * complex(1, self.pole.real / self.pole.imag)
            self.pushed, self.swing = y, self.swing * np.exp(self.pole * period)
            y -= self.swing.real
        return STROKE * float(y)

    def run(self, voltages: np.ndarray, period: float = PERIOD) -> np.ndarray:
        """Return the true displacements (n,) [m] of voltages (n,) [V]."""
        return np.array([self.step(v, period) for v in voltages.tolist()])

    def measured(self, displacement: np.ndarray) -> np.ndarray:
        """Return a displacement with the sensor's noise."""
        return displacement + self.noise * STROKE * self.rng.standard_normal(np.shape(displacement))


def records(kind: str, seed: int) -> list[dehyst.Record]:
    """Slow branches with falling tops and random turns; fast sines if the plant has a resonance."""
    rng, plant = np.random.default_rng(seed + 100), Plant(kind, seed)
    turns = [0, 100, 0, 85, 10, 70, 20, 60, 30, 50, *(100 * rng.random(24)), 100, 0]
    slow = np.concatenate(
        [np.linspace(a, b, max(2, round(abs(b - a) / 0.5)), endpoint=False) for a, b in pairwise(turns)]
    )
    slow = np.concatenate([slow, np.full(200, slow[-1])])
    made = [record(plant, slow, 5e-3)]
    if kind == "resonance":
        time = PERIOD * np.arange(2500)
        fast = [50 - 50 * np.cos(2 * np.pi * frequency * time) for frequency in (20, 60, 160)]
        made.append(record(plant, np.concatenate(fast), PERIOD))
    if kind == "rate":
        time = PERIOD * 5 * np.arange(4000)
        made.append(record(plant, 50 - 50 * np.cos(2 * np.pi * 10 * time) * (1 - 0.4 * time), 5 * PERIOD))
    return made


def record(plant: Plant, voltage: np.ndarray, period: float) -> dehyst.Record:
    y = plant.measured(plant.run(voltage, period))
    return dehyst.Record(period * np.arange(voltage.size), voltage, y, hold="sample")


def triangle() -> np.ndarray:
    """One cycle between 20 and 80 % of the stroke, its turns rounded over a twentieth [m]."""
    lines = 2 * np.abs(2 * ((np.arange(SAMPLES) / SAMPLES + 0.25) % 1) - 1) - 1
    window = np.hanning(SAMPLES // 20)
    rounded = np.fft.irfft(np.fft.rfft(lines) * np.fft.rfft(window / window.sum(), SAMPLES), SAMPLES)
    return STROKE * (0.5 + 0.3 * rounded)


class Bench:
    """A plant with its model, both at rest at the beginning of the path."""

    def __init__(self, kind: str, model: dehyst.Actuator, path: np.ndarray, seed: int, **options) -> None:
        self.path, self.plant = path, Plant(kind, seed)
        homing = 50 - 50 * np.cos(np.pi * np.arange(0, 4, 5e-3))
        self.plant.run(homing, 5e-3)
        state = simulated(model, homing, 5e-3 * np.arange(homing.size)).state
        self.loop = dehyst.Compensator(model, LIMITS, period=PERIOD, state=state, warns=False, **options)
        bend = 0.5 - 0.5 * np.cos(np.pi * np.arange(2000) / 2000)
        self.plant.run(self.loop.run(self.loop.displacement + bend * (path[0] - self.loop.displacement)))

    def frozen(self, cycles: int) -> np.ndarray:
        """Return the errors (cycles, n) [m] of the compensator alone."""
        return np.array([self.plant.run(self.loop.run(self.path)) - self.path for _ in range(cycles)])

    def repeated(self, cycles: int, sensor=None) -> tuple[np.ndarray, int | None]:
        """Return the true errors (cycles, n), and the cycle in which the sensor was no longer believed."""
        repetition, errors, seen = dehyst.Repetition(self.loop, self.path), [], None
        for k in range(cycles):
            y = self.plant.run(repetition.next())
            said = self.plant.measured(y)
            repetition.learn(said if sensor is None or k < FAULTY_FROM else sensor(said, k))
            errors.append(y - self.path)
            seen = k if seen is None and not repetition.believed else seen
        return np.array(errors), seen

    def fed_back(self, cycles: int, sensor=None) -> tuple[np.ndarray, int | None]:
        """Return the same for a feedback."""
        feedback, errors, seen = dehyst.Feedback(self.loop), [], None
        said, told = None, []
        for k in range(cycles):
            error = np.empty(self.path.size)
            for i, wanted in enumerate(self.path.tolist()):
                y = self.plant.step(feedback.step(wanted, said))
                told.append(float(self.plant.measured(y)))
                faulty = sensor is not None and k >= FAULTY_FROM
                said = float(sensor(np.array(told[-SAMPLES:]), k)[-1]) if faulty else told[-1]
                error[i] = y - wanted
            errors.append(error)
            seen = k if seen is None and not feedback.believed else seen
        return np.array(errors), seen


def sensor_faults(rng: np.random.Generator) -> dict:
    """Twenty-seven faulty sensors: functions from the measured cycle (n,) [m] and its number to the reading."""
    middle = 0.5 * STROKE

    def noise(y: np.ndarray) -> np.ndarray:
        return rng.standard_normal(y.size)

    return {
        "inverted": lambda y, k: 2 * middle - y,
        "inverted about zero": lambda y, k: -y,
        "micrometres": lambda y, k: 1e6 * y,
        "nanometres": lambda y, k: 1e9 * y,
        "scaled by 10": lambda y, k: 10 * y,
        "scaled by 2.5": lambda y, k: 2.5 * y,
        "scaled by 0.3": lambda y, k: 0.3 * y,
        "scaled by 1.2": lambda y, k: 1.2 * y,
        "scaled by 0.3 about the middle": lambda y, k: middle + 0.3 * (y - middle),
        "zero": lambda y, k: 0 * y,
        "stuck in the middle": lambda y, k: 0 * y + middle,
        "stuck below": lambda y, k: 0 * y + 0.3 * STROKE,
        "saturated above": lambda y, k: np.minimum(y, 0.4 * STROKE),
        "saturated below": lambda y, k: np.maximum(y, 0.6 * STROKE),
        "folded": lambda y, k: middle + np.abs(y - middle),
        "late by a quarter": lambda y, k: np.roll(y, SAMPLES // 4),
        "late by a half": lambda y, k: np.roll(y, SAMPLES // 2),
        "early by a quarter": lambda y, k: np.roll(y, -SAMPLES // 4),
        "noise of the stroke": lambda y, k: middle + 0.3 * STROKE * noise(y),
        "noise in the middle": lambda y, k: middle + 0.01 * STROKE * noise(y),
        "noise of a tenth": lambda y, k: y + 0.1 * STROKE * noise(y),
        "NaN": lambda y, k: y + np.nan,
        "infinite": lambda y, k: y + np.inf,
        "NaN and infinite in turn": lambda y, k: np.where(np.arange(y.size) % 2, np.nan, -np.inf),
        "spikes in two of three": lambda y, k: np.where(rng.random(y.size) < 0.67, STROKE * noise(y), y),
        "zero moved by a fifth": lambda y, k: y + 0.2 * STROKE,
        "zero drifts by 1 % a cycle": lambda y, k: y + 0.01 * STROKE * (k - FAULTY_FROM + 1),
    }


def percent(errors: np.ndarray) -> dict[str, list[float]]:
    rms, largest = np.sqrt(np.mean(errors**2, axis=1)), np.abs(errors).max(axis=1)
    return {
        "rms": [round(float(100 * x / STROKE), 4) for x in rms],
        "largest": [float(100 * x / STROKE) for x in largest],
    }


def tracked(kind: str, model: dehyst.Actuator, seed: int) -> dict:
    path = triangle()
    found = {
        "frozen": percent(Bench(kind, model, path, seed).frozen(CYCLES)),
        "repetition": percent(Bench(kind, model, path, seed).repeated(CYCLES)[0]),
        "feedback": percent(Bench(kind, model, path, seed).fed_back(10)[0]),
        "noise": 100 * Plant(kind, seed).noise,
    }
    rms = found["repetition"]["rms"]
    found["tenth_of_first"], found["worst_of_first"] = rms[9] / rms[0], max(rms) / rms[0]
    return found


def faulty_sensors(model: dehyst.Actuator, seed: int) -> dict[str, dict]:
    """Return the largest errors after a fault is found, or else of all cycles, over those of the compensator alone."""
    path, found = triangle(), {}
    frozen = np.abs(Bench("resonance", model, path, seed).frozen(FAULTY_CYCLES)).max(axis=1)
    for name in sensor_faults(np.random.default_rng(seed)):
        row = found.setdefault(name, {})
        for how in ("repeated", "fed_back"):
            sensor = sensor_faults(np.random.default_rng(seed))[name]
            errors, seen = getattr(Bench("resonance", model, path, seed), how)(FAULTY_CYCLES, sensor)
            largest = np.abs(errors).max(axis=1)
            # The correction ends in the cycle after the one that was judged.
            after = slice(FAULTY_FROM if seen is None else min(seen + 2, FAULTY_CYCLES - 1), None)
            row[how] = {"seen_after": None if seen is None else seen - FAULTY_FROM + 1}
            row[how]["of_frozen"] = float((largest[after] / frozen[after]).max())
            row[how]["worst_of_frozen"] = float((largest / frozen).max())
    return found


def stable(seed: int) -> dict:
    """Feedback at rest on linear plants whose resonance is known to 3 %: how an error of 1 % of the stroke ends.

    There is a reading each period or each seventh, in time or a period late.
    """
    rng, worst, count = np.random.default_rng(seed), 0.0, 0
    spring = dehyst.Spring([0, STROKE], [0, HIGHEST])
    for quality in (5, 10, 25, 50, 100):
        for frequency in (1e3, 2e3, 5e3, 1e4, 2e4):
            for rate in (5e3, 1e4, 2e4):
                for preview, every, late in product((False, True), (1, 7), (0, 1)):
                    known = dehyst.Dynamics(frequency * (1 + 0.03 * rng.uniform(-1, 1)), 0.5 / quality)
                    model = dehyst.Actuator(dehyst.MaxwellSlip([], []), spring, dynamics=known)
                    try:
                        worst, count = (
                            max(worst, settled(model, (frequency, quality), 1 / rate, preview, every, late)),
                            count + 1,
                        )
                    except dehyst.ModelError:
                        # A preview needs some samples in each radian of the resonance.
                        continue
    return {"plants": count, "worst_left_of_1_percent": worst}


def settled(model, resonance, period: float, preview: bool, every: int, late: int) -> float:
    """Return the share of an error that remains at last; a reading comes each `every` periods, `late` periods late."""
    (frequency, quality), said = resonance, [0.51 * STROKE] * (late + 1)
    loop = dehyst.Compensator(model, LIMITS, period=period, preview=preview, state=turned(model, 0.5 * STROKE))
    feedback = dehyst.Feedback(loop)
    zeta = 0.5 / quality
    pole = 2 * np.pi * frequency * complex(-zeta, np.sqrt(1 - zeta**2))
    turn, weight = np.exp(pole * period), complex(1, -zeta / np.sqrt(1 - zeta**2))
    swing, pushed, y = 0j, 0.5 * STROKE, 0.5 * STROKE
    steps = int(min(60_000, 12 * every / feedback.gain + 20 * quality / (frequency * period)))
    left = []
    for k in range(steps):
        push = STROKE * feedback.step(0.5 * STROKE, None if k % every else said[0]) / HIGHEST
        swing, pushed = (swing + weight * (push - pushed)) * turn, push
        y = pushed - swing.real
        said = [*said[1:], y + 0.01 * STROKE]
        left.append(abs(y + 0.01 * STROKE - 0.5 * STROKE) / (0.01 * STROKE))
    return max(left[-steps // 10 :])


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure repetition and feedback; see the top of this file.")
    parser.add_argument("--seed", type=int, default=0)
    seed = parser.parse_args().seed
    warnings.simplefilter("ignore")
    found, models = {}, {}
    for kind in PLANTS:
        models[kind] = dehyst.identify(records(kind, seed)).actuator
        found[kind] = tracked(kind, models[kind], seed)
        row = found[kind]
        print(
            kind,
            row["tenth_of_first"],
            row["worst_of_first"],
            {k: row[k]["rms"][::3] for k in ("frozen", "repetition", "feedback")},
        )
    told = faulty_sensors(models["resonance"], seed)
    for name, row in told.items():
        print(f"{name:32}", row)
    steady = stable(seed)
    print(steady)
    OUTPUT.write_text(json.dumps({"plants": found, "lies": told, "stable": steady}, indent=1) + "\n")


if __name__ == "__main__":
    main()
