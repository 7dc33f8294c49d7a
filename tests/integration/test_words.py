"""The words of the house: one word for one thing in text, and variables that name their thing."""

import ast
import re

import places
import pytest

# A word that another one replaced, and that one.
REPLACED = {
    r"trust bands?": "promise",
    r"datum": "zero",
    r"held back": "slewed",
    r"set aside": "left out, subtracted",
    r"rises and falls": "branches",
    r"so many": "a number",
}
TEXTS = [places.ROOT / "README.md", *(path for path in places.DOCS.rglob("*.md") if "decisions" not in path.parts)]
SOURCES = sorted(places.SOURCES.rglob("*.[jp][sy]"))
REST = [places.TESTS, places.BENCHMARKS, places.ROOT / "examples", places.ROOT / "packages"]


@pytest.mark.parametrize("path", [*TEXTS, *SOURCES], ids=lambda path: f"{path.parent.name}/{path.name}")
def test_a_thing_has_one_word(path):
    # A field of a file or of an object keeps its name.
    text = re.sub(r"`[^`\n]*`|\.\w+", "", path.read_text()) if path.suffix == ".md" else path.read_text()
    found = {word: new for word, new in REPLACED.items() if re.search(rf"(?<![\w.`_]){word}(?![\w`_])", text)}
    assert found == {}


def named_one(node):
    stored = isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store) and node.id == "one"
    return stored or (isinstance(node, ast.arg) and node.arg == "one")


@pytest.mark.parametrize("folder", [places.SOURCES, *REST], ids=lambda folder: folder.name)
def test_variables_name_their_thing(folder):
    trees = (ast.parse(path.read_text()) for path in folder.rglob("*.py"))
    assert not any(named_one(node) for tree in trees for node in ast.walk(tree))


def test_a_comment_begins_with_its_subject():
    texts = (path.read_text() for folder in (places.SOURCES, *REST) for path in folder.rglob("*.[jp][sy]"))
    assert [line for text in texts for line in re.findall(r"(?m)^ *(?:#|//) (?:Of|What|Where|Whether)\b.*", text)] == []
