"""Mutated files of every format, read and prepared as `dehyst identify` does: nothing but dehyst's own errors may come.

python tests/fuzz/files.py --seed 1 --count 10000
"""

import random
import resource
import sys
import tempfile
import warnings
from functools import cache
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "support")]

import batches
from file_mutations import mutated
from file_specimens import specimens

import dehyst
from dehyst.identification.preparation import prepare

# Formats that libraries in C read: that one crashes or hangs on a damaged file is no fault of this package.
IN_C = (".mat", ".h5", ".hdf5", ".parquet", ".tdms", ".xlsx")


@cache
def sound():
    """The sound files by name; made once, before workers are forked."""
    with tempfile.TemporaryDirectory() as folder:
        return specimens(Path(folder))


def content_of(seed, case):
    """Name and content of a case's file."""
    dice = random.Random(f"{seed}-{case}")
    name = dice.choice(sorted(sound()))
    return name, mutated(sound()[name], name, list(sound().values()), dice)


@cache
def bound_memory():
    """Let this worker reserve no more memory than a case may use: a file that declares more is a finding."""
    reserved = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (reserved + batches.MEMORY, resource.RLIM_INFINITY))


def play(seed, case, note):
    """Read a file and do with it what an identification does before it solves."""
    bound_memory()
    name, content = content_of(seed, case)
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        path = Path(folder) / name
        path.write_bytes(content)
        # An overflow on damaged numbers is one that nobody looked for.
        warnings.simplefilter("error", RuntimeWarning)
        try:
            record = dehyst.read(path)
            repr(record)
        except dehyst.DehystError as error:
            note(f"refused: {type(error).__name__}")
            return []
        record.problems(), record.cycles()
        try:
            prepared = prepare(record)
            prepared.span(), prepared.reduced
        except dehyst.DehystError as error:
            note(f"unusable: {type(error).__name__}")
            return []
    note("prepared")
    return []


def fault_of_a_library(seed, finding):
    return finding.get("ended", False) and content_of(seed, finding["case"])[0].endswith(IN_C)


def attack(seed, count):
    """Play cases; return the summary without what ended in a library."""
    sound()
    found = batches.run(play, seed, count)
    return {**found, "findings": [each for each in found["findings"] if not fault_of_a_library(seed, each)]}


if __name__ == "__main__":
    sound()
    batches.main("files", play, known=fault_of_a_library)
