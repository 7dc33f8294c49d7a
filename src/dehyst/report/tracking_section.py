"""Measurements along a path, as a section of the report."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from dehyst.control import TrackedPath
from dehyst.report.html import figure, length, number, panel, table
from dehyst.report.plots import INK, MEASURED, SIMULATED, inline, length_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLOURS = (SIMULATED, MEASURED)
_WORDS = {"nominal": "by a constant ratio", "compensated": "by the model"}


def followed_sections(followed: Mapping[str, TrackedPath]) -> list[str]:
    """Return a table and figures of the wanted and the reached path and of the errors; empty without a path."""
    if not followed:
        return []
    head = ("Voltage", "Largest error, % of the stroke", "RMS, %", "Largest")
    rows = [
        (
            (name, _WORDS.get(name, "")),
            number(path.largest_percent),
            number(path.rms_percent),
            length(float(np.abs(path.error).max())),
        )
        for name, path in followed.items()
    ]
    caption = (
        "The actuator was homed, driven along the path by each voltage, and measured: wanted and reached displacement, "
        "and reached minus wanted, each on a scale of its own. The first leg, from the homing onto the path, is "
        "left out."
    )
    return [
        "<h2>Measured along a path</h2>",
        table(head, rows, texts=1),
        figure("", caption, [panel(("Path", ""), _paths(followed), "Path"), *_errors(followed)]).replace(
            "<h2></h2>\n", ""
        ),
    ]


def _paths(followed: Mapping[str, TrackedPath]) -> str:
    factor, unit = length_unit(next(iter(followed.values())).stroke)

    def draw(ax: Axes) -> None:
        for (name, path), colour in zip(followed.items(), _COLOURS, strict=False):
            ax.plot(path.time, path.reached * factor, color=colour, lw=1.2, label=name)
        first = next(iter(followed.values()))
        ax.plot(first.time, first.wanted * factor, color=INK, lw=0.8, ls="--", label="wanted")
        ax.set(xlabel="time (s)", ylabel=f"displacement ({unit})")
        ax.legend(loc="upper center", ncols=3)
        ax.margins(y=0.15)

    return inline("path", draw)


def _errors(followed: Mapping[str, TrackedPath]) -> list[str]:
    """Return one panel for each voltage, on its own scale: the errors differ too much for one scale."""
    panels = []
    for (name, path), colour in zip(followed.items(), _COLOURS, strict=False):

        def draw(ax: Axes, path: TrackedPath = path, colour: str = colour) -> None:
            ax.plot(path.time, 100 * path.error / path.stroke, color=colour, lw=1)
            ax.axhline(0, color=INK, lw=0.8)
            ax.set(xlabel="time (s)", ylabel="error (% of the stroke)")

        panels.append(panel((name, _WORDS.get(name, "")), inline(f"error-{name}", draw), "Error of"))
    return panels
