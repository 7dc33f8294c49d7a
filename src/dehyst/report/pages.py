"""Pages about an identification or a calibration, an assessment, and a comparison."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from dehyst._io import PathLike, write_atomically
from dehyst._views.lines import ends
from dehyst.identification import Fit, StageFit
from dehyst.model import Actuator
from dehyst.report import sections
from dehyst.report.html import Part, Row, bullets, document, escape, length, number, reproduction, table, words
from dehyst.trust import OURS, Insight, ModelComparison, StageInsight, turn_plane

if TYPE_CHECKING:
    from dehyst.calibration import TrackedPath

NONE: Mapping[str, TrackedPath] = {}


def write_report(
    path: PathLike,
    found: Fit | StageFit | Insight | StageInsight | ModelComparison,
    *,
    command: str | None = None,
    insight: Insight | None = None,
    followed: Mapping[str, TrackedPath] = NONE,
) -> None:
    """Write a result to a self-contained HTML file.

    Parameters
    ----------
    path : path-like
        Replaced if it exists; never left half written.
    found : Fit, StageFit, Insight, StageInsight or ModelComparison
        Result of `dehyst.identify`, `dehyst.insight` or `dehyst.compare`.
    command : str, optional
        The command line to show.
    insight : Insight, optional
        With a fit of one axis: the assessment of its model, to show too.
    followed : mapping of str to TrackedPath, optional
        With a fit: measurements along a path, by the kind of its voltage.

    Raises
    ------
    FileFormatError
        If the file cannot be written.
    """
    if isinstance(found, Fit | StageFit):
        text = render(found, command, insight, followed)
    else:
        text = _compared(found, command) if isinstance(found, ModelComparison) else _assessed(found, command)
    write_atomically(path, text)


def render(
    fit: Fit | StageFit,
    command: str | None = None,
    insight: Insight | None = None,
    followed: Mapping[str, TrackedPath] = NONE,
) -> str:
    """Return the text of the report of a fit; the same text for the same `fit`."""
    if isinstance(fit, Fit):
        name = fit.actuator.name if fit.actuator else "Actuator not identified"
        head: list[Part] = [f"<h1>{escape(name)}</h1>", *_report(fit, insight, followed, command)]
        return document(f"{name}: identification", head)
    caption = f"with its standard error. Condition {fit.stage.condition:.4g}."
    parts: list[Part] = [
        "<h1>Coupled axes</h1>",
        f"<p>{words(fit.verdict)}.</p>",
        sections.coupling(fit.axes, fit.coupling, fit.uncertainty, caption),
        sections.stage_errors(fit),
    ]
    for j, (axis, own) in enumerate(zip(fit.axes, fit.fits, strict=True)):
        paths = {name: found.each[j] for name, found in followed.items()}
        parts += [f"<h2 class='axis'>Axis {escape(axis)}</h2>", *_report(own, None, paths, None)]
    return document("Coupled axes", [*parts, reproduction(command)])


def _report(
    fit: Fit, insight: Insight | None, followed: Mapping[str, TrackedPath], command: str | None
) -> Iterable[Part]:
    """Yield the verdict first, and all other sections in one fold."""
    actuator = fit.actuator if isinstance(fit.actuator, Actuator) else None
    turns = ((trace.record, trace.time, trace.voltage) for trace in fit.traces)
    yield _facts(fit, actuator)
    yield sections.verdict(fit)
    yield from sections.followed(followed)
    yield sections.before_and_after(fit)
    yield sections.residuals(fit)
    yield "<details>\n<summary>All that was found</summary>"
    yield sections.loops(fit)
    yield sections.residuals_over_displacement(fit)
    yield sections.remaining_error(fit)
    yield from sections.turned(turn_plane(turns, actuator.limits if actuator else None))
    if insight is not None:
        yield bullets("What the records do not determine", map(words, insight.warnings()))
        yield from sections.determined(insight)
    yield sections.candidates(fit)
    yield sections.errors_table(fit)
    yield sections.checks(fit)
    yield bullets("What was repaired or left out", map(words, fit.repairs), "Nothing was repaired or left out.")
    yield bullets("Remarks", map(words, fit.remarks), "No remarks.")
    yield from sections.made_of(actuator) if actuator else ()
    yield _reproduce(fit, command)
    yield "</details>"


def _facts(fit: Fit, actuator: Actuator | None) -> str:
    facts = ["Identification of a Maxwell-slip model of hysteresis"]
    facts += [ends(*actuator.limits, "V")] if actuator and actuator.limits else []
    if fit.errors:
        facts.append(f"stroke {length(fit.errors[0].stroke)}")
    return f'<p class="muted">{escape(" · ".join(facts))}</p>'


def _reproduce(fit: Fit, command: str | None) -> str:
    """Return the command, the options of the identification, and its records with their checksums."""
    options = dict(fit.options)
    records = [*options.pop("records", ()), *options.pop("validation", ())]
    entries = (f"<dt>{escape(str(key))}</dt><dd>{escape(_text(value))}</dd>" for key, value in options.items())
    rows = [tuple(str(record.get(key, "")) for key in ("name", "source", "sha256")) for record in records]
    sources = table(("Record", "File", "SHA-256"), rows, texts=3) if rows else ""
    return "\n".join([reproduction(command) or "<h2>How to reproduce</h2>", "<dl>", *entries, "</dl>", sources])


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value, default=str, ensure_ascii=False)


def _assessed(found: Insight | StageInsight, command: str | None) -> str:
    """Return the page of an assessment, of one axis or of several."""
    if isinstance(found, Insight):
        name, parts = found.actuator.name, _insight(found)
    else:
        half, caption = (found.high - found.low) / 2, "with half the interval that the records allow (90 %)."
        name, parts = "Coupled axes", [sections.coupling(found.axes, found.coupling, half, caption)]
        parts.append(bullets("Remarks", map(words, found.remarks)))
        for axis, insight in zip(found.axes, found.insights, strict=True):
            parts += [f"<h2 class='axis'>Axis {escape(axis)}</h2>", *_insight(insight)]
    head = f"<h1>{escape(name)}: how far to trust the model</h1>"
    return document(f"{name}: insight", [head, *parts, reproduction(command)])


def _insight(found: Insight) -> list[Part]:
    """Return the promise, the path, where the records turned, and what to record next."""
    records = ", ".join(escape(comparison.given.name) for comparison in found.comparisons)
    return [
        f'<p class="muted">Records: {records} · stroke {escape(length(found.stroke))}</p>',
        sections.promised(found),
        *sections.planned(found),
        *sections.determined(found),
        *sections.turned(found.turns, sections.path_turns(found)),
    ]


# Least number of models for bars; largest ratio of the longest bar to the median.
_FEWEST_BARS, _LONGEST = 2, 6.0
_ROLES = {"validation": "Held out", "training": "Training"}


def _compared(found: ModelComparison, command: str | None) -> str:
    """Return the page of a comparison."""
    best = "" if found.best is None else f"<p>{escape(str(found.best))}</p>"
    failures = (f"{escape(row.name)}: {escape(row.failure)}" for row in found.rows if row.failure)
    parts = ["<h1>Models compared</h1>", best, _bars(found), _scores(found), bullets("Failures", failures)]
    return document("Models compared", [*parts, reproduction(command)])


def _bars(found: ModelComparison) -> str:
    """Return bars: the largest and RMS error of each model on held-out time, the least RMS error first."""
    scores = [(score, row.name) for row in found.rows if (score := row.worst("validation")) is not None]
    if len(scores) < _FEWEST_BARS:
        return ""
    scores.sort(key=lambda pair: pair[0].rms)
    # The bar of a linear ratio would make the others too short: the scale ends at a multiple of the median.
    end = min(max(score.largest for score, _ in scores), _LONGEST * scores[len(scores) // 2][0].largest) or 1.0
    lines = "\n".join(
        f"<dt>{f'<b>{escape(name)}</b>' if name == OURS else escape(name)}</dt><dd>"
        f'<span class="bar" style="width:{100 * min(score.largest / end, 1.0):.1f}%"></span>'
        f'<span class="bar rms" style="width:{100 * min(score.rms / end, 1.0):.1f}%"></span>'
        f"<small>{number(score.largest)} % · {number(score.rms)} %"
        f"{' (longer than drawn)' if score.largest > end else ''}</small></dd>"
        for score, name in scores
    )
    return (
        '<h2>Which model predicts best</h2>\n<p class="muted">Largest and RMS error on held-out time, in % of the '
        f'stroke; the least RMS first.</p>\n<dl class="bars">{lines}</dl>'
    )


def _scores(found: ModelComparison) -> str:
    """Return the errors of each model."""
    rows: list[Row] = []
    for row in found.rows:
        scores = [row.worst(role) for role in _ROLES]
        cells = ["–" if score is None else (f"{number(score.largest)} %", f"{number(score.rms)} %") for score in scores]
        seconds = "–" if row.seconds is None else number(row.seconds)
        rows.append(((row.name, "this package" if row.name == OURS else ""), *cells, seconds))
    records = f"Training: {', '.join(found.records)}. {found.note} Stroke: {length(found.stroke)}."
    return (
        f'<h2>Errors</h2>\n<p class="muted">{escape(records)} Measured minus simulated displacement of the record with '
        "the largest error, in % of the stroke: largest and, in small print, RMS, with one free constant for each "
        f"record.</p>\n{table(('Model', *_ROLES.values(), 'Fit (s)'), rows, texts=1)}"
    )
