"""Mutants: how many small faults of the package do its tests catch?

    python tests/fuzz/mutants.py build/mutants --seed 1 --count 12

A mutant differs from the package in one place: a comparison, an arithmetic operator, a constant, a statement that is
removed, two arguments that are swapped. The work is done in a copy of the repository, in the folder given. At first
the tests of `TESTS` run there once, and each block of statements of the rooms notes the tests that enter it, in child
processes too (`entered.jsonl`, made when it is missing). Then tests that enter the block of a mutant run, those near
its file and the fast ones first, until one fails or the time limit is reached. Of the C core nothing is noted: tests of
`CORE_TESTS` run. Each mutant has a process of its own, a fork of this one, which has loaded NumPy and pytest; its last
words are in `repository.log`. With `--unchanged` nothing is changed, and nothing may be caught.

`mutants.jsonl` has a line for each mutant; its outcome is "caught", "survived", or "not tried" where no test enters the
block. A mutant may change nothing that matters: those that survive are to be read.
"""

import argparse
import ast
import contextlib
import importlib
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter, defaultdict
from pathlib import Path

import pytest

ROOMS = ("core", "identification", "control", "records", "instruments")
TESTS = ("contracts", "model", "trust", "virtual", "calibration", "operations", "cli")
CORE_TESTS = ("tests/core", "tests/model", "tests/control", "tests/contracts")
FAST = ("-m", "not slow and not nightly and not fuzz")
COMPARISONS = {"<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "!=", "!=": "=="}
ARITHMETIC = {"+": "-", "-": "+", "*": "/", "/": "*"}
LEFT_OUT = shutil.ignore_patterns(".git", "build", ".venv", "__pycache__", ".*_cache", ".hypothesis")
# What tests load; this process loads it once.
LOADED = (
    "numpy",
    "scipy.interpolate",
    "scipy.linalg",
    "scipy.optimize",
    "scipy.signal",
    "scipy.sparse.linalg",
    "hypothesis.extra.numpy",
    "hypothesis.stateful",
)
# The module of the copy by which its blocks note themselves, once a process and test.
NOTES = """
import fcntl, os
# Far from the numbers of the standard streams, which a test may have closed.
opened = os.open({!r}, os.O_WRONLY | os.O_APPEND)
file = fcntl.fcntl(opened, fcntl.F_DUPFD_CLOEXEC, 500)
os.close(opened)
seen, write = set(), os.write

def note(block):
    if block not in seen:
        seen.add(block)
        write(file, b"%d\\n" % block)
"""


class Entered:
    """A plugin of pytest: the blocks that each test enters, and how long it takes.

    What a fixture enters and takes is laid to all tests that use it, for it may be made once for them.
    """

    def __init__(self, notes, report):
        # Kept open, for a test may take the place of what opens files.
        self.notes, self.report = notes.open("rb"), report.open("w")
        self.own, self.of_fixtures, self.seconds = set(), defaultdict(set), {}

    def read(self):
        if "entered_blocks" in sys.modules:
            sys.modules["entered_blocks"].seen.clear()
        return {int(line) for line in self.notes.read().split()}

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef):
        self.own |= self.read()
        began = time.perf_counter()
        result = yield
        self.of_fixtures[fixturedef] |= self.read()
        self.seconds[fixturedef] = time.perf_counter() - began
        return result

    def pytest_runtest_makereport(self, item, call):
        if call.when == "call" and call.excinfo is None:
            blocks, seconds, shared = self.own | self.read(), call.duration, {}
            for fixture in (one for known in item._fixtureinfo.name2fixturedefs.values() for one in known):
                blocks = blocks | self.of_fixtures[fixture]
                if fixture.scope == "function":
                    seconds += self.seconds.get(fixture, 0.0)
                else:
                    shared[f"{fixture.baseid}:{fixture.argname}"] = self.seconds.get(fixture, 0.0)
            line = {"test": item.nodeid, "seconds": seconds, "shared": shared, "blocks": sorted(blocks)}
            self.report.write(json.dumps(line) + "\n")
        if call.when == "teardown":
            self.read()
            self.own = set()


