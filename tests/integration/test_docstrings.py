"""Names in backticks in the docstrings of the sources exist: a docstring that outlived a change is found here."""

import ast
import re

import places

ROOT = places.ROOT
PACKAGE = ROOT / "src" / "dehyst"
NAME = re.compile(r"(?<!`)`([A-Za-z_][\w.]*)(?:\(.*?\))?`(?!`)")
# Names of other programs: of pipython, and files that FMI prescribes or an export is given.
FOREIGN = {"ReadGCSCommand", "GcsCommandset", "modelDescription.xml", "NAME.h"}
DEFINITIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)

TREES = {path: ast.parse(path.read_text()) for path in sorted(PACKAGE.rglob("*.py"))}
C_NAMES = {
    name
    for path in (*places.CORE_FILES, *(ROOT / "bindings").iterdir(), *(PACKAGE / "exports" / "templates").iterdir())
    for name in re.findall(r"[A-Za-z_]\w+", path.read_text(errors="ignore"))
}


def bound(tree):
    """All names that are bound or used as an attribute, an argument or a key in a tree."""
    names = set()
    for node in ast.walk(tree):
        for kind, field in (
            (ast.Name, "id"),
            (ast.Attribute, "attr"),
            (ast.arg, "arg"),
            (ast.keyword, "arg"),
            (ast.alias, "asname"),
            (ast.alias, "name"),
            (DEFINITIONS, "name"),
        ):
            if isinstance(node, kind):
                names.add(getattr(node, field))
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value.isidentifier():
            names.add(node.value)
    return names


def members():
    """What each class has: its own methods, attributes and fields, and those of the classes that it is made from."""
    classes = {}
    for tree in TREES.values():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                classes.setdefault(node.name, []).append(node)

    def of(name):
        return set().union(*map(of_one, classes[name]))

    def of_one(node):
        own = {part.name for part in node.body if isinstance(part, DEFINITIONS)}
        own |= {part.target.id for part in node.body if isinstance(part, ast.AnnAssign)}
        own |= {target.id for part in node.body if isinstance(part, ast.Assign) for target in part.targets}
        own |= {
            part.attr
            for part in ast.walk(node)
            if isinstance(part, ast.Attribute)
            and isinstance(part.ctx, ast.Store)
            and getattr(part.value, "id", "") == "self"
        }
        bases = {getattr(base, "id", getattr(base, "attr", "")) for base in node.bases} & classes.keys()
        return own.union(*(of(base) for base in bases))

    return {name: of(name) for name in classes}


MEMBERS = members()
BOUND = {path: bound(tree) for path, tree in TREES.items()}
MODULES = {path.stem: names for path, names in BOUND.items()}
EVERY = set().union(*BOUND.values(), MODULES, {part.name for part in PACKAGE.rglob("*") if part.is_dir()}, C_NAMES)


def exists(name, path):
    """Whether a name means something: a private one in its own module, a dotted one in its class or module."""
    first, *rest = name.removeprefix("dehyst.").split(".")
    if not rest:
        return first in BOUND[path] if first.startswith("_") and not first.startswith("__") else first in EVERY
    if first in MEMBERS:
        return rest[0] in MEMBERS[first]
    if len(rest) == 1 and first in MODULES:
        return rest[0] in MODULES[first]
    return all(part in EVERY for part in (first, *rest))


def test_names_in_docstrings_exist():
    seen, stale = 0, []
    for path, tree in TREES.items():
        for node in ast.walk(tree):
            if not isinstance(node, (ast.Module, *DEFINITIONS)):
                continue
            for name in NAME.findall(ast.get_docstring(node) or ""):
                seen += 1
                if name not in FOREIGN and not exists(name, path):
                    stale.append((str(path.relative_to(PACKAGE)), getattr(node, "name", "module"), name))
    assert stale == []
    assert seen > 500
