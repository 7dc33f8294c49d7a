"""Creep that remains in a five-minute hold, on truths whose creep no model has. Writes `creep.json`.

    python benchmarks/creep.py [--seeds N]

Each truth is recorded by README's excitation and by a staircase with holds of a minute, identified, and moved by 60 %
of its stroke within two seconds, in the open loop, to a displacement that is to be held for five minutes. The creep is
the growth of the displacement in these five minutes at a constant voltage; the remaining creep is the growth with the
voltages of the model, relative to it.
"""

import argparse
import copy
import json
import time
from pathlib import Path

import numpy as np

import dehyst
from dehyst import Record
from dehyst.identification import state_after
from dehyst.waveforms import Sampling, recommended, staircase

OUTPUT = Path(__file__).with_suffix(".json")
HIGHEST, STROKE, NOISE = 100.0, 20e-6, 2e-4
PERIOD, RISE, HOLD, SHARE = 0.05, 2.0, 300.0, 0.6


class LaggingSwitches:
    """Relays of the voltage, each of which moves its domain with a delay of its own.

    The delays are log-uniform from 10 ms to 10 000 s, so that the switching part creeps with the logarithm of time, and
    the reversible part does not creep.
    """

    reversible = 0.6

    def __init__(self, rng, count=4000):
        half = rng.gamma(2.0, 0.06, 4 * count)
        centre = rng.normal(0.45, 0.2, half.size)
        inside = (centre + half < 1) & (centre - half > 0)
        self.up_at, self.down_at = (centre + half)[inside][:count], (centre - half)[inside][:count]
        size = self.up_at.size
        self.tau = 10 ** rng.uniform(-2, 4, size)
        # Most of a domain moves at once.
        self.at_once = rng.uniform(0.6, 1.0, size)
        self.up, self.moved = np.zeros(size), np.zeros(size)

    def play(self, u, steps):
        """Return the displacement (n,), about 0 to 1, for u (n,) in 0 to 1 and steps (n,) [s]."""
        reached = np.empty(u.size)
        for t, (now, step) in enumerate(zip(u.tolist(), steps.tolist(), strict=True)):
            self.up[self.up_at <= now] = 1.0
            self.up[self.down_at >= now] = 0.0
            self.moved += (self.up - self.moved) * -np.expm1(-step / self.tau)
            reached[t] = np.mean(self.at_once * self.up + (1 - self.at_once) * self.moved)
        return self.reversible * (u + 0.1 * u * (u - 1)) + (1 - self.reversible) * reached


class RelaxingPreload:
    """Asymmetric plays of the voltage that push against a preload of rubber, whose force relaxes.

    The rubber stiffens with its strain e: its force is a curve of e minus the relaxed force of ten Maxwell branches of
    ``e + e^2``, 50 ms to 2000 s.
    """

    def __init__(self, rng, count=60):
        self.radius = np.geomspace(0.004, 0.42, count)
        self.weight = rng.uniform(1.2, 1.6) * np.exp(-5 * self.radius) * np.gradient(self.radius)
        self.z = np.zeros(count)
        self.bend = rng.uniform(1.3, 1.9)
        self.tau = np.geomspace(0.05, 2000.0, 10)
        self.stiffness, self.slow = rng.uniform(0.025, 0.04), np.zeros(10)

    def play(self, u, steps):
        """Return the displacement (n,), about 0 to 1, for u (n,) in 0 to 1 and steps (n,) [s]."""
        reached = np.empty(u.size)
        rising, falling = np.tanh(self.bend * u - 0.1), 0.93 * np.tanh(0.85 * self.bend * u + 0.05) + 0.02 * u
        y = 0.0
        for t, step in enumerate(steps.tolist()):
            self.z = np.maximum(rising[t] - self.radius, np.minimum(falling[t] + self.radius, self.z))
            free = 0.6 * u[t] + float(self.weight @ self.z)
            kept = np.exp(-step / self.tau)
            for _ in range(4):
                strain = y + y * y
                slow = kept * self.slow + (1 - kept) * strain
                y = free - self.stiffness * float(np.mean(strain - slow)) * self.tau.size / 5
            self.slow = slow
            reached[t] = y
        return reached


