"""Plots of objects. They import `dehyst.report`, a layer above, when they are called."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, cast

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# The import by name points upward in the layers: see docs/explanation/decisions/0011-plot-methods.md.
_ROOM = "dehyst.report.plots"


class Plotted:
    """An object whose pictures are listed in ``dehyst.report.pictures`` by the name of its class."""

    __slots__ = ()

    def plot(self, kind: str | None = None, *, ax: Axes | None = None) -> Axes:
        """Draw the object on `ax`, by default new axes of matplotlib, and return them.

        `kind`, the first by default: "loop" or "time" of a record; "loop", "elements" or "creep" of an actuator;
        "loops", "hysteresis" (off the straight line), "residuals" or "residuals in time" of a fit and a check (which
        begins with "hysteresis"); "turns" (turning points) or "band" of an insight. Raise `ModelError` or `RecordError`
        if the object has no such picture, `MissingExtraError` if matplotlib is not installed.
        """
        return cast("Axes", import_module(_ROOM).draw(self, kind, ax))
