"""Stages of three coupled axes, each with another mechanism, which no model has, identified and predicted.

Coupling of 2 to 6 % between all axes, noise, and a held-out record in which the axes move together. The truths for the
final test have other mechanisms and other seeds. Writes `coupled_axes.json`.
"""

import argparse
import json
import time
from functools import partial
from pathlib import Path

import numpy as np
from strangers import truths
from virtual_trials import BoucWenActuator, PreisachActuator

import dehyst
from dehyst.records import Record
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, stage_excitation

OUTPUT = Path(__file__).parent / "coupled_axes.json"
HIGHEST = (100.0, 120.0, 100.0)
STROKES = (16e-6, 20e-6, 12e-6)
NOISE, FREQUENCY, RATE = 3e-9, 0.5, 50.0
SEEDS = 3


def own(kind, stroke, highest):
    return kind(stroke=stroke, highest=highest, noise=0.0)


def strange(*kinds):
    """Return makers of actuators of the suite of strangers."""
    return [partial(truths.VirtualStranger, kind, rate=RATE) for kind in kinds]


# No model can follow the third set: elements of Bouc and Wen do not return to the beginning of a loop.
SETS = {
    "truths": [partial(own, PlayActuator), partial(own, PreisachActuator), *strange(truths.Relays)],
    "set aside": strange(truths.Domains, truths.StribeckSlip, truths.Relays),
    "with Bouc-Wen": [partial(own, kind) for kind in (PlayActuator, PreisachActuator, BoucWenActuator)],
}
SHIFTS = {"truths": 0, "set aside": 50, "with Bouc-Wen": 80}


class VirtualStage:
    """Three actuators, their order and their coupling drawn by a seed."""

    def __init__(self, kinds, seed):
        rng = np.random.default_rng([18, seed])
        order = rng.permutation(3)
        self.actuators = [kinds[k](STROKES[j], HIGHEST[j]) for j, k in enumerate(order)]
        self.coupling = np.where(
            np.eye(3, dtype=bool), 1.0, rng.uniform(0.02, 0.06, (3, 3)) * rng.choice([-1, 1], (3, 3))
        )
        self.names = [type(getattr(actuator, "mechanism", actuator)).__name__ for actuator in self.actuators]
        self.rng = rng

    def play(self, seconds, voltage):
        """Return the measured displacements (n, axes) [m]."""
        moved = np.column_stack(
            [actuator.play(voltage[:, j], time=seconds, measured=False) for j, actuator in enumerate(self.actuators)]
        )
        return moved @ self.coupling.T + self.rng.normal(0.0, NOISE, moved.shape)


def records(stage, seed):
    """Return the training record, after one cycle of all axes, and a held-out record of all axes together."""
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
    record = _record(stage, start + training.time, training.voltage, "training")
    return record, _record(
        stage, record.time[-1] + 1 / RATE + held.time[: stop - first], held.voltage[first:stop], "held-out"
    )


def _record(stage, seconds, voltage, name):
    return Record(seconds, voltage, stage.play(seconds, voltage), name=name)


def measure(kinds, seed):
    """Identify a stage, and each of its axes alone."""
    stage = VirtualStage(kinds, seed)
    training, held = records(stage, seed)
    began = time.monotonic()
    fit = dehyst.identify(training, validate=held)
    seconds = time.monotonic() - began
    strokes, decoupling = np.ptp(training.displacement, axis=0), np.linalg.inv(stage.coupling).T
    single, floor = [], []
    for j in range(3):
        exact = [Record(r.time, r.voltage[:, j], (r.displacement @ decoupling)[:, j]) for r in (training, held)]
        by_itself = dehyst.identify(exact[0], validate=exact[1])
        floor.append(100 * by_itself.errors[-1].settled_largest / strokes[j])
        alone = dehyst.identify(training.axis(j), validate=held.axis(j))
        single.append(100 * alone.errors[-1].settled_largest / strokes[j])
    held_out = [error for error in fit.errors if error.role == "validation"]
    return {
        "seed": seed,
        "mechanisms": stage.names,
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
        "condition": fit.stage.condition,
        "seconds": seconds,
    }


def summary(rows):
    return {
        "matrix_error": max(row["matrix_error"] for row in rows),
        "largest_percent": max(max(row["largest_percent"]) for row in rows),
        "rms_percent": max(max(row["rms_percent"]) for row in rows),
        "uncoupled_largest_percent": max(max(row["uncoupled_largest_percent"]) for row in rows),
        "single_axis_largest_percent": min(max(row["single_axis_largest_percent"]) for row in rows),
        "seconds": max(row["seconds"] for row in rows),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--set", choices=[*SETS], action="append", help="default: all")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="of each set")
    options = parser.parse_args()
    chosen = options.set or [*SETS]
    found = json.loads(OUTPUT.read_text()) if OUTPUT.exists() and options.set else {}
    for name in chosen:
        rows = []
        for k in range(options.seeds):
            rows.append(measure(SETS[name], SHIFTS[name] + k))
            row = rows[-1]
            print(
                f"{name} {row['seed']} {'/'.join(row['mechanisms'])}: matrix within "
                f"{row['matrix_error']:.5f}, largest {np.round(row['largest_percent'], 3)} %, RMS "
                f"{np.round(row['rms_percent'], 3)} %, uncoupled "
                f"{np.round(row['uncoupled_largest_percent'], 3)} %, single "
                f"{np.round(row['single_axis_largest_percent'], 1)} %, {row['seconds']:.0f} s",
                flush=True,
            )
        found[name] = {"summary": summary(rows), "stages": rows}
        print(name, json.dumps(found[name]["summary"], indent=1))
        OUTPUT.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
