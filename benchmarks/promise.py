"""How often the promise of a model is kept, and how sharp it is. Writes `promise.json`.

Actuators with mechanisms that the model does not have are recorded and identified, and follow paths of five kinds in
the open loop, after a homing. A promise is kept if the largest error of the path, without its mean, is not above it. If
the records do not show whether actuator or sensor lags, a constant delay is subtracted too. It is sharp if it is not
much larger than the measured error. The second result is the error relative to the first sample of the path, as of a
sensor zeroed there: it must not exceed the promise plus the promised offset.

    python benchmarks/promise.py [found] [made] [--jobs N] [--rows FOLDER]

found  mechanisms on which the numbers in `dehyst.model.promise` were found; prints the factors they ask for
made   three more, made and run once when these numbers were final
"""

import argparse
import copy
import json
import sys
import zlib
from concurrent.futures import ProcessPoolExecutor
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

import dehyst
from dehyst import Record
from dehyst.model import simulated
from dehyst.model.promise import LARGEST, RMS
from dehyst.waveforms import Sampling, raised_cosine, recommended

sys.path.insert(0, str(Path(__file__).resolve().parent))
from strangers.disturbances import QUIET, Raw, Scale, filtered
from strangers.fresh_truths import FRESH
from strangers.more_truths import MORE, UNSEEN
from strangers.protocols import PROTOCOLS, Part, Protocol, branch_samples, random_turns, through
from strangers.truths import TRUTHS, Bench
from strangers.unspent_truths import UNSPENT

OUTPUT = Path(__file__).with_suffix(".json")
CONDITIONS = ("clean", "noise 0.3 %", "drift 2 %", "10 bit", "sensor filter", "unknown start")
KINDS = ("one sine", "triangles", "tops", "curves", "growing", "random", "tops and random", "staircase", "speeds")
SHARE = 0.9
PARTS = {"found": {**TRUTHS, **MORE, **UNSEEN, **FRESH}, "made": UNSPENT}
# Other protocols, and the recommended excitation as `dehyst excite` samples it by default.
DRIVE, FINE = Sampling(1.0, sample_rate=200.0), Sampling(1.0, sample_rate=1000.0)


def _tops_and_random(rng, fast):
    turns = [0.0, 1.0, 0.0, 1.0, *(t for top in np.linspace(0.85, 0.15, 5) for t in (0.0, top)), 0.0]
    turns += [*random_turns(rng, 24), 0.0]
    return [Part(through(turns, branch_samples(turns, 200)))]


def _triangles(rng, fast):
    turns = [0.0, 1.0, 0.0, 1.0, 0.0, *(t for top in (0.8, 0.6, 0.4, 0.2) for t in (top, 0.0, top, 0.0))]
    at = np.cumsum([0, *branch_samples(turns, 200)])
    return [Part(np.interp(np.arange(at[-1] + 1), at, turns))]


ALL_PROTOCOLS = {
    **PROTOCOLS,
    "recommended": Protocol("recommended", lambda rng, fast: [Part(recommended(1.0, drive=FINE).voltage)], 1000),
    "one sine": Protocol("one sine", lambda rng, fast: [Part(raised_cosine([1.0], cycles=4, drive=DRIVE).voltage)]),
    "triangles": Protocol("triangles", _triangles),
    "tops and random": Protocol("tops and random", _tops_and_random),
}


def joined(turns, counts):
    """Paths without velocity and acceleration at the turns."""
    branches = [np.array([turns[0]])]
    for (a, b), n in zip(pairwise(turns), counts, strict=True):
        w = np.arange(1, n + 1) / n
        branches.append(a + (b - a) * w**3 * (10 - 15 * w + 6 * w**2))
    return np.concatenate(branches)


