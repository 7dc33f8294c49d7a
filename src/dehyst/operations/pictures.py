"""The picture of a planned path: displacement, voltage, and where the error is."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from dehyst._io import write_atomically
from dehyst._views.html import escape
from dehyst.control import PathPlan
from dehyst.report import pictures
from dehyst.report.charts import Axis, Chart, Series
from dehyst.report.html import Charts, Part, document, reproduction, words


def _voltage(plan: PathPlan) -> Chart:
    """Return the voltage with what comes before the path, at negative times, and its clamped samples."""
    if plan.time is None:
        axis, x = Axis("sample"), np.arange(plan.voltage.size, dtype=np.float64) - plan.first
    else:
        axis, x = Axis("time", "s"), plan.time - plan.time[plan.first]
    clamped = Series("clamped", x[plan.clamped], plan.voltage[plan.clamped], "simulated", "points", width=3)
    return Chart("Voltage", axis, Axis("voltage", "V"), [Series("voltage", x, plan.voltage, "measured"), clamped])


def draw_plans(path: Path, axes: Sequence[str], plans: Sequence[PathPlan], *, command: str) -> None:
    """Write a self-contained HTML page with the plan of each axis."""

    def parts() -> Iterator[Part]:
        yield "<h1>A planned path</h1>"
        for axis, plan in zip(axes, plans, strict=True):
            yield axis and f"<h2>Axis {escape(axis)}</h2>"
            yield "" if plan.promise is None else f"<p>{words(plan.promise.sentence)}</p>"
            charts = pictures.planned_path(plan), _voltage(plan), pictures.error_band(plan)
            yield Charts("", "What the model expects along the path, and the promise around it.", charts, wide=True)
        yield reproduction(command)

    write_atomically(path, document("A planned path", parts()))
