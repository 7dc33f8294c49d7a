"""Sections of pages about a fit, its actuator, an assessment, a measured path, and coupled axes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from dehyst._types import Array
from dehyst._views.lines import percent
from dehyst.identification import Fit, Readiness, StageFit, Trace
from dehyst.model import Actuator, Outcome, parts_of
from dehyst.records import largest
from dehyst.report import html, pictures
from dehyst.report.charts import Chart
from dehyst.report.html import Charts, Part, Row, escape, length, number, words
from dehyst.trust import Insight, Turn, TurnPlane

if TYPE_CHECKING:
    from dehyst.calibration import TrackedPath

MOST_RECORDS = 6
_COLOURS = {Readiness.READY: "green", Readiness.USABLE: "amber", Readiness.NOT_USABLE: "red"}


def verdict(fit: Fit) -> str:
    """Return the verdict in the colour of its readiness: the number first, then the outcome of the identification."""
    expected = fit.promise
    errors = (expected.largest, expected.rms, expected.measured, expected.noise)
    most, rms, measured, noise = (percent(error, expected.stroke, goal=expected.goal) for error in errors)
    said = (
        f"is the largest error to expect on any path within these voltages (RMS {rms}, from {expected.basis}; the goal "
        f"is {expected.goal:g} %), {expected.promise.apart}. "
        f"The RMS error on the records is {measured}; the sensor's noise is {noise}. "
        f"{'' if fit.outcome is Outcome.IDENTIFIED else fit.outcome.value}"
    )
    why = "".join(f"<li>{words(reason[0].upper() + reason[1:])}.</li>" for reason in expected.why_not_ready)
    return (
        f'<div class="outcome {_COLOURS[expected.readiness]}" role="status">'
        f"<strong>{expected.readiness.value.capitalize()}</strong>"
        f"<b>{most} of the stroke <small>or {escape(length(expected.largest))}</small></b>\n"
        f"<p>{words(said)}</p>{f'<ul>{why}</ul>' if why else ''}</div>"
    )


def before_and_after(fit: Fit) -> Part:
    """Return the errors of a straight scale factor and of the model on the first held-out record."""
    shown = _shown(fit)
    if not shown:
        return ""
    trace = next((trace for trace in shown if trace.role == "validation"), shown[0]).settled
    stroke, counted = pictures.stroke_of(fit), trace.counted
    (off,), slope = pictures.off_line([counted])
    before, after = (number(100 * largest(error) / stroke) for error in (off, counted.residual))
    caption = (
        f"Largest error on this record after its second turning point: {before} % of the stroke with the best straight "
        f"scale factor ({number(slope * 1e6)} µm/V), {after} % with the model. "
        "Drag over a part of a chart to enlarge it; double-click to show all. Point at a curve to read its values."
    )
    return Charts("Before and after", caption, [pictures.before_and_after(trace, stroke)], wide=True)


def loops(fit: Fit) -> Charts:
    """Return measured and simulated loops minus a straight line, so that the hysteresis fills the height."""
    caption = (
        "Displacement minus a straight line, so that the hysteresis fills the height. Where the line (simulated) "
        "and the dots (measured) differ, the model is wrong; look at the turning points and at the minor loops."
    )
    charts = [pictures.hysteresis([trace]) for trace in _shown(fit)]
    return Charts("Loops, minus a straight line", caption + _only(fit), charts)


def residuals(fit: Fit) -> Part:
    """Return the residuals of the records in time."""
    caption = (
        "Measured minus simulated. A slow trend in time is drift or creep. Grey times were not compared; "
        "the list of repairs and omissions names them. All charts have the same scale."
    )
    return _residuals(fit, "Residuals in time", caption, pictures.residual_in_time)


def residuals_over_displacement(fit: Fit) -> Part:
    """Return the residuals of the records over displacement."""
    caption = (
        "If a mean (line) is outside of the noise band, or the means of rising and falling branches differ, the model "
        "does not describe this motion."
    )
    return _residuals(fit, "Residuals over displacement", caption, pictures.residual_over_displacement)


def _residuals(fit: Fit, title: str, caption: str, chart: Callable[..., Chart]) -> Part:
    """Return a chart of residuals of each record, all with the same scale."""
    shown, stroke = _shown(fit), pictures.stroke_of(fit)
    if not shown:
        return ""
    limit = 1.1 * max(100 * largest(trace.counted.residual) / stroke for trace in shown) or 1.0
    return Charts(title, caption + _only(fit), [chart([trace], stroke, limit) for trace in shown])


def _shown(fit: Fit) -> list[Trace]:
    """Return the traces to draw."""
    return [trace for trace in fit.traces if trace.time.size > 1][:MOST_RECORDS]


def _only(fit: Fit) -> str:
    if len(fit.traces) <= MOST_RECORDS:
        return ""
    return f" The first {MOST_RECORDS} of {len(fit.traces)} records are drawn; the table of errors lists all."


def remaining_error(fit: Fit) -> str:
    """Return the causes of the remaining error of each record."""
    causes = (words(left.sentence(pictures.stroke_of(fit))) for left in fit.remaining)
    return html.bullets("Where the remaining error comes from", causes)


def candidates(fit: Fit) -> str:
    """Return the candidates of the search, by their held-out errors."""
    chosen = fit.options.get("structure")
    rows: list[Row] = [
        (
            trial.words + (" (chosen)" if trial.structure is not None and trial.structure.as_dict() == chosen else ""),
            length(trial.held_out),
        )
        for trial in sorted(fit.trials, key=lambda trial: trial.held_out)
    ]
    head = ("Candidate", "RMS error on held-out parts of the records")
    return f"<h2>Candidates that were tried</h2>\n{html.table(head, rows, texts=1)}" if rows else ""


def errors_table(fit: Fit) -> str:
    """Return the errors by record, without and with its drift."""
    if not fit.errors:
        return ""
    kinds = {
        "Largest error": "largest",
        "RMS error": "rms",
        "Largest, drift left in": "largest_with_drift",
        "RMS, drift left in": "rms_with_drift",
    }
    rows: list[Row] = []
    for row in fit.errors:
        found = [float(getattr(row, name)) for name in kinds.values()]
        cells = [(f"{number(100 * error / row.stroke)} %", length(error)) for error in found]
        rows.append(((row.record, row.role), *cells, str(row.samples), str(row.left_out)))
    return (
        "<h2>Errors by record</h2>\n"
        '<p class="muted">Measured minus simulated displacement, with noise, in % of the stroke '
        f"({length(fit.errors[0].stroke)}, the range of the widest training loop). Validation records were "
        f"not fitted.</p>\n{html.table(('Record', *kinds, 'Samples counted', 'Left out'), rows, texts=1)}"
    )


def checks(fit: Fit) -> str:
    """Return the checks of the model and of its residuals, with their floors."""
    if not fit.checks:
        return ""
    rows: list[Row] = [
        (
            *(check.name, check.verdict.value, html.spelled(check.sentence)),
            *(("–" if x is None else (number(x), check.unit.replace("um", "µm"))) for x in (check.value, check.floor)),
        )
        for check in fit.checks
    ]
    head = ("Check", "Verdict", "Finding", "Value", "Floor")
    return (
        '<h2>Checks</h2>\n<p class="muted">Patterns of the residuals. Noise alone stays below the floor with 95 % '
        f"probability. A pattern below 0.1 % of the stroke always passes.</p>\n{html.table(head, rows, texts=3)}"
    )


def made_of(actuator: Actuator) -> list[Part]:
    """Return a description of each part of an actuator, and its charts."""
    rows: list[Row] = [
        (part.name, html.spelled(part.sentence).replace("tau(v)", "τ(v)")) for part in parts_of(actuator)
    ]
    parts = html.table(("Part", "What it does"), rows, texts=2)
    caption = (
        "Single large stiffnesses between zeros mean that the records determine sums of stiffnesses better than single "
        "ones. The model's file has all numbers."
    )
    charts = [pictures.elements(actuator)]
    charts += [pictures.creep(actuator)] if actuator.displacement_creep is not None else []
    return [f"<h2>What the model is made of</h2>\n{parts}", Charts("", caption, charts)]


def followed(paths: Mapping[str, TrackedPath]) -> list[Part]:
    """Return a table and charts of the wanted and the reached path and of the errors; empty without a path."""
    if not paths:
        return []
    head = ("", "Largest error, % of the stroke", "RMS, %", "Largest")
    rows = [
        (name, number(path.largest_percent), number(path.rms_percent), length(largest(path.error)))
        for name, path in paths.items()
    ]
    caption = (
        "The actuator was homed, driven along the path with each voltage, and measured. The charts show the wanted and "
        "the reached displacement, and their difference. The way from the homing to the path is left out."
    )
    table = f"<h2>Measured along a path</h2>\n{html.table(head, rows, texts=1)}"
    return [table, Charts("", caption, pictures.followed_path(paths))]


_PARTS = {
    "model": "the model",
    "temperature": "a temperature that was not tested, or is not known",
    "creep": "a creep slower than the records show",
    "lag": "a lag that the records do not determine",
    "start": "the unknown start",
    "missed": "clamped voltages",
    "voltages": "voltages beyond the records",
}


def promised(found: Insight) -> str:
    """Return the promise, then the warnings."""
    promise, warnings = found.promise, found.warnings()
    expected = "The error to expect is not known." if promise is None else " ".join(found.expected)
    new = promise is not None and bool(promise.untested) and found.plan is not None
    title = "Warning" if warnings else "Partly not tested" if new else "No warnings"
    items = "".join(f"<li>{words(warning)}</li>" for warning in warnings)
    return (
        f'<div class="outcome {"amber" if warnings or new else "green"}" role="status">'
        f"<strong>{title}</strong>"
        f'<p class="first">{words(expected)}</p>{f"<ul>{items}</ul>" if items else ""}</div>'
    )


def planned(found: Insight) -> list[Part]:
    """Return the promise along a path; empty without one."""
    plan, promise = found.plan, found.promise
    if plan is None or promise is None:
        return []
    rows: list[Row] = [
        (_PARTS[key], f"{number(100 * error / promise.stroke)} %", length(error))
        for key, error in promise.parts.items()
    ]
    beside = f"<div><h3>Causes of the largest error</h3>\n{html.table(('From', 'of stroke', ''), rows, 1)}</div>"
    caption = "The promise: the largest difference from the wanted path if the compensating voltage is played."
    charts = pictures.planned_path(plan), pictures.error_band(plan)
    return [Charts("The promise along the path", caption, charts, beside=(beside,))]


def turned(plane: TurnPlane | None, path: Sequence[Turn] = ()) -> list[Part]:
    """Return turning points and speeds of the records, and those of a path."""
    if plane is None:
        return []
    caption = (
        "A dot is a pair of voltages between which a record turned. On shaded loops the model is tested: a record has "
        "both branches."
    )
    rows: list[Row] = []
    turns = [*plane.turns, *path]
    for name in dict.fromkeys(turn.record for turn in turns):
        own = [turn for turn in turns if turn.record == name]
        speeds = [turn.speed for turn in own]
        speed = f"{number(min(speeds))} to {number(max(speeds))}" if np.isfinite(speeds).all() else "not known"
        rows.append((name, str(sum(turn.times for turn in own)), speed))
    head = ("Record", "Branches", "Mean speed of a branch (V/s)")
    beside = f"<div><h3>How fast</h3>\n{html.table(head, rows, 1)}</div>"
    charts = [pictures.turning_points(plane, path)]
    return [Charts("Where the records turned", caption, charts, beside=(beside,))]


def path_turns(found: Insight) -> Sequence[Turn]:
    """Return the turning points of an assessed path; empty without a path."""
    plan, plane = found.plan, found.turns
    if plan is None or plane is None:
        return ()
    return plane.path(plan.voltage[plan.first :], None if plan.time is None else plan.time[plan.first :])


def determined(found: Insight) -> Iterator[Part]:
    """Yield what to record next, and the combinations of stiffnesses that the records determine."""
    commands, directions = "\n".join(map(escape, found.record_next)), found.identifiability
    asked = f"<pre><code>{commands}</code></pre>" if commands else f"<p>{found.nothing_next.capitalize()}.</p>"
    known = f"{directions.determined} of {directions.of} combinations of stiffnesses of {escape(directions.subject)}"
    yield f"<h2>To record next</h2>\n{asked}"
    yield f"<h2>What the turning points determine</h2>\n<p>The turning points of the records determine {known}.</p>"


def coupling(axes: Sequence[str], matrix: Array, errors: Array, caption: str) -> str:
    """Return a coupling matrix, each entry with an error that the caption explains."""
    rows: list[Row] = []
    for i, axis in enumerate(axes):
        entries = [f"{own:+.5f} ± {error:.5f}" for own, error in zip(matrix[i], errors[i], strict=True)]
        rows.append((axis, *entries[:i], "1", *entries[i + 1 :]))
    said = f"Displacement of each axis (row) for each metre that an actuator (column) moves, {caption}"
    return f"<h2>Coupling</h2><p>{escape(said)}</p>{html.table(('axis', *axes), rows, 1)}"


def stage_errors(fit: StageFit) -> str:
    """Return the errors of each axis in each record, without the motion of the other axes."""
    head = ("record", "axis", "role", "samples", "largest, % of the stroke", "RMS, %", "largest")
    rows = list[Row]()
    for axis, own in zip(fit.axes, fit.fits, strict=True):
        sizes = [(number(e.largest_percent), number(e.rms_percent), length(e.largest)) for e in own.errors]
        rows += [(e.record, axis, e.role, str(e.samples), *size) for e, size in zip(own.errors, sizes, strict=True)]
    return f"<h2>Errors of simulating each record</h2>{html.table(head, rows, 3)}" if rows else ""
