"""The operations by name, in the order of their use; each is loaded when needed."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    import click


class Entry(NamedTuple):
    """Location of an operation, `module:name` in this package, and its purpose in a few words."""

    place: str
    words: str


JOURNEY: dict[str, dict[str, Entry]] = {
    "Try it": {
        "demo": Entry("demo:demo", "All steps on a virtual actuator"),
        "paper": Entry("paper:paper", "Repeat the paper's experiment on a virtual actuator"),
    },
    "Excite and record": {
        "excite": Entry("waves:excite", "Write the voltage of an excitation to play"),
        "show": Entry("show:show", "How a file is understood, with a drawing"),
        "calibrate": Entry("bench:calibrate", "Do the whole experiment on an instrument"),
    },
    "Identify and know": {
        "identify": Entry("identify:identify", "Fit a model to recorded loops"),
        "insight": Entry("assess:insight", "How far to trust a model, and what to record next"),
        "compare": Entry("compare:compare", "Compare with a table, a straight line and other models"),
        "fleet": Entry("fleet:fleet", "Identify many records at once, in one table"),
    },
    "Compensate and check": {
        "scan": Entry("waves:scan", "Write the path of a scan to follow"),
        "compensate": Entry("compensate:compensate", "The voltage that follows a path"),
        "simulate": Entry("simulate:simulate", "The displacement that a voltage causes"),
        "check": Entry("assess:check", "Whether a model is still true, by a new record"),
        "update": Entry("assess:update", "Update a model from one new record"),
        "follow": Entry("follow:follow", "Follow a path on an instrument, measure the error, learn"),
    },
    "Deploy": {
        "export": Entry("export:export", "C source for a microcontroller, WebAssembly, or an FMU"),
    },
}
ENTRIES = {name: entry for entries in JOURNEY.values() for name, entry in entries.items()}


def find(name: str) -> click.Command:
    """Return the command of an operation; raise OperationError if there is no such operation."""
    if name not in ENTRIES:
        from dehyst.operations.command import OperationError

        raise OperationError(argument="operation", got=repr(name), need=f"one of {', '.join(ENTRIES)}")
    module, _, function = ENTRIES[name].place.partition(":")
    found: click.Command = getattr(import_module(f"dehyst.operations.{module}"), function)
    return found
