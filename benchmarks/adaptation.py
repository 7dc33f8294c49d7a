"""A model in use for 200 cycles: stages that age, with sensors that are good, bad and absent. Writes `adaptation.json`.

Truths by five mechanisms that no model has (`strangers/truths.py`). Each is identified when it is new, and then follows
200 cycles of four turns: by `Compensator` with that model (frozen), and by `AdaptiveCompensator`. While it ages, its
gain falls by 7 %, its loop widens by 25 % and its curve bends; its displacement at the lowest voltage stays. Errors are
the true ones, in % of the reach of the model.

    python benchmarks/adaptation.py [--only PART ...] [--cycles N] [--lives N] [--jobs J]

Parts: life (the scenarios), unseen (some of them, of other truths), update (`dehyst.update` from one record), lives
(random limits, paths and sensors that lie:
voltages outside limits and slew rate are counted), cost (of a step). Parts that were not run keep their figures.
"""

import argparse
import json
import sys
import time
import warnings
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np

import dehyst
from dehyst.model.states import looped
from dehyst.virtual import PlayActuator

sys.path.insert(0, str(Path(__file__).resolve().parent))
from strangers.newest_truths import NEWEST
from strangers.protocols import PROTOCOLS, through
from strangers.truths import TRUTHS, Bench

OUTPUT = Path(__file__).with_suffix(".json")
GAIN, WIDTH, BEND = -0.07, 0.25, 0.04
# Samples of a period of the truth, and of a leg over the whole reach.
SAMPLES, LEG = 200, 100


# Arrays of a mechanism that are as large as its loop is wide.
WIDENED = {"StribeckSlip": ("friction",), "RandomField": ("half",), "Cascade": ("width_1", "width_2")}
ALL = TRUTHS | NEWEST


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
        elif kind.__name__ == "Softening":
            one.compliance = wider * kind.compliance
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
    truth = ALL[name]
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
    kinds = ("tops", "staircase") if "creep" in ALL[name].parts else ("tops",)
    return [PROTOCOLS[kind].parts(rng, 1.0)[0].u for kind in kinds]


@cache
def identified(name: str) -> dehyst.Actuator:
    """Return the model of a new stage."""
    return dehyst.identify(recorded(aged_bench(name), training(name), 0.0)[0]).actuator


def cycle_of(rng: np.random.Generator, before: float, *, small: bool) -> np.ndarray:
    """Return a cycle of four turns, as parts of the reach; a small one turns between 0.4 and 0.58."""
    low, high = ([0.40, 0.53, 0.40, 0.53], 0.05) if small else ([0.84, 0.30, 0.60, 0.03], 0.05)
    spread = np.array([1, 1, 1, 1]) if small else np.array([1, 6, 4, 1])
    order = [1, 0, 3, 2] if small else [0, 1, 2, 3]
    turns = [before, *(np.array(low)[order] + high * spread[order] * rng.random(4))]
    legs = [max(8, round(LEG * abs(b - a))) for a, b in pairwise(turns)]
    return through(turns, legs)[1:]


# Scenarios: whether it ages, and what the sensor gives of a displacement y [parts of the stroke] in cycle k of n.
def _drifts(y, k, n, rng):
    return y + 0.02 * k / n


def _noisy(y, k, n, rng):
    return y + 0.005 * rng.normal()


def _gone(y, k, n, rng):
    return None if n // 2 <= k < n // 2 + max(n // 10, 1) else y


SCENARIOS = {
    "ages": (True, None),
    "does not age": (False, None),
    "ages, noise 0.5 %": (True, _noisy),
    "noise 0.5 %": (False, _noisy),
    "ages, sensor drifts by 2 %": (True, _drifts),
    "sensor drifts by 2 %": (False, _drifts),
    "ages, no sensor for a tenth": (True, _gone),
    "ages, small paths, then large": (True, None),
    "load added at half time": (False, None),
    "sensor inverted": (False, lambda y, k, n, rng: 1 - y),
    "sensor stuck": (False, lambda y, k, n, rng: 0.4),
}
UNSEEN = ("ages", "does not age", "ages, noise 0.5 %", "noise 0.5 %", "sensor drifts by 2 %")


