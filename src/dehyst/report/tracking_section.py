"""What was measured along a path, as a section of the report."""

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
    """The section: a table, what was wanted and reached, and the errors; nothing if nothing was followed."""
    if not followed:
        return []
    head = ("Voltage", "Largest error, % of the stroke", "RMS, %", "Largest")
    rows = [
        (
            (name, _WORDS.get(name, "")),
            number(one.largest_percent),
            number(one.rms_percent),
            length(float(np.abs(one.error).max())),
        )
        for name, one in followed.items()
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
        for (name, one), colour in zip(followed.items(), _COLOURS, strict=False):
            ax.plot(one.time, one.reached * factor, color=colour, lw=1.2, label=name)
        first = next(iter(followed.values()))
        ax.plot(first.time, first.wanted * factor, color=INK, lw=0.8, ls="--", label="wanted")
        ax.set(xlabel="time (s)", ylabel=f"displacement ({unit})")
        ax.legend(loc="upper center", ncols=3)
        ax.margins(y=0.15)

    return inline("path", draw)


def _errors(followed: Mapping[str, TrackedPath]) -> list[str]:
    """One panel each, on a scale of its own: they differ too much for one."""
    panels = []
    for (name, one), colour in zip(followed.items(), _COLOURS, strict=False):

        def draw(ax: Axes, one: TrackedPath = one, colour: str = colour) -> None:
            ax.plot(one.time, 100 * one.error / one.stroke, color=colour, lw=1)
            ax.axhline(0, color=INK, lw=0.8)
            ax.set(xlabel="time (s)", ylabel="error (% of the stroke)")

        panels.append(panel((name, _WORDS.get(name, "")), inline(f"error-{name}", draw), "Error of"))
    return panels
