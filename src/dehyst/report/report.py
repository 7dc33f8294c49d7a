"""Pages: the report of an identification, a record, a calibration, and the history of checks."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from dehyst._errors import IdentifyError, ModelError
from dehyst._io import GENERATOR, PathLike, write_atomically
from dehyst.baselines import ModelComparison
from dehyst.identification import Fit, Structure
from dehyst.model import Actuator
from dehyst.records import Record
from dehyst.report.actuator_section import followed_sections, made_of, numbers, path_trial, slip_and_spring
from dehyst.report.comparison_section import comparison_sections
from dehyst.report.fit_section import (
    assumptions,
    before_and_after,
    constants,
    errors_table,
    loops,
    remaining_error,
    residuals,
    structures,
    verdict,
)
from dehyst.report.html import (
    Row,
    bullets,
    document,
    escape,
    figure,
    length,
    number,
    panel,
    reproduction,
    spelled,
    table,
)
from dehyst.report.plots import INK, MEASURED, SIMULATED, length_unit, line, svg_file
from dehyst.report.uncertainty_section import sections
from dehyst.trust import CheckHistory, Insight
from dehyst.trust.history import ControlChart

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from dehyst.calibration import Calibration, TrackedPath

NONE: Mapping[str, TrackedPath] = {}
_LABELS = {
    "program": "Program",
    "method": "Method",
    "norm": "Norm",
    "elements": "Slip elements requested",
    "slope_floor": "Floor of the slope (part of the mean)",
    "sensor_lag": "Sensor's lag (s)",
    "shared_datum": "Sensor zero shared by all records",
    "drift": "Drift of a record removed",
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
    """Write a report of `fit` to one HTML file that loads nothing from outside.

    Parameters
    ----------
    path : path-like
        Replaced if it exists; never left half written.
    fit : Fit
    command : str, optional
        The command line to show.
    insight : Insight, optional
        Assessment of the model, to show too.
    comparison : ModelComparison, optional
        Comparison with the baselines on the same records, to show too.
    followed : mapping of str to TrackedPath, optional
        Measurements along a path, by the kind of its voltage.

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

    `path`, `command` and errors are as in `write_report`; the `calibration` has all else.
    """
    if not isinstance(calibration.fit, Fit):
        hint = "use write_stage_report"
        raise ModelError(argument="calibration", got="one of several axes", need="one axis", hint=hint)
    followed = {"nominal": calibration.nominal, "compensated": calibration.compensated}
    write_report(path, calibration.fit, command=command, insight=calibration.insight, followed=followed)


def render(
    fit: Fit,
    command: str | None = None,
    insight: Insight | None = None,
    comparison: ModelComparison | None = None,
    followed: Mapping[str, TrackedPath] = NONE,
) -> str:
    """Return the text of the report; the same text for the same `fit`.

    `command` is the line that made it. `insight`, `comparison` and the paths `followed` add a section each. Raise
    `MissingExtraError` if there is something to draw and matplotlib is not installed.
    """
    name = fit.actuator.name if isinstance(fit.actuator, Actuator) else "Actuator not identified"
    actuator = fit.actuator if isinstance(fit.actuator, Actuator) else None
    parts = [
        f"<h1>{escape(name)}</h1>",
        _facts(fit, actuator),
        verdict(fit),
        *followed_sections(followed),
        before_and_after(fit),
        loops(fit),
        residuals(fit),
        remaining_error(fit),
        path_trial(fit),
        *structures(fit),
        errors_table(fit.errors),
        assumptions(fit, actuator),
        _list("What was repaired or left out", fit.repairs, "Nothing was repaired or left out."),
        _list("Remarks", fit.remarks, "No remarks."),
        *([made_of(actuator), slip_and_spring(actuator), numbers(actuator)] if actuator else []),
        *(["<h2>Insight: what the records determine</h2>", *sections(insight)] if insight else []),
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


def _list(title: str, sentences: Sequence[str], none: str) -> str:
    if not sentences:
        return f'<h2>{title}</h2>\n<p class="muted">{none}</p>'
    return bullets(title, (escape(spelled(one)) for one in sentences))


def _reproduce(fit: Fit, actuator: Actuator | None, command: str | None) -> str:
    options = dict(fit.options)
    records = [*options.pop("records", ()), *options.pop("validation", ())]
    delay = options.pop("delay_s", actuator.delay if actuator else None)
    stroke = options.pop("stroke_m", None)
    structure = options.pop("structure", None)
    if isinstance(structure, Mapping):
        # A structure contains its number of elements.
        options.pop("elements", None)
    entries = [(_LABELS.get(str(key), str(key)), _value(value)) for key, value in options.items()]
    if isinstance(structure, Mapping):
        chosen = Structure(**structure)
        entries.append(("Structure", f"{chosen.words}; smoothing {chosen.smoothing:g}"))
    if isinstance(delay, int | float):
        entries.append(("Delay of the displacement", f"{number(1e3 * delay, 4)} ms"))
    if isinstance(stroke, int | float):
        entries.append(("Stroke", length(stroke)))
    entries.append(("Solver", fit.status or "not known"))
    entries.append(("Duality gap, relative", number(fit.gap)))
    listed = "\n".join(f"<dt>{escape(key)}</dt><dd>{escape(value)}</dd>" for key, value in entries)
    shown = f"<pre>{escape(command)}</pre>\n" if command else ""
    return f"<h2>How to reproduce</h2>\n{shown}<dl>\n{listed}\n</dl>\n{_sources(records)}\n{constants(fit.errors)}"


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


# Points of a line that are drawn; between them nothing is visible at the size of the page.
_MOST = 20_000


def write_record_page(path: PathLike, record: Record, columns: Iterable[Row], *, command: str | None = None) -> None:
    """Write a record to one HTML file that loads nothing from outside.

    `record`: the record. `columns`: quantity, column and range, in words. `path`, `command` and errors are as in
    `write_report`.
    """
    every = record.by_axis()
    parts = [
        f"<h1>{escape(record.name)}</h1>",
        table(("quantity", "column", "range"), columns, 3),
        bullets("Notes", [escape(spelled(problem)) for one in every for problem in one.problems()]),
        figure(
            "Against time",
            "Check that the voltage is that of the actuator, not of a monitor.",
            [
                panel(one.name, f"{one.name}-time", _draw_in_time, one, label="time", rows=2, height=4.2)
                for one in every
            ],
        ),
        figure(
            "Loop",
            "A piezo actuator's loop runs counterclockwise.",
            [panel(one.name, f"{one.name}-loop", _draw_loop, one, label="loop") for one in every],
        ),
        reproduction(command),
    ]
    write_atomically(path, document(f"{record.name}: record", [part for part in parts if part]))


def _draw_in_time(upper: Axes, lower: Axes, record: Record) -> None:
    factor, unit = length_unit(record.stroke)
    rows = _drawn(record)
    line(upper, record.time[rows], record.voltage[rows], color=MEASURED)
    line(lower, record.time[rows], record.displacement[rows] * factor, color=MEASURED)
    upper.set(ylabel="voltage (V)")
    lower.set(xlabel="time (s)", ylabel=f"displacement ({unit})")


def _draw_loop(ax: Axes, record: Record) -> None:
    factor, unit = length_unit(record.stroke)
    rows = _drawn(record)
    ax.plot(record.voltage[rows], record.displacement[rows] * factor, color=MEASURED, lw=0.8)
    ax.set(xlabel="voltage (V)", ylabel=f"displacement ({unit})")


def _drawn(record: Record) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    return np.unique(np.linspace(0, len(record) - 1, min(len(record), _MOST)).astype(np.intp))


# Height of one panel [in], and of what is around all of them.
_PANEL, _AROUND = 1.15, 0.5
# So many labels fit below.
_MOST_LABELS = 8
_GREY = "#999999"


def write_check_history(path: PathLike, history: CheckHistory) -> None:
    """Draw a history to an SVG file: the errors with the goal, then each kind of change with its control limits.

    Points are single checks, lines their exponentially weighted moving averages.

    Parameters
    ----------
    path : path-like
        Replaced if it exists; never left half written.
    history : CheckHistory
        One check at least.

    Raises
    ------
    IdentifyError
        If there is no check.
    MissingExtraError
        If matplotlib is not installed.
    FileFormatError
        If the file cannot be written.
    """
    if not history.checks:
        raise IdentifyError(f"{history.folder}: got no check of this model, need one at least; run dehyst check first")
    charts = history.charts()

    def draw(first: Axes, *others: Axes) -> None:
        _errors(first, history)
        for ax, chart in zip(others, charts, strict=True):
            _chart(ax, chart)
        _dates((others or (first,))[-1], history)

    rows = 1 + len(charts)
    height = _AROUND + _PANEL * rows
    write_atomically(path, svg_file("checks", draw, rows=rows, height=height, creator=GENERATOR))


def _errors(ax: Axes, history: CheckHistory) -> None:
    """Draw the largest error of each check, its average and the goal."""
    numbers, errors = np.arange(1, len(history.checks) + 1), [one.error for one in history.checks]
    goals = [one.goal for one in history.checks]
    ax.plot(numbers, goals, color=_GREY, lw=0.8, ls="--")
    ax.plot(numbers, history.average_error(), color=SIMULATED, lw=1)
    ax.plot(numbers, errors, color=MEASURED, ls="none", marker="o", ms=3)
    ax.set_ylabel("error\n(% of stroke)")
    ax.set_ylim(0, 1.15 * max(*errors, *goals))


def _chart(ax: Axes, chart: ControlChart) -> None:
    """Draw one kind of change in standard deviations: checks, average and its limits, sums beyond theirs as crosses."""
    numbers = chart.places + 1
    ax.axhline(0, color=INK, lw=0.6)
    for sign in (-1, 1):
        ax.plot(numbers, sign * chart.limits, color=_GREY, lw=0.8, ls="--")
    ax.plot(numbers, chart.average, color=SIMULATED, lw=1)
    ax.plot(numbers, chart.scores, color=MEASURED, ls="none", marker="o", ms=3)
    alarms = chart.alarms
    ax.plot(numbers[alarms], chart.scores[alarms], color=SIMULATED, ls="none", marker="o", ms=6.5, mfc="none")
    ax.margins(y=0.12)
    ax.set_ylabel(f"{chart.name}\n(deviations)")


def _dates(ax: Axes, history: CheckHistory) -> None:
    """Write the dates of some checks below."""
    count = len(history.checks)
    shown = np.arange(0, count, -(-count // _MOST_LABELS))
    ax.set_xticks(shown + 1, [f"{k + 1}\n{history.checks[k].checked:%m-%d}" for k in shown])
    ax.set_xlabel(f"check and day, {history.checks[0].checked:%Y-%m-%d} to {history.checks[-1].checked:%Y-%m-%d}")
