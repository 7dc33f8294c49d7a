"""The operations by name, in the order of their use; each is loaded when needed."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import click

# The commands under each heading: the module of this package that has the command, and its purpose.
JOURNEY: dict[str, dict[str, tuple[str, str]]] = {
    "Try it": {
        "demo": ("demo", "All steps on a virtual actuator"),
        "paper": ("paper", "Repeat the paper's experiment on a virtual actuator"),
    },
    "Excite and record": {
        "excite": ("waves", "Write the voltage of an excitation to play"),
        "show": ("show", "How a file is understood"),
        "calibrate": ("bench", "Do the whole experiment on an instrument"),
    },
    "Identify and know": {
        "identify": ("identify", "Fit a model to recorded loops"),
        "insight": ("assess", "How far to trust a model, and what to record next"),
        "compare": ("compare", "Compare with a table, a straight line and other models"),
        "fleet": ("fleet", "Identify many records at once, in one table"),
    },
    "Compensate and check": {
        "scan": ("waves", "Write the path of a scan to follow"),
        "compensate": ("compensate", "The voltage that follows a path"),
        "simulate": ("simulate", "The displacement that a voltage causes"),
        "check": ("assess", "Check with a new record whether a model is still true"),
        "update": ("assess", "Update a model from one new record"),
        "follow": ("follow", "Follow a path on an instrument, measure the error, learn"),
    },
    "Deploy": {
        "export": ("export", "C source for a microcontroller, WebAssembly, or an FMU"),
    },
}
ENTRIES = {name: entry for entries in JOURNEY.values() for name, entry in entries.items()}


def find(name: str) -> click.Command:
    """Return the command of an operation."""
    found: click.Command = getattr(import_module(f"dehyst.operations.{ENTRIES[name][0]}"), name)
    return found
