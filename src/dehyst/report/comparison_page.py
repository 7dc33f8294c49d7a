"""A page that compares models."""

from __future__ import annotations

from os import PathLike

from dehyst._io import write_atomically
from dehyst._views.html import escape
from dehyst.report.html import Row, bullets, document, length, number, reproduction, table
from dehyst.trust import OURS, ModelComparison, RecordScore

_NONE = "–"
# Bars of one model are no comparison; largest ratio of the longest to the median.
_FEWEST_BARS, _LONGEST = 2, 6.0


def write_comparison(path: str | PathLike[str], found: ModelComparison, *, command: str | None = None) -> None:
    """Write a comparison to a self-contained HTML file.

    `path`, `command` and errors are as in `write_report`, but nothing is drawn; `found` is the comparison.
    """
    best = "" if found.best is None else f"<p>{escape(str(found.best))}</p>"
    failures = (f"{escape(row.name)}: {escape(row.failure)}" for row in found.rows if row.failure)
    parts = ["<h1>Models compared</h1>", best, _bars(found), _table(found), bullets("Failures", failures)]
    write_atomically(path, document("Models compared", [*filter(None, parts), reproduction(command)]))


def _bars(found: ModelComparison) -> str:
    """Return a picture: the largest and RMS error of each model on what was held out, least first."""
    scores = [(score, row.name) for row in found.rows if (score := row.worst("validation")) is not None]
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
    return (
        '<h2>Which model predicts best</h2>\n<p class="muted">Largest and RMS error on what was held out, in % of the '
        f'stroke; the least first.</p>\n<dl class="bars">{lines}</dl>'
    )


def _table(found: ModelComparison) -> str:
    """Return the errors of each model, the least of a column marked where two rows or more have a number."""
    rows: list[Row] = []
    columns: list[list[RecordScore | None]] = [[row.worst(role) for row in found.rows] for role in _ROLES]
    best = set()
    for place, scores in enumerate(columns, 1):
        known = [(score.largest, i) for i, score in enumerate(scores) if score is not None]
        best |= {(min(known)[1], place)} if len(known) > 1 else set()
    for row, *scores in zip(found.rows, *columns, strict=True):
        seconds = _NONE if row.seconds is None else number(row.seconds)
        rows.append(((row.name, "this package" if row.name == OURS else ""), *map(_cell, scores), seconds))
    records = f"Training: {', '.join(found.records)}. {found.note} Stroke: {length(found.stroke)}."
    return (
        f'<h2>Errors</h2>\n<p class="muted">{escape(records)} Measured minus simulated displacement of the record with '
        "the largest error, in % of the stroke: largest and, in small print, RMS, with one free constant for each "
        f"record.</p>\n{table(('Model', *_ROLES.values(), 'Fit (s)'), rows, texts=1, best=best)}"
    )


_ROLES = {"validation": "Held out", "training": "Training"}


def _cell(score: RecordScore | None) -> str | tuple[str, str]:
    return _NONE if score is None else (f"{number(score.largest)} %", f"{number(score.rms)} %")
