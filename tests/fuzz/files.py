"""Mutated files of every format, read and prepared as `dehyst identify` does: nothing but dehyst's own errors may come.

    python tests/fuzz/files.py --seed 1 --count 10000

prints one line of JSON and exits with 1 when there are findings.
"""

from __future__ import annotations

import argparse
import json
import random
import sys
import tempfile
import time
import warnings
from collections import Counter
from pathlib import Path
from typing import Any

import forked
from file_mutations import mutated
from file_specimens import specimens

import dehyst
from dehyst.identification.preparation import prepare

# Formats that libraries in C read.
_IN_C = (".mat", ".h5", ".hdf5", ".parquet", ".tdms", ".xlsx")
# Of each kind of finding, as many are printed.
_SHOWN = 3


def attack(seed: int, count: int, first: int = 0, only: str = "") -> dict[str, Any]:
    """Run cases and sum up.

    Parameters
    ----------
    seed, count, first : int
        Cases `first` to `first + count - 1` of the seed; each depends on the seed and its number alone.
    only : str
        Suffixes of the specimens to take, with commas between them; by default all of them.
    """
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "sound").mkdir()
        taken = tuple(only.split(","))
        sound = {file: content for file, content in specimens(folder / "sound").items() if file.endswith(taken)}
        numbers = range(first, first + count)
        results = list(forked.run(lambda number: _case(sound, folder, seed, number), numbers))
    for result in results:
        # That a library crashes or hangs on a damaged file is known, and nothing of this package.
        if result.pop("ended", False) and content_of(sound, seed, result["case"])[0].endswith(_IN_C):
            result["end"] = f"in its library: {result.pop('finding')}"
    findings = [result for result in results if "finding" in result]
    return {
        "cases": len(results),
        "findings": findings,
        "kinds": dict(Counter(result["finding"] for result in findings).most_common(20)),
        "ends": dict(Counter(result["end"] for result in results if "end" in result)),
        "longest_cpu_s": max((result.get("cpu_s", 0.0) for result in results), default=0.0),
        "peak_mib": max((result.get("memory", 0) for result in results), default=0) >> 20,
        "wall_s": round(time.perf_counter() - began, 1),
    }


def content_of(sound: dict[str, bytes], seed: int, number: int) -> tuple[str, bytes]:
    """Name and content of a case's file."""
    dice = random.Random(f"{seed}-{number}")
    name = dice.choice(sorted(sound))
    return name, mutated(sound[name], name, list(sound.values()), dice)


def _case(sound: dict[str, bytes], folder: Path, seed: int, number: int) -> dict[str, Any]:
    name, content = content_of(sound, seed, number)
    path = folder / name
    path.write_bytes(content)
    try:
        return {"end": _used(path), "file": name}
    except BaseException as error:
        error.args = (f"[{name}] {error}",)
        raise


def _used(path: Path) -> str:
    """Read a file and do with it what an identification does before it solves."""
    with warnings.catch_warnings():
        # An overflow on damaged numbers is one that nobody looked for.
        warnings.simplefilter("error", RuntimeWarning)
        try:
            record = dehyst.read(path)
            repr(record)
        except dehyst.DehystError as error:
            return f"refused: {type(error).__name__}"
        record.problems(), record.cycles()
        try:
            prepared = prepare(record)
            prepared.span(), prepared.reduced
        except dehyst.DehystError as error:
            return f"unusable: {type(error).__name__}"
    return "prepared"


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--count", type=int, default=10_000)
    options.add_argument("--first", type=int, default=0)
    options.add_argument("--only", default="")
    found = attack(**vars(options.parse_args()))
    shown: Counter[str] = Counter()
    kept = []
    for finding in found["findings"]:
        shown[finding["finding"]] += 1
        if shown[finding["finding"]] <= _SHOWN:
            kept.append(finding)
    print(json.dumps({**found, "findings": kept}))
    sys.exit(1 if kept else 0)


if __name__ == "__main__":
    main()
