"""The report of an identification or a calibration: one page."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from dehyst._errors import ModelError
from dehyst._io import PathLike, write_atomically
from dehyst._text import counted
from dehyst._views.html import escape
from dehyst.identification import Fit, Structure
from dehyst.model import Actuator
from dehyst.report import fit_section as of_fit
from dehyst.report.actuator_section import followed_sections, made_of
from dehyst.report.html import Part, bullets, document, length, number, table, words
from dehyst.report.trust_section import sections, turned
from dehyst.trust import Insight, turn_plane

if TYPE_CHECKING:
    from dehyst.calibration import Calibration, TrackedPath

NONE: Mapping[str, TrackedPath] = {}
_LABELS = {
    "program": "Program",
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
    followed: Mapping[str, TrackedPath] = NONE,
) -> None:
    """Write a report of `fit` to a self-contained HTML file.

    Parameters
    ----------
    path : path-like
        Replaced if it exists; never left half written.
    fit : Fit
    command : str, optional
        The command line to show.
    insight : Insight, optional
        Assessment of the model, to show too.
    followed : mapping of str to TrackedPath, optional
        Measurements along a path, by the kind of its voltage.

    Raises
    ------
    FileFormatError
        If the file cannot be written.
    """
    write_atomically(path, render(fit, command, insight, followed))


def write_calibration(path: PathLike, calibration: Calibration, *, command: str | None = None) -> None:
    """Write the report of a `calibration`: its fit, what the records determine, and the path as measured.

    `path`, `command` and errors are as in `write_report`.
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
    followed: Mapping[str, TrackedPath] = NONE,
) -> str:
    """Return the text of the report; the same text for the same `fit`.

    `command`: the command that made the report. `insight` and the paths `followed` add a section each.
    """
    actuator = fit.actuator if isinstance(fit.actuator, Actuator) else None
    name = actuator.name if actuator else "Actuator not identified"
    limits = actuator.limits if actuator else None
    trust = turned(turn_plane(((one.record, one.time, one.voltage) for one in fit.traces), limits))
    if insight is not None:
        trust += ["<h2>Insight: what the records determine</h2>", *sections(insight, None)]
    parts: list[Part] = [
        f"<h1>{escape(name)}</h1>",
        _facts(fit, actuator),
        of_fit.verdict(fit),
        *followed_sections(followed),
        of_fit.before_and_after(fit),
        of_fit.residuals(fit),
        "<details>\n<summary>All that was found</summary>",
        of_fit.loops(fit),
        of_fit.residuals_over_displacement(fit),
        of_fit.remaining_error(fit),
        *trust,
        of_fit.candidates(fit),
        of_fit.errors_table(fit.errors),
        of_fit.checks(fit),
        bullets("What was repaired or left out", map(words, fit.repairs), "Nothing was repaired or left out."),
        bullets("Remarks", map(words, fit.remarks), "No remarks."),
        *(made_of(actuator) if actuator else []),
        _reproduce(fit, actuator, command),
        "</details>",
    ]
    return document(f"{name}: identification", parts)


def _facts(fit: Fit, actuator: Actuator | None) -> str:
    facts = ["Identification of a Maxwell-slip model of hysteresis"]
    if actuator:
        facts.append(f"{counted(len(actuator.slip), 'slip element')}, {actuator.spring.voltage.size} spring knots")
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
    entries = {_LABELS.get(str(key), str(key)): _value(value) for key, value in options.items()}
    if isinstance(structure, Mapping):
        chosen = Structure(**structure)
        entries["Structure"] = f"{chosen.words}; smoothing {chosen.smoothing:g}"
    if isinstance(delay, int | float):
        entries["Delay of the displacement"] = f"{number(1e3 * delay, 4)} ms"
    if isinstance(stroke, int | float):
        entries["Stroke"] = length(stroke)
    listed = "\n".join(f"<dt>{escape(key)}</dt><dd>{escape(value)}</dd>" for key, value in entries.items())
    shown = f"<pre>{escape(command)}</pre>\n" if command else ""
    rows = [
        tuple(str(one.get(key, "")) for key in ("name", "source", "sha256"))
        if isinstance(one, Mapping)
        else (_value(one), "", "")
        for one in records
    ]
    sources = table(("Record", "File", "SHA-256"), rows, texts=3) if rows else ""
    return f"<h2>How to reproduce</h2>\n{shown}<dl>\n{listed}\n</dl>\n{sources}"


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return value if isinstance(value, str) else json.dumps(value, default=str, ensure_ascii=False)
