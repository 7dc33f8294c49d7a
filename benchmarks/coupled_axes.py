"""Stages of three coupled axes, each of another mechanism that no model is an instance of, identified and predicted.

Coupling of 2 to 6 % between all axes, noise, and a held-out record in which the axes move together; the same stages
with coupling that has hysteresis of its own must be found out. The truths set aside are of other mechanisms and other
seeds. `--set detection`: stages of two axes whose coupling of 3 % has hysteresis of its own on one side, or on none.
Writes `coupled_axes.json`.
"""

import argparse
import json
import time
from functools import partial
from pathlib import Path

import numpy as np
from strangers import last_truths, more_truths, truths
from virtual_trials import BoucWenActuator, PreisachActuator

import dehyst
from dehyst.records import Record
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, stage_excitation

OUTPUT = Path(__file__).parent / "coupled_axes.json"
HIGHEST = (100.0, 120.0, 100.0)
STROKES = (16e-6, 20e-6, 12e-6)
NOISE, FREQUENCY, RATE = 3e-9, 0.5, 50.0
# The coupling that has hysteresis: loops of a play operator, this much wider than those of the actuators.
WIDE = 0.9
PLAIN, BENT = (0, 1, 2), (3, 4)


def own(kind, stroke, highest):
    return kind(stroke=stroke, highest=highest, noise=0.0)


def strange(*kinds):
    """Return makers of actuators of the suite of strangers."""
    return [partial(truths.VirtualStranger, kind, rate=RATE) for kind in kinds]


# The model of no axis can follow the third set: elements of Bouc and Wen do not return to where a loop began.
SETS = {
    "truths": [partial(own, PlayActuator), partial(own, PreisachActuator), *strange(truths.Relays)],
    "set aside": strange(truths.Domains, truths.StribeckSlip, truths.Relays),
    "with Bouc-Wen": [partial(own, kind) for kind in (PlayActuator, PreisachActuator, BoucWenActuator)],
}
# Detection: seeds, coupling, mechanisms of the axes, and of the hysteretic coupling with this reversible share.
SEEDS, SIZE, REVERSIBLE = 20, 0.03, 0.1
AXES = [
    partial(own, PlayActuator),
    partial(own, PreisachActuator),
    *strange(truths.Relays, truths.StribeckSlip),
]
COUPLINGS = [truths.Domains, truths.Relays, more_truths.Moving, last_truths.ElasticLine, last_truths.Accommodating]
SHIFTS = {"truths": 0, "set aside": 50, "with Bouc-Wen": 80}


class VirtualStage:
    """Three actuators, their order and their coupling drawn by a seed; with `bent`, two couplings are hysteretic."""

    def __init__(self, kinds, seed, bent):
        rng = np.random.default_rng([18, seed])
        order = rng.permutation(3)
        self.actuators = [kinds[k](STROKES[j], HIGHEST[j]) for j, k in enumerate(order)]
        self.coupling = np.where(
            np.eye(3, dtype=bool), 1.0, rng.uniform(0.02, 0.06, (3, 3)) * rng.choice([-1, 1], (3, 3))
        )
        self.names = [type(getattr(one, "mechanism", one)).__name__ for one in self.actuators]
        self.rng = rng
        pairs = [(0, 1), (2, 0)] if bent else []
        self.bent = {
            (i, j): PlayActuator(stroke=STROKES[j], highest=HIGHEST[j], width=WIDE, noise=0.0) for i, j in pairs
        }

    def play(self, seconds, voltage):
        """Return the displacements (n, axes) [m] as measured."""
        moved = np.column_stack(
            [one.play(voltage[:, j], time=seconds, measured=False) for j, one in enumerate(self.actuators)]
        )
        y = moved @ self.coupling.T
        for (i, j), element in self.bent.items():
            other = element.play(voltage[:, j], time=seconds, measured=False)
            y[:, i] += self.coupling[i, j] * (other - moved[:, j])
        return y + self.rng.normal(0.0, NOISE, y.shape)


def records(stage, seed):
    """One cycle of all axes that is not recorded, the training record, and a held-out one with all axes together."""
    drive = Sampling(FREQUENCY, sample_rate=RATE)
    t = np.arange(0, 2.0, 1 / RATE)
    cycle = 0.5 * (1 - np.cos(np.pi * t))[:, None] * np.array(HIGHEST)
    stage.play(t, cycle)
    training = stage_excitation(HIGHEST, drive=drive, seed=seed)
    held = stage_excitation(
        [0.97 * top for top in HIGHEST], drive=Sampling(0.37, sample_rate=RATE), cycles=14, seed=100 + seed
    )
    _, first, stop = held.parts[-1]
    start = t[-1] + 1 / RATE
    one = _record(stage, start + training.time, training.voltage, "training")
    return one, _record(
        stage, one.time[-1] + 1 / RATE + held.time[: stop - first], held.voltage[first:stop], "held-out"
    )


