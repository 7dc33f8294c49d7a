"""What becomes of each laboratory file, trap and innocent twin: the table of `tests/golden/verdicts.json`.

A verdict is what `dehyst.read` makes of a file, with the columns that a user knows, then with those that the message
proposes: the numbers of the record, or the class and the argument of the error.

    python tests/fuzz/verdicts.py FILE.json
"""

import json
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

sys.path[:0] = [str(Path(__file__).parents[1] / "support")]

import laboratory_containers
import laboratory_files
import text_traps

import dehyst
from dehyst._errors import DehystError

PROPOSALS = 3


def specimens() -> Iterator[tuple[str, Any, str, str]]:
    """Yield each specimen: its name, the function that writes it, its file's name, and what a user knows of it."""
    for name, (write, words) in laboratory_files.FILES.items():
        yield f"file {name}", write, name, words
    for name, (trap, twin, words) in laboratory_containers.PAIRS.items():
        yield f"trap {name}", trap, name, ""
        yield f"twin {name}", twin, name, words
    for name, trap in text_traps.TRAPS.items():
        yield f"text trap: {name}", trap.trap, f"a{trap.suffix}", trap.options
        yield f"text twin: {name}", trap.twin, f"a{trap.suffix}", trap.options


def verdict(path: str, columns: str) -> dict[str, Any]:
    """Return what becomes of a file; proposals are taken as they are."""
    proposed: list[str] = []
    for _ in range(PROPOSALS):
        try:
            record = dehyst.read(path, columns)
        except DehystError as error:
            more = getattr(error, "proposal", "")
            if not more or more == columns:
                return {"refused": type(error).__name__, "proposed": proposed}
            proposed.append(more)
            columns = more
        else:
            ends = (record.time[[0, -1]], record.voltage[[0, -1]], record.displacement[[0, -1]])
            ranges = (np.ptp(record.time), np.ptp(record.voltage), np.ptp(record.displacement))
            return {
                "samples": len(record),
                "ends": [f"{value:.6e}" for pair in ends for value in pair],
                "ranges": [f"{value:.6e}" for value in ranges],
                "guessed": sorted(map(str, record.meta.get("guesses", ()))),
                "remarked": len(record.meta.get("remarks", ())),
                "proposed": proposed,
            }
    return {"refused": "no end of proposals", "proposed": proposed}


def verdicts() -> dict[str, Any]:
    """Return the verdicts of all specimens by name."""
    found, home = {}, Path.cwd()
    for name, write, file, columns in specimens():
        with tempfile.TemporaryDirectory() as folder:
            os.chdir(folder)
            try:
                write(Path(file))
                found[name] = verdict(file, columns)
            finally:
                os.chdir(home)
    return found


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(json.dumps(verdicts(), indent=1, ensure_ascii=False, sort_keys=True) + "\n")
