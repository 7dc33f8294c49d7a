"""Sections on a fit: verdict, errors by record, candidates, checks, and charts of its records."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import cycle

import numpy as np

from dehyst._types import Array, Mask
from dehyst._views.lines import percent
from dehyst.identification import Fit, Readiness, RecordErrors, Trace
from dehyst.records import largest, white_noise
from dehyst.report import html
from dehyst.report.charts import Axis, Chart, Colour, Series, broken, gaps
from dehyst.report.html import Charts, Row, escape, length, length_unit, number, words

_COLOURS = {Readiness.READY: "green", Readiness.USABLE: "amber", Readiness.NOT_USABLE: "red"}


def verdict(fit: Fit) -> str:
    """Return the verdict in the colour of its readiness: its number first, then the outcome of the identification."""
    expected = fit.promise
    if expected is None:
        word = Readiness.NOT_USABLE.value.capitalize()
        return f'<p class="outcome red" role="status"><strong>{word}</strong> {words(fit.outcome.value)}</p>'
    errors = (expected.largest, expected.rms, expected.measured, expected.noise)
    most, rms, measured, noise = (percent(error, expected.stroke) for error in errors)
    said = (
        f"is the largest error to expect on any path within these voltages, {expected.promise.apart}, "
        f"RMS {rms} (from {expected.basis}; "
        f"the goal is {expected.goal:g} %). The records are missed by {measured} RMS; the sensor's noise is {noise}. "
        f"{fit.outcome.value}"
    )
    why = "".join(f"<li>{words(reason[0].upper() + reason[1:])}.</li>" for reason in expected.why_not_ready)
    return (
        f'<div class="outcome {_COLOURS[expected.readiness]}" role="status">'
        f"<strong>{expected.readiness.value.capitalize()}</strong>"
        f"<b>{most} of the stroke <small>or {escape(length(expected.largest))}</small></b>\n"
        f"{words(said)}{f'<ul>{why}</ul>' if why else ''}</div>"
    )


def errors_table(errors: Sequence[RecordErrors]) -> str:
    """Return the errors by record, steady and with its drift."""
    if not errors:
        return ""
    kinds = {
        "Largest error": "largest",
        "RMS error": "rms",
        "Largest, drift left in": "largest_with_drift",
        "RMS, drift left in": "rms_with_drift",
    }

    def cell(row: RecordErrors, name: str) -> tuple[str, str]:
        error = float(getattr(row, name))
        return f"{number(100 * error / row.stroke)} %", length(error)

    rows: list[Row] = [
        (
            (row.record, row.role),
            *(cell(row, name) for name in kinds.values()),
            str(row.samples),
            str(row.left_out),
        )
        for row in errors
    ]
    return (
        "<h2>Errors by record</h2>\n"
        '<p class="muted">Measured minus simulated displacement, simulated from the voltage alone, in % of the stroke '
        f"({length(errors[0].stroke)}, the range of the widest training loop). Validation records took no part in the "
        f"fit of the model.</p>\n{html.table(('Record', *kinds, 'Samples counted', 'Left out'), rows, texts=1)}"
    )


def candidates(fit: Fit) -> str:
    """Return the candidates of the search and their held-out errors, best first."""
    if not fit.trials:
        return ""
    chosen = fit.options.get("structure")
    rows: list[Row] = [
        (
            trial.words + (" (chosen)" if trial.structure is not None and trial.structure.as_dict() == chosen else ""),
            length(trial.held_out),
        )
        for trial in sorted(fit.trials, key=lambda trial: trial.held_out)
    ]
    head = ("Candidate", "RMS error on held-out parts of the records")
    return html.folded("Candidates that were tried", {"": html.table(head, rows, texts=1)})


_CAUSES = {
    "noise": "the sensor's noise",
    "slow": "drift and other slow causes",
    "vibration": "a vibration",
    "model": "the model",
}


def remaining_error(fit: Fit) -> str:
    """Return where the remaining error of each record comes from: a bar of shares, and a sentence."""
    if not fit.remaining or not fit.errors:
        return ""
    swatch = '<span class="note"><i style="background:var(--{})"></i>{}</span>'
    bar = '<span style="width:{1:.1f}%;background:var(--{0})" title="{2}: {1:.0f} %"></span>'
    bars = "".join(
        f'<h3>{escape(left.record)} <span>{escape(left.role)}</span></h3>\n<div class="share">'
        f"{''.join(bar.format(key, 100 * getattr(left, key), cause) for key, cause in _CAUSES.items())}</div>\n"
        f'<p class="muted">{words(left.causes(fit.errors[0].stroke))}</p>'
        for left in fit.remaining
    )
    keys = "".join(swatch.format(*cause) for cause in _CAUSES.items())
    return (
        '<h2>Where the remaining error comes from</h2>\n<p class="muted">Shares of the power of the residual.</p>\n'
        f'<div class="shares"><p class="legend">{keys}</p>\n{bars}</div>'
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
        '<h2>Checks</h2>\n<p class="muted">Slopes and elements of the model, and patterns of its residuals. Floor: '
        "with 95 % probability noise alone gives no more; of a slope it is the least that the fit allowed. A pattern "
        f"below 0.1 % of the stroke passes in any case.</p>\n{html.table(head, rows, texts=3)}"
    )


MOST_RECORDS = 6
_BINS = 40
_FEWEST_IN_BIN = 5
# The noise band holds 95 % of the samples of a perfect model.
_DEVIATIONS = 2.0


def before_and_after(fit: Fit) -> Charts | str:
    """Return the errors of a straight scale factor and of the model, on the first held-out record."""
    shown = _shown(fit)
    if not shown:
        return ""
    trace = next((trace for trace in shown if trace.role == "validation"), shown[0])
    stroke = stroke_of(fit)
    (off,), slope = _off_line([trace])
    factor, unit = length_unit(float(np.ptp(trace.measured)))
    before, after = largest(off), largest(trace.residual)
    curves: tuple[tuple[str, Array, Colour], ...] = (
        ("straight scale factor", off, "without"),
        ("this model", trace.residual, "simulated"),
    )
    series = [
        Series(name, trace.simulated * factor, broken(trace.time, 100 * error / stroke), colour)
        for name, error, colour in curves
    ]
    axes = Axis("displacement", unit), Axis("error", "% of stroke")
    right = _right("error", stroke, before)
    chart = Chart(trace.record, *axes, series, role=trace.role, right=right, zero=True)
    caption = (
        f"Distance of this record from the best straight scale factor, {number(slope * 1e6)} µm/V, and from the "
        f"model: up to {number(100 * before / stroke)} % of the stroke before, {number(100 * after / stroke)} % after. "
        "Drag over a part of a chart to enlarge it; double-click for the whole. The pointer reads out values."
    )
    return Charts("Before and after", caption, [chart], wide=True)


def loops(fit: Fit) -> Charts:
    """Return the loops off a straight line, measured and simulated, so that hysteresis fills the height."""
    shown = _shown(fit)
    caption = (
        "Displacement minus a straight line, so that the hysteresis fills the height. Where the line (simulated) "
        "leaves the dots (measured), the model is wrong; look at the turning points and at the minor loops."
    )
    return Charts("Loops, off a straight line", caption + _only(fit), [hysteresis_chart([trace]) for trace in shown])


def loops_chart(traces: Sequence[Trace]) -> Chart:
    """Return measured and simulated displacement over voltage."""
    return _both(traces, [trace.measured for trace in traces], "displacement")


def hysteresis_chart(traces: Sequence[Trace]) -> Chart:
    """Return the loops minus the best straight line through all measured loops."""
    measured, slope = _off_line(traces)
    return replace(_both(traces, measured, f"off a line of {number(slope * 1e6)} µm/V"), zero=True)


def _both(traces: Sequence[Trace], measured: Sequence[Array], quantity: str) -> Chart:
    """Return a chart over voltage of what was measured and of what was simulated, which is less by the residual."""
    factor, unit = length_unit(max(*(float(np.ptp(y)) for y in measured), 1e-12))
    dots, lines = [], []
    for trace, shown in zip(traces, measured, strict=True):
        first, second = (broken(trace.time, length * factor) for length in (shown, shown - trace.residual))
        dots.append(Series("measured", trace.voltage, first, "measured", "points", 3, 0.5))
        lines.append(Series("simulated", trace.voltage, second, "simulated", width=1.2))
    axes = Axis("voltage", "V"), Axis(quantity, unit)
    return Chart(traces[0].record, *axes, [*dots, *lines], role=traces[0].role)


def residuals(fit: Fit) -> Charts | str:
    """Return the residuals of the records in time."""
    caption = (
        "Measured minus simulated. A slow trend in time is drift or creep. Grey parts of the time were not compared; "
        "the list of repairs and omissions names them. All charts share one scale."
    )
    return _residuals(fit, "Residuals in time", caption, residual_in_time)


def residuals_over_displacement(fit: Fit) -> Charts | str:
    """Return the residuals of the records over displacement."""
    caption = (
        "A mean (line) outside of the noise band, or a distance between the means of rising and falling branches, is a "
        "limit of the model."
    )
    return _residuals(fit, "Residuals over displacement", caption, residual_over_displacement)


def _residuals(fit: Fit, title: str, caption: str, chart: Callable[..., Chart]) -> Charts | str:
    """Return a chart of residuals of each record, all on one scale."""
    shown, stroke = _shown(fit), stroke_of(fit)
    if not shown:
        return ""
    limit = 1.1 * max(100 * largest(trace.residual) / stroke for trace in shown) or 1.0
    return Charts(title, caption + _only(fit), [chart([trace], stroke, limit) for trace in shown])


def residual_in_time(traces: Sequence[Trace], stroke: float, limit: float | None = None) -> Chart:
    """Return residuals [% of the stroke in m] against time; of one record the times that were not compared shaded."""
    colours: tuple[Colour, ...] = ("measured", "simulated", "rising", "falling")
    alone, series = len(traces) == 1, []
    for trace, colour in zip(traces, cycle(colours)):
        name, y = "residual" if alone else trace.record, 100 * trace.residual / stroke
        series.append(Series(name, trace.time, broken(trace.time, y), colour, width=1))
    chart = _residual(traces, Axis("time", "s"), series, stroke, limit)
    if not alone:
        return chart
    return replace(chart, shaded=_left_out(traces[0]), notes=(*chart.notes, ("not compared", "shade")))


def residual_over_displacement(traces: Sequence[Trace], stroke: float, limit: float | None = None) -> Chart:
    """Return residuals [% of the stroke in m] against displacement, branches apart, with the means of bins."""
    factor, unit = length_unit(max(float(np.ptp(trace.measured)) for trace in traces))
    place = np.concatenate([trace.simulated * factor for trace in traces])
    off = np.concatenate([100 * trace.residual / stroke for trace in traces])
    up = np.concatenate([rising(trace) for trace in traces])
    clouds, means = [], []
    branches: tuple[tuple[Colour, Mask], ...] = (("rising", up), ("falling", ~up))
    for name, branch in branches:
        clouds.append(Series(name, place[branch], off[branch], name, "points", 2.0, 0.45))
        means.append(Series(name, *_means(place[branch], off[branch]), name, width=2.4))
    return _residual(traces, Axis("displacement", unit), [*clouds, *means], stroke, limit)


def _residual(traces: Sequence[Trace], x: Axis, series: Sequence[Series], stroke: float, limit: float | None) -> Chart:
    noise = _DEVIATIONS * 100 * max(white_noise(trace.residual) for trace in traces) / stroke
    most = max(largest(trace.residual) for trace in traces) if limit is None else limit * stroke / 100
    return Chart(
        traces[0].record,
        x,
        Axis("residual", "% of stroke", None if limit is None else (-limit, limit)),
        series,
        role=traces[0].role,
        right=_right("residual", stroke, most),
        band=(-noise, noise),
        zero=True,
        notes=[("95 % of the noise", "band")],
    )


def rising(trace: Trace) -> Mask:
    """Return whether each sample lies on a rising branch (n,); a hold belongs to the branch before it."""
    # The simulated displacement moves in the direction of the voltage, and stands still with it.
    sign = np.sign(np.diff(trace.simulated, prepend=trace.simulated[:1]))
    last = np.maximum.accumulate(np.where(sign != 0, np.arange(sign.size), 0))
    return np.asarray(sign[last] >= 0)


def _means(place: Array, values: Array) -> tuple[Array, Array]:
    """Return the middles and the mean values of bins of equal width; NaN where samples are too few."""
    if not place.size:
        return np.zeros(0), np.zeros(0)
    edges = np.linspace(place.min(), place.max(), _BINS + 1)
    inside = np.clip(np.searchsorted(edges, place, side="right") - 1, 0, _BINS - 1)
    counts = np.bincount(inside, minlength=_BINS)
    sums = np.bincount(inside, weights=values, minlength=_BINS)
    means = np.where(counts >= _FEWEST_IN_BIN, sums / np.maximum(counts, 1), np.nan)
    return 0.5 * (edges[1:] + edges[:-1]), means


def _off_line(traces: Sequence[Trace]) -> tuple[list[Array], float]:
    """Return measured displacements less their best straight line over voltage [m], and the slope of that [m/V]."""
    voltage, y = (np.concatenate([getattr(trace, name) for trace in traces]) for name in ("voltage", "measured"))
    middle, rest = voltage.mean(), y.mean()
    spread = float((voltage - middle) @ (voltage - middle))
    slope = float((voltage - middle) @ (y - rest) / spread) if np.ptp(voltage) else 0.0
    return [trace.measured - rest - slope * (trace.voltage - middle) for trace in traces], slope


def _left_out(trace: Trace) -> list[tuple[float, float]]:
    """Return the parts of the time that were not compared: the time before the first sample, and gaps."""
    parts = [(float(trace.time[i]), float(trace.time[i + 1])) for i in gaps(trace.time)]
    return [(trace.began, float(trace.time[0])), *parts] if trace.began < trace.time[0] else parts


def _right(quantity: str, stroke: float, most: float) -> tuple[float, str, str]:
    """Return the second axis for errors in % of the stroke."""
    factor, unit = length_unit(most)
    return factor * stroke / 100, quantity, unit


def _shown(fit: Fit) -> list[Trace]:
    """Return the traces to draw."""
    return [trace for trace in fit.traces if trace.time.size > 1][:MOST_RECORDS]


def stroke_of(fit: Fit) -> float:
    """Return the stroke [m] to which percentages refer."""
    if fit.errors:
        return fit.errors[0].stroke
    return max((float(np.ptp(trace.measured)) for trace in fit.traces if trace.time.size), default=0.0) or 1.0


def _only(fit: Fit) -> str:
    if len(fit.traces) <= MOST_RECORDS:
        return ""
    return f" The first {MOST_RECORDS} of {len(fit.traces)} records are drawn; the table of errors lists all."
