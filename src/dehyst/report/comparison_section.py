"""A comparison of models, as a section of the report or as a page of its own."""

from __future__ import annotations

from os import PathLike

from dehyst._io.drafts import write_atomically
from dehyst.baselines import ModelComparison
from dehyst.baselines.scores import OURS, RecordScore
from dehyst.baselines.tracking_trials import TrackingErrors
from dehyst.report.html import Row, bullets, document, escape, length, number, reproduction, table

_NONE = "–"


def write_comparison(path: str | PathLike[str], found: ModelComparison, *, command: str | None = None) -> None:
    """Write a comparison to one HTML file that loads nothing from outside.

    `path`, `command` and errors are as in `write_report`, but nothing is drawn; `found` is the comparison.
    """
    records = f"Training: {', '.join(found.records)} · held out: {', '.join(found.held_out) or 'none'}"
    parts = [
        "<h1>Models compared</h1>",
        f'<p class="muted">{escape(records)} · stroke {escape(length(found.stroke))}</p>',
        *comparison_sections(found),
        reproduction(command),
    ]
    write_atomically(path, document("Models compared", parts))


def comparison_sections(found: ModelComparison) -> list[str]:
    """Return the page's sections, which the report can contain too."""
    return [part for part in (_table(found), _each(found), _costs(found), _failures(found)) if part]


def _table(found: ModelComparison) -> str:
    head: Row = [
        "Model",
        "Training",
        "Held out",
        "Held out, no constant",
        *(f"Tracking, {name}" for name in found.truths),
    ]
    rows: list[Row] = [
        [
            (row.name, "this package" if row.name == OURS else ""),
            _errors(row.worst("training")),
            _errors(row.worst("validation")),
            _without(row.worst("validation")),
            *(_errors(row.tracking.get(name)) for name in found.truths),
        ]
        for row in found.rows
    ]
    return (
        "<h2>Models compared</h2>\n"
        '<p class="muted">Every model fitted to the same records. Measured minus simulated displacement of the record '
        f"with the largest error, in % of the stroke ({escape(length(found.stroke))}): largest and, in small print, "
        "RMS, with one free constant for each record or with none. Tracking: wanted minus reached displacement of a "
        "virtual actuator along a random path of 40 reversals; the model was fitted to that actuator's own records."
        f"{' ' + escape(found.note) if found.note else ''}</p>\n"
        f"{table(head, rows, texts=1)}"
    )


def _costs(found: ModelComparison) -> str:
    head = ("Model", "Fit (s)", "Simulate (ns a sample)", "Compensate (ns a sample)", "Coefficients")
    rows: list[Row] = [
        (
            row.name,
            *(_NONE if x is None else number(x) for x in (row.seconds, row.simulate, row.compensate)),
            _NONE if row.parameters is None else str(row.parameters),
        )
        for row in found.rows
    ]
    return f"<h2>Cost</h2>\n{table(head, rows, texts=1)}"


def _without(score: RecordScore | None) -> str | tuple[str, str]:
    return _NONE if score is None else _pair(score.largest_without, score.rms_without)


def _pair(largest: float, rms: float) -> tuple[str, str]:
    return f"{number(largest)} %", f"{number(rms)} %"


def _errors(score: RecordScore | TrackingErrors | None) -> str | tuple[str, str]:
    return _NONE if score is None else _pair(score.largest, score.rms)


def _each(found: ModelComparison) -> str:
    rows: list[Row] = [
        (
            row.name,
            score.record,
            score.role,
            *_pair(score.largest, score.rms),
            *_pair(score.largest_without, score.rms_without),
            str(score.samples),
            str(score.left_out),
        )
        for row in found.rows
        for score in row.scores
    ]
    if not rows:
        return ""
    head = (
        "Model",
        "Record",
        "Role",
        "Largest",
        "RMS",
        "Largest, no constant",
        "RMS, no constant",
        "Samples counted",
        "Left out",
    )
    body = table(head, rows, texts=3)
    return f"<details>\n<summary>Every model on every record</summary>\n<div>{body}</div>\n</details>"


def _failures(found: ModelComparison) -> str:
    return bullets("Failures", (f"{escape(row.name)}: {escape(row.failure)}" for row in found.rows if row.failure))
