"""The result of an identification, and its summary in lines and in HTML."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from typing import TYPE_CHECKING, Any, Literal

from dehyst._text import escaped, to_know
from dehyst._views import html, tables
from dehyst._views.fields import json_values
from dehyst._views.lines import length, percent
from dehyst._views.pictures import plotted
from dehyst.identification.expectation import Expectation, Readiness
from dehyst.identification.results import Check, HeldOutHolds, RecordErrors, RemainingError, Trace
from dehyst.identification.structure import Structure
from dehyst.model import Actuator, Outcome, State, parts_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame


@dataclass(frozen=True, eq=False)
class Fit:
    """The result of an identification.

    Attributes
    ----------
    actuator : AbstractModel or None
        None only when the outcome is `Outcome.FAILED`.
    outcome : Outcome
    errors : tuple of RecordErrors
        One for each record, training first, then validation.
    repairs : tuple of str
        Sentences on data that were left out, shifted or removed before or during the fit.
    remarks : tuple of str
        Sentences on the limits of the result.
    traces : tuple of Trace
        Measured and simulated displacement of each record.
    status : str
        Status text of the solver.
    gap : float
        Duality gap, relative to the sum of the absolute weighted voltages.
    options : Mapping
        Options as requested and as used.
    checks : tuple of Check
        Assumptions of the model, tested on the records.
    trials : tuple of dehyst.identification.structure_selection.StructureTrial
        Structures that were tried, if one was selected.
    expectation : Expectation or None
        Expected error of a path, and the verdict; None when the outcome is `Outcome.FAILED`.
    remaining : tuple of RemainingError
        Sources of each record's error.
    holds : HeldOutHolds or None
        Errors in held-out holds with each form of creep; None if the records do not show them.
    """

    actuator: Any
    outcome: Outcome
    errors: tuple[RecordErrors, ...] = ()
    repairs: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    traces: tuple[Trace, ...] = ()
    status: str = ""
    gap: float = float("nan")
    options: Mapping[str, Any] = field(default_factory=dict)
    checks: tuple[Check, ...] = ()
    trials: tuple[Any, ...] = ()
    expectation: Expectation | None = None
    remaining: tuple[RemainingError, ...] = ()
    holds: HeldOutHolds | None = None

    def __repr__(self) -> str:
        records = ", ".join(f"'{escaped(error.record)}'" for error in self.errors[:3])
        more = f" and {len(self.errors) - 3} more" if len(self.errors) > 3 else ""
        verdict = "" if self.expectation is None else f"{self.expectation.words}; "
        return f"<Fit of {records or 'no record'}{more}: {verdict}{self.outcome.name}>"

    def __str__(self) -> str:
        return escaped(_one_line(self))

    def _repr_html_(self) -> str:
        return _as_html(self)

    def summary(self, full: bool = False) -> str:
        """Return what `dehyst identify` prints: the error to expect and at most three things to know, in lines.

        `full` returns what `--all` prints: also errors, structures, parts, repairs and all remarks.
        """
        return "\n".join(escaped(line) for line in (_lines if full else _brief)(self))

    def to_dataframe(self) -> DataFrame:
        """Return the errors as a pandas DataFrame, one row for each record: in % of the stroke and in nm.

        Raise `MissingExtraError` if pandas is not installed.
        """
        names = "record", "role", "samples", "left_out", "largest_percent", "rms_percent"
        columns = {name: [getattr(error, name) for error in self.errors] for name in names}
        columns |= {f"{name}_nm": [getattr(error, name) * 1e9 for error in self.errors] for name in ("largest", "rms")}
        return tables.frame({**columns, "drifted_percent": [error.drifted_percent for error in self.errors]})

    def plot(
        self,
        kind: Literal["loops", "hysteresis", "residuals", "residuals in time"] = "loops",
        *,
        ax: Axes | None = None,
    ) -> Axes:
        """Draw the fit: all records, measured and simulated.

        Parameters
        ----------
        kind : str
            "loops": displacement over voltage. "hysteresis": loops minus the straight line through the measured loops,
            which enlarges hysteresis and misfit. "residuals": measured minus simulated over displacement, rising and
            falling branches apart. "residuals in time".
        ax : matplotlib.axes.Axes, optional
            Where to draw; default: the axes of a new figure.

        Returns
        -------
        matplotlib.axes.Axes

        Raises
        ------
        ModelError
            If there is no such kind, or nothing to draw: an identification that failed.
        MissingExtraError
            If matplotlib is not installed.
        """
        return plotted("fit", self, kind, ax)

    @property
    def good(self) -> bool:
        """Whether the model may be used: neither its outcome nor its expected error forbids this."""
        usable = self.expectation is None or self.expectation.readiness is not Readiness.NOT_USABLE
        return self.outcome.good and usable

    @property
    def starts(self) -> dict[str, tuple[State, ...]]:
        """The states from which each record was simulated, by its name; one for each of its pieces."""
        return {error.record: error.starts for error in self.errors}

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values without the traces."""
        keys = "outcome sentence=outcome.value good verdict=expectation remaining errors checks repairs remarks holds"
        return {
            **json_values(self, keys),
            "solver": {"status": self.status, "duality_gap": self.gap if isfinite(self.gap) else None},
            **json_values(self, "options trials"),
        }


