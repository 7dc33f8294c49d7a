"""A comparison of models, as a section of the report or as a separate page."""

from __future__ import annotations

from os import PathLike

from dehyst._io import write_atomically
from dehyst._views.html import escape
from dehyst.baselines import OURS, ModelComparison, RecordScore, TrackingErrors
from dehyst.report.html import Row, bullets, document, folded, length, number, reproduction, table

_NONE = "–"
_KINDS = {
    "Largest": "largest",
    "RMS": "rms",
    "Largest, no constant": "largest_without",
    "RMS, no constant": "rms_without",
}
# Bars of one model are no comparison; largest ratio of the longest to the median.
_FEWEST_BARS, _LONGEST = 2, 6.0


def write_comparison(path: str | PathLike[str], found: ModelComparison, *, command: str | None = None) -> None:
    """Write a comparison to a self-contained HTML file.

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
    failures = (f"{escape(row.name)}: {escape(row.failure)}" for row in found.rows if row.failure)
    parts = _bars(found), _table(found), _each(found), _costs(found), bullets("Failures", failures)
    return [part for part in parts if part]


def _bars(found: ModelComparison) -> str:
    """Return a picture: the largest and RMS error of each model, held out if records are, least first."""
    role = "validation" if found.held_out else "training"
    scores = [(score, row.name) for row in found.rows if (score := row.worst(role)) is not None]
    if len(scores) < _FEWEST_BARS:
        return ""
    scores.sort(key=lambda pair: pair[0].largest)
    # Beside a linear ratio the others would be dots: the scale ends at some times the middle.
    end = min(scores[-1][0].largest, _LONGEST * scores[len(scores) // 2][0].largest) or 1.0
    lines = "\n".join(
        f"<dt>{f'<b>{escape(name)}</b>' if name == OURS else escape(name)}</dt><dd>"
        f'<span class="bar" style="width:{100 * min(score.largest / end, 1.0):.1f}%"></span>'
        f'<span class="bar rms" style="width:{100 * min(score.rms / end, 1.0):.1f}%"></span>'
        f"<small>{number(score.largest)} % · {number(score.rms)} %"
        f"{' (longer than drawn)' if score.largest > end else ''}</small></dd>"
        for score, name in scores
    )
    which = "the held-out records" if found.held_out else "the training records"
    return (
        f'<h2>Which model predicts best</h2>\n<p class="muted">Largest and RMS error on {which}, in % of the stroke; '
        f'the least first.</p>\n<dl class="bars">{lines}</dl>'
    )


def _table(found: ModelComparison) -> str:
    """Return the errors of each model, the least of a column marked where two rows or more have a number."""
    columns: dict[str, list[tuple[float, float] | None]] = {
        "Training": [_errors(row.worst("training")) for row in found.rows],
        "Held out": [_errors(row.worst("validation")) for row in found.rows],
        "Promised": [row.promised for row in found.rows],
        "Held out, no constant": [
            None if (score := row.worst("validation")) is None else (score.largest_without, score.rms_without)
            for row in found.rows
        ],
        **{f"Tracking, {name}": [_errors(row.tracking.get(name)) for row in found.rows] for name in found.truths},
    }
    best = set()
    for number_, (name, errors) in enumerate(columns.items(), 1):
        if name == "Promised":
            continue
        known = [(error[0], i) for i, error in enumerate(errors) if error is not None]
        if len(known) > 1:
            best.add((min(known)[1], number_))
    rows: list[Row] = [
        ((row.name, "this package" if row.name == OURS else ""), *map(_cell, errors))
        for row, *errors in zip(found.rows, *columns.values(), strict=True)
    ]
    return (
        "<h2>Models compared</h2>\n"
        '<p class="muted">Every model fitted to the same records. Measured minus simulated displacement of the record '
        f"with the largest error, in % of the stroke ({escape(length(found.stroke))}): largest and, in small print, "
        "RMS, with one free constant for each record or with none. Promised: the errors to expect of the held-out "
        "records; of other models by the rule of dehyst, from their training errors. Tracking: wanted minus reached "
        "displacement of a virtual actuator along a random path of 40 reversals; the model was fitted to that "
        "actuator's own records."
        f"{' ' + escape(found.note) if found.note else ''}</p>\n"
        f"{table(('Model', *columns), rows, texts=1, best=best)}"
    )


def _errors(score: RecordScore | TrackingErrors | None) -> tuple[float, float] | None:
    return None if score is None else (score.largest, score.rms)


def _cell(errors: tuple[float, float] | None) -> str | tuple[str, str]:
    return _NONE if errors is None else (f"{number(errors[0])} %", f"{number(errors[1])} %")


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


def _each(found: ModelComparison) -> str:
    head = ("Model", "Record", "Role", *_KINDS, "Samples counted", "Left out")
    rows: list[Row] = []
    for row in found.rows:
        for score in row.scores:
            errors = (f"{number(getattr(score, kind))} %" for kind in _KINDS.values())
            rows.append((row.name, score.record, score.role, *errors, str(score.samples), str(score.left_out)))
    return folded("Every model on every record", {"": table(head, rows, texts=3)}) if rows else ""
