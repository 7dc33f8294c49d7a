"""The result of `dehyst.insight`: how far a model can be trusted, and what to record next."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from dehyst._text import counted, escaped
from dehyst._views import html
from dehyst._views.fields import json_values
from dehyst._views.pictures import plotted
from dehyst.control import Homing, PossibleStart, StartError
from dehyst.identification import Identifiability
from dehyst.model import Actuator, TemperatureCover, words_of
from dehyst.trust.evidence import Evidence
from dehyst.trust.experiment_design import Suggestion
from dehyst.trust.judgement import Judgement, judge
from dehyst.trust.prediction_band import ERRORS, PredictionBand
from dehyst.trust.state_knowledge import StateKnowledge
from dehyst.trust.turn_plane import TurnPlane, turn_plane

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# A model that misses records by more than this part of their range [%] is no model of them.
_MISSED = 5.0
# Nor is one that misses them by more than this [%] and this many times as far as those it was identified from.
_WORTH, _TIMES = 0.5, 3.0
# Limits may be wider than the recorded voltages by this part, for a rounded number's sake.
_WIDER = 0.01


def of_another(actuator: Actuator, misfit: float, stroke: float) -> str | None:
    """Return a warning if the records seem to belong to another actuator."""
    range_ = float(np.ptp(actuator.spring.displacement))
    missed, known = 100 * misfit / stroke, actuator.identification
    own = np.inf if known is None or known.largest_error is None else known.largest_error
    if missed <= _MISSED and not (missed > _WORTH and misfit > _TIMES * own):
        return None
    return (
        f"The model misses these records by up to {missed:.3g} % of their range, {stroke * 1e6:.4g} um (its own is "
        f"{range_ * 1e6:.4g} um): they belong to another actuator or are in other units. Nothing below holds for them."
    )


def beyond(actuator: Actuator, limits: tuple[float, float] | None) -> str | None:
    """Return a warning if limits [V] go beyond the recorded voltages."""
    recorded = actuator.limits
    if recorded is None or limits is None:
        return None
    over = max(recorded[0] - limits[0], limits[1] - recorded[1])
    if over <= _WIDER * (recorded[1] - recorded[0]):
        return None
    return (
        f"The limits, {limits[0]:.6g} to {limits[1]:.6g} V, go {over:.4g} V beyond those of the records, "
        f"{recorded[0]:.6g} to {recorded[1]:.6g} V: all results for voltages there are extrapolated."
    )


def not_homed(homing: Homing | None) -> str | None:
    """Return a warning if the rise before a trajectory leaves the state unknown."""
    if homing is None or homing.certified:
        return None
    return (
        "The trajectory is taken to start after a rise through all of the limits, which does not make the "
        f"state known ({'; '.join(homing.remarks)}): what was done before may show in it."
    )


@dataclass(frozen=True, eq=False)
class Insight:
    """How far a model can be trusted, and what to record next.

    Attributes
    ----------
    evidence : Evidence
    knowledge : tuple of StateKnowledge
    limits : (float, float) or None
        Voltages allowed [V].
    homing : Homing or None
        None if the model has no voltage limits.
    band : PredictionBand or None
        Prediction band of the trajectory, if one was given.
    advice : tuple of Suggestion
        Excitations to record next, best first; empty if none on the menu determines more.
    start : PossibleStart or None
        Start of the trajectory; None: the top of the limits, after a rise through them.
    opened : StartError or None
        Displacement error along the trajectory due to its unknown start; None if the start is known.
    temperatures : TemperatureCover
        Temperatures of the records, those in use, and those to record at.
    """

    evidence: Evidence
    knowledge: tuple[StateKnowledge, ...]
    limits: tuple[float, float] | None
    homing: Homing | None = None
    band: PredictionBand | None = None
    advice: tuple[Suggestion, ...] = ()
    start: PossibleStart | None = None
    opened: StartError | None = None
    temperatures: TemperatureCover = field(default_factory=TemperatureCover)

    @property
    def actuator(self) -> Actuator:
        """The model."""
        return self.evidence.actuator

    @property
    def identifiability(self) -> Identifiability:
        """Identifiability of the stiffnesses; if the model has more parts, of ten plain slip elements instead."""
        return self.evidence.identifiability

    @property
    def misfit(self) -> float:
        """The largest error of the model on these records [m]."""
        return self.evidence.misfit

    @property
    def turns(self) -> TurnPlane | None:
        """The plane of turning points: where the records turned, and which regions they test."""
        records = (one.record.record for one in self.evidence.comparisons)
        return turn_plane(((one.name, one.time, one.voltage) for one in records), self.limits)

    def __repr__(self) -> str:
        return one_line(self)

    def _repr_html_(self) -> str:
        return as_html(self)

    def summary(self, full: bool = False) -> str:
        """Return what `dehyst insight` prints: the error to expect, warnings, and what to record next, in lines.

        With `full`, return what `--all` prints: also the directions, and when the state becomes known.
        """
        return "\n".join(escaped(line) for line in (lines if full else _brief)(self))

    def plot(
        self,
        kind: Literal["directions", "band"] | None = None,
        *,
        ax: Axes | None = None,
    ) -> Axes:
        """Draw what the records determine.

        Parameters
        ----------
        kind : str, optional
            "directions": singular values of the stiffness directions, determined or open. "band": where the
            displacement of the trajectory may be, minus the wanted path. Default: "band", if there is a trajectory.
        ax : matplotlib.axes.Axes, optional
            Where to draw; default: the axes of a new figure.

        Returns
        -------
        matplotlib.axes.Axes

        Raises
        ------
        ModelError
            If there is no such kind, or no numbers for it.
        MissingExtraError
            If matplotlib is not installed.
        """
        return plotted("insight", self, kind, ax)

    @property
    def trustworthy(self) -> bool:
        """Whether the records determine all directions of the stiffnesses; see `identifiability`."""
        return self.identifiability.determined == self.identifiability.of

    @property
    def judgement(self) -> Judgement:
        """The expected error of the trajectory; without a trajectory, of a path like the records."""
        begins = "" if self.band is None else "top" if self.start is None else self.start.name
        return judge(self.actuator, self.band, self.opened, begins=begins)

    def warnings(self) -> tuple[str, ...]:
        """Return warnings to consider before the model is used."""
        remarks: list[str | None] = [
            of_another(self.actuator, self.misfit, self.evidence.stroke),
            self._open(),
            beyond(self.actuator, self.limits),
            self.temperatures.sentence if self.temperatures.missing else None,
        ]
        if self.band is not None:
            remarks += self.band.warnings
            remarks += [not_homed(self.homing)] if self.start is None else [*self.start.remarks, self._open_start()]
        return tuple(remark for remark in remarks if remark)

    def _open(self) -> str | None:
        if self.trustworthy:
            return None
        found = self.identifiability
        next_ = f" Add {self.advice[0].words}." if self.advice else ""
        return (
            f"{found.of - found.determined} of {found.of} directions of {found.subject} are open: motions that turn "
            f"elsewhere than the records do may be predicted wrongly.{next_}"
        )

    def _open_start(self) -> str | None:
        """Return a sentence on the trajectory's error due to its unknown start, if that exceeds the model's error."""
        if self.start is None or self.opened is None or not self.opened.matters:
            return None
        return (
            f"The start after {self.start.name} leaves {self.opened.percent(self.opened.largest):.2g} % of the stroke "
            "open on this trajectory; the band does not include this."
        )

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values; lengths in metres."""
        band = None if self.band is None else {f"{name}_m": error for name, error in self.band.errors().items()}
        homing = "turns_V=turns travel_V=travel certified seconds=played.duration error_m=error width_m=width remarks"
        directions = json_values(self.identifiability, "determined of singular_values_V_per_V=values")
        return {
            **self.evidence.as_dict(),
            "warnings": list(self.warnings()),
            **json_values(self, "misfit_m=misfit judgement"),
            "directions": directions,
            **json_values(self, "advice state=knowledge start=start.name turns"),
            "temperatures": self.temperatures.as_dict(),
            "homing": None if self.homing is None else json_values(self.homing, homing),
            "trajectory": band,
            "band": None if self.band is None else self.band.as_dict(self.evidence.stroke),
        }


