"""Tests assert numbers, types and fields; few of them pin a sentence, which then can be worded better freely."""

import ast
import re

import places

SENTENCE = re.compile(r"(?:[A-Za-z'-]{2,}[ ,]+){3}[A-Za-z']{2,}")


def checks(tree):
    """Yield what is demanded: the expression of each `assert`, and each `match`."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Assert):
            yield node.test
        elif isinstance(node, ast.keyword) and node.arg == "match":
            yield node.value


def pins(check):
    """Whether four words of English in a row are demanded."""
    constants = (node.value for node in ast.walk(check) if isinstance(node, ast.Constant))
    return any(isinstance(value, str) and SENTENCE.search(value) for value in constants)


def test_at_most_four_of_a_hundred_checks_pin_a_sentence():
    pinned = [pins(check) for path in places.TESTS.rglob("test_*.py") for check in checks(ast.parse(path.read_text()))]
    assert sum(pinned) <= 0.04 * len(pinned)