class ThermalRelays:
    """Relays that switch by thermal activation over barriers: faster loops are wider, and a hold creeps.

    A relay follows its side at the rate ``exp((|field| - barrier) / width)`` per second, of a field that the relay's
    bias shifts; the barriers have two peaks.
    """

    reversible = 0.7

    def __init__(self, rng, count=600):
        low = rng.random(count) < 0.6
        self.barrier = np.where(low, rng.gamma(4.0, 0.02, count), rng.gamma(9.0, 0.025, count))
        self.bias = rng.normal(0.48, 0.2, count)
        self.width = rng.uniform(0.008, 0.014)
        self.side, self.u = np.full(count, -1.0), 0.0

    def play(self, u, steps):
        """Return the displacement (n,), about 0 to 1, for u (n,) in 0 to 1 and steps (n,) [s]."""
        mean = np.empty(u.size)
        for t, (now, step) in enumerate(zip(u.tolist(), steps.tolist(), strict=True)):
            parts = max(1, round(abs(now - self.u) / 0.01))
            for k in range(1, parts + 1):
                field = self.u + (now - self.u) * k / parts - self.bias
                rate = np.exp(np.minimum((np.abs(field) - self.barrier) / self.width, 40.0)) / 20
                self.side += (np.sign(field) - self.side) * -np.expm1(-rate * step / parts)
            self.u = now
            mean[t] = self.side.mean()
        return self.reversible * (u + 0.15 * u * (u - 1)) + (1 - self.reversible) * 0.5 * (1 + mean)


TRUTHS = {kind.__name__: kind for kind in (LaggingSwitches, RelaxingPreload, ThermalRelays)}


class Stage:
    """A truth at rest at 0 V; time goes on from one call to the next."""

    def __init__(self, truth, rng):
        self.mechanism, self.time = truth(rng), 0.0
        self.mechanism.play(np.zeros(20), np.full(20, 1000.0))
        self.zero = float(self.mechanism.play(np.zeros(1), np.ones(1))[0])

    def play(self, time, voltage):
        """Return the displacement (n,) [m] at times (n,) [s] after the last one."""
        steps = np.diff(time, prepend=0.0)
        return STROKE * (self.mechanism.play(voltage / HIGHEST, np.maximum(steps, 1e-9)) - self.zero)


def recorded(stage, rng):
    """README's excitation, then a staircase with holds of a minute."""
    drive = Sampling(frequency=0.1, sample_rate=1 / PERIOD, limits=(0.0, HIGHEST))
    records = []
    for excitation in (
        recommended(HIGHEST, drive=drive),
        staircase(HIGHEST, back=True, drive=drive),
    ):
        y = stage.play(excitation.time + PERIOD, excitation.voltage)
        y = y + rng.normal(0, NOISE * STROKE, y.size)
        records.append(Record(excitation.time, excitation.voltage, y, excitation.name))
    return records


def held(stage, actuator, last):
    """Return the creep of a five-minute hold [m] at a constant voltage, and the creep with a model's voltages (n,)."""
    (start, _), (low, high) = state_after(actuator, last), np.quantile(last.displacement, [0.002, 0.998])
    begin = float(last.displacement[-20:].mean())
    s = np.arange(1, round(RISE / PERIOD) + 1) / round(RISE / PERIOD)
    rise = begin + (low + SHARE * (high - low) - begin) * s**3 * (10 - 15 * s + 6 * s**2)
    wanted = np.append(rise, np.full(round(HOLD / PERIOD), rise[-1]))
    clock = PERIOD * np.arange(wanted.size + 1)
    wanted = np.append(begin, wanted)
    path = actuator.compensate(wanted, time=clock, state=start, extrapolate=True)
    voltage = np.clip(path.voltage[1:], 0.0, HIGHEST)
    constant = np.where(np.arange(voltage.size) < s.size, voltage, voltage[s.size - 1])
    kept, followed = (copy.deepcopy(stage).play(clock[1:], played)[s.size - 1 :] for played in (constant, voltage))
    return kept[-1] - kept[0], followed - followed[0], rise[-1] - begin


def trial(name, seed):
    """Record, identify, hold: a row."""
    rng = np.random.default_rng([seed, 19, len(name)])
    stage = Stage(TRUTHS[name], rng)
    records = recorded(stage, rng)
    begin = time.process_time()
    fit = dehyst.identify(records)
    seconds = time.process_time() - begin
    creep, followed, step = held(stage, fit.actuator, records[-1])
    return {
        "truth": name,
        "seed": seed,
        "creep_percent_of_step": round(100 * creep / step, 2),
        "found": fit.actuator.displacement_creep is not None,
        "left_percent": round(100 * followed[-1] / creep, 1),
        "most_left_percent": round(100 * float(np.abs(followed).max()) / abs(creep), 1),
        "rms_percent": [round(error.rms_percent, 3) for error in fit.errors],
        "cpu_s": round(seconds, 1),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=20, help="first seed")
    parser.add_argument("--truths", nargs="*", default=list(TRUTHS), choices=list(TRUTHS))
    options = parser.parse_args()
    rows = []
    for name in options.truths:
        for seed in range(options.first, options.first + options.seeds):
            rows.append(trial(name, seed))
            print(json.dumps(rows[-1]), flush=True)
    table = {
        "seeds": options.seeds,
        "hold_s": HOLD,
        "rows": rows,
    }
    OUTPUT.write_text(json.dumps(table, indent=1) + "\n")


if __name__ == "__main__":
    main()
