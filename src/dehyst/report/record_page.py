"""A record as a page: what its file was understood as, against time and as a loop."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from dehyst._io.drafts import PathLike, write_atomically
from dehyst.records import Record
from dehyst.report.html import Row, bullets, document, escape, figure, panel, reproduction, spelled, table
from dehyst.report.plots import MEASURED, inline, length_unit, line

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Points of a line that are drawn; between them nothing is visible at the size of the page.
_MOST = 20_000


def write_record_page(path: PathLike, record: Record, columns: Iterable[Row], *, command: str | None = None) -> None:
    """Write a record to one HTML file that loads nothing from outside.

    `record`: the record. `columns`: quantity, column and range, in words. `path`, `command` and errors are as in
    `write_report`.
    """
    title = (record.name, "")
    parts = [
        f"<h1>{escape(record.name)}</h1>",
        table(("quantity", "column", "range"), columns, 3),
        bullets("Notes", [escape(spelled(problem)) for problem in record.problems()]),
        figure(
            "Against time",
            "Check that the voltage is that of the actuator, not of a monitor.",
            [panel(title, _in_time(record), "time")],
        ),
        figure("Loop", "A piezo actuator's loop runs counterclockwise.", [panel(title, _loop(record), "loop")]),
        reproduction(command),
    ]
    write_atomically(path, document(f"{record.name}: record", [part for part in parts if part]))


def _in_time(record: Record) -> str:
    factor, unit = length_unit(record.stroke)
    rows = _drawn(record)

    def draw(upper: Axes, lower: Axes) -> None:
        line(upper, record.time[rows], record.voltage[rows], color=MEASURED)
        line(lower, record.time[rows], record.displacement[rows] * factor, color=MEASURED)
        upper.set(ylabel="voltage (V)")
        lower.set(xlabel="time (s)", ylabel=f"displacement ({unit})")

    return inline(f"{record.name}-time", draw, rows=2, height=4.2)


def _loop(record: Record) -> str:
    factor, unit = length_unit(record.stroke)
    rows = _drawn(record)

    def draw(ax: Axes) -> None:
        ax.plot(record.voltage[rows], record.displacement[rows] * factor, color=MEASURED, lw=0.8)
        ax.set(xlabel="voltage (V)", ylabel=f"displacement ({unit})")

    return inline(f"{record.name}-loop", draw)


def _drawn(record: Record) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    return np.unique(np.linspace(0, len(record) - 1, min(len(record), _MOST)).astype(np.intp))
