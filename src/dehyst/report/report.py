"""What an identification found, as one self-contained HTML file to read, print and pass on."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from dehyst._io.drafts import PathLike, write_atomically
from dehyst._types import Array
from dehyst.baselines import ModelComparison
from dehyst.control import TrackedPath
from dehyst.identification.structure_selection import label
from dehyst.model import Actuator, Fit, GradedSlip, MaxwellSlip, Outcome, RecordErrors, Structure, Trace
from dehyst.report import plots
from dehyst.report.comparison_section import comparison_sections
from dehyst.report.html import MINUS, Row, document, escape, figure, length, number, panel, table
from dehyst.report.parts_section import made_of
from dehyst.report.tracking_section import followed_sections
from dehyst.report.uncertainty_section import sections
from dehyst.uncertainty import Insight

if TYPE_CHECKING:
    from dehyst.instruments.calibration import Calibration

MOST_RECORDS = 6
NONE: Mapping[str, TrackedPath] = {}
_LABELS = {
    "program": "Program",
    "method": "Method",
    "norm": "Norm",
    "elements": "Slip elements asked for",
    "slope_floor": "Floor of the slope (part of the mean)",
    "shared_datum": "Sensor zero shared by all records",
    "drift": "Drift of a record set aside",
}


def write_report(
    path: PathLike,
    fit: Fit,
    *,
    command: str | None = None,
    insight: Insight | None = None,
    comparison: ModelComparison | None = None,
    followed: Mapping[str, TrackedPath] = NONE,
) -> None:
    """Write a report of `fit` to one HTML file that asks for nothing from outside.

    Parameters
    ----------
    path : path-like
        Replaced if it exists; never left half written.
    fit : Fit
    command : str, optional
        The command line that made it, to be shown.
    insight : Insight, optional
        What the records can and cannot tell, to be shown too.
    comparison : ModelComparison, optional
        Ours and rival models on the same records, to be shown too.
    followed : mapping of str to TrackedPath, optional
        What was measured along a path, by how its voltage was made.

    Raises
    ------
    MissingExtraError
        If there is something to draw and matplotlib is not installed.
    FileFormatError
        If the file cannot be written.
    """
    write_atomically(path, render(fit, command, insight, comparison, followed))


def write_calibration(path: PathLike, calibration: Calibration, *, command: str | None = None) -> None:
    """Write the report of a calibration: its fit, what the records determine, and the path as measured.

    Parameters
    ----------
    path : path-like
        Replaced if it exists; never left half written.
    calibration : Calibration
    command : str, optional
        The command line that made it, to be shown.

    Raises
    ------
    MissingExtraError
        If matplotlib is not installed.
    FileFormatError
        If the file cannot be written.
    """
    followed = {"nominal": calibration.nominal, "compensated": calibration.compensated}
    write_report(path, calibration.fit, command=command, insight=calibration.insight, followed=followed)


def render(
    fit: Fit,
    command: str | None = None,
    insight: Insight | None = None,
    comparison: ModelComparison | None = None,
    followed: Mapping[str, TrackedPath] = NONE,
) -> str:
    """Return the text of the report; the same text for the same fit.

    Raises
    ------
    MissingExtraError
        If there is something to draw and matplotlib is not installed.
    """
    name = fit.actuator.name if isinstance(fit.actuator, Actuator) else "Actuator not identified"
    actuator = fit.actuator if isinstance(fit.actuator, Actuator) else None
    parts = [
        f"<h1>{escape(name)}</h1>",
        _facts(fit, actuator),
        _outcome(fit.outcome),
        *followed_sections(followed),
        _errors(fit.errors),
        _trials(fit),
        _checks(fit, actuator),
        _sentences("What was repaired or left out", fit.repairs, "Nothing was repaired or left out."),
        _sentences("What to know", fit.remarks, "No remarks."),
        _loops(fit),
        _residuals(fit),
        *([made_of(actuator), _model(actuator), _numbers(actuator)] if actuator else []),
        *(sections(insight) if insight else []),
        *(comparison_sections(comparison) if comparison else []),
        _reproduce(fit, actuator, command),
    ]
    return document(f"{name}: identification", parts)


def _facts(fit: Fit, actuator: Actuator | None) -> str:
    kind = "wider " if actuator and actuator.wide else ""
    facts = [f"Identification of a {kind}Maxwell-slip model of hysteresis"]
    if actuator:
        count = len(actuator.slip)
        facts.append(f"{count} slip element{'s' if count != 1 else ''}, {actuator.spring.voltage.size} spring knots")
    if actuator and actuator.limits:
        facts.append(f"{number(actuator.limits[0])} to {number(actuator.limits[1])} V")
    if fit.errors:
        facts.append(f"stroke {length(fit.errors[0].stroke)}")
    return f'<p class="muted">{escape(" · ".join(facts))}</p>'


def _outcome(outcome: Outcome) -> str:
    if outcome is Outcome.IDENTIFIED:
        colour, word = "green", "Good"
    elif outcome.good:
        colour, word = "amber", "Usable, with care"
    else:
        colour, word = "red", "Not usable"
    return f'<p class="outcome {colour}" role="status"><strong>{word}</strong> {_said(escape(outcome.value))}</p>'


def _errors(errors: Sequence[RecordErrors]) -> str:
    if not errors:
        return ""
    rows: list[Row] = [
        (
            (error.record, error.role),
            *(
                (f"{number(100 * e / error.stroke)} %", length(e))
                for e in (error.largest, error.rms, error.largest_with_drift, error.rms_with_drift)
            ),
            *(str(error.samples), str(error.left_out)),
        )
        for error in errors
    ]
    head = (
        "Record",
        "Largest error",
        "RMS error",
        "Largest, drift left in",
        "RMS, drift left in",
        "Samples counted",
        "Left out",
    )
    stroke = length(errors[0].stroke)
    return (
        "<h2>Errors by record</h2>\n"
        '<p class="muted">Measured minus simulated displacement, simulated from the voltage alone, in % of the stroke '
        f"({stroke}, the range of the widest training loop). Validation records took no part in the fit of the "
        f"model.</p>\n{table(head, rows, texts=1)}"
    )


def _trials(fit: Fit) -> str:
    """Structures that were tried, the chosen one first."""
    if not fit.trials:
        return ""
    best = min(fit.trials, key=lambda one: one.structure.as_dict() != fit.options.get("structure"))
    first = fit.trials[0]
    rows: list[Row] = [
        (
            label(one.structure, fit.trials) + (" (chosen)" if one is best else ""),
            str(one.structure.parameters),
            length(one.held_out),
            length(one.training),
        )
        for one in sorted(fit.trials, key=lambda one: one.held_out)
    ]
    head = ("Structure", "Coefficients", "RMS error of cycles held out", "of the records themselves")
    why = "A part is added where it lowers the error of cycles held out in turn by 3 % at least."
    if best is not first and first.structure.plain:
        times = number(first.held_out / best.held_out)
        why += f" The plain class that was tried first, {first.structure.words}, misses them {times} times as far."
    return f'<h2>How much model</h2>\n<p class="muted">{why}</p>\n{table(head, rows, texts=1)}'


def _checks(fit: Fit, actuator: Actuator | None) -> str:
    wide, checks = actuator is not None and actuator.wide, fit.checks
    if not checks:
        return ""
    rows: list[Row] = [
        (
            *(check.name, check.verdict.value, _said(check.sentence)),
            *(("–" if x is None else (number(x), _said(check.unit))) for x in (check.value, check.floor)),
        )
        for check in checks
    ]
    head = ("Taken for granted", "Verdict", "What was found", "Value", "Floor")
    where, slope = "the records", "Assumption I"
    if wide:
        where = "what it leaves of the records (it needs neither symmetry nor closed loops, as the plain class does)"
        slope = "rising branches"
    return (
        "<h2>Assumptions</h2>\n"
        f'<p class="muted">What the model takes for granted, looked for in {where}. Floor: what noise alone gives, '
        f"with 95 % probability no more; for {slope} the least slope that was allowed. Less than 0.1 % of the "
        f"range passes in any case.</p>\n{table(head, rows, texts=3)}"
    )


def _sentences(title: str, sentences: Sequence[str], none: str) -> str:
    if not sentences:
        return f'<h2>{title}</h2>\n<p class="muted">{none}</p>'
    items = "\n".join(f"<li>{_said(escape(sentence))}</li>" for sentence in sentences)
    return f"<h2>{title}</h2>\n<ul>\n{items}\n</ul>"


def _said(sentence: str) -> str:
    """The text with micrometres spelt as they are; not yet fit for HTML."""
    return re.sub(r"(?<=\d |V/)um\b", "µm", sentence)


def _shown(fit: Fit) -> list[tuple[Trace, float]]:
    """Traces to draw, each with the stroke to which its percentages refer."""
    traces = [trace for trace in fit.traces if trace.time.size > 1]
    widest = max((float(np.ptp(trace.measured)) for trace in traces), default=0.0)
    stroke = fit.errors[0].stroke if fit.errors else widest
    return [(trace, stroke) for trace in traces[:MOST_RECORDS]]


def _only(fit: Fit) -> str:
    if len(fit.traces) <= MOST_RECORDS:
        return ""
    return f" The first {MOST_RECORDS} of {len(fit.traces)} records are drawn; the table above tells of all."


def _loops(fit: Fit) -> str:
    panels = [panel(_whose(t), plots.loop(t, name=f"loop{i}"), "Loop of") for i, (t, _) in enumerate(_shown(fit))]
    caption = (
        "Where the thin line (simulated) leaves the broad one (measured), the model misses; look at the turning points "
        "and at the minor loops." + _only(fit)
    )
    return figure("Loops", caption, panels)


def _residuals(fit: Fit) -> str:
    shown = _shown(fit)
    if not shown:
        return ""
    worst = max(float(np.abs(100 * trace.residual / stroke).max()) for trace, stroke in shown)
    limit = 1.3 * worst or 1.0
    panels = []
    for i, (trace, stroke) in enumerate(shown):
        time = plots.residual_in_time(trace, stroke, limit, name=f"time{i}")
        place = plots.residual_in_displacement(trace, stroke, limit, name=f"place{i}")
        panels.append(panel(_whose(trace), time, "Residual against time of"))
        panels.append(panel(_whose(trace), place, "Residual against displacement of"))
    caption = (
        "A slow trend in time is drift or creep; a pattern in displacement, or rising and falling branches apart, is "
        "what the model cannot follow; an even band is the sensor's noise. The circle marks the largest residual; all "
        "panels share one scale." + _only(fit)
    )
    if any(trace.time.size > plots.MOST_BRANCH_POINTS for trace, _ in shown):
        caption += f" Against displacement, {plots.MOST_BRANCH_POINTS} samples of a longer record are drawn."
    return figure("Residuals: measured minus simulated", caption, panels)


def _model(actuator: Actuator) -> str:
    slip = panel(("Slip elements", ""), plots.slip_elements(_plain(actuator), name="slip"), "")
    spring = panel(("Parallel spring", ""), plots.parallel_spring(actuator.spring, name="spring"), "")
    caption = (
        "Among the slip elements, lone large values between zeros (hollow circles) hint that the records tell sums of "
        "stiffnesses better than single ones. The spring rises everywhere (Assumption I)."
    )
    if isinstance(actuator.slip, GradedSlip):
        caption += " These elements are graded: each is shown as stiff as the most that it can hold makes it."
    return figure("Its slip elements and spring" if actuator.wide else "The model", caption, [slip, spring])


def _plain(actuator: Actuator) -> MaxwellSlip:
    return actuator.slip if isinstance(actuator.slip, MaxwellSlip) else actuator.slip.stiffest()


def _whose(trace: Trace) -> tuple[str, str]:
    return trace.record, trace.role


def _numbers(actuator: Actuator) -> str:
    slip, spring = _plain(actuator), actuator.spring
    each = [str(i) for i in range(1, len(slip) + 1)]
    columns = (slip.breakaway * 1e6, slip.stiffness * 1e-6, slip.friction)
    elements = zip(each, *map(_column, columns), strict=True)
    each = [str(i) for i in range(1, spring.voltage.size + 1)]
    knots = zip(each, _column(spring.displacement * 1e6), _column(spring.voltage), strict=True)
    first = table(("i", "ρᵢ (µm)", "κᵢ (V/µm)", "fᵢ = κᵢ ρᵢ (V)"), elements, texts=0)
    second = table(("Knot", "y (µm)", "η (V)"), knots, texts=0)
    return (
        "<details>\n<summary>The model's numbers</summary>\n"
        f'<div class="panels tables">\n<div><h3>Slip elements</h3>\n{first}'
        f"</div>\n<div><h3>Knots of the parallel spring</h3>\n{second}</div>\n</div>\n</details>"
    )


def _constants(errors: Iterable[RecordErrors]) -> str:
    """Show each record's nuisances, which a critical reader asks for: they are fitted to held-out records too."""
    rows: list[Row] = [
        (
            (error.record, error.role),
            *(number(x) for x in (error.offset, error.datum * 1e6, error.drifted_percent, error.decades)),
        )
        for error in errors
    ]
    if not rows:
        return ""
    head = ("Record", "Offset (V)", "Sensor's zero (µm)", "Drift (% of stroke)", "over decades of time")
    return (
        "<details>\n<summary>Constants found for each record, validation records too</summary>\n"
        f"<div>{table(head, rows, texts=1)}</div>\n</details>"
    )


