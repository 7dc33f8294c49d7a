"""A fit in words: the lines of `Fit.summary`, which `dehyst identify` prints, and its HTML."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from dehyst._text import escaped
from dehyst._views import html
from dehyst._views.lines import length, percent
from dehyst.model.actuator import Actuator
from dehyst.model.readiness import Readiness
from dehyst.model.structure import Structure
from dehyst.model.summary import parts_of

if TYPE_CHECKING:
    from dehyst.model.fit import Fit, RecordErrors

# Structures, best first.
_SHOWN = 5
_COLOURS = {Readiness.READY: "green", Readiness.USABLE: "amber", Readiness.NOT_USABLE: "red"}


def label(structure: Structure, trials: Sequence[Any]) -> str:
    """Describe a structure in words, with its smoothing if only that differs from another trial."""
    smoothings = {trial.structure.smoothing for trial in trials if trial.structure.words == structure.words}
    return structure.words if len(smoothings) < 2 else f"{structure.words}; smoothing {structure.smoothing:g}"


def one_line(fit: Fit) -> str:
    """Return the verdict with its numbers, or how the fit ended."""
    return fit.outcome.value if fit.expectation is None else fit.expectation.sentence


def lines(fit: Fit) -> Iterator[str]:
    """Yield the lines of a summary: verdict, errors, structures, parts, repairs, remaining error, remarks, solver."""
    if fit.expectation is not None:
        yield fit.expectation.sentence
    yield fit.outcome.value
    yield from _error_table(fit.errors)
    yield from _structures(fit)
    if parts := _parts(fit.actuator):
        yield from ("", "The model is made of:", *(f"  {name + ':':<18}{sentence}" for name, sentence in parts))
    for title, sentences in _lists(fit):
        if sentences:
            yield from ("", f"{title}:", *(f"  - {sentence}" for sentence in sentences))
    yield ""
    yield f"Solver: {fit.status}, duality gap {fit.gap:.1g}"


def _error_table(errors: Sequence[RecordErrors]) -> Iterator[str]:
    if not errors:
        return
    names = [escaped(error.record) for error in errors]
    width = max(6, *map(len, names))
    yield ""
    yield f"{'':<{width}}  {'':<10} {'':>8} {'':>8}  {'of the stroke':^18}  {'':^18}  {'with its drift':^18}"
    yield f"{'record':<{width}}  {'role':<10} {'samples':>8} {'left out':>8}" + 3 * f"  {'largest':>9}{'RMS':>9}"
    for name, error in zip(names, errors, strict=True):
        drift, rms = 100 * error.largest_with_drift / error.stroke, 100 * error.rms_with_drift / error.stroke
        yield (
            f"{name:<{width}}  {error.role:<10} {error.samples:>8} {error.left_out:>8}"
            f"  {error.largest_percent:>7.3f} % {error.rms_percent:>7.3f} %"
            f"  {error.largest * 1e9:>6.0f} nm {error.rms * 1e9:>6.0f} nm  {drift:>7.3f} %{rms:>7.3f} %"
        )


def _structures(fit: Fit) -> Iterator[str]:
    if not fit.trials:
        return
    yield ""
    yield "Structures tried, RMS error of cycles held out in turn:"
    structure = fit.options.get("structure")
    for trial in sorted(fit.trials, key=lambda trial: trial.held_out)[:_SHOWN]:
        chosen = " (chosen)" if trial.structure.as_dict() == structure else ""
        yield f"  {trial.held_out * 1e9:>7.1f} nm  {label(trial.structure, fit.trials)}{chosen}"
    yield "  (A part is kept only if it lowers this error by at least 3 %.)"


def _parts(actuator: Any) -> list[tuple[str, str]]:
    """Return name and sentence of each part of a wider actuator."""
    wide = isinstance(actuator, Actuator) and actuator.wide
    return [(part.name, part.sentence) for part in parts_of(actuator)] if wide else []


def _lists(fit: Fit) -> tuple[tuple[str, Sequence[str]], ...]:
    causes = [one.sentence(fit.errors[0].stroke) for one in fit.remaining]
    return ("Repaired or left out", fit.repairs), ("Remaining error", causes), ("Remarks", fit.remarks)


def as_html(fit: Fit) -> str:
    """Return a fit for a notebook: verdict, errors, and what opens with a click."""
    head = ("record", "role", "samples", "left out", "largest", "RMS", "largest, % of stroke", "RMS, % of stroke")
    rows = [
        (
            error.record,
            error.role,
            error.samples,
            error.left_out,
            length(error.largest),
            length(error.rms),
            percent(error.largest, error.stroke),
            percent(error.rms, error.stroke),
        )
        for error in fit.errors
    ]
    verdict = fit.expectation
    return html.block(
        "Fit" if verdict is None else f"Fit: {verdict.readiness.value}",
        html.line(one_line(fit)),
        html.line(fit.outcome.value) if verdict is not None else "",
        html.table(head, rows) if rows else "",
        html.folded("Parts of the model", [f"{name}: {sentence}" for name, sentence in _parts(fit.actuator)]),
        html.folded("Assumptions", [f"{check.name}: {check.verdict.value}. {check.sentence}" for check in fit.checks]),
        *(html.folded(title, sentences) for title, sentences in _lists(fit)),
        colour="red" if not fit.good else "" if verdict is None else _COLOURS[verdict.readiness],
    )
