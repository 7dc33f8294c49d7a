"""Names in backticks in the docstrings of the sources exist: a docstring that outlived a change is found here."""

import ast
import re

import places

ROOT = places.ROOT
PACKAGE = ROOT / "src" / "dehyst"
NAME = re.compile(r"(?<!`)`([A-Za-z_][\w.]*)(?:\(.*?\))?`(?!`)")
# Names of other programs: of pipython, and files that FMI prescribes or an export is given.
FOREIGN = {"ReadGCSCommand", "GcsCommandset", "modelDescription.xml", "NAME.h", "check.c"}
DEFINITIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
# Fields of a node that hold a name.
NAMED = {
    ast.Name: ("id",),
    ast.Attribute: ("attr",),
    ast.arg: ("arg",),
    ast.keyword: ("arg",),
    ast.alias: ("asname", "name"),
    **dict.fromkeys(DEFINITIONS, ("name",)),
}


def bound(tree):
    """All names that are bound or used as an attribute, an argument or a key in a tree."""
    names = set()
    for node in ast.walk(tree):
        names.update(getattr(node, field) for field in NAMED.get(type(node), ()))
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value.isidentifier():
            names.add(node.value)
    return names


def members(trees):
    """What each class has: its own methods, attributes and fields, and those of the classes that it is made from."""
    classes = {}
    for tree in trees:
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


def c_names():
    """Identifiers of the C sources."""
    return {
        name
        for folder in ("bindings", "bindings/wasm", "src/dehyst/exports/templates")
        for path in (*places.CORE_FILES, *(ROOT / folder).glob("*.*"))
        for name in re.findall(r"[A-Za-z_]\w+", path.read_text(errors="ignore"))
    }


class Vocabulary:
    """The names of the sources."""

    def __init__(self, trees):
        self.members = members(trees.values())
        self.bound = {path: bound(tree) for path, tree in trees.items()}
        self.modules = {path.stem: names for path, names in self.bound.items()}
        folders = {part.name for part in PACKAGE.rglob("*") if part.is_dir()}
        self.every = set().union(*self.bound.values(), self.modules, folders, c_names())

    def has(self, name, path):
        """Whether a name means something: a private one in its own module, a dotted one in its class or module."""
        first, *rest = name.removeprefix("dehyst.").split(".")
        if not rest:
            private = first.startswith("_") and not first.startswith("__")
            return first in self.bound[path] if private else first in self.every
        if first in self.members:
            return rest[0] in self.members[first]
        if len(rest) == 1 and first in self.modules:
            return rest[0] in self.modules[first]
        return all(part in self.every for part in (first, *rest))


def test_names_in_docstrings_exist():
    trees = {path: ast.parse(path.read_text()) for path in sorted(PACKAGE.rglob("*.py"))}
    vocabulary, seen, stale = Vocabulary(trees), 0, []
    for path, tree in trees.items():
        for node in ast.walk(tree):
            if not isinstance(node, (ast.Module, *DEFINITIONS)):
                continue
            for name in NAME.findall(ast.get_docstring(node) or ""):
                seen += 1
                if name not in FOREIGN and not vocabulary.has(name, path):
                    stale.append((str(path.relative_to(PACKAGE)), getattr(node, "name", "module"), name))
    assert stale == []
    assert seen > 500
