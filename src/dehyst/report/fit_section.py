"""Sections on a fit: its verdict, errors by record, choice of the structure, assumptions, remaining error."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from dehyst._views.lines import percent
from dehyst.model import Actuator, Fit, Readiness, RecordErrors
from dehyst.model.fit_summary import label
from dehyst.report.charts import Axis, Chart, Series
from dehyst.report.html import Charts, Row, escape, length, number, spelled, table
from dehyst.report.plots import length_unit

_COLOURS = {Readiness.READY: "green", Readiness.USABLE: "amber", Readiness.NOT_USABLE: "red"}


def verdict(fit: Fit) -> str:
    """Return the verdict in the colour of its readiness: its number first, then how the identification ended."""
    expected = fit.expectation
    if expected is None:
        word = Readiness.NOT_USABLE.value.capitalize()
        return f'<p class="outcome red" role="status"><strong>{word}</strong> {escape(spelled(fit.outcome.value))}</p>'
    word = expected.readiness.value.capitalize()
    errors = (expected.largest, expected.rms, expected.measured, expected.noise)
    largest, rms, measured, noise = (percent(error, expected.stroke) for error in errors)
    sentences = (
        f"is the largest error to expect on a path like the records, RMS {rms} (from {expected.basis}; the goal is "
        f"{expected.goal:g} %). The records are missed by {measured} RMS; the sensor's noise is {noise}. "
        f"{spelled(fit.outcome.value)}"
    )
    why = "".join(f"<li>{escape(spelled(one[0].upper() + one[1:]))}.</li>" for one in expected.why_not_ready)
    return (
        f'<div class="outcome {_COLOURS[expected.readiness]}" role="status"><strong>{word}</strong>'
        f"<b>{largest} of the stroke <small>or {escape(length(expected.largest))}</small></b>\n"
        f"{escape(sentences)}{f'<ul>{why}</ul>' if why else ''}</div>"
    )


def errors_table(errors: Sequence[RecordErrors]) -> str:
    """Return the errors by record, steady and with its drift."""
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


def structures(fit: Fit) -> list[str | Charts]:
    """Return the structures that were tried: error against size, and a table, best first."""
    if not fit.trials:
        return []
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
    body = table(head, rows, texts=1)
    return [
        Charts("Choice of the structure", why, (_by_size(fit, best),)),
        f"<details>\n<summary>The structures that were tried</summary>\n<div>{body}</div>\n</details>",
    ]


def _by_size(fit: Fit, best: Any) -> Chart:
    """Return the errors of the structures against their number of coefficients."""
    factor, unit = length_unit(max(trial.held_out for trial in fit.trials))
    sizes = np.array([float(trial.structure.parameters) for trial in fit.trials])
    held_out = factor * np.array([trial.held_out for trial in fit.trials])
    training = factor * np.array([trial.training for trial in fit.trials])
    names = tuple(label(trial.structure, fit.trials) for trial in fit.trials)
    one = np.array([fit.trials.index(best)])
    series = (
        Series("held-out cycles", sizes, held_out, "measured", "points", 7, 0.8, names=names),
        Series("the records themselves", sizes, training, "without", "points", 5, 0.7, names=names),
        Series("chosen", sizes[one], held_out[one], "simulated", "points", 11, names=(f"chosen: {names[one[0]]}",)),
    )
    y = Axis("RMS error", unit, (0.0, 1.1 * float(np.max(held_out, where=np.isfinite(held_out), initial=0.0)) or 1.0))
    return Chart("", "", "Error against size of the structures tried", Axis("number of coefficients", ""), y, series)


_CAUSES = (
    ("noise", "the sensor's noise"),
    ("slow", "drift and other slow causes"),
    ("vibration", "a vibration"),
    ("model", "the model"),
)


def remaining_error(fit: Fit) -> str:
    """Return where the remaining error of each record comes from: a bar of shares, and a sentence."""
    if not fit.remaining or not fit.errors:
        return ""
    keys = "".join(f'<span><i style="background:var(--{key})"></i>{words}</span>' for key, words in _CAUSES)
    bars = []
    for one in fit.remaining:
        shares = "".join(
            f'<span style="width:{100 * getattr(one, key):.1f}%;background:var(--{key})" '
            f'title="{words}: {100 * getattr(one, key):.0f} %"></span>'
            for key, words in _CAUSES
        )
        words = spelled(one.causes(fit.errors[0].stroke))
        bars.append(
            f'<h3>{escape(one.record)} <span>{escape(one.role)}</span></h3>\n<div class="share">{shares}</div>\n'
            f'<p class="muted">{escape(words)}</p>'
        )
    return (
        '<h2>Where the remaining error comes from</h2>\n<p class="muted">Shares of the power of the residual.</p>\n'
        f'<div class="shares"><p class="keys">{keys}</p>\n{"".join(bars)}</div>'
    )


def assumptions(fit: Fit, actuator: Actuator | None) -> str:
    """Return the checks of a model's assumptions, with their floors."""
    wide, checks = actuator is not None and actuator.wide, fit.checks
    if not checks:
        return ""
    rows: list[Row] = [
        (
            *(check.name, check.verdict.value, spelled(check.sentence)),
            *(("–" if x is None else (number(x), check.unit.replace("um", "µm"))) for x in (check.value, check.floor)),
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


def constants(errors: Iterable[RecordErrors]) -> str:
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
