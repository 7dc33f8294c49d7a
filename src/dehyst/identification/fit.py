"""The result of an identification, and its summary in lines and in HTML."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from dehyst._text import escaped, to_know
from dehyst._views import html, tables
from dehyst._views.fields import json_values
from dehyst._views.lines import length, percent
from dehyst._views.pictures import Plotted
from dehyst.identification.checks import RemainingError
from dehyst.identification.expectation import Expectation, Readiness
from dehyst.identification.results import Check, RecordErrors, Trace
from dehyst.model import Actuator, Motion, Outcome, parts_of, stroke_of
from dehyst.records import Record

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, eq=False)
class Fit(Plotted):
    """The result of an identification.

    Attributes
    ----------
    actuator : Actuator
    outcome : Outcome
    errors : tuple of RecordErrors
        One for each record, training first, then validation.
    repairs : tuple of str
        Sentences on data that were left out, shifted or removed before or during the fit.
    remarks : tuple of str
        Sentences on the limits of the result.
    traces : tuple of Trace
        Measured and simulated displacement of each record.
    options : Mapping
        Options as requested and as used.
    checks : tuple of Check
        Properties of the model and of its residuals.
    trials : tuple
        Candidates of the search, each with its `words`, its `held_out` error [m] and its `structure`.
    promise : Expectation or None
        Error to expect of a path, and the verdict; None if it was not judged.
    remaining : tuple of RemainingError
        Sources of each record's error.
    """

    actuator: Actuator
    outcome: Outcome
    errors: tuple[RecordErrors, ...] = ()
    repairs: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    traces: tuple[Trace, ...] = ()
    options: Mapping[str, Any] = field(default_factory=dict)
    checks: tuple[Check, ...] = ()
    trials: tuple[Any, ...] = ()
    promise: Expectation | None = None
    remaining: tuple[RemainingError, ...] = ()

    def __repr__(self) -> str:
        records = ", ".join(f"'{escaped(error.record)}'" for error in self.errors[:3])
        more = f" and {len(self.errors) - 3} more" if len(self.errors) > 3 else ""
        verdict = "" if self.promise is None else f"{self.promise.readiness.value}; {self.promise.promise!r}; "
        return f"<Fit of {records or 'no record'}{more}: {verdict}{self.outcome.name}>"

    def __str__(self) -> str:
        return escaped(_one_line(self))

    def _repr_html_(self) -> str:
        verdict = self.promise
        return html.block(
            "Fit" if verdict is None else f"Fit: {verdict.readiness.value}",
            html.line(_one_line(self)),
            html.line(self.outcome.value) if verdict is not None else "",
            html.table(_HEAD, _error_rows(self.errors)) if self.errors else "",
            html.folded("Parts of the model", [f"{name}: {sentence}" for name, sentence, _ in parts_of(self.actuator)]),
            html.folded("Checks", [f"{check.name}: {check.verdict.value}. {check.sentence}" for check in self.checks]),
            *(html.folded(title, sentences) for title, sentences in _lists(self)),
            colour="red" if not self.good else "" if verdict is None else _COLOURS[verdict.readiness],
        )

    def summary(self, full: bool = False) -> str:
        """Return what `dehyst identify` prints: the error to expect and at most three things to know, in lines.

        `full` returns what `--verbose` prints: also errors, structures, parts, repairs and all remarks.
        """
        return "\n".join(escaped(line) for line in (_lines if full else _brief)(self))

    @property
    def model(self) -> Actuator:
        """The actuator, as `StageFit.model` is the stage."""
        return self.actuator

    def simulate(self, voltage: ArrayLike, **options: Any) -> Motion:
        """Return the displacement that a voltage (n,) [V] causes, as `Actuator.simulate` with its options."""
        return self.actuator.simulate(voltage, **options)

    def score(self, record: Record) -> RecordErrors:
        """Return the errors of the model on another record, with a constant, a zero and a drift of its own.

        Raise `RecordError` or `IdentifyError` if the record cannot be used.
        """
        from dehyst.identification.comparison import compare, errors_of, prepare_for

        stroke = self.errors[0].stroke if self.errors else stroke_of(self.actuator)
        prepared = prepare_for(self.actuator, record)
        known = self.actuator.identification
        drifts = prepared.can_drift and known is not None and known.drift
        return errors_of(self.actuator, compare(self.actuator, prepared, stroke, drifting=drifts), "validation")[0]

    def to_dataframe(self) -> DataFrame:
        """Return the errors as a pandas DataFrame, one row for each record: in % of the stroke and in nm.

        Raise `MissingExtraError` if pandas is not installed.
        """
        names = "record", "role", "samples", "left_out", "largest_percent", "rms_percent"
        columns = {name: [getattr(error, name) for error in self.errors] for name in names}
        columns |= {f"{name}_nm": [getattr(error, name) * 1e9 for error in self.errors] for name in ("largest", "rms")}
        return tables.frame({**columns, "drifted_percent": [error.drifted_percent for error in self.errors]})

    @property
    def good(self) -> bool:
        """Whether the model may be used: neither its outcome nor its expected error forbids this."""
        usable = self.promise is None or self.promise.readiness is not Readiness.NOT_USABLE
        return self.outcome.good and usable

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values without the traces."""
        keys = "outcome sentence=outcome.value good verdict=promise remaining errors checks repairs remarks"
        return json_values(self, f"{keys} options trials")


