"""Mutants: how many small faults of the package do its tests catch?

    python tests/fuzz/mutants.py build/mutants --seed 1 --count 12

A mutant differs from the package in one place: a comparison, an arithmetic operator, a number, or a call whose answer
nobody takes. The work is done in a copy of the repository, in the folder given. The tests of `ROOMS` run there, first
those whose file has the name of the mutant's file, until one fails or the time limit is reached.

`mutants.jsonl` has a line for each mutant; its outcome is "caught", "survived" (no test failed), "time limit" (none had
failed by then) or "not compiled". A mutant may change nothing that matters: those that survive are to be read.
"""

import argparse
import json
import os
import random
import re
import shutil
import subprocess
import sys
from pathlib import Path

import sanitized

REPOSITORY = Path(__file__).resolve().parents[2]
# The tests that are to catch the mutants of a room.
ROOMS = {
    "core": ("core", "model", "control", "contracts"),
    "identification": ("identification", "trust"),
    "control": ("control", "contracts"),
    "records": ("records", "cli"),
    "instruments": ("instruments", "contracts", "calibration"),
}
LEFT_OUT = shutil.ignore_patterns(".git", "build", ".venv", "__pycache__", ".*_cache", ".hypothesis")
PAIRS = ("< <=", "> >=", "== !=", "+ -", "* /", "and or")
INSTEAD = {old: new for pair in PAIRS for old, new in (pair.split(), pair.split()[::-1])}
# Places in Python and in C: text and comments, which stay, then whole calls, operators between blanks, and numbers.
PLACES = re.compile(
    r'(?P<kept>""".*?"""|/\*.*?\*/|(?:"(?:\\.|[^"\\\n])*")|(?:\'(?:\\.|[^\'\\\n])*\')|^ *#[^\n]*| # [^\n]*)'
    r"|(?:(?<=\n)(?P<indent> +)(?P<call>(?!return|if|for|while)[a-z][\w.>-]*\([^()\n]*\);?)(?=\n))"
    r"|(?:(?<= )(?P<operator>[<>=!]=|[-+*/<>]|and|or)(?= ))"
    r"|(?<![\w.])(?P<number>\d+(?:\.\d+)?)(?![\w.])",
    re.MULTILINE | re.DOTALL,
)


def mutants_of(text):
    """Yield start, end and what stands there instead, for each mutant of a source."""
    for found in PLACES.finditer(text):
        kind = found.lastgroup
        if kind == "kept":
            continue
        if kind == "operator":
            other = INSTEAD[found[kind]]
        elif kind == "number":
            other = str(2 * float(found[kind]) if "." in found[kind] else 2 * int(found[kind]) or 1)
        else:
            other = ";" if found[kind].endswith(";") else "pass"
        yield *found.span(kind), other


def compiled(folder, copy):
    """Whether the core of the copy was compiled into its package."""
    try:
        for module in sanitized.compiled(copy, folder / "objects", CMAKE_BUILD_TYPE="Release"):
            shutil.copy(module, copy / "src/dehyst")
    except RuntimeError:
        return False
    shutil.copy(folder / "objects/core/amalgamation/dehyst.c", copy / "src/dehyst/exports/templates/dehyst.c")
    return True


def outcome(copy, room, file, limit):
    """Run the tests of a room until one fails; those near the mutant's file run first."""
    tests = [path for name in ROOMS[room] for path in sorted((copy / "tests" / name).rglob("test_*.py"))]
    tests.sort(key=lambda path: file.stem not in path.stem)
    words = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *map(str, tests)]
    environment = {**os.environ, "PYTHONPATH": str(copy / "src"), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        done = subprocess.run(words, cwd=copy, env=environment, capture_output=True, timeout=limit, check=False)
    except subprocess.TimeoutExpired:
        return "time limit"
    return "caught" if done.returncode else "survived"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=lambda text: Path(text).resolve())
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=12, help="mutants of each room")
    parser.add_argument("--limit", type=float, default=60.0, help="seconds of tests for each mutant")
    given = parser.parse_args()
    copy, drawn = given.folder / "repository", []
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(REPOSITORY, copy, ignore=LEFT_OUT, symlinks=True)
    for room in ROOMS:
        folder = copy / ("core/src" if room == "core" else f"src/dehyst/{room}")
        every = [(path, place) for path in sorted(folder.rglob("*.[cp]*")) for place in mutants_of(path.read_text())]
        drawn += [(room, *mutant) for mutant in random.Random(f"{room} {given.seed}").sample(every, given.count)]
    # A run that is broken off has tried about as many of each room.
    random.Random(given.seed).shuffle(drawn)
    for room, path, (first, last, other) in drawn:
        text = path.read_text()
        path.write_text(text[:first] + other + text[last:])
        built = room != "core" or compiled(given.folder, copy)
        told = outcome(copy, room, path, given.limit) if built else "not compiled"
        path.write_text(text)
        if room == "core":
            compiled(given.folder, copy)
        place = f"{path.relative_to(copy)}:{text.count(chr(10), 0, first) + 1}"
        found = {"room": room, "place": place, "before": text[first:last], "after": other, "outcome": told}
        with (given.folder / "mutants.jsonl").open("a") as report:
            report.write(json.dumps(found) + "\n")
        print("{outcome:12} {place} {before!r} -> {after!r}".format_map(found), flush=True)


if __name__ == "__main__":
    main()
