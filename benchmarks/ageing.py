"""Stages that have aged, checked and updated by a later record: `python benchmarks/ageing.py` writes `ageing.json`.

Each stage has a mechanism that no model has, and is identified when it is new. Then one to three of gain, loop width,
lag, zero and creep change. A stated change is false if it differs from the truth by more than twice its stated error. A
change of over 2 % of the stroke is missed if it is named neither alone nor together with others.
"""

import json
import warnings
from functools import cache
from pathlib import Path

import numpy as np
from strangers.protocols import branch_samples, random_turns, through
from strangers.truths import Domains

import dehyst
from dehyst.trust.changes import SLOW
from dehyst.waveforms.excitation import Excitation, Sampling
from dehyst.waveforms.standard import raised_cosine, recommended

# Range of voltages [V], stroke [m], period of a loop [s], sample rate [Hz], noise [of the stroke]; numbers of stages.
VOLTS, STROKE, PERIOD, RATE, NOISE, SEED, CHECKS, UPDATES = 100.0, 12e-6, 10.0, 40.0, 5e-4, 11, 60, 6
SINES, HALF = Sampling(1 / PERIOD, RATE), round(RATE * PERIOD / 2)
EXCITATION = recommended(VOLTS, drive=SINES)
LATER = {f"{n} sines": raised_cosine(VOLTS, cycles=n, drive=SINES) for n in (1, 2, 4)} | {"excitation": EXCITATION}
for cycles in (1, 2, 4):
    rises = 1 - np.abs(np.arange(2 * cycles * HALF + 1) / HALF % 2 - 1)
    LATER[f"{cycles} triangles"] = Excitation("triangles", VOLTS * rises, RATE)
TURNS = [0.0, 1.0, 0.0, 1.0, 0.0, *random_turns(np.random.default_rng(5), 24, 0.03, 0.96), 0.0]
PATH = Excitation("path", VOLTS * through(TURNS, branch_samples(TURNS, 400)), RATE)
# Changes: parts of gain and width, lag [s], zero and creep of a decade [of the stroke].
SIZES = {"gain": (0.01, 0.08), "width": (0.1, 0.5), "lag": (0.02, 0.15)}
SIZES |= {"zero": (0.005, 0.05), "creep": (0.003, 0.015)}


def relays(rng):
    """Return Preisach's relays of an asymmetric density, with steep edges: from u (n,) to displacements (n,)."""
    edge, reversible, bend = 0.01 * rng.uniform(0.5, 1.5), rng.uniform(0.4, 0.7), rng.uniform(-0.15, 0.15)
    centre = np.where(rng.random(1500) < 0.6, rng.normal(0.35, 0.2, 1500), rng.normal(0.7, 0.15, 1500))
    half = rng.gamma(2.0, rng.uniform(0.04, 0.07), 1500)

    def play(u, width):
        x, share = np.zeros(centre.size), np.empty(u.size)
        up, down = (np.clip((u[:, None] - centre - sign * width * half) / edge, 0, 1) for sign in (1, -1))
        for t in range(u.size):
            share[t] = np.clip(x, up[t], down[t], out=x).mean()
        return reversible * (u + bend * u * (1 - u)) + (1 - reversible) * share

    return play


def walls(rng):
    """Return populations of domain walls, each with its own pinning."""
    pinning = np.array(Domains.pinning) * rng.uniform(0.5, 1.1, 3)

    def play(u, width):
        domains = Domains()
        domains.pinning = tuple(width * pinning)
        return domains.play(u, u)

    return play


class Stage:
    """A stage of a mechanism, new or aged."""

    def __init__(self, name, seed):
        self.mechanism, self.scale = {"relays": relays, "walls": walls}[name](np.random.default_rng(seed)), 1.0
        self.scale = STROKE / np.ptp(self.still(LATER["2 sines"].voltage))

    def still(self, voltage, aged=None):
        """Return the displacement [m] after two loops, without lag and slow change."""
        aged, loops = aged or dict.fromkeys(SIZES, 0.0), LATER["2 sines"].voltage
        u = np.append(loops, voltage) / VOLTS
        y = self.scale * self.mechanism(u, 1 + aged["width"])[loops.size :]
        return (1 + aged["gain"]) * y + aged["zero"] * STROKE

    def record(self, excitation, aged=None, seed=0):
        """Return a record, and the slow change within it (n,) [m]."""
        rng, time, aged = np.random.default_rng(seed), excitation.time, aged or dict.fromkeys(SIZES, 0.0)
        acting = np.interp(time - aged["lag"], time, excitation.voltage)
        slow = aged["creep"] * STROKE * np.log10(1 + time / (PERIOD * rng.uniform(0.05, 0.3)))
        y = self.still(acting, aged) + slow + rng.normal(0, NOISE * STROKE, time.size)
        return dehyst.Record(time, excitation.voltage, y, name="later"), slow


@cache
def identified(name, seed):
    """Return a stage and its model when it is new."""
    stage = Stage(name, seed)
    return stage, dehyst.identify(stage.record(EXCITATION, seed=seed)[0]).actuator


