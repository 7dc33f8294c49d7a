"""The public interface as text: names and signatures of Python, and the options of the command line.

After an intended change: python tests/support/public_api.py
"""

import inspect
import re
import sys
from enum import Enum
from pathlib import Path

HERE = Path(__file__).parent
LISTED = HERE.parent / "golden" / "public_api.txt"


def signature(thing):
    """Names, kinds, defaults and annotations, without text that differs between runs."""
    shown = re.sub(r" at 0x[0-9a-f]+", "", str(inspect.signature(thing)))
    return re.sub(r"ForwardRef\(('[^']*')\)", r"\1", shown)


def of_class(name, kind, public):
    """Lines of a class: its signature, and the methods and properties that no other public class has."""
    if issubclass(kind, Enum):
        yield f"{name}: {' '.join(kind.__members__)}"
        return
    if issubclass(kind, Exception):
        yield f"{name}({', '.join(base.__name__ for base in kind.__bases__)})"
        return
    yield f"{name}{signature(kind)}"
    for member in sorted(dir(kind)):
        value = inspect.getattr_static(kind, member)
        owner = next(base for base in kind.__mro__ if member in vars(base))
        of_others = owner is not kind and (owner in public or not owner.__module__.startswith("dehyst"))
        if member.startswith(("_", "test_")) or of_others:
            continue
        value = getattr(value, "__func__", value)
        yield f"{name}.{member}{signature(value) if inspect.isfunction(value) else ''}"


def of_rooms():
    """Lines of each public name: values, then functions and classes, each once; then the classes that these return."""
    from faces import public, returned

    named = {**public(), **returned()}
    for thing, name in named.items():
        if callable(thing):
            yield from of_class(name, thing, named) if inspect.isclass(thing) else [f"{name}{signature(thing)}"]
        else:
            yield name


def of_commands():
    """A line for each command with its options."""
    from command_line import commands

    for name, command in commands():
        words = [
            "|".join((*own.opts, *own.secondary_opts)) if own.param_type_name == "option" else own.name.upper()
            for own in command.params
        ]
        yield f"$ dehyst {name} {' '.join(words)}"


def lines():
    """The whole interface, in the order of the rooms."""
    return [*of_rooms(), *of_commands()]


if __name__ == "__main__":
    sys.path.insert(0, str(HERE))
    LISTED.write_text("\n".join(lines()) + "\n", encoding="utf-8")
