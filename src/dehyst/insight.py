"""What records can and cannot tell of an actuator: open directions, error bars, what to record next, how to home."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._native import Array, vector
from dehyst.actuator import Actuator, interval
from dehyst.advice import Suggestion, advise
from dehyst.band import Band, homed
from dehyst.bracket import Bracket, known_by_displacement
from dehyst.compensator import Compensator
from dehyst.directions import Directions
from dehyst.elements import MaxwellSlip
from dehyst.evidence import Evidence
from dehyst.homing import Homing, shortest_homing
from dehyst.intervals import LEAST_REPEATS, Intervals, resample
from dehyst.latitude import Latitude, latitude
from dehyst.metrics import largest
from dehyst.record import Record

Progress = Callable[[str], None]
# An element that holds less of the voltage than this has nothing to be homed for.
_SMALL = 1e-9
# A model that misses records by more than this part of their range [%] is no model of them.
_MISSED = 5.0
# Nor is one that misses them by more than this [%] and this many times as far as those it was identified from.
_WORTH, _TIMES = 0.5, 3.0
# Limits may be wider than the recorded voltages by this part, for a rounded number's sake.
_WIDER = 0.01


@dataclass(frozen=True)
class Knowledge:
    """From when on the state is known along a record, nothing being known before it.

    Attributes
    ----------
    record : str
    by_displacement, by_voltage : float or None
        Time since the record's start [s] from which every element with stiffness is known: to one who sees the
        displacement, and to one who sees the voltage alone; None if never.
    """

    record: str
    by_displacement: float | None
    by_voltage: float | None


@dataclass(frozen=True, eq=False)
class Insight:
    """How far a model may be trusted, and what to do about it.

    Attributes
    ----------
    actuator : Actuator
    evidence : Evidence
    directions : Directions
    intervals : Intervals or None
        From resampled cycles; None if they were not asked for.
    latitude : Latitude or None
        What the records do not contradict; None with the intervals.
    advice : tuple of Suggestion
        Best first; empty if nothing on the menu tells more.
    knowledge : tuple of Knowledge
    homing : Homing or None
        None if the model has no voltage limits.
    band : Band or None
        If a trajectory was given.
    misfit : float
        The largest error of the model on these records [m].
    limits : (float, float) or None
        Voltages allowed [V].
    """

    actuator: Actuator
    evidence: Evidence
    directions: Directions
    intervals: Intervals | None
    latitude: Latitude | None
    advice: tuple[Suggestion, ...]
    knowledge: tuple[Knowledge, ...]
    homing: Homing | None
    band: Band | None
    misfit: float
    limits: tuple[float, float] | None

    @property
    def stiffness(self) -> Array | None:
        """Lowest and highest kappa_i (2, N) [V/m] by noise and open directions together; None without intervals."""
        if self.intervals is None or self.latitude is None:
            return None
        noise, free = self.intervals.stiffness, self.latitude.stiffness
        return np.array([np.minimum(noise[0], free[0]), np.maximum(noise[1], free[1])])

    @property
    def trustworthy(self) -> bool:
        """Whether the records leave no direction of the stiffnesses open."""
        return self.directions.determined == self.directions.of

    def warnings(self) -> tuple[str, ...]:
        """What must be known before the model is used."""
        said = (self._of_another(), self._open(), self._beyond())
        return (*(one for one in said if one), *(() if self.band is None else self._band_warnings(self.band)))

    def _of_another(self) -> str | None:
        stroke, range_ = self.evidence.stroke, float(np.ptp(self.actuator.spring.displacement))
        missed, own = 100 * self.misfit / stroke, self.actuator.provenance.get("largest_error_m", np.inf)
        if missed <= _MISSED and not (missed > _WORTH and self.misfit > _TIMES * own):
            return None
        return (
            f"The model misses these records by up to {missed:.3g} % of their range, {stroke * 1e6:.4g} um (its own is "
            f"{range_ * 1e6:.4g} um): they are of another actuator, or in other units. Nothing below holds for them."
        )

    def _open(self) -> str | None:
        if self.trustworthy:
            return None
        told = self.directions
        next_ = f" Add {self.advice[0].words}." if self.advice else ""
        return (
            f"{told.of - told.determined} of {told.of} directions of the stiffnesses are open: motions that turn "
            f"elsewhere than the records do may be predicted wrongly.{next_}"
        )

    def _beyond(self) -> str | None:
        recorded = self.actuator.limits
        if recorded is None or self.limits is None:
            return None
        over = max(recorded[0] - self.limits[0], self.limits[1] - recorded[1])
        if over <= _WIDER * (recorded[1] - recorded[0]):
            return None
        return (
            f"The limits, {self.limits[0]:.6g} to {self.limits[1]:.6g} V, go {over:.4g} V beyond those of the records, "
            f"{recorded[0]:.6g} to {recorded[1]:.6g} V: what is said of voltages there is extrapolated."
        )

    def _band_warnings(self, band: Band) -> list[str]:
        said = list(band.warnings)
        parts = {name: 100 * error / self.evidence.stroke for name, error in band.errors().items()}
        if parts["open"] > max(parts["misfit"], parts["noise"], 0.1) and not self.trustworthy:
            said.append(
                f"On this trajectory open directions may cause an error of {parts['open']:.2g} % of the range; the "
                f"model misses its own records by {parts['misfit']:.2g} % only, which says nothing of it."
            )
        if self.homing is not None and not self.homing.certified:
            said.append(
                "The trajectory is taken to start after a rise through all of the limits, which does not make the "
                f"state known ({'; '.join(self.homing.remarks)}): what was done before may show in it."
            )
        return said

    def as_dict(self) -> dict[str, Any]:
        """JSON values; lengths in metres."""
        told, bounds = self.directions, self.stiffness
        return {
            **self.evidence.as_dict(),
            "warnings": list(self.warnings()),
            "misfit_m": self.misfit,
            "directions": {"determined": told.determined, "of": told.of,
                           "singular_values_V_per_V": told.values.tolist(),
                           "open": [change.tolist() for change in told.open],
                           "sentences": list(told.sentences())},
            "stiffness_V_per_m": {
                "model": self.actuator.slip.stiffness.tolist(),
                "noise": None if self.intervals is None else self.intervals.stiffness.tolist(),
                "open": None if self.latitude is None else self.latitude.stiffness.tolist(),
                "both": None if bounds is None else bounds.tolist(),
            },
            "spring_V": {
                "knots_m": self.actuator.spring.displacement.tolist(),
                "noise": None if self.intervals is None else self.intervals.spring.tolist(),
                "open": None if self.latitude is None else self.latitude.spring.tolist(),
            },
            "level": None if self.intervals is None else self.intervals.level,
            "advice": [one.as_dict() for one in self.advice],
            "state": [{"record": one.record, "known_by_displacement_s": one.by_displacement,
                       "known_by_voltage_s": one.by_voltage} for one in self.knowledge],
            "homing": None if self.homing is None else {
                "turns_V": list(self.homing.turns), "travel_V": self.homing.travel, "certified": self.homing.certified,
                "width_m": self.homing.width, "remarks": list(self.homing.remarks)},
            "trajectory": None if self.band is None else {
                f"{name}_m": error for name, error in self.band.errors().items()},
        }  # fmt: skip


def insight(
    actuator: Actuator,
    records: Record | Sequence[Record],
    *,
    trajectory: ArrayLike | None = None,
    limits: tuple[float, float] | None = None,
    seconds: float | None = None,
    level: float = 0.9,
    repeats: int = 100,
    seed: int = 0,
    progress: Progress = lambda _: None,
) -> Insight:
    """Say what records tell of an actuator that was identified from them, and what they leave open.

    Parameters
    ----------
    actuator : Actuator
    records : Record or sequence of Record
        Those it was identified from.
    trajectory : (n,) array_like, optional
        A displacement to follow [m], on the model's axis: how wrong may it come out? It is followed from the top of
        the limits on, where the state is known.
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
    evidence = Evidence.of(actuator, records)
    allowed = actuator.limits if limits is None else interval(limits)
    misfit = _misfit(evidence)
    free = intervals = band = None
    if repeats:
        intervals = resample(evidence, level=level, repeats=repeats, seed=seed, progress=progress)
        progress("looking for models that the records do not contradict")
        if trajectory is None:
            free = latitude(evidence)
        else:
            wanted, start = vector(trajectory, "trajectory"), homed(actuator, allowed)
            command = Compensator(actuator, allowed).trajectory(wanted, state=start)
            free = latitude(evidence, command.displacement, start)
            band = Band.of(wanted, command, intervals, free, misfit=misfit, limits=allowed)
    progress("ranking excitations")
    advice = () if allowed is None else advise(evidence, limits=allowed, seconds=seconds)
    homing = None if allowed is None else shortest_homing(actuator, limits=allowed, present=allowed[0], stiff_only=True)
    known = tuple(_knowledge(evidence, number) for number in range(len(evidence.comparisons)))
    return Insight(actuator, evidence, evidence.directions, intervals, free, advice, known, homing, band, misfit,
                   allowed)  # fmt: skip


