"""The public names of each room, which are `__all__` of its package, and the classes that they return.

A program writes public names only. It gets objects of further classes from them, which need no name of their own, but
whose members are as public: `tests/golden/public_api.txt` has both with signatures, and so has the reference.
"""

import importlib
import inspect
import re

_ROOMS = (
    "calibration cli control exports fleet identification instruments model records report paper testing trust virtual "
    "waveforms web workbench"
)
_MODULES = {room: importlib.import_module(f"dehyst.{room}") for room in _ROOMS.split()}
FACES = {
    "dehyst": list(importlib.import_module("dehyst").__all__),
    **{room: list(getattr(module, "__all__", ())) for room, module in _MODULES.items()},
}
# Drivers are imported one by one: each needs its own library or instrument.
DRIVERS = {"dehyst.instruments.epics": ["EpicsRig", "PvNames"], "dehyst.instruments.pi": ["PiRig"]}
# Types in a docstring: "name : type", or classes alone, as of a result.
_TYPES = re.compile(r"^(?:[\w, ]+ : .+|[A-Z]\w+(?:(?:, | or )[A-Z]\w+)*)$", re.MULTILINE)


def public():
    """Every public object with the name under which it is imported, each once, `dehyst` first."""
    named = {}
    for room, names in {**FACES, **DRIVERS}.items():
        module = importlib.import_module(room if room.startswith("dehyst") else f"dehyst.{room}")
        for name in names:
            named.setdefault(getattr(module, name), f"{module.__name__}.{name}")
    return named


def _types(thing):
    """Texts that name the types of what an object gives: its results and fields, as documented, else as annotated."""
    documented = _TYPES.findall(inspect.cleandoc(thing.__doc__ or ""))
    if not inspect.isclass(thing):
        return [*documented, str(getattr(thing, "__annotations__", {}).get("return"))]
    texts = documented or [str(kind) for kind in vars(thing).get("__annotations__", {}).values()]
    for name, member in vars(thing).items():
        call = getattr(member, "__func__", getattr(member, "fget", getattr(member, "func", member)))
        texts += _types(call) if inspect.isfunction(call) and not name.startswith("_") else ()
    return texts


def returned():
    """The classes that faces offer, and that public objects give or are derived from: class -> name."""
    offered = {
        kind: f"{module.__name__}.{kind.__name__}"
        for module in _MODULES.values()
        for kind in vars(module).values()
        if inspect.isclass(kind) and f"{kind.__module__}.".startswith(f"{module.__name__}.")
    }
    by_name, named = {kind.__name__: kind for kind in offered}, {*public()}
    waiting = [*named]
    while waiting:
        thing = waiting.pop()
        words = re.findall(r"\w+", " ".join(_types(thing)))
        new = {by_name[word] for word in words if word in by_name} | {*getattr(thing, "__bases__", ())} & {*offered}
        waiting += new - named
        named |= new
    return {
        kind: name for kind, name in sorted(offered.items(), key=lambda item: item[1]) if kind in named - {*public()}
    }