def _reproduce(fit: Fit, actuator: Actuator | None, command: str | None) -> str:
    options = dict(fit.options)
    records = [*options.pop("records", ()), *options.pop("validation", ())]
    delay = options.pop("delay_s", actuator.delay if actuator else None)
    stroke = options.pop("stroke_m", None)
    structure = options.pop("structure", None)
    if isinstance(structure, Mapping):
        # It has elements of its own.
        options.pop("elements", None)
    entries = [(_LABELS.get(str(key), str(key)), _value(value)) for key, value in options.items()]
    if isinstance(structure, Mapping):
        made = Structure(**structure)
        entries.append(("Structure", f"{made.words}; smoothing {made.smoothing:g}"))
    if isinstance(delay, int | float):
        entries.append(("Delay of the displacement", f"{number(1e3 * delay, 4)} ms"))
    if isinstance(stroke, int | float):
        entries.append(("Stroke", length(stroke)))
    entries.append(("Solver", fit.status or "not known"))
    entries.append(("Duality gap, relative", number(fit.gap)))
    listed = "\n".join(f"<dt>{escape(key)}</dt><dd>{escape(value)}</dd>" for key, value in entries)
    shown = f"<pre>{escape(command)}</pre>\n" if command else ""
    return f"<h2>How to reproduce</h2>\n{shown}<dl>\n{listed}\n</dl>\n{_sources(records)}\n{_constants(fit.errors)}"


def _sources(records: Any) -> str:
    if not isinstance(records, Sequence) or isinstance(records, str) or not records:
        return ""
    rows = [
        tuple(str(record.get(key, "")) for key in ("name", "source", "sha256"))
        if isinstance(record, Mapping)
        else (_value(record), "", "")
        for record in records
    ]
    return table(("Record", "File", "SHA-256"), rows, texts=3)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return value if isinstance(value, str) else json.dumps(value, default=str, ensure_ascii=False)


def _column(values: Array) -> list[str]:
    """Write a column with the decimals that give its largest value six digits."""
    largest = float(np.abs(values).max())
    decimals = min(12, max(0, 5 - math.floor(math.log10(largest)))) if largest > 0 else 0
    return [f"{float(value):.{decimals}f}".replace("-", MINUS) if value else "0" for value in values]
