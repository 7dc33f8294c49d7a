"""The report of an identification: one self-contained HTML file."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from dehyst._io.drafts import PathLike, write_atomically
from dehyst.baselines import ModelComparison
from dehyst.control import TrackedPath
from dehyst.model import Actuator, Fit, Readiness, RecordErrors, Structure
from dehyst.model.fit_summary import label
from dehyst.report.comparison_section import comparison_sections
from dehyst.report.fit_section import loops, numbers, residuals, slip_and_spring
from dehyst.report.html import Row, bullets, document, escape, length, number, table
from dehyst.report.parts_section import made_of
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
        _outcome(fit),
        *followed_sections(followed),
        _errors(fit.errors),
        _trials(fit),
        _checks(fit, actuator),
        _sentences("What was repaired or left out", fit.repairs, "Nothing was repaired or left out."),
        _sentences("Remaining error", [one.sentence(fit.errors[0].stroke) for one in fit.remaining], "None."),
        _sentences("Remarks", fit.remarks, "No remarks."),
        loops(fit),
        residuals(fit),
        *([made_of(actuator), slip_and_spring(actuator), numbers(actuator)] if actuator else []),
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


_COLOURS = {Readiness.READY: "green", Readiness.USABLE: "amber", Readiness.NOT_USABLE: "red"}


def _outcome(fit: Fit) -> str:
    """Return the verdict in the colour of its readiness, then how the identification ended."""
    if fit.expectation is None:
        colour, word, sentence = "red", Readiness.NOT_USABLE.value.capitalize(), fit.outcome.value
    else:
        colour = _COLOURS[fit.expectation.readiness]
        word, _, sentence = fit.expectation.sentence.partition(": ")
        sentence = f"{sentence[0].upper()}{sentence[1:]} {fit.outcome.value}"
    return f'<p class="outcome {colour}" role="status"><strong>{word}</strong> {_with_units(escape(sentence))}</p>'


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
    """List the structures that were tried, best first."""
    if not fit.trials:
        return ""
    best = min(fit.trials, key=lambda trial: trial.structure.as_dict() != fit.options.get("structure"))
    first = fit.trials[0]
    rows: list[Row] = [
        (
            label(trial.structure, fit.trials) + (" (chosen)" if trial is best else ""),
            str(trial.structure.parameters),
            length(trial.held_out),
            length(trial.training),
        )
        for trial in sorted(fit.trials, key=lambda trial: trial.held_out)
    ]
    head = ("Structure", "Coefficients", "RMS error of held-out cycles", "RMS error of the records themselves")
    why = "A part is added if it lowers the error of cycles held out in turn (cross-validation) by at least 3 %."
    if best is not first and first.structure.plain:
        times = number(first.held_out / best.held_out)
        why += (
            f" The plain structure that was tried first, {first.structure.words}, has {times} times the error of the "
            "chosen one."
        )
    return f'<h2>Choice of the structure</h2>\n<p class="muted">{why}</p>\n{table(head, rows, texts=1)}'


def _checks(fit: Fit, actuator: Actuator | None) -> str:
    wide, checks = actuator is not None and actuator.wide, fit.checks
    if not checks:
        return ""
    rows: list[Row] = [
        (
            *(check.name, check.verdict.value, _with_units(check.sentence)),
            *(("–" if x is None else (number(x), _with_units(check.unit))) for x in (check.value, check.floor)),
        )
        for check in checks
    ]
    head = ("Assumption", "Verdict", "Finding", "Value", "Floor")
    where, slope = "the records", "Assumption I"
    if wide:
        where = "its residuals (it needs neither symmetry nor closed loops, as a plain model does)"
        slope = "rising branches"
    return (
        "<h2>Assumptions</h2>\n"
        f'<p class="muted">The assumptions of the model, tested on {where}. Floor: with 95 % probability noise alone '
        f"gives no more; for {slope} it is the least slope that was allowed. A value below 0.1 % of the range passes "
        f"in any case.</p>\n{table(head, rows, texts=3)}"
    )


def _sentences(title: str, sentences: Sequence[str], none: str) -> str:
    if not sentences:
        return f'<h2>{title}</h2>\n<p class="muted">{none}</p>'
    return bullets(title, (_with_units(escape(sentence)) for sentence in sentences))


def _with_units(sentence: str) -> str:
    """Write um as µm; the text is not yet escaped for HTML."""
    return re.sub(r"(?<=\d |V/)um\b", "µm", sentence)


def _constants(errors: Iterable[RecordErrors]) -> str:
    """Show each record's nuisances: they are fitted to held-out records too."""
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
