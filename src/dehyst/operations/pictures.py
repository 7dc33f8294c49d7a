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
    """Return the voltage along the path, without what comes before it, and its clamped samples."""
    volts, clamped = plan.voltage[plan.first :], plan.clamped[plan.first :]
    axis, x = Axis("sample"), np.arange(volts.size, dtype=np.float64)
    if plan.time is not None:
        axis, x = Axis("time", "s"), plan.time[plan.first :] - plan.time[plan.first]
    series = [Series("voltage", x, volts, "measured")]
    series += [Series("clamped", x[clamped], volts[clamped], "simulated", "points", width=3)] if clamped.any() else []
    return Chart("Voltage", axis, Axis("voltage", "V"), series)


def draw_plans(path: Path, axes: Sequence[str], plans: Sequence[PathPlan], *, command: str) -> None:
    """Write a self-contained HTML page with the plan of each axis."""

    def parts() -> Iterator[Part]:
        yield "<h1>A planned path</h1>"
        for axis, plan in zip(axes, plans, strict=True):
            yield axis and f"<h2>Axis {escape(axis)}</h2>"
            yield "" if plan.promise is None else f"<p>{words(plan.promise.sentence)}</p>"
            charts = pictures.planned_path(plan), _voltage(plan), pictures.error_band(plan)
            yield Charts("", f"After {plan.seconds or 0.0:.4g} s that lead to the path.", charts, wide=True)
        yield reproduction(command)

    write_atomically(path, document("A planned path", parts()))