def life(name: str, scenario: str, cycles: int, *, adaptive: bool, late: int = 0) -> dict:
    """Return largest and RMS error of each cycle in % of the reach, and what was done; `late`: delay of the sensor."""
    model, bench, (ages, sensor) = identified(name), aged_bench(name), SCENARIOS.get(scenario, (False, None))
    truth, rng, sense = bench.truth, np.random.default_rng(3), np.random.default_rng(5)
    step, now = truth.period / SAMPLES, 2 * truth.period
    loops = truth.low + (truth.high - truth.low) * (0.5 - 0.5 * np.cos(2 * np.pi * np.arange(1, 401) / 200))
    bench.play(step * np.arange(1, 401), loops)
    limits, (low, high) = (truth.low, truth.high), model.reach
    options = {"period": step, "state": looped(model, limits, rising=False), "warns": False}
    loop = (dehyst.AdaptiveCompensator if adaptive else dehyst.Compensator)(model, limits, **options)
    y, before, errors, seen = None, 0.03, [], []
    for k in range(cycles):
        if ages:
            bench.mechanism.become(k / max(cycles - 1, 1))
        path = cycle_of(rng, before, small="small" in scenario and k < 0.8 * cycles)
        before, error = path[-1], np.empty(path.size)
        for i, part in enumerate(path):
            wanted = low + (high - low) * part
            if adaptive:
                measured = None
                if y is not None:
                    seen = [*seen[-late:], y] if late else [y]
                    measured = seen[0] / truth.stroke
                    measured = measured if sensor is None else sensor(measured, k, cycles, sense)
                    measured = None if measured is None else measured * truth.stroke
                voltage = loop.step(wanted, measured)
            else:
                voltage = loop.step(wanted)
            now += step
            y = float(bench.play(np.array([now]), np.array([voltage]))[0])
            if "load" in scenario and k >= cycles // 2:
                y -= 0.03 * truth.stroke
            error[i] = 100 * (y - wanted) / (high - low)
        errors.append((np.abs(error).max(), np.sqrt(np.mean(error**2))))
    found = {"largest": [row[0] for row in errors], "rms": [row[1] for row in errors]}
    if adaptive:
        found |= {
            "exchanges": sum(one.used for one in loop.log),
            "cycles": len(loop.log),
            "datum": 100 * loop.datum / (high - low),
        }
        found["reasons"] = {
            reason: [one.reason.split(":")[0] for one in loop.log].count(reason)
            for reason in {one.reason.split(":")[0] for one in loop.log}
        }
    return found


