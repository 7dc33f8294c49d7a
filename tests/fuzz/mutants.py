"""Mutants: how many small faults of the package do its tests catch?

    python tests/fuzz/mutants.py build/mutants --seed 1 --count 12

A mutant differs from the package in one place: a comparison, an arithmetic operator, a constant, a statement that is
removed, two arguments that are swapped. The work is done in a copy of the repository, in the folder given. The tests of
`ROOMS` run there, first those whose file has the name of the mutant's file, until one fails or the time limit is
reached. With `--unchanged` nothing is changed, and nothing may be caught.

`mutants.jsonl` has a line for each mutant; its outcome is "caught", "survived" (no test failed), "time limit" (none had
failed by then) or "not compiled". A mutant may change nothing that matters: those that survive are to be read.
"""

import argparse
import ast
import contextlib
import json
import os
import random
import re
import shutil
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

# The tests that are to catch the mutants of a room.
ROOMS = {
    "core": ("core", "model", "control", "contracts"),
    "identification": ("identification", "trust"),
    "control": ("control", "contracts"),
    "records": ("records", "cli"),
    "instruments": ("instruments", "contracts", "calibration"),
}
COMPARISONS = {"<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "!=", "!=": "=="}
ARITHMETIC = {"+": "-", "-": "+", "*": "/", "/": "*"}
LEFT_OUT = shutil.ignore_patterns(".git", "build", ".venv", "__pycache__", ".*_cache", ".hypothesis")


# Python ---------------------------------------------------------------------------------------------------------------


def functions(tree, path=()):
    """Yield (qualified name, function) of a syntax tree; functions inside of functions belong to these."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef):
            yield ".".join((*path, node.name)), node
        elif isinstance(node, ast.ClassDef):
            yield from functions(node, (*path, node.name))


OPERATORS = {
    **{ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq},
    **{ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In},
    **{ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult},
}


def ordered(call):
    """Return whether the order of the first two arguments of a call counts."""
    name = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
    plain = len(call.args) > 1 and not any(isinstance(argument, ast.Starred) for argument in call.args)
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
    """Return name of the function, line, text before, text after, and the source of a mutant."""
    tree = ast.parse(source)
    name, function = list(functions(tree))[number]
    kind, node = list(places_in(function))[place]
    before = ast.unparse(node)
    change(kind, node, tree)
    after = "pass" if kind == "statement" else ast.unparse(node)
    return name, node.lineno, before, after, ast.unparse(tree)


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


@contextlib.contextmanager
def instead(path, text):
    """Write another text to a file for a while."""
    source, times = path.read_bytes(), path.stat()
    path.write_text(text)
    try:
        yield
    finally:
        path.write_bytes(source)
        # Its bytecode of before is still good.
        os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))


class Mutants:
    """A copy of the repository, and its compiled modules."""

    def __init__(self, given):
        self.folder, self.copy, self.limit = given.folder, given.folder / "repository", given.limit
        shutil.rmtree(self.copy, ignore_errors=True)
        shutil.copytree(given.repository, self.copy, ignore=LEFT_OUT, symlinks=True)
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

    def outcome(self, room, file):
        """Run the tests of a room until one fails; those near the mutant's file run first."""
        tests = [path for name in ROOMS[room] for path in sorted((self.copy / "tests" / name).rglob("test_*.py"))]
        tests.sort(key=lambda path: Path(file).stem not in path.stem)
        words = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *map(str, tests)]
        environment = {**os.environ, "PYTHONPATH": str(self.copy / "src"), "PYTHONDONTWRITEBYTECODE": "1"}
        with (self.folder / "repository.log").open("wb") as log:
            try:
                done = subprocess.run(
                    words, cwd=self.copy, env=environment, stdout=log, stderr=log, timeout=self.limit, check=False
                )
            except subprocess.TimeoutExpired:
                return "time limit"
        return "caught" if done.returncode else "survived"

    def tried(self, room, mutant, unchanged=False):
        """Return the report of a mutant; or of its unchanged file, to see whether the tests fail without a fault."""
        file, where, kind, place = mutant
        path = self.copy / file
        source = path.read_text()
        if room == "core":
            name = ""
            line, before, after, text = c_mutant(source, where, kind, place)
        else:
            name, line, before, after, text = python_mutant(source, where, place)
        if unchanged:
            text = source if room == "core" else ast.unparse(ast.parse(source))
        began = time.monotonic()
        with instead(path, text), self.compiled() if room == "core" else contextlib.nullcontext(True) as built:
            outcome = self.outcome(room, file) if built else "not compiled"
        return {
            "room": room,
            "file": file,
            "line": line,
            "function": name,
            "kind": kind,
            "before": before,
            "after": after,
            "seconds": round(time.monotonic() - began, 1),
            "outcome": outcome,
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
    parser.add_argument("--rooms", nargs="+", default=tuple(ROOMS))
    parser.add_argument("--limit", type=float, default=60.0, help="seconds of tests for each mutant")
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
