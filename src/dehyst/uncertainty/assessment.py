"""What records can and cannot tell of an actuator: open directions, error bars, what to record next, how to home."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._threads import one_thread
from dehyst._types import Array, Progress
from dehyst._validation import interval, vector
from dehyst.control import Compensator, Homing, shortest_homing
from dehyst.identification.diagnostics.identifiability import Identifiability
from dehyst.model import Actuator
from dehyst.records import Record
from dehyst.uncertainty.bootstrap import LEAST_REPEATS, Intervals, resample
from dehyst.uncertainty.evidence import Evidence
from dehyst.uncertainty.experiment_design import Suggestion, advise
from dehyst.uncertainty.feasible_set import FeasibleSet, feasible_set
from dehyst.uncertainty.messages import beyond, misfit_of, not_homed, of_another
from dehyst.uncertainty.prediction_band import PredictionBand, state_at_top
from dehyst.uncertainty.state_knowledge import StateKnowledge
from dehyst.uncertainty.wide_insight import WideInsight, look


@dataclass(frozen=True, eq=False)
class Insight:
    """How far a model may be trusted, and what to do about it.

    Attributes
    ----------
    actuator : Actuator
    evidence : Evidence
    identifiability : Identifiability
    intervals : Intervals or None
        From resampled cycles; None if they were not asked for.
    latitude : FeasibleSet or None
        What the records do not contradict; None with the intervals.
    advice : tuple of Suggestion
        Best first; empty if nothing on the menu tells more.
    knowledge : tuple of StateKnowledge
    homing : Homing or None
        None if the model has no voltage limits.
    band : PredictionBand or None
        If a trajectory was given.
    misfit : float
        The largest error of the model on these records [m].
    limits : (float, float) or None
        Voltages allowed [V].
    """

    actuator: Actuator
    evidence: Evidence
    identifiability: Identifiability
    intervals: Intervals | None
    feasible_set: FeasibleSet | None
    advice: tuple[Suggestion, ...]
    knowledge: tuple[StateKnowledge, ...]
    homing: Homing | None
    band: PredictionBand | None
    misfit: float
    limits: tuple[float, float] | None

    @property
    def stiffness(self) -> Array | None:
        """Lowest and highest kappa_i (2, N) [V/m] by noise and open directions together; None without intervals."""
        if self.intervals is None or self.feasible_set is None:
            return None
        noise, free = self.intervals.stiffness, self.feasible_set.stiffness
        return np.array([np.minimum(noise[0], free[0]), np.maximum(noise[1], free[1])])

    @property
    def trustworthy(self) -> bool:
        """Whether the records leave no direction of the stiffnesses open."""
        return self.identifiability.determined == self.identifiability.of

    def warnings(self) -> tuple[str, ...]:
        """What must be known before the model is used."""
        said = (
            of_another(self.actuator, self.misfit, self.evidence.stroke),
            self._open(),
            beyond(self.actuator, self.limits),
        )
        return (*(one for one in said if one), *(() if self.band is None else self._band_warnings(self.band)))

    def _open(self) -> str | None:
        if self.trustworthy:
            return None
        told = self.identifiability
        next_ = f" Add {self.advice[0].words}." if self.advice else ""
        return (
            f"{told.of - told.determined} of {told.of} directions of the stiffnesses are open: motions that turn "
            f"elsewhere than the records do may be predicted wrongly.{next_}"
        )

    def _band_warnings(self, band: PredictionBand) -> list[str]:
        said = list(band.warnings)
        parts = {name: 100 * error / self.evidence.stroke for name, error in band.errors().items()}
        if parts["open"] > max(parts["misfit"], parts["noise"], 0.1) and not self.trustworthy:
            said.append(
                f"On this trajectory open directions may cause an error of {parts['open']:.2g} % of the range; the "
                f"model misses its own records by {parts['misfit']:.2g} % only, which says nothing of it."
            )
        unknown = not_homed(self.homing)
        if unknown:
            said.append(unknown)
        return said

    def as_dict(self) -> dict[str, Any]:
        """JSON values; lengths in metres."""
        told, bounds = self.identifiability, self.stiffness
        return {
            **self.evidence.as_dict(),
            "warnings": list(self.warnings()),
            "misfit_m": self.misfit,
            "directions": {
                "determined": told.determined,
                "of": told.of,
                "singular_values_V_per_V": told.values.tolist(),
                "open": [change.tolist() for change in told.open],
                "sentences": list(told.sentences()),
            },
            "stiffness_V_per_m": {
                "model": self.actuator.slip.stiffness.tolist(),
                "noise": None if self.intervals is None else self.intervals.stiffness.tolist(),
                "open": None if self.feasible_set is None else self.feasible_set.stiffness.tolist(),
                "both": None if bounds is None else bounds.tolist(),
            },
            "spring_V": {
                "knots_m": self.actuator.spring.displacement.tolist(),
                "noise": None if self.intervals is None else self.intervals.spring.tolist(),
                "open": None if self.feasible_set is None else self.feasible_set.spring.tolist(),
            },
            "level": None if self.intervals is None else self.intervals.level,
            "advice": [one.as_dict() for one in self.advice],
            "state": [one.as_dict() for one in self.knowledge],
            "homing": None
            if self.homing is None
            else {
                "turns_V": list(self.homing.turns),
                "travel_V": self.homing.travel,
                "certified": self.homing.certified,
                "width_m": self.homing.width,
                "remarks": list(self.homing.remarks),
            },
            "trajectory": None
            if self.band is None
            else {f"{name}_m": error for name, error in self.band.errors().items()},
        }


@one_thread()
def insight(
    actuator: Actuator,
    records: Record | Sequence[Record],
    *,
    trajectory: ArrayLike | None = None,
    time: ArrayLike | None = None,
    limits: tuple[float, float] | None = None,
    seconds: float | None = None,
    level: float = 0.9,
    repeats: int = 100,
    seed: int = 0,
    progress: Progress = lambda _: None,
) -> Insight | WideInsight:
    """Say what records tell of an actuator that was identified from them, and what they leave open.

    Of a wider actuator less is judged, see `dehyst.uncertainty.wide_insight.WideInsight`.

    Parameters
    ----------
    actuator : Actuator
    records : Record or sequence of Record
        Those it was identified from.
    trajectory : (n,) array_like, optional
        A displacement to follow [m], on the model's axis: how wrong may it come out? It is followed from the top of
        the limits on, where the state is known.
    time : (n,) array_like, optional
        Of the trajectory [s]; needed by a model that moves in time.
    limits : (float, float), optional
        Voltages allowed [V]; default: those of the model.
    seconds : float, optional
        Longest excitation to be advised.
    level : float, optional
        Of the intervals.
    repeats : int, optional
        Sets of resampled cycles; 0 leaves out intervals and bands.
    seed : int, optional
    progress : callable, optional
        Called with a few words at each step.

    Raises
    ------
    RecordError, IdentifyError
        If a record cannot be used or an option is impossible.
    ModelError
        If a trajectory is given without repeats, or is no path.
    """
    _check(trajectory is not None, repeats, level)
    progress("reading the records beside the model")
    allowed = actuator.limits if limits is None else interval(limits)
    if actuator.wide:
        path = None if trajectory is None else vector(trajectory, "trajectory")
        return look(
            actuator,
            records,
            path,
            None if time is None else vector(time, "time"),
            limits=allowed,
            level=level,
            repeats=repeats,
            seed=seed,
            progress=progress,
        )
    evidence = Evidence.of(actuator, records)
    misfit = misfit_of(actuator, evidence.comparisons)
    free = intervals = band = None
    if repeats:
        intervals = resample(evidence, level=level, repeats=repeats, seed=seed, progress=progress)
        progress("looking for models that the records do not contradict")
        if trajectory is None:
            free = feasible_set(evidence)
        else:
            wanted, start = vector(trajectory, "trajectory"), state_at_top(actuator, allowed)
            command = Compensator(actuator, allowed).trajectory(wanted, state=start)
            free = feasible_set(evidence, command.displacement, start)
            band = PredictionBand.of(wanted, command, intervals, free, misfit=misfit, limits=allowed)
    progress("ranking excitations")
    advice = () if allowed is None else advise(evidence, limits=allowed, seconds=seconds)
    homing = None if allowed is None else shortest_homing(actuator, limits=allowed, present=allowed[0], stiff_only=True)
    known = tuple(StateKnowledge.of(actuator, one) for one in evidence.comparisons)
    return Insight(
        actuator, evidence, evidence.identifiability, intervals, free, advice, known, homing, band, misfit, allowed
    )


def _check(trajectory: bool, repeats: int, level: float) -> None:
    if repeats < 0 or 0 < repeats < LEAST_REPEATS:
        raise ModelError(f"repeats: got {repeats}, need {LEAST_REPEATS} at least, or 0 to leave out the intervals")
    if not 0 < level < 1:
        raise ModelError(f"level: got {level}, need a number between 0 and 1, e.g. 0.9")
    if trajectory and not repeats:
        raise ModelError(
            f"repeats: got 0 and a trajectory, need {LEAST_REPEATS} at least to say how wrong it may come out"
        )
