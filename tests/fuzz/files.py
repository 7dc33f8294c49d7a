"""Mutated files of every format, read and prepared as for an identification: only dehyst's own errors may come."""

import random
import resource
import sys
import tempfile
import warnings
from functools import cache
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "support")]

import batches
import laboratory_containers
from file_mutations import mutated

import dehyst
from dehyst.identification.preparation import prepare

# Formats that libraries in C read: that one crashes or hangs on a damaged file is no fault of this package.
IN_C = (".mat", ".h5", ".hdf5", ".parquet", ".tdms", ".xlsx")


@cache
def sound():
    """Contents by name; made by a child: threads that libraries start would not be there in workers forked later."""
    with tempfile.TemporaryDirectory() as folder:
        batches.in_a_child(lambda: laboratory_containers.write_sound(Path(folder)))
        return {path.name: path.read_bytes() for path in sorted(Path(folder).iterdir())}


def content_of(seed, case):
    """Name and content of a case's file."""
    dice = random.Random(f"{seed}-{case}")
    name = dice.choice(sorted(sound()))
    return name, mutated(sound()[name], name, dice)


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
            repr(record), record.problems(), record.cycles()
            prepared = prepare(record)
            prepared.span(), prepared.reduced
        except dehyst.DehystError as error:
            note(f"refused: {type(error).__name__}")
            return []
    note("prepared")
    return []


def attack(seed, count):
    """Play cases; return the summary without what ended in a library."""
    sound()  # once, before workers are forked
    found = batches.run(play, seed, count)
    own = [
        each for each in found["findings"] if not (each["ended"] and content_of(seed, each["case"])[0].endswith(IN_C))
    ]
    return {**found, "findings": own}
