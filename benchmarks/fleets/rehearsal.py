"""Runs of a fleet that are killed at any moment, begun twice, and resumed on a dataset that has changed meanwhile.

    python benchmarks/fleets/rehearsal.py [--kills 30] [--doubles 10] [--seed 1]

The records have names of arbitrary bytes. After each run the table must have one row of each record, with the hash of
its samples, and nothing else may be left beside it. Writes the part "rehearsal" of `fleet.json`.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path

import numpy as np

from dehyst import Record, write_record
from dehyst.fleet import load, open_dataset
from dehyst.fleet.dataset import Reader, sha256_of
from dehyst.virtual import PlayActuator

OUTPUT = Path(__file__).resolve().parents[1] / "fleet.json"
DEHYST = [sys.executable, "-c", "from dehyst.cli import main; main()"]
RECORDS = 12
TARGETS = ("client", "worker", "all", "terminate")
CHANGES = ("nothing", "removed", "added", "changed")


def write(path: Path, seed: int) -> None:
    """Write a record whose file has the same size whatever its seed."""
    rise = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, 31) / 30)
    voltage = np.concatenate([[0.0], *(top * part for top in (100, 100, 60, 30, 100) for part in (rise, 1 - rise))])
    actuator = PlayActuator(stroke=10e-6, highest=100.0, plays=50, noise=2e-9, seed=seed, width=0.5)
    displacement = np.round(1e6 * actuator.play(voltage) + 10, 6)
    plain = path.with_name("draft")
    write_record(plain.with_suffix(".csv"), Record(np.arange(voltage.size) / 1000, voltage, 1e-6 * displacement))
    text = plain.with_suffix(".csv").read_text()
    path.write_text("\n".join(line.ljust(80) for line in text.splitlines()) + "\n")
    plain.with_suffix(".csv").unlink()


def any_name(chance: random.Random) -> str:
    """Return a name of arbitrary bytes that a file system takes."""
    letters = [byte for byte in range(1, 256) if byte not in b"/."]
    return os.fsdecode(bytes(chance.choices(letters, k=chance.randint(1, 12))) + b".csv")


def change(folder: Path, what: str, chance: random.Random) -> None:
    """Remove, add or change one record; a changed one keeps its size and its time."""
    path = chance.choice(sorted(folder.iterdir(), key=os.fsencode))
    if what == "removed":
        path.unlink()
    if what in ("removed", "added"):
        # The number of records stays about the same.
        write(folder / any_name(chance), chance.randrange(10**6))
    if what == "changed":
        before = path.stat()
        write(path, chance.randrange(10**6))
        os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
        if path.stat().st_size != before.st_size:
            raise SystemExit("a changed record has another size")


def started(folder: Path, output: Path, *more: str) -> subprocess.Popen:
    words = [*DEHYST, "fleet", "identify", str(folder), "-o", str(output), "--jobs", "2", *more]
    return subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def children(pid: int) -> list[int]:
    with suppress(OSError):
        return [int(one) for file in Path(f"/proc/{pid}/task").glob("*/children") for one in file.read_text().split()]
    return []


def strike(process: subprocess.Popen, target: str) -> None:
    """Kill a run or a part of it."""
    workers = children(process.pid)
    for pid in workers[:1] if target == "worker" else workers if target == "all" else []:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    if target == "terminate":
        process.terminate()
    elif target != "worker":
        process.kill()
    process.communicate()


def fault_of(folder: Path, output: Path) -> str | None:
    """Return what is wrong with a table, if anything is."""
    dataset, reader = open_dataset(folder), Reader({})
    expected = {task.within: sha256_of(reader.record(task)) for task in dataset.tasks}
    rows = load(output).rows
    if Counter(row["place"] for row in rows) != Counter(expected.keys()):
        return "rows are not those of the records"
    if wrong := [row["place"] for row in rows if row["sha256"] != expected[row["place"]]]:
        return f"rows of other samples: {wrong}"
    if lost := [row["reason"] for row in rows if row["outcome"] == "lost"]:
        return f"lost: {lost}"
    left = sorted(path.name for path in output.parent.iterdir() if path not in (folder, output))
    return f"left behind: {left}" if left else None


def rehearse(kills: int, doubles: int, seed: int) -> dict:
    """Return how often a run was killed or begun twice, and the faults of the tables afterwards."""
    chance, faults = random.Random(seed), []
    tally: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "records"
        folder.mkdir()
        while len(list(folder.iterdir())) < RECORDS:
            write(folder / any_name(chance), chance.randrange(10**6))
        began = time.monotonic()
        started(folder, Path(name) / "table.parquet").communicate()
        usual = time.monotonic() - began
        for k in range(kills):
            output = Path(name) / "table.parquet"
            target, what = chance.choice(TARGETS), chance.choice(CHANGES)
            output.unlink(missing_ok=True)
            process = started(folder, output)
            time.sleep(chance.uniform(0.0, 1.1) * usual)
            strike(process, target)
            change(folder, what, chance)
            again = started(folder, output, "--resume")
            errors = again.communicate()[1].decode(errors="replace")
            fault = f"status {again.returncode}: {errors}" if again.returncode else fault_of(folder, output)
            faults += [f"kill {k} ({target}, {what}): {fault}"] if fault else []
            tally.update([target, what])
        for k in range(doubles):
            output = Path(name) / "table.parquet"
            output.unlink(missing_ok=True)
            first = started(folder, output, *chance.choice(((), ("--resume",))))
            time.sleep(chance.uniform(0.0, 1.1) * usual * (k > 2))
            both = [first, started(folder, output, "--resume")]
            ends = [one.communicate() and one.returncode for one in both]
            fault = fault_of(folder, output) if set(ends) <= {0, 2} and 0 in ends else f"ends {ends}"
            faults += [f"double start {k}: {fault}"] if fault else []
            tally["refused"] += 2 in ends
    return {"records": RECORDS, "kills": kills, "double_starts": doubles, "faults": faults, **tally}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    for name, count in (("--kills", 30), ("--doubles", 10), ("--seed", 1)):
        parser.add_argument(name, type=int, default=count)
    given = parser.parse_args()
    result = rehearse(given.kills, given.doubles, given.seed)
    print(json.dumps(result, indent=1))
    known = json.loads(OUTPUT.read_text())
    OUTPUT.write_text(json.dumps(known | {"rehearsal": result}, indent=1) + "\n")
    sys.exit(1 if result["faults"] else 0)


if __name__ == "__main__":
    main()