def one_line(found: Insight) -> str:
    """Return the number of determined directions as text."""
    directions = f"{found.identifiability.determined} of {found.identifiability.of} directions determined"
    return f"<Insight of '{escaped(found.actuator.name)}': {directions}, {counted(len(found.warnings()), 'warning')}>"


def as_html(found: Insight) -> str:
    """Return an assessment for a notebook: warnings, and what is known."""
    warnings, stroke = found.warnings(), found.evidence.stroke
    rows = [
        ("largest error on the records", f"{100 * found.misfit / stroke:.3g} % of the stroke"),
        ("directions determined", f"{found.identifiability.determined} of {found.identifiability.of}"),
    ]
    if found.band is not None:
        errors = {name: error for name, error in found.band.errors().items() if error or name != "clamped"}
        rows += [
            (f"path: {ERRORS[name]}", f"{100 * error / stroke:.3g} % of the stroke") for name, error in errors.items()
        ]
    title = f"Insight of '{found.actuator.name}'"
    text = html.preformatted("Summary", lines(found))
    return html.block(title, *map(html.line, warnings), html.facts(rows), text, colour="amber" if warnings else "green")


def _answer(found: Insight) -> Iterator[str]:
    """Yield the error to expect, of the trajectory or of a path like the records, and the warnings."""
    stroke, warnings = found.evidence.stroke, found.warnings()
    another = of_another(found.actuator, found.misfit, stroke)
    if another is not None:
        yield f"WARNING: {another}"
    elif words := found.judgement.words(stroke):
        yield f"Expect {'any path' if found.band is None else 'this path'} {words}."
        yield from found.judgement.untested
    misfit = 100 * found.misfit / stroke
    yield f"The largest error of the model on these records is {misfit:.3g} % of the stroke."
    for warning in warnings[another is not None :]:
        yield ""
        yield f"WARNING: {warning}"