def _check(trajectory: bool, repeats: int, level: float) -> None:
    if repeats < 0 or 0 < repeats < LEAST_REPEATS:
        raise ModelError(f"repeats: got {repeats}, need {LEAST_REPEATS} at least, or 0 to leave out the intervals")
    if not 0 < level < 1:
        raise ModelError(f"level: got {level}, need a number between 0 and 1, e.g. 0.9")
    if trajectory and not repeats:
        raise ModelError(
            f"repeats: got 0 and a trajectory, need {LEAST_REPEATS} at least to say how wrong it may come out"
        )


def _misfit(evidence: Evidence) -> float:
    actuator = evidence.actuator
    errors = [played[2] - played[3] for one in evidence.comparisons for _, _, played in one.played(actuator)]
    return largest(np.concatenate(errors))


def _stiff(actuator: Actuator) -> Actuator:
    """The actuator without elements that hold nothing: it does the same."""
    keep = actuator.slip.friction > _SMALL * float(np.ptp(actuator.spring.voltage))
    slip = MaxwellSlip(actuator.slip.breakaway[keep], actuator.slip.stiffness[keep])
    return Actuator(slip, actuator.spring, limits=actuator.limits)


def _knowledge(evidence: Evidence, number: int) -> Knowledge:
    one = evidence.comparisons[number]
    actuator, record = _stiff(evidence.actuator), one.record.record
    # Noise widens a range by its extremes; what it adds is no excursion.
    reach = 2 * actuator.slip.breakaway + 4 * one.record.noise
    if not reach.size:
        return Knowledge(record.name, 0.0, 0.0)
    seen = known_by_displacement(0.5 * reach, record.displacement).first_known
    bracket = Bracket.at_rest(actuator, float(record.voltage[0]))
    played = bracket.drive(actuator, record.voltage).first_known

    def time(sample: int | None) -> float | None:
        return None if sample is None else float(record.time[sample] - record.time[0])

    return Knowledge(record.name, time(seen), time(played))