def _record(stage, seconds, voltage, name):
    return Record(seconds, voltage, stage.play(seconds, voltage), name=name)


def measure(kinds, seed, bent):
    """Identify one stage, and each of its axes as if it was alone."""
    stage = VirtualStage(kinds, seed, bent)
    training, held = records(stage, seed)
    began = time.monotonic()
    fit = dehyst.identify_stage(training, validate=held)
    seconds = time.monotonic() - began
    strokes = np.ptp(training.displacement, axis=0)
    single, floor = [], []
    for j in range(3):
        exact = [one.axis(j, (one.displacement @ np.linalg.inv(stage.coupling).T)[:, j]) for one in (training, held)]
        by_itself = dehyst.identify(exact[0], validate=exact[1], throw=False)
        floor.append(100 * by_itself.errors[-1].settled_largest / strokes[j])
        alone = dehyst.identify(training.axis(j), validate=held.axis(j), throw=False)
        single.append(100 * alone.errors[-1].settled_largest / strokes[j])
    held_out = [error for error in fit.errors if error.role == "validation"]
    return {
        "seed": seed,
        "mechanisms": stage.names,
        "hysteretic_coupling": bent,
        "coupling": stage.coupling.tolist(),
        "matrix_error": float(np.abs(fit.coupling - stage.coupling)[~np.eye(3, dtype=bool)].max()),
        "matrix_error_in_standard_errors": float(
            (np.abs(fit.coupling - stage.coupling) / np.where(fit.uncertainty > 0, fit.uncertainty, np.inf)).max()
        ),
        "largest_percent": [error.largest_percent for error in held_out],
        "rms_percent": [error.rms_percent for error in held_out],
        "left_out": [error.left_out / (error.samples + error.left_out) for error in held_out],
        "single_axis_largest_percent": single,
        "uncoupled_largest_percent": floor,
        "is_matrix": fit.is_matrix,
        "residual_coupling_percent": (100 * fit.cross_talk.size).tolist(),
        "certainty": fit.cross_talk.certainty.tolist(),
        "rank_one_share": fit.rank_one_share.tolist(),
        "condition": fit.condition,
        "passes": fit.passes,
        "seconds": seconds,
    }


class TwoAxes:
    """Two actuators; `hysteretic`: the second one moves the first axis through a mechanism of its own."""

    def __init__(self, seed, hysteretic):
        rng = np.random.default_rng([29, seed])
        kinds = rng.choice(len(AXES), 2, replace=False)
        self.actuators = [AXES[kind](STROKES[j], HIGHEST[j]) for j, kind in enumerate(kinds)]
        self.coupling = np.eye(2) + SIZE * np.array([[0, 1], [1, 0]]) * rng.choice([-1, 1], (2, 2))
        self.element = wide(COUPLINGS[seed % len(COUPLINGS)]) if hysteretic else None
        self.names = [type(getattr(one, "mechanism", one)).__name__ for one in (*self.actuators, self.element) if one]
        self.rng, self.apart = rng, 0.0

    def play(self, seconds, voltage):
        """Return the displacements (n, axes) [m] as measured."""
        moved = np.column_stack(
            [one.play(voltage[:, j], time=seconds, measured=False) for j, one in enumerate(self.actuators)]
        )
        y = moved @ self.coupling.T
        if self.element is not None:
            other = self.element.play(voltage[:, 1], time=seconds)
            y[:, 0] += self.coupling[0, 1] * (other - moved[:, 1])
            # What no number describes, by the best of all numbers.
            h, g = moved[:, 1] - moved[:, 1].mean(), other - other.mean()
            self.apart = SIZE * float(np.std(g - h * (h @ g) / (h @ h))) / STROKES[0]
        return y + self.rng.normal(0.0, NOISE, y.shape)


def wide(kind):
    """Return a mechanism as an actuator of the second axis with hardly a reversible part: loops of twice the width."""

    def made():
        one = kind()
        one.reversible = REVERSIBLE
        return one

    cycle = np.tile(0.5 - 0.5 * np.cos(np.linspace(0, 2 * np.pi, 101)[1:]), 3)
    reached = made().play(cycle, np.full(cycle.size, 0.01))[100:]
    return truths.VirtualStranger(made, STROKES[1] / float(np.ptp(reached)), HIGHEST[1], rate=RATE)