def truth(stage, aged, excitation, slow):
    """Return the changes and their largest effects [m], by name, along a path without noise."""
    voltage, time, half = excitation.voltage, excitation.time, round(RATE * PERIOD / 2)
    new, old = stage.still(voltage, aged), stage.still(voltage)
    gain = np.ptp(new[half:]) / np.ptp(old[half:])
    areas = [abs(np.sum(np.diff(voltage) * (y[1:] + y[:-1]) / 2)) for y in (new, old)]
    found = {"gain": gain - 1, "width": areas[0] / areas[1] / gain - 1, "lag": aged["lag"]}
    for name, curve in (("drift", time / time[-1]), ("creep", np.log10(1 + time / (0.1 * PERIOD)))):
        rest, found[name] = np.linalg.lstsq(np.column_stack([np.ones(curve.size), curve]), slow, rcond=None)[0].tolist()
        found[f"zero beside {name}"] = new[-1] - old[-1] + rest
    bins, rising = np.round(voltage / 2).astype(int), np.gradient(voltage) > 0
    between = [np.ptp(new[bins == k]) if np.any(rising[bins == k]) else 0.0 for k in range(2, 49)]
    effects = {"gain": found["gain"] * np.ptp(new), "width": found["width"] * max(between) / 2}
    effects |= {"lag": aged["lag"] * np.abs(np.gradient(new, time)).max(), "zero": found["zero beside creep"]}
    effects["creep"] = found["creep"] * curve[-1]
    return found, {name: abs(effect) for name, effect in effects.items()}


def checked(name, own, aged, kind, seed):
    """Return the results of a check, (name, kind, value, error, truth, whether stated), and the missed changes."""
    (stage, model), excitation = identified(name, own), LATER[kind]
    record, slow = stage.record(excitation, aged, seed)
    *changes, shape = dehyst.check(model, record).changes
    true, most = truth(stage, aged, excitation, slow)
    slower, rows = next((change.name for change in changes if change.name in SLOW), "creep"), []
    for change in changes:
        together = min(change.value, sum(most["creep" if part == "drift" else part] for part in change.parts))
        right = true.get(f"zero beside {slower}" if change.name == "zero" else change.name, together)
        rows.append((change.name, kind, change.value, change.error, right, change.counts))
    named = {"creep" if part == "drift" else part for change in changes if change.counts for part in change.parts}
    large = [part for part, effect in most.items() if effect > 0.02 * STROKE]
    return rows, large, [(part, kind, aged, shape.counts) for part in large if part not in named]


def updated(name, own, aged, kind, seed):
    """Return largest and RMS errors [% of the stroke] on a random path: old, updated and new model."""
    (stage, old), changed = identified(name, own), {"gain": aged["gain"] or 0.05, "width": aged["width"] or 0.2}
    aged = dict.fromkeys(SIZES, 0.0) | changed
    made = dehyst.update(old, stage.record(LATER[kind], aged, seed)[0]).actuator
    anew = dehyst.identify(stage.record(EXCITATION, aged, seed + 1)[0]).actuator
    errors = (dehyst.check(model, stage.record(PATH, aged, seed + 2)[0]) for model in (old, made, anew))
    return [kind, *([100 * error.largest / STROKE, 100 * error.rms / STROKE] for error in errors)]


def main() -> None:
    """Check and update aged stages, and write the table."""
    warnings.simplefilter("ignore")
    rng, cases = np.random.default_rng(SEED), []
    for number in range(CHECKS):
        count = 0 if rng.random() < 0.125 else rng.integers(1, 4)
        some = rng.choice([*SIZES], count, replace=False, p=[0.3, 0.3, 0.15, 0.15, 0.1])
        signs = {name: 1 if name == "lag" else rng.choice([-1, 1]) for name in SIZES}
        aged = {name: float(rng.uniform(*SIZES[name]) * signs[name] * (name in some)) for name in SIZES}
        of = ("relays", "walls")[number % 2], SEED + number // 2 % 3, aged
        cases.append((*of, str(rng.choice([*LATER])), int(rng.integers(1 << 30))))
    found = [checked(*case) for case in cases]
    rows = [row for rows, _, _ in found for row in rows]
    beyond = [abs(value - true) > 2 * error for _, _, value, error, true, _ in rows]
    kept = {name: [not far for far, row in zip(beyond, rows, strict=True) if row[0] == name] for name in SIZES}
    table = {"truths": len(found), "stated": sum(row[-1] for row in rows)}
    table["false"] = [row for far, row in zip(beyond, rows, strict=True) if far and row[-1]]
    table["within two errors"] = {name: [sum(some), len(some)] for name, some in kept.items()}
    table["over 2 %"] = sum(len(large) for _, large, _ in found)
    table["missed"] = [x for *_, missed in found for x in missed]
    kinds = "2 sines", "4 triangles", "excitation"
    table["updates"] = [updated(*case[:3], kinds[k % 3], case[4]) for k, case in enumerate(cases[:UPDATES])]
    for kind in kinds:
        ratio = [np.divide(made, anew) for k, _, made, anew in table["updates"] if k == kind]
        table[f"update to anew, {kind}"] = np.median(ratio, axis=0).tolist(), np.max(ratio, axis=0).tolist()
    Path(__file__).with_suffix(".json").write_text(json.dumps(table, indent=1, default=float) + "\n")


if __name__ == "__main__":
    main()
