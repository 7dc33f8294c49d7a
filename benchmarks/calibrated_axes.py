"""Three coupled axes calibrated over a socket: an emulated controller around virtual stages, mechanisms and seeds.

The actuators are no instances of any model. The path is followed by all axes together; its error on each axis is that
which the sensors measured. Writes `calibrated_axes.json`.
"""

import argparse
import json
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
from strangers import truths

from dehyst.calibration import calibrate
from dehyst.instruments import open_rig
from dehyst.virtual import PlayActuator, VirtualBench, VirtualStage

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
from emulator import Controller, Server
from truths import BoucWenActuator, PreisachActuator

OUTPUT = Path(__file__).parent / "calibrated_axes.json"
HIGHEST, STROKES, NOISE = (100.0, 120.0, 150.0), (16e-6, 20e-6, 12e-6), 2e-9
SPEED, RATE = 20.0, 400.0
GOAL = 0.3


# Name: mechanisms of the axes, and seed.
CASES = {
    "plays, Preisach, relays": ([PlayActuator, PreisachActuator, truths.Relays], 1),
    "domains, slips, relays (set aside)": ([truths.Domains, truths.StribeckSlip, truths.Relays], 2),
    "Preisach, plays, Preisach": ([PreisachActuator, PlayActuator, PreisachActuator], 3),
    "with a Bouc-Wen actuator": ([PlayActuator, BoucWenActuator, PreisachActuator], 4),
}


def actuator(kind, j):
    if kind.__module__.startswith("dehyst"):
        return kind(stroke=STROKES[j], highest=HIGHEST[j], noise=0.0)
    return truths.VirtualStranger(kind, STROKES[j], HIGHEST[j])


def measure(name):
    kinds, seed = CASES[name]
    rng = np.random.default_rng([18, seed])
    coupling = np.where(np.eye(3, dtype=bool), 1.0, rng.uniform(0.02, 0.06, (3, 3)) * rng.choice([-1, 1], (3, 3)))
    stage = VirtualStage(
        [actuator(kind, j) for j, kind in enumerate(kinds)],
        coupling,
        noise=NOISE,
        seed=seed,
    )
    began = time.monotonic()
    with Server(Controller(VirtualBench(stage, speed=SPEED)), port=0, lock=threading.Lock()) as server:
        with open_rig(f"pi://{server.host}:{server.port}/1,2,3") as rig, tempfile.TemporaryDirectory() as folder:
            result = calibrate(rig, folder)
        ends = [bench.voltage for bench in server.controller.instrument.axes]
    row = {
        "truths": name,
        "largest_percent": list(result.compensated.largest_percent),
        "rms_percent": list(result.compensated.rms_percent),
        "nominal_percent": list(result.nominal.largest_percent),
        "matrix_error": float(np.abs(result.fit.coupling - coupling).max()),
        "verdict": result.fit.verdict,
        "voltages_at_end": ends,
        "seconds": time.monotonic() - began,
    }
    print(
        f"{name:36s} largest {', '.join(f'{e:.3f}' for e in row['largest_percent'])} %  RMS "
        f"{max(row['rms_percent']):.3f} %  without a model {max(row['nominal_percent']):.1f} %  matrix "
        f"{row['matrix_error']:.5f}",
        flush=True,
    )
    return row


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="*", help="of these names only; nothing is written then")
    chosen = parser.parse_args().cases
    rows = [measure(name) for name in chosen or CASES]
    if not chosen:
        OUTPUT.write_text(json.dumps({"goal_percent": GOAL, "stages": rows}, indent=2) + "\n")


if __name__ == "__main__":
    main()
