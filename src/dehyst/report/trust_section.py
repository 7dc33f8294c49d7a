"""The assessment of a model: sections of the report, or a separate page."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dehyst._io import PathLike, write_atomically
from dehyst._types import Array
from dehyst.control import PathPlan
from dehyst.identification import Identifiability
from dehyst.model import Promise
from dehyst.report import html
from dehyst.report.charts import Axis, Chart, Colour, Series
from dehyst.report.html import Charts, Part, Row, escape, length, length_unit, number, words
from dehyst.trust import Insight, StageInsight, Turn, TurnPlane

# What each part of a promise comes from.
_PARTS = {
    "model": "the model",
    "temperature": "a temperature that was not tested, or is not known",
    "start": "the unknown start",
    "clamped": "voltages that are not allowed",
}
# Singular values below this are rounding; drawn at the foot of the scale.
_FOOT = 1e-5


def write_insight(path: PathLike, found: Insight | StageInsight, *, command: str | None = None) -> None:
    """Write an assessment to a self-contained HTML file.

    `path`, `command` and errors are as in `write_report`; `found` is the assessment, of one axis or of several.
    """
    if not isinstance(found, Insight):
        _write_stage_insight(path, found, command)
        return
    name = escape(found.actuator.name)
    records = ", ".join(escape(one.record.name) for one in found.evidence.comparisons)
    parts = [
        f"<h1>{name}: how far to trust the model</h1>",
        f'<p class="muted">Records: {records} · stroke {escape(length(found.evidence.stroke))}</p>',
        *sections(found, found.turns),
        html.reproduction(command),
    ]
    write_atomically(path, html.document(f"{found.actuator.name}: insight", parts))


def _write_stage_insight(path: PathLike, found: StageInsight, command: str | None) -> None:
    """Write the coupling with its intervals, and the sections of each axis."""
    half = (found.high - found.low) / 2
    matrix: list[Row] = [
        (axis, *("1" if i == j else f"{found.coupling[i, j]:+.5f} ± {half[i, j]:.5f}" for j in range(len(found.axes))))
        for i, axis in enumerate(found.axes)
    ]
    caption = (
        "Displacement of each axis (row) for each metre that an actuator (column) moves, with half the interval that "
        "the records allow (90 %)."
    )
    parts: list[Part] = [
        "<h1>Coupled axes: how far to trust the model</h1>",
        f"<h2>Coupling</h2><p>{escape(caption)}</p>{html.table(('axis', *found.axes), matrix, 1)}",
        html.bullets("Remarks", map(words, found.remarks)),
    ]
    for axis, one in zip(found.axes, found.insights, strict=True):
        parts += [f"<h2>Axis {escape(axis)}</h2>", *sections(one, one.turns)]
    write_atomically(path, html.document("Coupled axes: insight", [*parts, html.reproduction(command)]))


def sections(found: Insight, plane: TurnPlane | None) -> list[Part]:
    """Return the sections of a page or of the report: the answer first, the directions folded.

    `plane`: plane of the records' turning points, shown if given.
    """
    plan = found.plan
    path = () if plan is None else (plan.voltage[plan.first :], None if plan.time is None else plan.time[plan.first :])
    return [
        _verdict(found),
        *_trajectory(found),
        *turned(plane, () if plane is None or not path else plane.path(*path)),
        _next(found),
        "<details>\n<summary>What the turning points determine</summary>",
        _directions(found),
        "</details>",
    ]


def _verdict(found: Insight) -> str:
    """Return the error to expect, then the warnings."""
    promise, warnings = found.promise, found.warnings()
    expected = "The error to expect is not known." if promise is None else " ".join(found.expected)
    # Of a path that nobody has asked for it is said, and no more.
    new = promise is not None and bool(promise.untested) and found.plan is not None
    title = "Warning" if warnings else "In part not tested" if new else "No warnings"
    items = "".join(f"<li>{words(warning)}</li>" for warning in warnings)
    return (
        f'<div class="outcome {"amber" if warnings or new else "green"}" role="status">'
        f"<strong>{title}</strong>"
        f'<p class="first">{words(expected)}</p>{f"<ul>{items}</ul>" if items else ""}</div>'
    )


def _trajectory(found: Insight) -> list[Part]:
    """Return the promise along a path; empty without one."""
    plan, promise = found.plan, found.promise
    if plan is None or promise is None:
        return []
    rows: list[Row] = [
        (_PARTS[key], f"{number(100 * error / promise.stroke)} %", length(error))
        for key, error in promise.parts.items()
    ]
    beside = f"<div><h3>Causes of the largest error</h3>\n{html.table(('From', 'of stroke', ''), rows, 1)}</div>"
    caption = "The promise: how far the displacement may be from the wanted path if the compensating voltage is played."
    wanted, expected = plan.displacement[plan.first :], plan.expected[plan.first :]
    factor, unit = length_unit(float(np.ptp(expected)))
    axis, x = _clock(plan)
    edges = (expected - promise.half) * factor, (expected + promise.half) * factor
    path = [
        _area("may be reached", x, edges, "measured", 0.25),
        Series("wanted", x, wanted * factor, "ink", width=1.8),
    ]
    charts = Chart("Path", axis, Axis("displacement", unit), path), band_chart(plan)
    return [Charts("The promise along the path", caption, charts, beside=(beside,))]


def _clock(plan: PathPlan) -> tuple[Axis, Array]:
    """Return time, or the number of the sample where no time was given."""
    if plan.time is None:
        return Axis("sample"), np.arange(plan.voltage.size - plan.first, dtype=np.float64)
    return Axis("time", "s"), plan.time[plan.first :] - plan.time[plan.first]


def _area(name: str, x: Array, edges: Sequence[Array], colour: Colour, opacity: float) -> Series:
    low, high = edges
    return Series(name, x, low, colour, "area", opacity=opacity, top=high)


def band_chart(plan: PathPlan) -> Chart:
    """Return the error to expect along a planned path [% of the stroke]; none without a promise."""
    axis, x = _clock(plan)
    promise: Promise | None = plan.promise
    missed = (plan.expected - plan.displacement)[plan.first :]
    series = []
    if promise is not None:
        edges = [100 * (missed + sign * promise.half) / promise.stroke for sign in (-1, 1)]
        series = [_area("promise", x, edges, "measured", 0.3)]
    return Chart("Error", axis, Axis("error", "% of stroke"), series, zero=True)


def turned(plane: TurnPlane | None, path: Sequence[Turn] = ()) -> list[Part]:
    """Return where the records turned and how fast, and the same of a path."""
    if plane is None:
        return []
    caption = (
        "Dots: voltages between which the records turned. Rings: the voltage was held there. Shaded: loops on which "
        "the model is tested, because both branches begin where a record turned and do not go beyond it."
    )
    rows: list[Row] = []
    turns = [*plane.turns, *path]
    for name in dict.fromkeys(turn.record for turn in turns):
        own = [turn for turn in turns if turn.record == name]
        speeds = [turn.speed for turn in own]
        speed = f"{number(min(speeds))} to {number(max(speeds))}" if np.isfinite(speeds).all() else "not known"
        rows.append((name, str(sum(turn.times for turn in own)), speed))
    head = ("Record", "Branches", "Speed (V/s)")
    beside = f"<div><h3>How fast</h3>\n{html.table(head, rows, 1)}</div>"
    return [Charts("Where the records turned", caption, [_turns_chart(plane, path)], beside=(beside,))]


def _turns_chart(plane: TurnPlane, path: Sequence[Turn]) -> Chart:
    """Return the plane of turning points with the tested cells, and where a path turns."""
    ends, cells = plane.edges[[0, -1]], plane.cells.astype(np.float64)
    series = [
        Series("", plane.edges, plane.edges, "tested", "cells", values=cells, darkest=3.0),
        Series("", ends, ends, "without", width=1),
        *_dots("records", plane.turns, "measured", 5),
        *_dots("this path", path, "simulated", 8),
    ]
    edge = 0.03 * float(np.ptp(ends))
    shown = float(ends[0]) - edge, float(ends[1]) + edge
    x, y = (Axis(f"{which} turning point", "V", shown) for which in ("lower", "upper"))
    notes = [("tested, paler: one branch of the loop only", "tested")]
    return Chart("Turning points", x, y, series, notes=notes)


def _dots(name: str, turns: Sequence[Turn], colour: Colour, width: float) -> list[Series]:
    """Return a dot for each turn, and a ring where the voltage was held."""
    series = []
    for held in (False, True):
        some = [turn for turn in turns if turn.held > 0 or not held]
        if some:
            lower, upper = np.sort([(turn.begin, turn.end) for turn in some]).T
            words = tuple(turn.words for turn in some)
            size = width + 4 if held else width
            series.append(Series(name, lower, upper, colour, "points", size, names=words, hollow=held))
    return series[::-1]


def _next(found: Insight) -> str:
    commands = "\n".join(found.record_next)
    if not commands:
        return ""
    return f"<h2>What to record next</h2>\n<pre><code>{escape(commands)}</code></pre>"


def _directions(found: Insight) -> Charts:
    directions = found.identifiability
    caption = (
        f"The turning points of the records determine {directions.determined} of {directions.of} directions of "
        f"{directions.subject}, with the spring and each record's constant free. A singular value is the RMS voltage "
        "that one volt of breakaway voltages in its direction causes, without the part that a spring can cancel. "
        "Hollow: open."
    )
    return Charts("", caption, [directions_chart(directions)])


def directions_chart(found: Identifiability) -> Chart:
    """Return the singular value of each direction, filled if the records determine it, hollow if not."""
    values = np.maximum(found.values, _FOOT)
    order, known = np.arange(1.0, values.size + 1), np.arange(values.size) < found.determined
    series = [
        Series("determined", order[known], values[known], "measured", "points", 7),
        Series("open", order[~known], values[~known], "measured", "points", 7, hollow=True),
    ]
    x = Axis("direction", "", (0.5, values.size + 0.5))
    y = Axis("singular value", "V/V", (0.8 * _FOOT, 2 * max(float(values.max()), _FOOT)), log=True)
    return Chart("Singular values", x, y, [one for one in series if one.x.size])
