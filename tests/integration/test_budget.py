"""The size of the house: lines, names, options and words, each with a budget that only falls.

Numbers here may be lowered, never raised: who needs more of one thing takes it from another of the same kind, or
removes something. What there is: `PYTHONPATH=tests/support python tests/integration/test_budget.py`.
"""

import click
import places
import pytest
from faces import FACES

from dehyst.operations.command import HOUSE as HOUSE_OPTIONS
from dehyst.operations.registry import ENTRIES, find

FOUNDATION = "foundation"
# Lines of Python of each room, everything counted: `__init__`, docstrings, empty lines.
ROOMS = {
    "calibration": 1069,
    "cli": 361,
    "control": 3477,
    "exports": 1265,
    "fleet": 310,
    "foundation": 1325,
    "identification": 5799,
    "instruments": 2434,
    "model": 3370,
    "operations": 2683,
    "paper": 957,
    "records": 4496,
    "report": 1466,
    "testing": 346,
    "trust": 2268,
    "virtual": 734,
    "waveforms": 1284,
    "web": 50,
    "workbench": 2196,
}
HOUSE = {
    "lines of Python": 35890,
    "files of Python": 186,
    "lines of C and C++": 5786,
    "lines of JavaScript and CSS": 2700,
    "lines of tests": 28413,
    "lines of benchmarks": 4946,
    "words of docs": 27326,
    "public names": 75,
    "commands": 16,
    "options": 106,
    "lines of packages/rivals": 2046,
}


def files(folder, *suffixes):
    """The files of a folder that somebody wrote, by suffix."""
    left_out = {"build", "gallery", "api", "__pycache__"}
    found = (path for path in folder.rglob("*") if path.suffix in suffixes)
    return [path for path in found if not left_out & {*path.relative_to(folder).parts}]


def lines(paths):
    return sum(len(path.read_text().splitlines()) for path in paths)


def room_of(path):
    """The folder below the package, or the file that is a room of its own."""
    first = path.relative_to(places.SOURCES).parts[0]
    return FOUNDATION if first.startswith("_") else first.removesuffix(".py")


def lines_of_rooms():
    counts = dict.fromkeys(sorted({room_of(path) for path in files(places.SOURCES, ".py")}), 0)
    for path in files(places.SOURCES, ".py"):
        counts[room_of(path)] += lines([path])
    return counts


def options_of(command):
    """The names of the options of a command, of all its kinds, without those of every command."""
    kinds = getattr(command, "commands", {"": command}).values()
    return {own.name for kind in kinds for own in kind.params if isinstance(own, click.Option)} - {*HOUSE_OPTIONS}


def sizes():
    python = files(places.SOURCES, ".py")
    pages = [path for path in places.DOCS.rglob("*.md") if not {"gallery", "api"} & {*path.parts}]
    return {
        "lines of Python": lines(python),
        "files of Python": len(python),
        "lines of C and C++": lines(
            [*files(places.CORE, ".c", ".h"), *files(places.ROOT / "bindings", ".c", ".h", ".cpp", ".py")]
        ),
        "lines of JavaScript and CSS": lines(
            path for path in files(places.SOURCES, ".js", ".css") if "templates" not in path.parts
        ),
        "lines of tests": lines(files(places.TESTS, ".py", ".c")),
        "lines of benchmarks": lines(files(places.BENCHMARKS, ".py")),
        "words of docs": sum(len(page.read_text().split()) for page in pages),
        "public names": len({name for names in FACES.values() for name in names}),
        "commands": len(ENTRIES),
        "options": sum(len(options_of(find(name))) for name in ENTRIES),
        "lines of packages/rivals": lines(files(places.ROOT / "packages" / "rivals" / "src", ".py")),
    }


def test_every_room_has_a_budget():
    assert set(lines_of_rooms()) == set(ROOMS)


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_keeps_its_budget(room):
    assert lines_of_rooms()[room] <= ROOMS[room]


@pytest.mark.parametrize("what", HOUSE)
def test_the_house_keeps_its_budget(what):
    assert sizes()[what] <= HOUSE[what]


if __name__ == "__main__":
    for title, found, budget in (("room", lines_of_rooms(), ROOMS), ("house", sizes(), HOUSE)):
        print(f"{title:30} {'is':>8} {'budget':>8}")
        print(*(f"{name:30} {count:8d} {budget.get(name, 0):8d}" for name, count in found.items()), sep="\n")
        print()