def _brief(found: Insight) -> Iterator[str]:
    yield from _answer(found)
    yield from _band(found)
    yield from _advice(found)


def lines(found: Insight) -> Iterator[str]:
    """Yield all lines of a summary, in the order in which they matter."""
    yield from _answer(found)
    yield ""
    yield from _directions(found)
    yield from _band(found)
    yield from _advice(found)
    yield ""
    yield "When the state becomes known, if nothing is known before:"
    for known in found.knowledge:
        measured, played = (_moment(t) for t in (known.by_displacement, known.by_voltage))
        yield (
            f"  - {known.record}: {measured} from the measured displacement, "
            f"{played if known.judged else 'not judged'} from the voltage alone"
        )
    yield from _homing(found)


def _directions(found: Insight) -> Iterator[str]:
    identifiability = found.identifiability
    yield (
        f"Directions of {identifiability.subject} that the turning points determine, whatever the noise: "
        f"{identifiability.determined} of {identifiability.of}"
    )
    values = " ".join(f"{value:.2g}" for value in identifiability.values)
    yield f"  singular values, V for each volt of breakaway voltage: {values}"


def _advice(found: Insight) -> Iterator[str]:
    if found.temperatures.missing:
        yield ""
        yield f"To record at {words_of(found.temperatures.missing)}: the excitation of the records, or"
        if found.limits is not None:
            yield f"      dehyst excite descending-tops {found.limits[1]:.6g} -o tops.csv"
    elif sentence := found.temperatures.sentence:
        yield ""
        yield sentence
    if found.advice:
        yield ""
        yield "To record next, best first:"
        for excitation in found.advice[:3]:
            yield f"  - {excitation.words}: {excitation.determined} of {excitation.of} in {excitation.seconds:.4g} s"
            yield f"      {excitation.command}"
    elif found.trustworthy:
        yield ""
        yield "To record next: nothing; no loop determines more directions."


def _homing(found: Insight) -> Iterator[str]:
    if found.homing is None:
        return
    turns = ", ".join(f"{v:.6g}" for v in found.homing.turns)
    verdict = "certified" if found.homing.certified else "NOT certified"
    if found.homing.played is None:
        yield f"  - shortest homing: {turns} V ({verdict}: from any state to within {found.homing.width * 1e6:.1g} um)"
    else:
        yield (
            f"  - homing: {turns} V in {found.homing.played.duration:.4g} s ({verdict}: the displacement is known to "
            f"{found.homing.error * 1e6:.3g} um after it)"
        )
    for remark in found.homing.remarks:
        yield f"      {remark}"


def _moment(seconds: float | None) -> str:
    return "never" if seconds is None else f"after {seconds:.4g} s"


def _band(found: Insight) -> Iterator[str]:
    if found.band is None:
        return

    stroke = found.evidence.stroke
    yield ""
    yield "Causes of the error, in % of the stroke:"
    for name, error in found.band.errors().items():
        if error or name != "clamped":
            yield f"  {ERRORS[name]:<42}{100 * error / stroke:8.3f} %{error * 1e9:10.0f} nm"
