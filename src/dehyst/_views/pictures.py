"""The door to pictures: objects are drawn by `dehyst.report`, which lies above them and is loaded when it is needed."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, cast

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# By name: an import statement would lead upward. See docs/explanation/decisions/0011-plot-methods.md.
_ROOM = "dehyst.report.object_plots"


def plotted(function: str, thing: object, kind: str | None, ax: Axes | None) -> Axes:
    """Draw an object by a function of the room that draws; return the axes."""
    return cast("Axes", getattr(import_module(_ROOM), function)(thing, kind, ax))
