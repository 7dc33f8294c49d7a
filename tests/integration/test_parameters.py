"""Every parameter of a public function, class or method is documented, and none is documented that is not there."""

import importlib
import inspect
import re
from enum import Enum

import pytest
from faces import FACES

HEADING = re.compile(r"^(\w[\w ]*)\n-{3,}$", re.M)
ENTRY = re.compile(r"^(\*{0,2}\w+(?:, \*{0,2}\w+)*)(?: :.*)?$", re.M)
IN_PROSE = re.compile(r"(?<!`)`\*{0,2}(\w+)`(?!`)")
IMPLIED = {"self", "cls"}


def entries(text):
    """The names in a docstring's `Parameters` and, of a dataclass, `Attributes`: in numpydoc's form."""
    _, *parts = HEADING.split(inspect.cleandoc(text or ""))
    sections = dict(zip(parts[::2], parts[1::2], strict=True))
    lines = ENTRY.findall(sections.get("Parameters", "") + "\n" + sections.get("Attributes", ""))
    return {name.strip("* ") for line in lines for name in line.split(",")}


def documented(text):
    """The names that a docstring explains: in those sections, or in backticks in the sentences above all sections."""
    return entries(text) | set(IN_PROSE.findall(HEADING.split(inspect.cleandoc(text or ""))[0]))


def parameters(thing):
    """The names that a caller may give."""
    names = inspect.signature(thing).parameters
    return {name for name in names if not name.startswith("_")} - IMPLIED


def members(thing):
    """The public methods that a class defines itself, as functions."""
    for name, member in vars(thing).items():
        function = getattr(member, "__func__", member)
        # The tests of a contract take fixtures.
        if inspect.isfunction(function) and not name.startswith(("_", "test_")):
            yield name, function


def is_given_parameters(thing):
    """Whether somebody makes it by its arguments: no exception, enumeration or interface."""
    return not (
        issubclass(thing, (Exception, Enum)) or inspect.isabstract(thing) or getattr(thing, "_is_protocol", False)
    )


def public_things():
    """Each public function, class and method once: its name, itself, and the docstrings that may document it."""
    seen = set()
    for room in FACES:
        face = importlib.import_module("dehyst" if room == "dehyst" else f"dehyst.{room}")
        for name in FACES[room]:
            thing = getattr(face, name)
            if not callable(thing) or thing in seen:
                continue
            seen.add(thing)
            if inspect.isfunction(thing):
                yield f"{room}.{name}", thing, [thing.__doc__]
            elif inspect.isclass(thing):
                line = [kind for kind in thing.__mro__ if kind.__module__.startswith("dehyst")]
                if is_given_parameters(thing):
                    yield f"{room}.{name}", thing, [kind.__doc__ for kind in line]
                for method, function in members(thing):
                    texts = [vars(kind)[method].__doc__ for kind in line if method in vars(kind)]
                    named = {name for text in texts for name in re.findall(r"see\s+`(\w+)`", text or "")}
                    texts += [kind.__doc__ for kind in line if kind.__name__ in named]
                    yield f"{room}.{name}.{method}", function, texts


THINGS = {name: (thing, texts) for name, thing, texts in public_things()}


def test_all_of_them_are_looked_at():
    assert len(THINGS) > 250
    assert {"dehyst.identify", "dehyst.Compensator.step", "records.read_table"} <= THINGS.keys()


@pytest.mark.parametrize("name", THINGS)
def test_every_parameter_is_documented(name):
    thing, texts = THINGS[name]
    assert parameters(thing) - set().union(*map(documented, texts)) == set()


@pytest.mark.parametrize("name", [name for name, (thing, _) in THINGS.items() if inspect.isfunction(thing)])
def test_no_parameter_is_documented_that_is_not_there(name):
    thing, (text, *_) = THINGS[name]
    assert entries(text) <= parameters(thing)


def test_the_check_would_notice():
    def scaled(path, *records, by, unit):
        """Return records with displacements in a `unit`.

        Parameters
        ----------
        path, *records : Record
            What to scale: not a name.

        Raises
        ------
        ValueError
            If `by` is zero.
        """

    assert parameters(scaled) - documented(scaled.__doc__) == {"by"}