def compared(case: tuple[str, str, int]) -> dict:
    """Return the figures of a truth and a scenario."""
    name, scenario, cycles = case
    warnings.simplefilter("ignore")
    late = int(scenario.split()[-2]) if "late" in scenario else 0
    frozen = life(name, scenario, cycles, adaptive=False)
    own = life(name, scenario, cycles, adaptive=True, late=late)
    a, f = np.array(own["largest"]), np.array(frozen["largest"])
    last, usual = slice(-max(cycles // 20, 1), None), np.median(f[: max(cycles // 10, 1)])
    return {
        "truth": name,
        "scenario": scenario,
        "cycles": cycles,
        "frozen_end": [float(f[last].mean()), float(np.mean(frozen["rms"][last]))],
        "adaptive_end": [float(a[last].mean()), float(np.mean(own["rms"][last]))],
        "end_ratio": float(a[last].mean() / f[last].mean()),
        "life_ratio": float(a.max() / f.max()),
        "mean_ratio": float(a.mean() / f.mean()),
        "worst_cycle_ratio": float((a / np.maximum(f, usual)).max()),
        "worst_cycle_ratio_raw": float((a / f).max()),
        **{key: own[key] for key in ("exchanges", "cycles", "datum", "reasons")},
    }


def lives(seeds: range, samples: int = 1500) -> dict:
    """Count voltages outside limits or slew rate in random lives with sensors that lie after a third of them."""
    warnings.simplefilter("ignore")
    model = identified_play()
    outside = steep = steps = used = 0
    for seed in seeds:
        rng = np.random.default_rng(seed)
        plant = PlayActuator(seed=seed)
        width = model.limits[1] - model.limits[0]
        ends = np.sort(model.limits[0] + width * rng.random(2))
        low, high = float(ends[0]), float(ends[1] + 0.05 * width)
        slew = None if rng.random() < 0.3 else float(width * 10 ** rng.uniform(0, 3))
        loop = dehyst.AdaptiveCompensator(
            model,
            (low, high),
            slew,
            period=1e-3,
            warns=False,
            memory=float(1.5 + 10 * rng.random()),
            zero_drifts=bool(rng.random() < 0.5),
            integral_time=None if rng.random() < 0.5 else float(10 ** rng.uniform(-3, 0)),
        )
        bottom, top = model.reach
        turns = rng.uniform(-0.2, 1.2, samples // 20)
        path = bottom + (top - bottom) * np.interp(np.arange(samples), np.arange(turns.size) * 20, turns)
        kind, late, stuck = rng.integers(7), int(rng.integers(1, 30)), 0.0
        before, seen, y = loop.voltage, [], None
        for i, wanted in enumerate(path.tolist()):
            measured = y
            if y is not None:
                seen.append(y)
                if 3 * i < samples:
                    pass
                elif kind == 1:
                    measured = None if rng.random() < 0.5 else float("nan")
                elif kind == 2:
                    measured = stuck = stuck if i % 100 else y
                elif kind == 3:
                    measured = top - y
                elif kind == 4:
                    measured = seen[-min(late, len(seen))]
                elif kind == 5:
                    measured = float(rng.choice([1e30, -1e30, np.inf, y, 0.0]))
                elif kind == 6:
                    measured = y * rng.uniform(0.7, 1.4) + 0.3 * top * rng.normal()
            voltage = loop.step(wanted, measured)
            outside += not low <= voltage <= high
            steep += slew is not None and abs(voltage - before) > slew * 1e-3 * (1 + 1e-9) + 1e-9
            before, steps = voltage, steps + 1
            y = float(plant.play([voltage], time=[(i + 1) * 1e-3])[0])
        used += sum(one.used for one in loop.log)
    return {"lives": len(seeds), "steps": steps, "outside": int(outside), "steep": int(steep), "exchanges": int(used)}


@cache
def identified_play() -> dehyst.Actuator:
    """Return the Maxwell-slip model of a virtual actuator of plays."""
    u = training("relays")[0]
    at = 1e-3 * np.arange(u.size)
    plant = PlayActuator(seed=0)
    record = dehyst.Record(at, 200 * u, plant.play(200 * u, time=at), name="plays")
    return dehyst.identify(record, structure="maxwell_slip", elements=10).actuator


def cost(steps: int = 100_000) -> dict:
    """Return the time of a step [us]: median and worst, with learning, of two models, and of `Compensator`."""
    found = {}
    for name, model in (("Maxwell-slip, 10 elements", identified_play()), ("graded", identified("relays"))):
        low, high = model.reach
        path = (low + (high - low) * (0.5 - 0.45 * np.cos(2 * np.pi * np.arange(steps) / 1000))).tolist()
        plain = dehyst.Compensator(model, period=1e-3, warns=False)
        loop = dehyst.AdaptiveCompensator(model, period=1e-3, warns=False)
        aged = 0.97
        steps_of = {"plain": lambda wanted, _, step=plain.step: step(wanted), "adaptive": loop.step}
        for kind, step in steps_of.items():
            spent, last = np.empty(steps), low
            for i, wanted in enumerate(path):
                begin = time.perf_counter()
                step(wanted, last)
                spent[i] = time.perf_counter() - begin
                last = low + aged * (wanted - low)
            key = f"{name}, {kind}"
            found[key] = {
                "median_us": 1e6 * float(np.median(spent)),
                "mean_us": 1e6 * float(spent.mean()),
                "p9999_us": 1e6 * float(np.quantile(spent, 0.9999)),
                "worst_us": 1e6 * float(spent.max()),
            }
        found[f"{name}, adaptive"]["exchanges"] = sum(one.used for one in loop.log)
    return found


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
    """Run the parts that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    every = ("life", "unseen", "update", "lives", "cost")
    parser.add_argument("--only", nargs="+", choices=every)
    parser.add_argument("--scenarios", nargs="+", help="some of them; the file is not written then")
    parser.add_argument("--cycles", type=int, default=200)
    parser.add_argument("--lives", type=int, default=10_000)
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    parts = options.only or every
    data = json.loads(OUTPUT.read_text()) if OUTPUT.exists() else {}
    with ProcessPoolExecutor(options.jobs) as pool:
        late = [f"sensor late by {n} samples" for n in (2, 10)]
        for part, truths, scenarios in (("life", TRUTHS, (*SCENARIOS, *late)), ("unseen", NEWEST, UNSEEN)):
            if part not in parts:
                continue
            cases = [(name, one, options.cycles) for one in options.scenarios or scenarios for name in truths]
            data[part] = []
            for one in pool.map(compared, cases):
                data[part].append(one)
                print(
                    f"{one['truth']:12s} {one['scenario']:30s} end {one['adaptive_end'][0]:.2f} of "
                    f"{one['frozen_end'][0]:.2f} = {one['end_ratio']:.3f}, life {one['life_ratio']:.2f}, "
                    f"mean {one['mean_ratio']:.2f}, cycle "
                    f"{one['worst_cycle_ratio']:.2f} ({one['worst_cycle_ratio_raw']:.2f}), {one['exchanges']} of "
                    f"{one['cycles']}, datum {one['datum']:.2f} {one['reasons']}",
                    flush=True,
                )
        if "update" in parts:
            data["update"] = list(pool.map(updated, TRUTHS))
            print(*data["update"], sep="\n")
        if "lives" in parts:
            size = 250
            runs = pool.map(
                lives, [range(first, min(first + size, options.lives)) for first in range(0, options.lives, size)]
            )
            total: dict[str, int] = {}
            for one in runs:
                total = {key: total.get(key, 0) + value for key, value in one.items()}
            data["lives"] = total
            print(total)
    if "cost" in parts:
        data["cost"] = cost()
        print(json.dumps(data["cost"], indent=1))
    if not options.scenarios:
        OUTPUT.write_text(json.dumps(data, indent=1) + "\n")


if __name__ == "__main__":
    main()
