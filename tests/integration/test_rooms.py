"""The walls of the house: what each room offers, and who imports whom."""

import ast
import re
from functools import cache
from graphlib import CycleError, TopologicalSorter

import architecture
import places
import pytest
from faces import DRIVERS, FACES, returned

MODULES = architecture.files()
# Folders, and single files.
_PLACES = (*(path.parent for path in places.SOURCES.glob("*/__init__.py")), *places.SOURCES.glob("*.py"))
ROOMS = sorted({path.stem for path in _PLACES if not path.stem.startswith("_")})
PAGES = [places.ROOT / "README.md", *sorted(places.DOCS.rglob("*.md"))]


@cache
def tree_of(module):
    return ast.parse(MODULES[module].read_text())


def trees():
    return {module: tree_of(module) for module in MODULES}


def room_of(module):
    return (*module.split("."), "", "")[1]


def offered(face):
    """The names that a face imports, for everybody or for sister rooms; a room in a file lists them."""
    if MODULES[face].name != "__init__.py":
        return set(FACES[room_of(face)])
    return {alias.name for node in tree_of(face).body if isinstance(node, ast.ImportFrom) for alias in node.names}


OFFERED = {f"dehyst.{room}": offered(f"dehyst.{room}") for room in FACES if room != "dehyst"}
# Rooms that run the library: each of their modules loads what one command needs.
COMMANDS = {"cli", "operations", "workbench"}
# Modules that are imported one by one: what they load is needed nowhere else.
ALONE = {*DRIVERS}


def crossing():
    """Every import from another room, for type checkers too: the importing module, and what it imports from where."""
    for module, tree in trees().items():
        for node in ast.walk(tree):
            source = node.module if isinstance(node, ast.ImportFrom) else ""
            if room_of(module) != "" and room_of(source) in {*ROOMS} - {room_of(module)}:
                yield from ((module, source, alias.name) for alias in node.names)


@pytest.mark.parametrize("face", [face for face in OFFERED if MODULES[face].name == "__init__.py"])
def test_a_face_only_imports_and_lists(face):
    documentation, *statements = tree_of(face).body
    assert isinstance(documentation, ast.Expr)
    assert isinstance(documentation.value, ast.Constant)
    if not isinstance(statements[-1], ast.ImportFrom):
        listed = statements.pop()
        assert isinstance(listed, ast.Assign)
        assert listed.targets[0].id == "__all__"
        assert set(ast.literal_eval(listed.value)) <= OFFERED[face]
    assert all(isinstance(node, ast.ImportFrom) for node in statements)


def test_every_name_of_a_face_is_public_or_returned_or_imported_by_another_room():
    used = {(source, name) for _, source, name in crossing()}
    rivals = map(ast.parse, (path.read_text() for path in places.RIVALS.rglob("*.py")))
    used |= {(statement.module, statement.name) for tree in rivals for statement in architecture.imports(tree)}
    public = {(f"dehyst.{room}", name) for room, names in FACES.items() for name in names}
    public |= {tuple(name.rsplit(".", 1)) for name in returned().values()} | {("dehyst.cli", "main")}
    assert {(face, name) for face, names in OFFERED.items() for name in names} - used - public == set()


def test_rooms_import_each_other_through_their_faces():
    passed_by = [
        f"{module}: {name} from {source}"
        for module, source, name in crossing()
        if source not in ALONE and name not in OFFERED.get(source, ()) and room_of(module) not in COMMANDS
    ]
    assert passed_by == []


def test_imports_have_no_cycle():
    graph = architecture.module_graph(MODULES, deferred=False)
    assert sum(map(len, graph.values())) > 500
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


def snippets(page):
    """The Python of a page: its fenced blocks, or an example as a whole."""
    text = page.read_text()
    return [text] if page.suffix == ".py" else re.findall(r"```python\n(.*?)```", text, re.DOTALL)


@pytest.mark.parametrize(
    "page", [*PAGES, *sorted(places.EXAMPLES.rglob("*.py"))], ids=lambda page: str(page.relative_to(places.ROOT))
)
def test_readme_docs_and_examples_use_only_public_names(page):
    public = {"dehyst": FACES["dehyst"], **{f"dehyst.{room}": names for room, names in FACES.items()}, **DRIVERS}
    hidden = []
    for tree in map(ast.parse, snippets(page)):
        ours = [statement for statement in architecture.imports(tree) if statement.module.split(".")[0] == "dehyst"]
        hidden += [
            f"from {statement.module} import {statement.name}"
            for statement in ours
            if statement[:2] != ("dehyst", None) and statement.name not in public.get(statement.module, ())
        ]
        attributes = [node for node in ast.walk(tree) if isinstance(node, ast.Attribute)]
        used = {node.attr for node in attributes if ast.unparse(node.value) == "dehyst"}
        hidden += [f"dehyst.{name}" for name in sorted(used - set(FACES["dehyst"]))]
    assert hidden == []
