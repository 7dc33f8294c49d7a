"""Errors of identified models, and of the voltage they compute, in % of the stroke. Writes `accuracy.json`.

Three parts; without one named, all:

main      dehyst: the demo's virtual actuator, and the measured records
tracking dehyst and every model of `dehyst_rivals` on every virtual actuator of `virtual_trials`: fitted to its
          records once, then compensated along random paths, a path for each seed
measured  every model on the measured records: fitted to the major loop and the first ramps, scored on the other ramps;
          dehyst a second time, without the displacement measured before these, like the others

    python benchmarks/accuracy.py [PART ...] [--only MODEL ...] [--seeds N] [--data FOLDER]

Parts that were not run keep their figures. No virtual actuator is an instance of the model. The measured records (a
PICMA stack in a micromanipulator) are read from `examples/measured/p885`, or from FOLDER.
"""

import argparse
import json
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from virtual_trials import TRIALS, TrackingTrial

import dehyst
from dehyst import Actuator
from dehyst.identification import prepare
from dehyst.model import AbstractModel, Motion, simulated
from dehyst.operations import demo
from dehyst.trust.comparison import OURS, Played, scored
from dehyst_rivals import RIVALS, linear_ratio

DATA = Path(__file__).resolve().parents[1] / "examples" / "measured" / "p885"
OUTPUT = Path(__file__).with_suffix(".json")
PARTS = ("main", "tracking", "measured")
SPLIT, FIRST_SEED = 4500, 7
UNTOLD = f"{OURS}, told the voltage only"
# Largest and RMS error required of dehyst, in % of the stroke.
ASKED = {"play": (0.15, 0.05), "creep": (0.25, 0.09), "preisach": (0.5, 0.2), "boucwen": (1.0, 0.4)}
ASKED_MEASURED = (0.85, 0.22)
FAILURES = (ValueError, ArithmeticError, RuntimeError)


@dataclass(frozen=True)
class VoltageOnly(AbstractModel):
    """An actuator whose state follows from the voltage of the lead-in alone, as that of every baseline does."""

    actuator: Actuator

    @property
    def delay(self) -> float:
        """The delay of the actuator [s]."""
        return self.actuator.delay

    def simulate(self, voltage: Any, *, time: Any = None, state: Any = None) -> Motion:
        """Simulate the actuator from its start before this voltage."""
        return simulated(self.actuator, voltage, time)

    def compensate(self, displacement: Any, *, time: Any = None, state: Any = None) -> Motion:
        """Compensate as the actuator."""
        return self.actuator.compensate(displacement, time=time, state=state)


def entrants() -> dict:
    """Return name -> identification; the variant that knows only the voltage runs on the measured records alone."""
    known = {
        OURS: lambda records: dehyst.identify(records, structure="auto").actuator,
        f"{OURS}, paper's": lambda records: dehyst.identify(records, structure="maxwell_slip").actuator,
        **RIVALS,
        "linear ratio": linear_ratio,
    }
    return known | {UNTOLD: lambda records: VoltageOnly(known[OURS](records))}


def virtual() -> dict:
    _, fit, path = demo.journey()
    found = {kind: demo.errors_of(path, kind) for kind in ("linear", "compensated")}
    return found | {"errors": fit.as_dict()["errors"]}


def p885(folder: Path) -> tuple[dehyst.Record, dehyst.Record]:
    major, ramps = (dehyst.read(folder / name, "voltage=drive_V") for name in ("major.csv", "ramps.csv"))
    return major, ramps


def measured(folder: Path) -> dict:
    major, ramps = p885(folder)
    start = time.perf_counter()
    fit = dehyst.identify([major, ramps])
    seconds = time.perf_counter() - start
    results = {"record": {"seconds": seconds, "errors": [error.as_dict() for error in fit.errors]}}
    split = dehyst.identify([major, ramps[:SPLIT]], validate=replace(ramps[SPLIT:], name="ramps, held out"))
    results["held out"] = {"errors": [error.as_dict() for error in split.errors]}
    return results


def compared_on(trial: TrackingTrial, name: str, identification: Any, seeds: int) -> dict:
    """Return a model's row on a virtual actuator's records, and its tracking errors on each path."""
    kept: list[AbstractModel] = []

    def fit(records: Any) -> AbstractModel:
        kept.append(identification(records))
        return kept[0]

    records = list(trial.records())
    (row,), _ = scored(records, [Played(prepare(record)) for record in trial.held_out()], {name: fit}, print)
    found = row.as_dict() | {"tracking": {}}
    for seed in range(FIRST_SEED, FIRST_SEED + seeds) if kept else ():
        try:
            error = trial.track(kept[0], seed)
            found["tracking"][str(seed)] = {
                "largest_percent": error.largest,
                "rms_percent": error.rms,
                "beyond_voltage_percent": error.beyond,
            }
        except FAILURES as failure:
            found["said"] = f"{found['said'] or ''} Seed {seed}: {failure}".strip()
    return found


