"""The report of an identification or a calibration: one page."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from dehyst._errors import ModelError
from dehyst._io import PathLike, write_atomically
from dehyst._views.html import escape
from dehyst.baselines import ModelComparison
from dehyst.identification import Fit, Structure
from dehyst.model import Actuator
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
from dehyst.report.html import Part, bullets, document, length, number, table, words
from dehyst.report.trust_section import sections, turned
from dehyst.trust import Insight
from dehyst.trust.turn_plane import turn_plane

if TYPE_CHECKING:
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

    `command` is the line that made it. `insight`, `comparison` and the paths `followed` add a section each.
    """
    actuator = fit.actuator if isinstance(fit.actuator, Actuator) else None
    name = actuator.name if actuator else "Actuator not identified"
    trust: list[Part] = []
    if insight is not None:
        trust = ["<h2>Insight: what the records determine</h2>", *sections(insight)]
    elif fit.traces:
        limits = actuator.limits if actuator else None
        trust = turned(turn_plane([(one.record, one.time, one.voltage) for one in fit.traces], limits))
    parts: list[Part] = [
        f"<h1>{escape(name)}</h1>",
        _facts(fit, actuator),
        verdict(fit),
        *followed_sections(followed),
        before_and_after(fit),
        loops(fit),
        residuals(fit),
        remaining_error(fit),
        path_trial(fit),
        *trust,
        *structures(fit),
        errors_table(fit.errors),
        assumptions(fit, actuator),
        bullets("What was repaired or left out", map(words, fit.repairs), "Nothing was repaired or left out."),
        bullets("Remarks", map(words, fit.remarks), "No remarks."),
        *([*made_of(actuator), slip_and_spring(actuator), numbers(actuator)] if actuator else []),
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


def _sources(records: Sequence[Any]) -> str:
    rows = [
        tuple(str(record.get(key, "")) for key in ("name", "source", "sha256"))
        if isinstance(record, Mapping)
        else (_value(record), "", "")
        for record in records
    ]
    return table(("Record", "File", "SHA-256"), rows, texts=3) if rows else ""


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return value if isinstance(value, str) else json.dumps(value, default=str, ensure_ascii=False)
