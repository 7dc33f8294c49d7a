"""Smaller pages: a record, and coupled axes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from dehyst._io import PathLike, write_atomically
from dehyst._types import Array
from dehyst.identification import StageFit
from dehyst.records import Record
from dehyst.report import html
from dehyst.report.charts import Axis, Chart, Series, broken
from dehyst.report.html import Charts, Part, Row, bullets, length_unit, words


def write_record_page(path: PathLike, record: Record, columns: Iterable[Row], *, command: str | None = None) -> None:
    """Write a `record` to a self-contained HTML file.

    `columns`: quantity, column and range, in words. `path`, `command` and errors are as in `write_report`.
    """
    every = [record.axis(axis) for axis in record.axes or ("",)]
    in_time = [chart for one in every for chart in time_charts(one)]
    parts: list[Part] = [
        f"<h1>{html.escape(record.name)}</h1>",
        html.table(("quantity", "column", "range"), columns, 3),
        bullets("Notes", (words(problem) for one in every for problem in one.problems())),
        Charts("Against time", "Check that the voltage is that of the actuator, not of a monitor.", in_time),
        Charts("Loop", "A piezo actuator's loop runs counterclockwise.", [loop_chart(one) for one in every]),
        html.reproduction(command),
    ]
    write_atomically(path, html.document(f"{record.name}: record", parts))


def time_charts(record: Record) -> list[Chart]:
    """Return voltage and displacement of a record of one axis against time, and a signal that was counted."""
    factor, unit = length_unit(record.stroke)
    quantities = [(record.voltage, Axis("voltage", "V")), (record.displacement * factor, Axis("displacement", unit))]
    quantities += [(one.values, Axis("signal", one.unit)) for one in record.others if one.name == "signal"]
    return [Chart(record.name, Axis("time", "s"), y, _drawn(record, record.time, values)) for values, y in quantities]


def loop_chart(record: Record) -> Chart:
    """Return the displacement of a record of one axis over its voltage."""
    factor, unit = length_unit(record.stroke)
    x, y = Axis("voltage", "V"), Axis("displacement", unit)
    return Chart(record.name, x, y, _drawn(record, record.voltage, record.displacement * factor))


def _drawn(record: Record, x: Array, y: Array) -> list[Series]:
    """Return a line through all samples, and points at events."""
    line, at = Series("", x, broken(record.time, y), "measured"), record.measured
    return [line] if at is None else [line, Series("events", x[at], y[at], "simulated", "points", 4.0)]


def write_stage_report(path: PathLike, fit: StageFit, records: Sequence[Record], *, command: str | None = None) -> None:
    """Write the report of a `fit` of several axes to a self-contained HTML file.

    `records`: the records of the identification, training first. `path`, `command` and errors are as in `write_report`.
    """
    parts: list[Part] = [
        "<h1>Coupled axes</h1>",
        f"<p>{words(fit.verdict)}.</p>",
        _coupling(fit),
        _stage_errors(fit),
        *_axes(fit, records),
        bullets("Axes", (words(f"{a}: {one}") for a, one in zip(fit.axes, fit.fits, strict=True))),
        html.reproduction(command),
    ]
    write_atomically(path, html.document("Coupled axes", parts))


def _coupling(fit: StageFit) -> str:
    matrix: list[Row] = []
    for i, axis in enumerate(fit.axes):
        entries = [f"{own:+.5f} ± {error:.5f}" for own, error in zip(fit.coupling[i], fit.uncertainty[i], strict=True)]
        matrix.append((axis, *entries[:i], "1", *entries[i + 1 :]))
    caption = (
        f"Displacement of each axis (row) for each metre that an actuator (column) moves, with its standard error. "
        f"Condition {fit.condition:.4g}."
    )
    return f"<h2>Coupling</h2><p>{html.escape(caption)}</p>{html.table(('axis', *fit.axes), matrix, 1)}"


def _stage_errors(fit: StageFit) -> str:
    head = ("record", "axis", "role", "samples", "largest, % of the stroke", "RMS, %", "largest, nm")
    rows = [
        (
            *(e.record, e.axis, e.role, str(e.samples)),
            *(f"{e.largest_percent:.3f}", f"{e.rms_percent:.3f}", f"{1e9 * e.largest:.1f}"),
        )
        for e in fit.errors
    ]
    return f"<h2>Errors of simulating each record</h2>{html.table(head, rows, 3)}" if rows else ""


def _axes(fit: StageFit, records: Sequence[Record]) -> list[Part]:
    """Return the loops of each axis, and what the model leaves over the voltages of the others."""
    caption = (
        "Measured displacement over the axis' own voltage, then the model's residual over the voltage of each other "
        "axis: a shape in the residual is coupling that the matrix does not describe."
    )
    parts: list[Part] = []
    for i, axis in enumerate(fit.axes):
        charts = []
        # Its own voltage first.
        for j in sorted(range(len(fit.axes)), key=lambda k: k != i):
            shown = [one.displacement * 1e6 for one in records] if j == i else [one * 1e9 for one in fit.residuals]
            y = Axis(f"displacement {axis}", "µm") if j == i else Axis(f"residual of {axis}", "nm")
            lines = [
                Series(record.name, record.voltage[:, j], broken(record.time, values[:, i]), "measured", width=1)
                for record, values in zip(records, shown, strict=True)
            ]
            charts.append(Chart(y.quantity, Axis(f"voltage of {fit.axes[j]}", "V"), y, lines))
        parts.append(Charts(f"Axis {axis}", caption, charts))
    return parts