def on_measured(folder: Path, name: str, identification: Any) -> dict:
    """Train on the samples before a hold, simulate them again and predict the samples after it."""
    major, ramps = p885(folder)
    lead = float(ramps.time[SPLIT] - ramps.time[0])
    training = [major, replace(ramps[:SPLIT], name="first ramps")]
    (row,), stroke = scored(training, [Played(prepare(ramps), lead=lead)], {name: identification}, print)
    return row.as_dict() | {"stroke_m": stroke}


def show(title: str, errors: list[dict]) -> None:
    print(f"\n{title:<46}  largest %    RMS %   with its drift")
    for error in errors:
        print(
            f"  {error['record']:<28}{error['role']:<16}{error['largest_percent']:10.3f}{error['rms_percent']:10.3f}"
            f"{error['largest_with_drift_percent']:10.3f}{error['rms_with_drift_percent']:8.3f}"
        )


def show_main(results: dict) -> None:
    show("virtual actuator", results["virtual"]["errors"])
    for name in ("linear", "compensated"):
        row = results["virtual"][name]
        print(f"  tracking, {name:<34}{row['largest_percent']:10.3f}{row['rms_percent']:10.3f}")
    for name, found in (results["measured"] or {}).items():
        show(f"P-885, {name}", found["errors"])


def pair(figures: tuple[float, float] | None) -> str:
    return f"{'-':>16}" if figures is None else f"{figures[0]:>9.3f}{figures[1]:7.3f}"


def worst(row: dict | None) -> tuple[float, float] | None:
    """Return the largest and RMS error of the seed with the largest error."""
    figures = [(seed["largest_percent"], seed["rms_percent"]) for seed in ((row or {}).get("tracking") or {}).values()]
    return max(figures, default=None)


def held_out(row: dict | None) -> list[tuple[float, float] | None]:
    """Return the errors with a constant removed, and without."""
    errors = [error for error in (row or {}).get("errors", ()) if error["role"] == "validation"]
    return [
        (errors[0][f"largest{way}_percent"], errors[0][f"rms{way}_percent"]) if errors else None
        for way in ("", "_without_constant")
    ]


def show_compared(tracking: dict, rows: dict) -> None:
    names = [name for name in entrants() if any(name in part for part in (*tracking.values(), rows))]
    titles = [*ASKED, "P-885", "no constant"]
    print(f"\n{'largest and RMS error, %':<34}" + "".join(f"{title:>16}" for title in titles))
    print(f"{'asked of ours':<34}" + "".join(map(pair, (*ASKED.values(), ASKED_MEASURED))))
    for name in names:
        figures = [worst(tracking.get(truth, {}).get(name)) for truth in ASKED] + held_out(rows.get(name))
        print(f"{name:<34}" + "".join(map(pair, figures)))
    for where, part in (*tracking.items(), ("P-885", rows)):
        for name, row in part.items():
            if row["said"]:
                print(f"{name}, {where}: {row['said']}")


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Measure accuracy; see the top of this file.")
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"{', '.join(PARTS)}; default: all")
    parser.add_argument(
        "--only",
        action="append",
        metavar="MODEL",
        choices=list(entrants()),
        help="of tracking and measured; may be repeated",
    )
    parser.add_argument("--truth", action="append", choices=list(TRIALS), help="of tracking; may be repeated")
    parser.add_argument("--seeds", type=int, default=3, help="paths for each virtual actuator; default: 3")
    parser.add_argument("--data", type=Path, default=DATA, help="folder of the measured records")
    parser.add_argument("--output", type=Path, default=OUTPUT, help="default: accuracy.json beside this file")
    given = parser.parse_args()
    for part in given.parts:
        if part not in PARTS:
            parser.error(f"no part '{part}'; try {', '.join(PARTS)}")
    return given


def main() -> None:
    given = arguments()
    parts, data = given.parts or PARTS, given.data.is_dir()
    results = json.loads(given.output.read_text()) if given.output.exists() else {}
    compared = results.setdefault("compared", {"tracking": {}, "measured": {}})
    compared |= {
        "asked": {
            truth: {"largest_percent": a, "rms_percent": b}
            for truth, (a, b) in (ASKED | {"measured": ASKED_MEASURED}).items()
        }
    }
    if not data:
        print(f"no measured data in {given.data.name}: left out; the table of README still needs them")
    if "main" in parts:
        results |= {"virtual": virtual(), "measured": measured(given.data) if data else None}
        show_main(results)
    for name, identification in entrants().items():
        if given.only and name not in given.only:
            continue
        for truth in given.truth or TRIALS if "tracking" in parts and name != UNTOLD else ():
            print(f"{name} on {truth}", flush=True)
            compared["tracking"].setdefault(truth, {})[name] = compared_on(
                TRIALS[truth], name, identification, given.seeds
            )
        if "measured" in parts and data:
            print(f"{name} on P-885", flush=True)
            compared["measured"][name] = on_measured(given.data, name, identification)
    if compared["tracking"] or compared["measured"]:
        show_compared(compared["tracking"], compared["measured"])
    given.output.write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
