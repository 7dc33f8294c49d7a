"""Models of actuators that have aged, updated from one record. Writes `update.json`.

Truths by five mechanisms that no model has (`strangers/truths.py`). Each is identified when it is new. Then its gain
falls by 7 %, its loop widens by 25 % and its curve bends; its displacement at the lowest voltage stays. Errors are
those on another path of the aged actuator, in % of the stroke: of the old model, of `dehyst.update` from one record,
and of a model that is identified from new records.

    python benchmarks/update.py [--jobs J]
"""

import argparse
import json
import sys
import warnings
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

import dehyst

sys.path.insert(0, str(Path(__file__).resolve().parent))
from strangers.protocols import PROTOCOLS, through
from strangers.truths import TRUTHS, Bench

OUTPUT = Path(__file__).with_suffix(".json")
GAIN, WIDTH, BEND = -0.07, 0.25, 0.04
# Samples of a period of the truth.
SAMPLES = 200


# Arrays of a mechanism that are as large as its loop is wide.
WIDENED = {"StribeckSlip": ("friction",)}


class Ageing:
    """A mechanism whose gain, loop width and shape change with its `age`, from 0 (new) to 1.

    Its displacement at the lowest voltage of a slow major loop stays where it is.
    """

    def __init__(self, make, *, calibrated: bool = True) -> None:
        self.mechanism, self.age = make(), 0.0
        self.new = {key: np.copy(value) for key, value in vars(self.mechanism).items() if isinstance(value, np.ndarray)}
        self.ages, self.bottoms = np.linspace(0, 1, 5), np.zeros(5)
        if calibrated:
            self.bottoms = np.array([self._bottom(make, age) for age in self.ages])

    @staticmethod
    def _bottom(make, age: float) -> float:
        aged = Ageing(make, calibrated=False)
        aged.become(age)
        loops = np.tile(0.5 - 0.5 * np.cos(2 * np.pi * np.arange(1, 401) / 400), 4)
        return aged._bent(loops, np.full(loops.size, 1 / 400))[-1]

    def become(self, age: float) -> None:
        """Age."""
        self.age, wider, one = age, 1 + WIDTH * age, self.mechanism
        kind = type(one)
        if kind.__name__ == "Relays":
            centre, half = (0.5 * (self.new["up_at"] + sign * self.new["down_at"]) for sign in (1, -1))
            one.up_at, one.down_at = centre + wider * half, centre - wider * half
        elif kind.__name__ == "Domains":
            one.pinning = tuple(wider * pinning for pinning in kind.pinning)
        elif kind.__name__ in WIDENED:
            for name in WIDENED[kind.__name__]:
                setattr(one, name, wider * self.new[name])
        elif kind.__name__ == "Rayleigh":
            one.strength = wider * kind.strength
            one.reversible = kind.reversible - 0.9 * (wider - 1) * kind.strength
        else:
            one.strengths = tuple(wider * strength for strength in kind.strengths)

    def _bent(self, u, steps):
        y = self.mechanism.play(u, steps)
        return y + BEND * self.age * y * (1 - y**2)

    def play(self, u, steps):
        """Return the displacement (n,) for u (n,)."""
        rest = np.interp(self.age, self.ages, self.bottoms)
        return self.bottoms[0] + (1 + GAIN * self.age) * (self._bent(u, steps) - rest)


def aged_bench(name: str) -> Bench:
    """Return a bench whose mechanism is `Ageing`."""
    truth = TRUTHS[name]
    return Bench(replace(truth, mechanism=lambda: Ageing(truth.mechanism)))


def recorded(bench: Bench, parts, now: float, noise: float = 2e-4, seed: int = 1) -> tuple[list[dehyst.Record], float]:
    """Return records of parts of the voltage's range (n,), and the time at their end [s]."""
    truth, rng, records = bench.truth, np.random.default_rng(seed), []
    for part in parts:
        at = now + truth.period / SAMPLES * (1 + np.arange(part.size))
        now, voltage = at[-1], truth.low + (truth.high - truth.low) * part
        y = bench.play(at, voltage) + rng.normal(0, noise * truth.stroke, part.size)
        records.append(dehyst.Record(at, voltage, y, name=f"{truth.name} {len(records)}"))
    return records, now


def training(name: str) -> list[np.ndarray]:
    """Return descending tops, and of a truth that creeps a staircase too."""
    rng = np.random.default_rng(1)
    kinds = ("tops", "staircase") if "creep" in TRUTHS[name].parts else ("tops",)
    return [PROTOCOLS[kind].parts(rng, 1.0)[0].u for kind in kinds]


@cache
def identified(name: str) -> dehyst.Actuator:
    """Return the model of a new stage."""
    return dehyst.identify(recorded(aged_bench(name), training(name), 0.0)[0]).actuator


def updated(name: str) -> dict:
    """Return errors on a test path of an aged stage: old model, `update` from one loop, identified anew."""
    warnings.simplefilter("ignore")
    old, bench = identified(name), aged_bench(name)
    bench.mechanism.become(1.0)
    _, now = recorded(bench, [through([0, 1, 0, 1, 0], [100] * 4)], 0.0)
    loop, now = recorded(bench, [through([0, 1, 0, 0.5, 0.25, 0.5, 0], [100, 100, 50, 25, 25, 50])], now, seed=2)
    single, now = recorded(bench, [through([0, 1, 0], [100, 100])], now, seed=6)
    full, now = recorded(bench, training(name), now, seed=3)
    anew = dehyst.identify(full).actuator
    rng = np.random.default_rng(7)
    test = through(
        [
            0.0,
            *np.concatenate(
                [[hi, lo] for hi, lo in zip(rng.uniform(0.5, 0.95, 15), rng.uniform(0.05, 0.45, 15), strict=True)]
            ),
            0.0,
        ],
        [60] * 31,
    )
    test, _ = recorded(bench, [test], now, seed=4)
    found = {"truth": name}
    candidates = {"old": old, "anew": anew}
    for kind, record in (("one loop", single[0]), ("loop and minor loop", loop[0])):
        made = dehyst.update(old, record)
        candidates[kind] = made.actuator
        found[f"{kind}: what"] = made.sentence
    for kind, model in candidates.items():
        checked = dehyst.check(model, test[0])
        found[kind] = [100 * checked.largest / TRUTHS[name].stroke, 100 * checked.rms / TRUTHS[name].stroke]
    found["ratio"] = {
        kind: [a / b for a, b in zip(found[kind], found["anew"], strict=True)]
        for kind in ("old", "one loop", "loop and minor loop")
    }
    return found


def main() -> None:
    """Update each truth, and write the errors."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--jobs", type=int, default=2)
    with ProcessPoolExecutor(parser.parse_args().jobs) as pool:
        found = list(pool.map(updated, TRUTHS))
    print(*found, sep="\n")
    OUTPUT.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
