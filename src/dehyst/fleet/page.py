"""The page of a fleet: what to do (recalibrate, look at, measure again), then distributions and each record."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dehyst._io import PathLike, write_atomically
from dehyst._text import counted
from dehyst._types import Array
from dehyst._views.html import escape
from dehyst.fleet.drift import Drifts
from dehyst.fleet.findings import MISSED, QUANTITIES, Findings, modelled
from dehyst.report import Axis, Chart, Series, html

# Rows of a table on the page, and bars of a histogram.
_MOST, _BARS = 200, 40
# Diameter [px] of a record and of one to look at, and of both where there are many.
_DOTS, _SMALL_DOTS, _MANY = (5.0, 8.0), (3.0, 5.0), 2000
# Of a histogram from and to these quantiles, so that one outlier does not squeeze the others.
_ENDS = (0.002, 0.998)


def write_fleet_page(
    path: PathLike, findings: Findings, *, drifts: Drifts | None = None, command: str | None = None
) -> None:
    """Write a self-contained HTML file.

    `findings`: findings in the table. `drifts`: costs of ageing, if the table has sessions. `command`: the command that
    made the page. Raise `FileFormatError` if `path` cannot be written.
    """
    fleet = findings.fleet
    counts = ", ".join(f"{count} {outcome}" for outcome, count in findings.counts.items())
    total = counted(len(fleet), "record")
    refused = [
        (str(len(names)), reason, f"{', '.join(names[:5])}{', ...' if len(names) > 5 else ''}")
        for reason, names in findings.refused
    ]
    parts = [
        f"<h1>Fleet of {total}</h1>\n<p>{escape(f'{fleet.path.name}: {counts}.')}</p>",
        "" if drifts is None else _recalibrate(drifts),
        _listed(findings),
        _section("Without a model", "", ("records", "reason", "which"), refused, 3) if refused else "",
        html.bullets("Same samples", [escape(" = ".join(group)) for group in findings.duplicates[:_MOST]]),
        _distributions(findings),
        _map(findings),
        html.reproduction(command),
    ]
    write_atomically(path, html.document(f"Fleet of {total}: {fleet.path.stem}", [part for part in parts if part]))


def _section(title: str, words: str, head: tuple[str, ...], rows: Sequence[html.Row], texts: int) -> str:
    """Return a heading, a sentence, and the first rows of a table whose first columns are `texts`."""
    parts = [f"<h2>{title}</h2>", f"<p>{escape(words)}</p>" if words else ""]
    parts += [html.table(head, rows[:_MOST], texts)] if rows else []
    return "\n".join(part for part in parts if part)


def _recalibrate(drifts: Drifts) -> str:
    """Return the actuators to recalibrate, the largest cost first."""
    due = drifts.recalibrate
    words = (
        f"{len(due)} of {counted(len(drifts.ageing), 'actuator')} with two sessions or more, {drifts.ends[0]} to "
        f"{drifts.ends[1]}: keeping the oldest model costs more than {drifts.goal:g} % of the stroke, or the cost is "
        f"out of its limits. It usually costs {drifts.usual:.2g} %."
    )
    rows = []
    for one in due:
        first, *_, last = map(str, one.sessions)
        rows.append((str(one.serial), first, last, html.number(one.costs[-1]), f"{one.signed[-1]:+.2g}"))
    head = ("actuator", "since", "at", "cost, % of the stroke", "change of the stroke, %")
    return _section("To recalibrate", words, head, rows, 3)


def _listed(findings: Findings) -> str:
    if not findings.listed:
        return ""
    rows = [
        (one.record, one.quantity.title, html.number(one.value), html.number(one.median), html.number(one.score, 2))
        for one in findings.outliers
    ]
    rows += [(name, MISSED, "", "", "") for name in findings.inaccurate]
    more = f"\n<p>{len(rows) - _MOST} more: see dehyst fleet report --json.</p>" if len(rows) > _MOST else ""
    words = f"{counted(len(findings.listed), 'record')}, the farthest from the fleet first."
    return _section("To look at", words, ("record", "quantity", "value", "fleet's median", "z"), rows, 2) + more


def _distributions(findings: Findings) -> html.Charts | str:
    charts = []
    for quantity, values in findings.distributions().items():
        if values.size > 1:
            series = Series("records", *_histogram(values), "measured")
            axes = Axis(quantity.name, quantity.unit), Axis("records", "")
            charts.append(Chart(quantity.name, *axes, (series,)))
    if not charts:
        return ""
    caption = "Records over each quantity; of many records the outermost 0.2 % on either side are in the tables only."
    return html.Charts("Distributions", caption, tuple(charts))


def _histogram(values: Array) -> tuple[Array, Array]:
    """Return the outline of a histogram."""
    low, high = np.quantile(values, _ENDS[0], method="lower"), np.quantile(values, _ENDS[1], method="higher")
    inner = values[(values >= low) & (values <= high)]
    counts, edges = np.histogram(inner, bins=min(_BARS, max(5, values.size // 5)))
    x = np.repeat(edges, 2)
    return x, np.concatenate([[0.0], np.repeat(counts.astype(np.float64), 2), [0.0]])


def _map(findings: Findings) -> html.Charts | str:
    """Return width and error over the stroke, with one dot for each record."""
    rows = modelled(findings.fleet)
    if len(rows) < 2:
        return ""
    names = [findings.fleet.name(row) for row in rows]
    listed = set(findings.listed)
    far = np.array([name in listed for name in names])
    usual, larger = _DOTS if len(rows) <= _MANY else _SMALL_DOTS
    x = np.array([float(row["stroke_um"]) for row in rows])
    charts = []
    for quantity in (next(one for one in QUANTITIES if one.name == name) for name in ("width at 50 %", "RMS error")):
        y, title = quantity.values(rows), f"{quantity.name} over stroke"
        seen = tuple(name for name in names if name in listed)
        series = (
            Series("records", x[~far], y[~far], "measured", kind="points", width=usual, opacity=0.6),
            Series("to look at", x[far], y[far], "simulated", kind="points", width=larger, names=seen),
        )
        axes = Axis("stroke", "um"), Axis(quantity.name, quantity.unit)
        charts.append(Chart(title, *axes, [one for one in series if one.x.size]))
    return html.Charts("Each record", "Point at a record to look at, to read its name.", tuple(charts))
