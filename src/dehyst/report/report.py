"""The report of an identification: one self-contained HTML file."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from dehyst._io.drafts import PathLike, write_atomically
from dehyst.baselines import ModelComparison
from dehyst.control import TrackedPath
from dehyst.model import Actuator, Fit, Structure
from dehyst.report.comparison_section import comparison_sections
from dehyst.report.fit_section import assumptions, constants, errors_table, remaining_error, structures, verdict
from dehyst.report.html import bullets, document, escape, length, number, spelled, table
from dehyst.report.parts_section import made_of, numbers, slip_and_spring
from dehyst.report.path_section import path_trial
from dehyst.report.record_charts import before_and_after, loops, residuals
from dehyst.report.tracking_section import followed_sections
from dehyst.report.uncertainty_section import sections
from dehyst.uncertainty import Insight

if TYPE_CHECKING:
    from dehyst.instruments.calibration import Calibration

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
