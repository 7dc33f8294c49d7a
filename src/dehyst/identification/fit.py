"""The result of an identification, and its summary in lines and in HTML."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from numpy.typing import ArrayLike

from dehyst._text import counted, escaped
from dehyst._views.fields import json_values
from dehyst._views.lines import length, percent
from dehyst._views.pictures import Plotted
from dehyst.identification.checks import RemainingError
from dehyst.identification.expectation import Expectation, Readiness
from dehyst.identification.results import Check, RecordErrors, Trace
from dehyst.model import Actuator, Motion, Outcome, parts_of
from dehyst.records import Record


@dataclass(frozen=True, eq=False)
class Fit(Plotted):
    """The result of an identification.

    Attributes
    ----------
    actuator : Actuator
    outcome : Outcome
    promise : Expectation
        Expected error of a path, and the verdict.
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
    remaining : tuple of RemainingError
        Sources of each record's error.
    """

    actuator: Actuator
    outcome: Outcome
    promise: Expectation
    errors: tuple[RecordErrors, ...] = ()
    repairs: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    traces: tuple[Trace, ...] = ()
    options: Mapping[str, Any] = field(default_factory=dict)
    checks: tuple[Check, ...] = ()
    trials: tuple[Any, ...] = ()
    remaining: tuple[RemainingError, ...] = ()

    def __repr__(self) -> str:
        verdict = f"{self.promise.readiness.value}; {self.promise.promise!r}"
        return f"<Fit of {counted(len(self.errors), 'record')}: {verdict}; {self.outcome.name}>"

    def __str__(self) -> str:
        return escaped(self.promise.sentence)

    def summary(self, full: bool = False) -> str:
        """Return the text that `dehyst identify` prints: the expected error and at most three remarks or repairs.

        With `full` it is the text of `--verbose`: also errors, structures, parts, all repairs and all remarks.
        """
        return "\n".join(escaped(line) for line in (_lines if full else _brief)(self))

    @property
    def model(self) -> Actuator:
        """The actuator; `StageFit.model` is its counterpart for a stage."""
        return self.actuator

    def simulate(self, voltage: ArrayLike, **options: Any) -> Motion:
        """Return the displacement that a voltage (n,) [V] causes; `options`: options of `Actuator.simulate`."""
        return self.actuator.simulate(voltage, **options)

    def score(self, record: Record) -> RecordErrors:
        """Return the errors of the model on another record; a constant, a zero and a drift are fitted to it.

        Raise `RecordError` or `IdentifyError` if the record cannot be used.
        """
        from dehyst.identification.comparison import compare_all, errors_of

        (compared,) = compare_all(self.actuator, record)
        return errors_of(self.actuator, compared, "validation")[0]

    @property
    def good(self) -> bool:
        """Whether the model may be used: neither its outcome nor its expected error forbids this."""
        return self.outcome.good and self.promise.readiness is not Readiness.NOT_USABLE

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values without the traces."""
        keys = "outcome sentence=outcome.value good verdict=promise remaining errors checks repairs remarks"
        return json_values(self, f"{keys} options trials")


_HEAD = ("record", "role", "samples", "left out", "largest with noise, % stroke", "RMS, % of stroke", "largest", "RMS")
# Number of entries of a list in a summary.
_SHOWN = 3


def _brief(fit: Fit) -> Iterator[str]:
    """Yield the expected error, its origin, and at most three remarks or repairs."""
    verdict = fit.promise
    yield f"{verdict.headline}."
    yield verdict.origin
    yield from (f"{name}: {sentence}" for name, sentence in parts_of(fit.actuator) if name == "Creep")
    ended = [] if fit.outcome.good else [fit.outcome.value]
    # Remarks name causes, such as the voltage of another axis: for a model that is not usable they come first.
    usable = verdict.readiness is not Readiness.NOT_USABLE
    things = verdict.reservations + fit.remarks if usable else fit.remarks + verdict.reservations
    if first := [*ended, *things, *fit.repairs][:_SHOWN]:
        yield from ("", *(f"  - {sentence}" for sentence in first))


def _lines(fit: Fit) -> Iterator[str]:
    """Yield the lines of a summary: verdict, errors, candidates, parts, repairs, remaining error, remarks."""
    yield fit.promise.sentence
    if fit.outcome is not Outcome.IDENTIFIED:
        yield fit.outcome.value
    if fit.errors:
        rows: list[tuple[str, ...]] = [_HEAD]
        for error in fit.errors:
            counts, sizes = (error.samples, error.left_out), (error.largest, error.rms)
            shares = (percent(size, error.stroke) for size in sizes)
            rows.append((escaped(error.record), error.role, *map(str, counts), *shares, *map(length, sizes)))
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        yield from ("", *("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows))
    if fit.trials:
        yield from ("", "Candidates and their RMS error on held-out parts; a further part must lower it clearly:")
        chosen = fit.options.get("structure")
        for trial in sorted(fit.trials, key=lambda trial: trial.held_out)[:_SHOWN]:
            mark = " (chosen)" if trial.structure is not None and trial.structure.as_dict() == chosen else ""
            yield f"  {trial.held_out * 1e9:>7.1f} nm  {trial.words}{mark}"
    parts = (f"  {name + ':':<18}{sentence}" for name, sentence in parts_of(fit.actuator))
    yield from ("", "Parts of the model:", *parts)
    causes = [cause.sentence(fit.promise.stroke) for cause in fit.remaining]
    lists = ("Repaired or left out", fit.repairs), ("Remaining error", causes), ("Remarks", fit.remarks)
    for title, sentences in lists:
        if sentences:
            yield from ("", f"{title}:", *(f"  - {sentence}" for sentence in sentences))