# Python ---------------------------------------------------------------------------------------------------------------


def functions(tree, path=()):
    """Yield (qualified name, function) of a syntax tree; functions inside of functions belong to these."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef):
            yield ".".join((*path, node.name)), node
        elif isinstance(node, ast.ClassDef):
            yield from functions(node, (*path, node.name))


def blocks_of(node):
    """Return (the statements of a block, the number of its first statement that is no docstring) of a node."""
    lists = (getattr(node, name, None) for name in ("body", "orelse", "finalbody"))
    documented = isinstance(node, ast.FunctionDef | ast.ClassDef) and ast.get_docstring(node) is not None
    return [(block, int(documented and len(block) > 1)) for block in lists if isinstance(block, list) and block]


def noting(source, file, blocks):
    """Return the source with a note at the entry of each block of a function; append their "file:line" to `blocks`."""
    tree = ast.parse(source)
    for _, function in functions(tree):
        for block, first in [each for node in ast.walk(function) for each in blocks_of(node)]:
            line = block[first].lineno
            block.insert(first, ast.parse(f"__import__('entered_blocks').note({len(blocks)})").body[0])
            blocks.append(f"{file}:{line}")
    return ast.unparse(ast.fix_missing_locations(tree))


def block_line(function, place):
    """Return the line of the first statement of the innermost block that has a node in it."""
    line, waiting = function.body[0].lineno, [function]
    while waiting:
        for block, first in blocks_of(waiting.pop()):
            for statement in block:
                if any(node is place for node in ast.walk(statement)):
                    line, waiting = block[first].lineno, [statement]
                    # A handler of exceptions and a case are no statements.
                    waiting += [*getattr(statement, "handlers", ()), *getattr(statement, "cases", ())]
    return line


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


def python_mutants(repository, room):
    """Yield (file, number of the function, kind, number of the place) of all mutants of a room."""
    for path in sorted((repository / "src" / "dehyst" / room).rglob("*.py")):
        for number, (_, function) in enumerate(functions(ast.parse(path.read_text()))):
            for place, (kind, _) in enumerate(places_in(function)):
                yield path.relative_to(repository).as_posix(), number, kind, place


def python_mutant(source, number, place):
    """Return name of the function, line, line of the block, text before, text after, and the source of a mutant."""
    tree = ast.parse(source)
    name, function = list(functions(tree))[number]
    kind, node = list(places_in(function))[place]
    block, before = block_line(function, node), ast.unparse(node)
    change(kind, node, tree)
    after = "pass" if kind == "statement" else ast.unparse(node)
    return name, node.lineno, block, before, after, ast.unparse(tree)


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


def c_mutants(repository):
    """Yield (file, line, kind, place in the line) of all mutants of the core."""
    for path in sorted((repository / "core" / "src").rglob("*.[ch]")):
        depth, comment = 0, False
        for number, line in enumerate(path.read_text().splitlines()):
            comment = comment or line.lstrip().startswith("/*")
            if depth and not comment and not line.startswith("#"):
                for kind, pattern in C_PLACES:
                    for place in range(len(pattern.findall(line.partition("/*")[0]))):
                        yield path.relative_to(repository).as_posix(), number, kind, place
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


def pytest_of(copy, arguments, limit=None, plugins=(), keep=False):
    """Run pytest on the copy in a fork of this process; return its exit status, or None where it took too long."""
    child = os.fork()
    if not child:
        try:
            os.setsid()
            os.chdir(copy)
            words = os.open(f"{copy}.log", os.O_RDWR | os.O_CREAT | os.O_TRUNC)
            for stream in range(3):
                os.dup2(words, stream)
            sys.path[0] = str(copy / "src")
            sys.dont_write_bytecode = not keep
            os.environ.update(PYTHONPATH=sys.path[0], **({} if keep else {"PYTHONDONTWRITEBYTECODE": "1"}))
            options = ["-q", "-p", "no:cacheprovider", "-p", "no:xdist", "--no-header"]
            os._exit(int(pytest.main([*options, *arguments], plugins=[make() for make in plugins])))
        finally:
            os._exit(1)
    end = time.monotonic() + (limit or float("inf"))
    done = 0
    while not done and time.monotonic() < end:
        time.sleep(0.02)
        done, status = os.waitpid(child, os.WNOHANG)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    if done:
        return os.waitstatus_to_exitcode(status)
    os.waitpid(child, 0)
    return None


def noted(folder, copy, rooms, tests):
    """Return the tests by the block "file:line" that they enter, and all tests; run them where that is not known."""
    report, named = folder / "entered.jsonl", folder / "blocks.json"
    if not report.exists():
        notes, module, blocks = folder / "notes.txt", copy / "src" / "entered_blocks.py", []
        notes.write_text("")
        module.write_text(NOTES.format(str(notes)))
        paths = [path for room in rooms if room != "core" for path in (copy / "src/dehyst" / room).rglob("*.py")]
        with contextlib.ExitStack() as restoring:
            for path in paths:
                text = noting(path.read_text(), path.relative_to(copy).as_posix(), blocks)
                restoring.enter_context(instead(path, text))
            draft = report.with_suffix(".part")
            pytest_of(copy, [*FAST, *tests], plugins=[lambda: Entered(notes, draft)], keep=True)
        module.unlink()
        named.write_text(json.dumps(blocks))
        draft.rename(report)
    blocks, entering = json.loads(named.read_text()), defaultdict(list)
    lines = [json.loads(line) for line in report.read_text().splitlines()]
    for line in lines:
        for block in line.pop("blocks"):
            entering[blocks[block]].append(line)
    return entering, lines


def within(tests, file, limit):
    """Return tests of a file of the package that together take no longer than the limit [s], and how long they take.

    The fastest come first. But each folder that the name of the test's file has in common with the source's, and its
    name, count as if the test were five times as fast, and other variants of a test as if five times as slow.
    """
    *folders, name = Path(file).with_suffix("").parts[2:]
    ranked, variants = [], Counter()
    for test in sorted(tests, key=lambda test: test["seconds"] + sum(test["shared"].values())):
        function, _, _ = test["test"].partition("[")
        *others, other = Path(function.partition("::")[0]).with_suffix("").parts[1:]
        near = sum(map(str.__eq__, folders, others)) + (name in other) - (variants[function] > 0)
        variants[function] += 1
        ranked.append(((test["seconds"] + sum(test["shared"].values()) + 0.02) / 5.0**near, test))
    chosen, total, made = [], 0.0, set()
    for _, test in sorted(ranked, key=lambda each: each[0]):
        cost = test["seconds"] + 0.01 + sum(s for fixture, s in test["shared"].items() if fixture not in made)
        if total + cost <= limit:
            chosen.append(test["test"])
            total += cost
            made.update(test["shared"])
    return chosen, total


@contextlib.contextmanager
def instead(path, text):
    """Write another text to a file for a while."""
    source, times = path.read_bytes(), path.stat()
    path.write_text(text)
    try:
        yield
    finally:
        path.write_bytes(source)
        # What was compiled of it before is still good.
        os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))


class Mutants:
    """A copy of the repository, and its compiled modules."""

    def __init__(self, given):
        self.folder, self.copy, self.limit = given.folder, given.folder / "repository", given.limit
        shutil.rmtree(self.copy, ignore_errors=True)
        shutil.copytree(given.repository, self.copy, ignore=LEFT_OUT, symlinks=True)
        for name in LOADED:
            importlib.import_module(name)
        tests = [name for room in (*ROOMS, *TESTS) if (self.copy / (name := f"tests/{room}")).exists()]
        self.entering, self.tests = noted(self.folder, self.copy, given.rooms, tests)
        pytest_of(self.copy, ["--collect-only", *tests], keep=True)
        if "core" in given.rooms:
            rules = self.copy / "core/CMakeLists.txt"
            rules.write_text(rules.read_text().replace("-O3", "-O1"))
            self.compile("-S", self.copy, "-B", self.folder / "objects", "-G", "Ninja", *cmake_options())

    @staticmethod
    def compile(*words):
        return not subprocess.run(["cmake", *map(str, words)], capture_output=True, check=False).returncode

    @contextlib.contextmanager
    def compiled(self):
        """Compile the core of the copy into its package for a while; give whether that went well."""
        objects, package = self.folder / "objects", self.copy / "src/dehyst"
        kept, built = self.folder / "compiled", self.compile("--build", objects)
        shutil.rmtree(kept, ignore_errors=True)
        kept.mkdir()
        text = package / "exports/templates/dehyst.c"
        for old in (*package.glob("*.so"), text):
            shutil.move(old, kept)
        try:
            if built:
                for module in objects.glob("*.so"):
                    shutil.copy(module, package)
                shutil.copy(objects / "core/amalgamation/dehyst.c", text)
            yield built
        finally:
            for new in (*package.glob("*.so"), text):
                new.unlink(missing_ok=True)
            for old in kept.glob("*.so"):
                shutil.move(old, package)
            shutil.move(kept / text.name, text)

    def tried(self, room, mutant, unchanged=False):
        """Return the report of a mutant; or of its unchanged file, to see whether the tests fail without a fault."""
        file, where, kind, place = mutant
        path = self.copy / file
        source = path.read_text()
        if room == "core":
            name = ""
            line, before, after, text = c_mutant(source, where, kind, place)
            entering = [test for test in self.tests if test["test"].startswith(CORE_TESTS)]
        else:
            name, line, block, before, after, text = python_mutant(source, where, place)
            entering = self.entering[f"{file}:{block}"]
        if unchanged:
            text = source if room == "core" else ast.unparse(ast.parse(source))
        tests, seconds = within(entering, file, self.limit)
        began = time.monotonic()
        with instead(path, text), self.compiled() if room == "core" else contextlib.nullcontext(True) as built:
            listed = self.folder / "tests.txt"
            listed.write_text("\n".join(tests))
            status = pytest_of(self.copy, ["-x", f"@{listed}"], 30 + 5 * seconds) if built and tests else None
        outcome = "survived" if status == 0 else "caught"
        return {
            "room": room,
            "file": file,
            "line": line,
            "function": name,
            "kind": kind,
            "before": before,
            "after": after,
            "tests": len(tests),
            "of": len(entering),
            "seconds": round(time.monotonic() - began, 1),
            "outcome": outcome if built and tests else "not tried" if built else "not compiled",
        }


def cmake_options():
    nanobind = subprocess.check_output([sys.executable, "-m", "nanobind", "--cmake_dir"], text=True).strip()
    return (
        "-DSKBUILD_PROJECT_NAME=dehyst",
        f"-DPython_EXECUTABLE={sys.executable}",
        "-DCMAKE_BUILD_TYPE=Release",
        f"-Dnanobind_DIR={nanobind}",
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=lambda text: Path(text).resolve())
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=12, help="mutants of each room")
    parser.add_argument("--rooms", nargs="+", default=ROOMS)
    parser.add_argument("--limit", type=float, default=20.0, help="seconds of tests for each mutant")
    parser.add_argument("--unchanged", action="store_true", help="change nothing: what is caught then is no fault")
    parser.add_argument("--repository", type=Path, default=Path(__file__).resolve().parents[2])
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    drawn = []
    for room in given.rooms:
        every = list(c_mutants(given.repository) if room == "core" else python_mutants(given.repository, room))
        drawn += [(room, mutant) for mutant in random.Random(f"{room} {given.seed}").sample(every, given.count)]
    # A run that is broken off has tried about as many of each room.
    random.Random(given.seed).shuffle(drawn)
    mutants, outcomes = Mutants(given), Counter()
    for room, mutant in drawn:
        found = mutants.tried(room, mutant, given.unchanged)
        outcomes[room, found["outcome"]] += 1
        with (given.folder / "mutants.jsonl").open("a") as report:
            report.write(json.dumps(found) + "\n")
        print("{outcome:12} {file}:{line} {function} {kind}: {before!r} -> {after!r}".format_map(found), flush=True)
    for (room, outcome), number in sorted(outcomes.items()):
        print(f"{room:16} {outcome:12} {number}")


if __name__ == "__main__":
    main()
