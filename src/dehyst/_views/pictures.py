"""Plots of objects, by `dehyst.report`, which is a layer above and is imported when needed."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, cast

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# By name: an import statement would lead upward. See docs/explanation/decisions/0011-plot-methods.md.
_ROOM = "dehyst.report.object_plots"


def plotted(function: str, thing: object, kind: str | None, ax: Axes | None) -> Axes:
    """Draw an object with a function of ``dehyst.report.object_plots``; return the axes."""
    return cast("Axes", getattr(import_module(_ROOM), function)(thing, kind, ax))