def paths(rng, n):
    """Paths as parts of the stroke, by kind; `n` samples a period."""
    anywhere = [0.0, *random_turns(rng, 24, 0.03, 0.96)]
    inner = [0.0, 0.3, *random_turns(rng, 24, 0.3, 0.7)]
    loops = [0.0, *(x for c in (0.25, 0.5, 0.75, 0.4) for x in (c, *(c + 0.05, c - 0.05) * 4))]
    raster = [0.0, *(0.9, 0.1) * 8]
    levels = [*np.linspace(0, 0.9, 7), *np.linspace(0.75, 0.1, 6)]
    stairs = [np.zeros(1)]
    for a, b in pairwise(levels):
        stairs += [joined([a, b], [n // 8])[1:], np.full(n // 4, b)]
    return {
        "random": joined(anywhere, branch_samples(anywhere, n)),
        "inner": joined(inner, branch_samples(inner, n)),
        "loops": joined(loops, branch_samples(loops, n)),
        "raster": joined(raster, [n // 2] * (len(raster) - 1)),
        "stairs": np.concatenate(stairs),
    }


class Stage:
    """A truth on its bench, with all voltages that were played."""

    def __init__(self, truth):
        self.bench, self.truth, self.now, self.times, self.volts = Bench(truth), truth, 0.0, [], []

    def play(self, u, step):
        """Play u; return times, voltages and displacements."""
        time, volts = (
            self.now + step * np.arange(1, u.size + 1),
            self.truth.low + (self.truth.high - self.truth.low) * u,
        )
        self.now = float(time[-1])
        self.times.append(time)
        self.volts.append(volts)
        return time, volts, self.bench.play(time, volts)


def recorded(stage, protocol, condition, rng):
    """Play a protocol; return the records under a condition."""
    truth, n = stage.truth, protocol.samples
    parts = protocol.parts(rng("protocol"), truth.fast)
    step, fastest = truth.period / n, max(part.speed for part in parts)
    if condition == "unknown start":
        turns = [0.0, *random_turns(rng("start"), 5), parts[0].u[0]]
        stage.play(through(turns, branch_samples(turns, n)), step)
        stage.times, stage.volts = [], []
    elif parts[0].u[0]:
        stage.play(through([0.0, parts[0].u[0]], [n // 4]), step)
    noise, records = rng("disturbance"), []
    scale = Scale(truth.stroke, truth.high - truth.low, truth.period, truth.period / 200 / fastest)
    for k, part in enumerate(parts):
        time, volts, y = stage.play(part.u, step / part.speed)
        y = y + noise.normal(0, QUIET * truth.stroke, y.size)
        if condition == "noise 0.3 %":
            y = y + noise.normal(0, 0.003 * truth.stroke, y.size)
        elif condition == "drift 2 %":
            y = y + 0.02 * truth.stroke * (time - time[0]) / np.ptp(time)
        elif condition == "sensor filter":
            y = filtered(Raw(time, volts, y, ""), scale, noise)
        elif condition == "10 bit":
            bits = truth.stroke * 1.2 / 1023, (truth.high - truth.low) / 1023
            y, volts = (bit * np.round(column / bit) for bit, column in zip(bits, (y, volts), strict=True))
        records.append(Record(time, volts, y, f"{truth.name}-{k}"))
    return records, step


def case(job):
    """Identify one truth from one protocol under one condition, and follow all paths: a row for each."""
    name, kind, condition, seed = job
    truth, protocol = {**PARTS["found"], **UNSPENT}[name], ALL_PROTOCOLS[kind]
    about = {"truth": name, "protocol": kind, "condition": condition, "seed": seed}

    def rng(what):
        return np.random.default_rng([seed, zlib.crc32(f"{name}/{kind}/{condition}:{what}".encode())])

    stage = Stage(truth)
    records, step = recorded(stage, protocol, condition, rng)
    last = (stage.volts[-1][-1] - truth.low) / (truth.high - truth.low)
    homing = through([last, 0.0, 1.0, 0.0, 1.0, 0.0], [protocol.samples // 2] * 5)
    reached = float(np.ptp(stage.play(homing, step)[2][-protocol.samples :]))
    try:
        fit = dehyst.identify(records)
    except ValueError as error:
        return [{**about, "refused": str(error)}]
    model, rows = fit.actuator, []
    validity = model.identification.validity
    volts, times = np.concatenate(stage.volts), np.concatenate(stage.times)
    homed = simulated(model, volts, times)
    for path, u in paths(rng("path"), protocol.samples).items():
        when = stage.now + step * np.arange(u.size)
        wanted = float(homed.displacement[-1]) + reached * u
        ahead = CubicSpline(when, wanted)(np.minimum(when + model.delay, when[-1])) if model.delay else wanted
        plan = dehyst.plan_path(model, ahead, time=when, start=homed.state, home=False, on_time=False)
        sent = plan.voltage[plan.first :]
        error = (wanted - np.append(wanted[0], copy.deepcopy(stage.bench).play(when[1:], sent[1:])))[1:]
        found = plan.promise
        if found.delay:
            rate = np.gradient(wanted, when)[1:]
            error -= rate * np.polyfit(rate, error, 1)[0]
        zeroed = float(np.abs(error - error[0]).max())
        error -= error.mean()
        rows.append(
            {
                **about,
                "path": path,
                "largest": float(np.abs(error).max()),
                "rms": float(error.std()),
                "zeroed": zeroed,
                "promised_largest": found.largest,
                "promised_rms": found.rms,
                "promised_zeroed": found.largest + found.offset,
                "untested": [gap.what for gap in found.untested],
                "held_out": validity.rms,
                "shown": validity.largest,
                "disagreement": validity.disagreement,
                "lag": validity.lag,
                "stroke": validity.stroke,
                "clamped": float(np.mean(plan.clamped)),
                "ready": fit.promise.readiness.name,
            }
        )
    return rows


def summary(rows, by):
    """Return coverage and sharpness of rows by a key."""
    table = {}
    for value in dict.fromkeys(row[by] for row in rows) if by else [""]:
        own = [row for row in rows if not by or row[by] == value]
        ratio = np.array([row["promised_largest"] / row["largest"] for row in own])
        other = np.array([row["promised_rms"] / row["rms"] for row in own])
        table[value] = {
            "paths": len(own),
            "kept": float(np.mean(ratio >= 1)),
            "kept_rms": float(np.mean(other >= 1)),
            "kept_zeroed": float(np.mean([row["promised_zeroed"] >= row["zeroed"] for row in own])),
            "sharpness": float(np.exp(np.log(ratio).mean())),
            "sharpness_rms": float(np.exp(np.log(other).mean())),
            "over_three": float(np.mean(ratio > 3)),
            "missed_by_twice": float(np.mean(ratio < 0.5)),
            "ready_and_missed_by_twice": int(
                sum(row["ready"] == "READY" and row["largest"] > 2 * row["promised_largest"] for row in own)
            ),
        }
    return table


def jobs_of(truths, seed):
    """Return for each truth two conditions of the recommended excitation, and one of every second other protocol."""
    jobs = []
    for i, truth in enumerate(truths):
        jobs += [(truth, "recommended", CONDITIONS[(2 * i + 3 * k + seed) % 6], seed) for k in range(2)]
        for j, kind in enumerate(KINDS):
            if (i + j + seed) % 2 or len(truths) < 10:
                jobs.append((truth, kind, CONDITIONS[(i + j + seed) % 6], seed))
    return jobs


def measured(part, seed, jobs):
    """Return the rows of a part, and its entry in `promise.json`."""
    truths, rows = [*PARTS[part]], []
    with ProcessPoolExecutor(jobs) as pool:
        for found in pool.map(case, jobs_of(truths, seed)):
            rows += found
            print(*(found[0][key] for key in ("truth", "protocol", "condition")), flush=True)
    return rows, tables_of(rows, part, seed)


def tables_of(rows, part, seed):
    """Return the entry of `promise.json` for the rows of a part."""
    good = [row for row in rows if "largest" in row]
    tables = {by or "all": summary(good, by) for by in ("", "truth", "protocol", "condition", "path")}
    for by, table in tables.items():
        print(f"by {by}", *(f"{value} {count}" for value, count in table.items()), sep="\n  ")
    result = {"seed": seed, "refused": len(rows) - len(good), "tables": tables}
    return result | ({"factors": asked_for(good)} if part == "found" else {})


def asked_for(rows):
    """Return the factors of the largest and of the RMS error that suffice for `SHARE` of the rows."""
    found = {}
    for key, factor in (("largest", LARGEST), ("rms", RMS)):
        found[key] = factor * float(np.quantile([row[key] / row[f"promised_{key}"] for row in rows], SHARE))
    print(found)
    return found


def main():
    parser = argparse.ArgumentParser(description="Measure the promise; see the top of this file.")
    parser.add_argument("parts", nargs="*", help=f"of {', '.join(PARTS)}; default: all")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rows", type=Path, help="folder for all rows")
    given = parser.parse_args()
    results = json.loads(OUTPUT.read_text()) if OUTPUT.exists() else {}
    for part in given.parts or PARTS:
        if part not in PARTS:
            parser.error(f"no part '{part}'; try {' or '.join(PARTS)}")
        rows, results[part] = measured(part, given.seed, given.jobs)
        if given.rows:
            (given.rows / f"{part}.json").write_text(json.dumps(rows))
        OUTPUT.write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
