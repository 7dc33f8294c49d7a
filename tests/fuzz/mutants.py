"""Mutants: how many small faults of the package do its tests catch?

    python tests/fuzz/mutants.py build/mutants --seed 1 --count 12

A mutant differs from the package in one place: a comparison, an arithmetic operator, a constant, a statement that is
removed, two arguments that are swapped. The work is done in a copy of the repository, in the folder given. At first
the tests of `TESTS` run there once, and each function notes the tests that enter it (`entered.json`, made when it is
missing). Then the tests that enter a mutated function run, the fastest first, then the others of their files, until
one fails or the time limit is reached. Of the C core nothing is noted: the tests of `CORE_TESTS` run, in this order.

`mutants.jsonl` has a line for each mutant; its outcome is "caught", "survived", or "not tried" where no test enters the
function. A mutant may change nothing that matters: those that survive are to be read.
"""

import argparse
import ast
import json
import os
import random
import re
import shutil
import subprocess
import sys
from collections import Counter, defaultdict
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
ROOMS = ("core", "identification", "control", "records", "instruments")
TESTS = (*(f"tests/{room}" for room in ROOMS[1:]), "tests/contracts")
# By the folder of the source.
CORE_TESTS = {
    "core/src/bank/": ("tests/control/test_bank.py",),
    "core/src/records/": ("tests/identification/regression", "tests/model/test_evaluator.py"),
    "core/src/": (
        "tests/core/test_plain.py",
        "tests/model/test_evaluator.py",
        "tests/model/test_smooth_slip.py",
        "tests/model/test_dynamics.py",
        "tests/control/test_compensator.py",
        "tests/contracts/test_hysteresis_laws.py",
        "tests/core/test_all_parts.py",
    ),
}
FAST = ("-m", "not slow and not nightly and not fuzz")
COMPARISONS = {"<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "!=", "!=": "=="}
ARITHMETIC = {"+": "-", "-": "+", "*": "/", "/": "*"}
LEFT_OUT = shutil.ignore_patterns(".git", "build", ".venv", "__pycache__", ".*_cache", ".hypothesis")


# By the exit status of pytest; where it names tests that are not there, nothing was tried.
OUTCOMES = {0: "survived", 4: "not tried", 5: "not tried"}


class Entered:
    """A plugin of pytest: the functions that each test enters, and how long it takes."""

    def __init__(self, report):
        # Kept open, for a test may take the place of what opens files.
        self.report, self.names = os.open(report, os.O_WRONLY | os.O_CREAT | os.O_APPEND), set()

    def pytest_runtest_logreport(self, report):
        if report.when == "call" and report.passed:
            line = {"test": report.nodeid, "seconds": report.duration, "functions": sorted(self.names)}
            os.write(self.report, f"{json.dumps(line)}\n".encode())
        if report.when == "teardown":
            self.names.clear()


# Python ---------------------------------------------------------------------------------------------------------------


def functions(tree, path=()):
    """Yield (qualified name, function) of a syntax tree; functions inside of functions belong to these."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef):
            yield ".".join((*path, node.name)), node
        elif isinstance(node, ast.ClassDef):
            yield from functions(node, (*path, node.name))


def noting(source, file):
    """Return the source with a note at the entry of each function."""
    tree = ast.parse(source)
    for name, function in functions(tree):
        begin = 1 if ast.get_docstring(function) is not None else 0
        function.body[begin:begin] = ast.parse(
            f"__import__('sys').__dict__.setdefault('entered', set()).add({f'{file}:{name}'!r})"
        ).body
    return ast.unparse(ast.fix_missing_locations(tree))


OPERATORS = {
    **{ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq},
    **{ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In},
    **{ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult},
}


def ordered(call):
    """Return whether the order of the first two arguments of a call counts."""
    name = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
    plain = len(call.args) > 1 and not any(isinstance(one, ast.Starred) for one in call.args)
    return plain and name not in ("max", "min", "maximum", "minimum", "hypot")


def places_in(function):
    """Yield (kind, node) of what can be changed in a function; text, annotations and `zip(strict=...)` stay."""
    waiting = list(function.body)
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Raise | ast.JoinedStr) or (isinstance(node, ast.keyword) and node.arg == "strict"):
            continue
        if isinstance(node, ast.AnnAssign):
            waiting.extend([node.value] if node.value else [])
            continue
        if isinstance(node, ast.Compare) and type(node.ops[0]) in OPERATORS:
            yield "comparison", node
        if isinstance(node, ast.BinOp | ast.AugAssign) and type(node.op) in OPERATORS:
            yield "arithmetic", node
        if isinstance(node, ast.Constant) and isinstance(node.value, int | float):
            yield "constant", node
        if isinstance(node, ast.Call) and ordered(node):
            yield "arguments", node
        if isinstance(node, ast.Expr | ast.AugAssign) and not (
            isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant | ast.Yield | ast.YieldFrom)
        ):
            yield "statement", node
        waiting.extend(ast.iter_child_nodes(node))


def change(kind, node, tree):
    """Change a node of a syntax tree in place."""
    if kind == "comparison":
        node.ops[0] = OPERATORS[type(node.ops[0])]()
    elif kind == "arithmetic":
        node.op = OPERATORS[type(node.op)]()
    elif kind == "constant":
        node.value = not node.value if isinstance(node.value, bool) else node.value * 2 if node.value else 1
    elif kind == "arguments":
        node.args[:2] = node.args[1], node.args[0]
    else:
        for parent in ast.walk(tree):
            for name in ("body", "orelse", "finalbody"):
                block = getattr(parent, name, None)
                if isinstance(block, list) and node in block:
                    block[block.index(node)] = ast.copy_location(ast.Pass(), node)


def python_mutants(room):
    """Yield (file, function, kind, number of the place) of all mutants of a room."""
    for path in sorted((REPOSITORY / "src" / "dehyst" / room).rglob("*.py")):
        for name, function in functions(ast.parse(path.read_text())):
            for place, (kind, _) in enumerate(places_in(function)):
                yield path.relative_to(REPOSITORY).as_posix(), name, kind, place


def python_mutant(source, name, place):
    """Return line, text before, text after, and the source of a mutant."""
    tree = ast.parse(source)
    function = dict(functions(tree))[name]
    kind, node = list(places_in(function))[place]
    line, before = node.lineno, ast.unparse(node)
    change(kind, node, tree)
    return line, before, "pass" if kind == "statement" else ast.unparse(node), ast.unparse(tree)


# C --------------------------------------------------------------------------------------------------------------------

C_PLACES = (
    ("comparison", re.compile(r"(?<= )(<=|>=|==|!=|<|>)(?= )")),
    ("arithmetic", re.compile(r"(?<=[\w)\]] )([-+*/])(?==? )")),
    ("constant", re.compile(r"(?<![\w.])(\d+(?:\.\d+)?)(?![\w.])")),
    (
        "statement",
        re.compile(r"^ {4,}((?!return|break|continue|const|int |dehyst_|static|for|if|else|while)[a-z][^{}]*;)$"),
    ),
    ("arguments", re.compile(r"(?<=\w\()(\w+, \w+)(?=[,)])")),
)


def c_mutants():
    """Yield (file, line, kind, place in the line) of all mutants of the core."""
    for path in sorted((REPOSITORY / "core" / "src").rglob("*.[ch]")):
        depth, comment = 0, False
        for number, line in enumerate(path.read_text().splitlines()):
            comment = comment or line.lstrip().startswith("/*")
            if depth and not comment and not line.startswith("#"):
                for kind, pattern in C_PLACES:
                    for place in range(len(pattern.findall(line.partition("/*")[0]))):
                        yield path.relative_to(REPOSITORY).as_posix(), number, kind, place
            comment = comment and "*/" not in line
            depth += line.count("{") - line.count("}")


def c_mutant(source, number, kind, place):
    """Return line, text before, text after, and the source of a mutant."""
    lines = source.splitlines()
    line = lines[number]
    match = list(dict(C_PLACES)[kind].finditer(line.partition("/*")[0]))[place]
    old = match[1]
    if kind == "arguments":
        new = ", ".join(reversed(old.split(", ")))
    elif kind == "constant":
        new = str(2 * float(old) if "." in old else 2 * int(old)) if float(old) else "1"
    else:
        new = {**COMPARISONS, **ARITHMETIC}.get(old, ";")
    lines[number] = line[: match.start(1)] + new + line[match.end(1) :]
    return number + 1, line.strip(), lines[number].strip(), "\n".join(lines) + "\n"


# Runs -----------------------------------------------------------------------------------------------------------------


def pytest_of(copy, arguments, limit=None):
    """Run pytest in the copy; return its exit status, or None where it took too long."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--no-header", *arguments]
    environment = {**os.environ, "PYTHONPATH": str(copy / "src"), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        done = subprocess.run(command, cwd=copy, env=environment, capture_output=True, check=False, timeout=limit)
    except subprocess.TimeoutExpired:
        return None
    return done.returncode


def noted(folder, copy):
    """Return the tests of each function, as `chosen_tests` does."""
    report = folder / "entered.jsonl"
    if not report.exists():
        sources = {path: path.read_text() for room in ROOMS[1:] for path in (copy / "src/dehyst" / room).rglob("*.py")}
        for path, source in sources.items():
            path.write_text(noting(source, path.relative_to(copy).as_posix()))
        draft = report.with_suffix(".part")
        draft.unlink(missing_ok=True)
        words = [sys.executable, __file__, "--note", str(draft), "-q", "-p", "no:cacheprovider", *FAST, *TESTS]
        environment = {**os.environ, "PYTHONPATH": str(copy / "src")}
        subprocess.run(words, cwd=copy, env=environment, check=False, stdout=subprocess.DEVNULL)
        for path, source in sources.items():
            path.write_text(source)
        draft.rename(report)
    return chosen_tests(map(json.loads, report.read_text().splitlines()))


def chosen_tests(lines):
    """Return {function: (seconds, test)}: those that enter it, the fastest first, then the others of their files.

    A module's fixture is noted at the first test that uses it, and others of the file look at what it made.
    """
    tests, files = defaultdict(list), defaultdict(list)
    for line in lines:
        timed = line["seconds"], line["test"]
        files[line["test"].partition("::")[0]].append(timed)
        for function in line["functions"]:
            tests[function].append(timed)
    chosen = {}
    for function, entering in tests.items():
        names = {test.partition("::")[0] for _, test in entering}
        beside = {timed for name in names for timed in files[name]} - {*entering}
        chosen[function] = sorted(entering) + sorted(beside)
    return chosen


def within(tests, limit):
    """Return the fastest tests that together take no longer than the limit [s]."""
    chosen, total = [], 0.0
    for seconds, test in tests:
        total += seconds + 0.01
        if total > limit:
            break
        chosen.append(test)
    return chosen


class Mutants:
    """A copy of the repository, and its compiled modules."""

    def __init__(self, folder, limit):
        self.folder, self.copy, self.limit = folder, folder / "repository", limit
        shutil.rmtree(self.copy, ignore_errors=True)
        shutil.copytree(REPOSITORY, self.copy, ignore=LEFT_OUT, symlinks=True)
        self.tests = noted(folder, self.copy)

    def compiled(self):
        """Compile the core of the copy into its package; return whether that went well."""
        objects = self.folder / "objects"
        nanobind = subprocess.check_output([sys.executable, "-m", "nanobind", "--cmake_dir"], text=True).strip()
        options = [
            "-DSKBUILD_PROJECT_NAME=dehyst",
            f"-DPython_EXECUTABLE={sys.executable}",
            "-DCMAKE_BUILD_TYPE=Release",
        ]
        options.append(f"-Dnanobind_DIR={nanobind}")
        for command in (["cmake", "-S", self.copy, "-B", objects, *options], ["cmake", "--build", objects]):
            if subprocess.run(list(map(str, command)), capture_output=True, check=False).returncode:
                return False
        for module in objects.glob("*.so"):
            shutil.copy(module, self.copy / "src" / "dehyst")
        shutil.copy(objects / "core/amalgamation/dehyst.c", self.copy / "src/dehyst/exports/templates")
        return True

    def tried(self, room, mutant):
        """Return the report of a mutant."""
        file, where, kind, place = mutant
        path = self.copy / file
        source = path.read_text()
        made = c_mutant(source, where, kind, place) if room == "core" else python_mutant(source, where, place)
        line, before, after, text = made
        of_core = next((each for folder, each in CORE_TESTS.items() if file.startswith(folder)), ())
        tests = (*FAST, *of_core) if room == "core" else within(self.tests.get(f"{file}:{where}", ()), self.limit)
        try:
            path.write_text(text)
            built = room != "core" or self.compiled()
            listed = self.folder / "tests.txt"
            listed.write_text("\n".join(tests))
            patience = 1200 if room == "core" else 10 * self.limit + 60
            status = pytest_of(self.copy, ["-x", f"@{listed}"], patience) if built and tests else 5
        finally:
            path.write_text(source)
        return {
            "room": room,
            "file": file,
            "line": line,
            "function": where if room != "core" else "",
            "kind": kind,
            "before": before,
            "after": after,
            "tests": len(tests),
            "outcome": OUTCOMES.get(status, "caught") if built else "not compiled",
        }


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=12, help="mutants of each room")
    parser.add_argument("--rooms", nargs="+", choices=ROOMS, default=ROOMS)
    parser.add_argument("--limit", type=float, default=20.0, help="seconds of tests for each mutant")
    given = parser.parse_args()
    folder = given.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    drawn = []
    for room in given.rooms:
        every = list(c_mutants() if room == "core" else python_mutants(room))
        drawn += [(room, mutant) for mutant in random.Random(f"{room} {given.seed}").choices(every, k=given.count)]
    mutants, outcomes = Mutants(folder, given.limit), Counter()
    for room, mutant in drawn:
        found = mutants.tried(room, mutant)
        outcomes[room, found["outcome"]] += 1
        with (folder / "mutants.jsonl").open("a") as report:
            report.write(json.dumps(found) + "\n")
        print("{outcome:12} {file}:{line} {function} {kind}: {before!r} -> {after!r}".format_map(found), flush=True)
    for (room, outcome), number in sorted(outcomes.items()):
        print(f"{room:16} {outcome:12} {number}")


def note(report, arguments):
    import pytest

    plugin = Entered(report)
    sys.entered = plugin.names
    sys.exit(pytest.main(arguments, plugins=[plugin]))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--note"]:
        note(sys.argv[2], sys.argv[3:])
    main()