_HEAD = ("record", "role", "samples", "left out", "largest with noise, % stroke", "RMS, % of stroke", "largest", "RMS")
# Number of candidates in a summary.
_SHOWN = 5
_COLOURS = {Readiness.READY: "green", Readiness.USABLE: "amber", Readiness.NOT_USABLE: "red"}


def _one_line(fit: Fit) -> str:
    """Return the verdict with its numbers, or how the fit ended."""
    return fit.outcome.value if fit.promise is None else fit.promise.sentence


def _brief(fit: Fit) -> Iterator[str]:
    """Yield the error to expect, what it comes from, at most three things to know, and how many more there are."""
    verdict, things = fit.promise, [*fit.remarks]
    if verdict is None:
        yield fit.outcome.value
    else:
        yield f"{verdict.headline}."
        yield verdict.origin
        yield from (f"{name}: {sentence}" for name, sentence, _ in parts_of(fit.actuator) if name == "Creep")
        ended = [] if fit.outcome.good else [fit.outcome.value]
        # Remarks name causes, such as the voltage of another axis: of a model that is of no use they come first.
        usable = verdict.readiness is not Readiness.NOT_USABLE
        things = [*ended, *(verdict.reservations + fit.remarks if usable else fit.remarks + verdict.reservations)]
    yield from to_know([*things, *fit.repairs])


def _lines(fit: Fit) -> Iterator[str]:
    """Yield the lines of a summary: verdict, errors, candidates, parts, repairs, remaining error, remarks."""
    yield _one_line(fit)
    if fit.promise is not None and fit.outcome is not Outcome.IDENTIFIED:
        yield fit.outcome.value
    if fit.errors:
        rows = [_HEAD, *_error_rows(fit.errors)]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        yield from ("", *("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows))
    if fit.trials:
        yield from ("", "Candidates, best first, and their RMS error on held-out parts of the records:")
        chosen = fit.options.get("structure")
        for trial in sorted(fit.trials, key=lambda trial: trial.held_out)[:_SHOWN]:
            mark = " (chosen)" if trial.structure is not None and trial.structure.as_dict() == chosen else ""
            yield f"  {trial.held_out * 1e9:>7.1f} nm  {trial.words}{mark}"
    parts = (f"  {name + ':':<18}{sentence}" for name, sentence, _ in parts_of(fit.actuator))
    yield from ("", "The model is made of:", *parts)
    for title, sentences in _lists(fit):
        if sentences:
            yield from ("", f"{title}:", *(f"  - {sentence}" for sentence in sentences))


def _error_rows(errors: Sequence[RecordErrors]) -> list[tuple[str, ...]]:
    """Return the cells of the errors by record, in the order of the head."""
    rows = []
    for error in errors:
        counts = escaped(error.record), error.role, str(error.samples), str(error.left_out)
        sizes = error.largest, error.rms
        rows.append((*counts, *(percent(size, error.stroke) for size in sizes), *map(length, sizes)))
    return rows


def _lists(fit: Fit) -> tuple[tuple[str, Sequence[str]], ...]:
    causes = [cause.sentence(fit.errors[0].stroke) for cause in fit.remaining]
    return ("Repaired or left out", fit.repairs), ("Remaining error", causes), ("Remarks", fit.remarks)
