"""Errors of identified models, and of the voltage they compute, in % of the stroke. Writes `accuracy.json`.

The virtual actuator is `dehyst.truths.PlayActuator`, no instance of the model. The measured records (a PICMA stack in a
micromanipulator) are read from `../shared/data/p885` beside the repository, or from the folder given as an argument.
"""

import json
import sys
import time
from pathlib import Path

import dehyst
from dehyst import demo

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "p885"
METHODS = ("record", "breakpoints", "antisymmetric")


def virtual() -> dict:
    found = demo.run().as_dict()
    return {key: found[key] for key in ("linear", "compensated", "paper")} | {"errors": found["fit"]["errors"]}


def measured(folder: Path) -> dict:
    columns = {"voltage": "drive_V", "displacement": "displacement_um"}
    major, ramps = (dehyst.read(folder / name, **columns) for name in ("major.csv", "ramps.csv"))
    results = {}
    for method in METHODS:
        start = time.perf_counter()
        fit = dehyst.identify([major, ramps], method=method)
        results[method] = {"seconds": time.perf_counter() - start, "errors": [error.as_dict() for error in fit.errors]}
    split = dehyst.identify([major, ramps[:4500]], validate=ramps[4500:].with_name("ramps, held out"))
    results["held out"] = {"errors": [error.as_dict() for error in split.errors]}
    return results


def show(title: str, errors: list[dict]) -> None:
    print(f"\n{title:<46}  largest %    RMS %   with its drift")
    for error in errors:
        print(f"  {error['record']:<28}{error['role']:<16}{error['largest_percent']:10.3f}{error['rms_percent']:10.3f}"
              f"{error['largest_with_drift_percent']:10.3f}{error['rms_with_drift_percent']:8.3f}")  # fmt: skip


def main() -> None:
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else DATA
    results = {"virtual": virtual(), "measured": measured(folder) if folder.is_dir() else None}
    show("virtual actuator", results["virtual"]["errors"])
    for name in ("linear", "compensated"):
        row = results["virtual"][name]
        print(f"  tracking, {name:<34}{row['largest_percent']:10.3f}{row['rms_percent']:10.3f}")
    for name, found in (results["measured"] or {}).items():
        show(f"P-885, {name}", found["errors"])
    if results["measured"] is None:
        print(f"\nno measured data in {folder.name}: left out; the README's table keeps needing them")
    Path(__file__).with_suffix(".json").write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