def detect(seed, hysteretic):
    """Identify a stage of two axes, and return what is said of its coupling."""
    stage = TwoAxes(seed, hysteretic)
    drive = Sampling(FREQUENCY, sample_rate=RATE)
    t = np.arange(0, 2.0, 1 / RATE)
    stage.play(t, 0.5 * (1 - np.cos(np.pi * t))[:, None] * np.array(HIGHEST[:2]))
    training = stage_excitation(HIGHEST[:2], drive=drive, seed=seed)
    began = time.process_time()
    fit = dehyst.identify_stage(_record(stage, 2.0 + training.time, training.voltage, "training"), throw=False)
    talk = fit.cross_talk
    return {
        "seed": seed,
        "mechanisms": stage.names,
        "hysteretic_coupling": hysteretic,
        "no_number_percent": 100 * stage.apart,
        "is_matrix": fit.is_matrix,
        "beyond": talk.beyond.tolist(),
        "residual_coupling_percent": (100 * talk.size).tolist(),
        "certainty": talk.certainty.tolist(),
        "seconds": time.process_time() - began,
    }


def detection(seeds):
    """Return how often a hysteretic coupling is found, on the right side, and a linear one is accused."""
    rows = []
    for seed in range(seeds):
        for hysteretic in (True, False):
            rows.append(detect(seed, hysteretic))
            row = rows[-1]
            print(
                f"detection {seed} {'/'.join(row['mechanisms'])}: {row['no_number_percent']:.3f} % no number; left "
                f"{row['residual_coupling_percent'][0][1]:.3f} and {row['residual_coupling_percent'][1][0]:.3f} %, "
                f"certainty {row['certainty'][0][1]:.1f} and {row['certainty'][1][0]:.1f}, "
                f"{'a matrix' if row['is_matrix'] else 'no matrix'}, {row['seconds']:.0f} s",
                flush=True,
            )
    found = [row["beyond"] == [[False, True], [False, False]] for row in rows if row["hysteretic_coupling"]]
    accused = [not row["is_matrix"] for row in rows if not row["hysteretic_coupling"]]
    counts = {"found": sum(found), "of_hysteretic": len(found), "accused": sum(accused), "of_linear": len(accused)}
    print("detection", counts)
    return {"summary": counts, "stages": rows}


def summary(rows):
    plain, bent = ([row for row in rows if row["hysteretic_coupling"] is kind] for kind in (False, True))
    return {
        "matrix_error": max(row["matrix_error"] for row in plain),
        "largest_percent": max(max(row["largest_percent"]) for row in plain),
        "rms_percent": max(max(row["rms_percent"]) for row in plain),
        "uncoupled_largest_percent": max(max(row["uncoupled_largest_percent"]) for row in plain),
        "single_axis_largest_percent": min(max(row["single_axis_largest_percent"]) for row in plain),
        "matrices_reported_as_such": sum(row["is_matrix"] for row in plain),
        "of_matrices": len(plain),
        "hysteretic_found": sum(not row["is_matrix"] for row in bent),
        "of_hysteretic": len(bent),
        "seconds": max(row["seconds"] for row in rows),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--set", choices=[*SETS, "detection"], action="append", help="default: all")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="at most so many of each set")
    options = parser.parse_args()
    chosen = options.set or [*SETS, "detection"]
    found = json.loads(OUTPUT.read_text()) if OUTPUT.exists() and options.set else {}
    for name in chosen:
        if name == "detection":
            found[name] = detection(options.seeds)
            OUTPUT.write_text(json.dumps(found, indent=1) + "\n")
            continue
        shift = SHIFTS[name]
        cases = [(k, False) for k in PLAIN[: options.seeds]] + [(k, True) for k in BENT[: options.seeds]]
        rows = []
        for k, bent in cases:
            rows.append(measure(SETS[name], shift + k, bent))
            row = rows[-1]
            print(
                f"{name} {row['seed']} {'/'.join(row['mechanisms'])}{' hysteretic' if bent else ''}: matrix within "
                f"{row['matrix_error']:.5f}, largest {np.round(row['largest_percent'], 3)} %, RMS "
                f"{np.round(row['rms_percent'], 3)} %, uncoupled "
                f"{np.round(row['uncoupled_largest_percent'], 3)} %, single "
                f"{np.round(row['single_axis_largest_percent'], 1)} %, "
                f"{'a matrix' if row['is_matrix'] else 'no matrix'}, {row['seconds']:.0f} s",
                flush=True,
            )
        found[name] = {"summary": summary(rows), "stages": rows}
        print(name, json.dumps(found[name]["summary"], indent=1))
        OUTPUT.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