# Structures, best first.
_SHOWN = 5
_COLOURS = {Readiness.READY: "green", Readiness.USABLE: "amber", Readiness.NOT_USABLE: "red"}


def label(structure: Structure, trials: Sequence[Any]) -> str:
    """Describe a structure in words, with its smoothing if only that differs from another trial."""
    smoothings = {trial.structure.smoothing for trial in trials if trial.structure.words == structure.words}
    return structure.words if len(smoothings) < 2 else f"{structure.words}; smoothing {structure.smoothing:g}"


def _one_line(fit: Fit) -> str:
    """Return the verdict with its numbers, or how the fit ended."""
    return fit.outcome.value if fit.expectation is None else fit.expectation.sentence


def _brief(fit: Fit) -> Iterator[str]:
    """Yield the error to expect, what it comes from, at most three things to know, and how many more there are."""
    verdict, things = fit.expectation, [*fit.remarks]
    if verdict is None:
        yield fit.outcome.value
    else:
        yield f"{verdict.headline}."
        yield verdict.origin
        yield from _creep(fit)
        ended = [] if fit.outcome.good else [fit.outcome.value]
        # Remarks name causes, such as the voltage of another axis: of a model that is of no use they come first.
        usable = verdict.readiness is not Readiness.NOT_USABLE
        things = [*ended, *(verdict.reservations + fit.remarks if usable else fit.remarks + verdict.reservations)]
    yield from to_know([*things, *fit.repairs])


def _lines(fit: Fit) -> Iterator[str]:
    """Yield the lines of a summary: verdict, errors, structures, parts, repairs, remaining error, remarks, solver."""
    if fit.expectation is not None:
        yield fit.expectation.sentence
    yield fit.outcome.value
    yield from _error_table(fit.errors)
    if fit.trials:
        yield from ("", "Structures tried, RMS error of cycles held out in turn:")
        structure = fit.options.get("structure")
        for trial in sorted(fit.trials, key=lambda trial: trial.held_out)[:_SHOWN]:
            chosen = " (chosen)" if trial.structure.as_dict() == structure else ""
            yield f"  {trial.held_out * 1e9:>7.1f} nm  {label(trial.structure, fit.trials)}{chosen}"
        yield "  (A part is kept only if it lowers this error by at least 3 %.)"
    yield from _creep(fit)
    if parts := _parts_of(fit.actuator):
        yield from ("", "The model is made of:", *(f"  {name + ':':<18}{sentence}" for name, sentence in parts))
    for title, sentences in _lists(fit):
        if sentences:
            yield from ("", f"{title}:", *(f"  - {sentence}" for sentence in sentences))
    yield from ("", f"Solver: {fit.status}, duality gap {fit.gap:.1g}")


def _creep(fit: Fit) -> Iterator[str]:
    """Yield a line on the form of creep that predicts held-out holds best, if the records have holds."""
    if fit.holds is not None:
        yield fit.holds.sentence(fit.actuator)


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


def _parts_of(actuator: Any) -> list[tuple[str, str]]:
    """Return name and sentence of each part of an actuator; none where there is no actuator."""
    parts = parts_of(actuator) if isinstance(actuator, Actuator) else ()
    return [(part.name, part.sentence) for part in parts]


def _lists(fit: Fit) -> tuple[tuple[str, Sequence[str]], ...]:
    causes = [one.sentence(fit.errors[0].stroke) for one in fit.remaining]
    return ("Repaired or left out", fit.repairs), ("Remaining error", causes), ("Remarks", fit.remarks)


def _as_html(fit: Fit) -> str:
    """Return a fit for a notebook: verdict, errors, and what opens with a click."""
    head = ("record", "role", "samples", "left out", "largest", "RMS", "largest, % of stroke", "RMS, % of stroke")
    rows = [
        (
            *(one.record, one.role, one.samples, one.left_out, length(one.largest), length(one.rms)),
            *(percent(one.largest, one.stroke), percent(one.rms, one.stroke)),
        )
        for one in fit.errors
    ]
    verdict = fit.expectation
    return html.block(
        "Fit" if verdict is None else f"Fit: {verdict.readiness.value}",
        html.line(_one_line(fit)),
        html.line(fit.outcome.value) if verdict is not None else "",
        *map(html.line, _creep(fit)),
        html.table(head, rows) if rows else "",
        html.folded("Parts of the model", [f"{name}: {sentence}" for name, sentence in _parts_of(fit.actuator)]),
        html.folded("Assumptions", [f"{check.name}: {check.verdict.value}. {check.sentence}" for check in fit.checks]),
        *(html.folded(title, sentences) for title, sentences in _lists(fit)),
        colour="red" if not fit.good else "" if verdict is None else _COLOURS[verdict.readiness],
    )
