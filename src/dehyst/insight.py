"""What records can and cannot tell of an actuator: open directions, error bars, what to record next, how to home."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._native import Array, vector
from dehyst.actuator import Actuator
from dehyst.advice import Suggestion, advise
from dehyst.bracket import Bracket, known_by_displacement
from dehyst.compensator import Compensator
from dehyst.directions import Directions
from dehyst.elements import MaxwellSlip
from dehyst.evidence import Evidence
from dehyst.homing import Homing, shortest_homing
from dehyst.intervals import Intervals, resample
from dehyst.latitude import Latitude, latitude
from dehyst.metrics import largest
from dehyst.model import State
from dehyst.record import Record

Progress = Callable[[str], None]
# An element that holds less of the voltage than this has nothing to be homed for.
_SMALL = 1e-9


@dataclass(frozen=True, eq=False)
class Band:
    """Where the displacement of a trajectory may be, in metres on the model's axis.

    Attributes
    ----------
    voltage, displacement : (n,) array
        Played [V], and what the model does with it.
    noise : (2, n) array
        Lowest and highest prediction of models identified from resampled cycles.
    open : (2, n) array
        Lowest and highest prediction of models that the records do not contradict.
    misfit : float
        The largest error of the model on these records [m]: what no model of its class may be able to follow.
    warnings : tuple of str
        What was clamped or extrapolated.
    """

    voltage: Array
    displacement: Array
    noise: Array
    open: Array
    misfit: float
    warnings: tuple[str, ...]

    @property
    def lowest(self) -> Array:
        """(n,) lowest displacement to be expected [m]: the lower of both bands, less the misfit."""
        return np.asarray(np.minimum(self.noise[0], self.open[0]) - self.misfit)

    @property
    def highest(self) -> Array:
        """(n,) highest displacement to be expected [m]."""
        return np.asarray(np.maximum(self.noise[1], self.open[1]) + self.misfit)

    @property
    def error(self) -> float:
        """The largest error to be expected [m]."""
        return max(largest(self.highest - self.displacement), largest(self.displacement - self.lowest))

    def columns(self) -> dict[str, Array]:
        """Columns for a file, in volts and micrometres."""
        return {"voltage_V": self.voltage, "expected_um": self.displacement * 1e6, "lowest_um": self.lowest * 1e6,
                "highest_um": self.highest * 1e6}  # fmt: skip

    def errors(self) -> dict[str, float]:
        """Largest errors [m] that noise, open directions and the model's misfit may cause, and all together."""

        def off(band: Array) -> float:
            return largest(np.maximum(band[1] - self.displacement, self.displacement - band[0]))

        return {"noise": off(self.noise), "open": off(self.open), "misfit": self.misfit, "all": self.error}


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
        said = []
        told = self.directions
        if not self.trustworthy:
            next_ = f" Add {self.advice[0].words}." if self.advice else ""
            said.append(
                f"{told.of - told.determined} of {told.of} directions of the stiffnesses are open: motions that turn "
                f"elsewhere than the records do may be predicted wrongly.{next_}"
            )
        if self.band is not None:
            stroke = self.evidence.stroke
            parts = {name: 100 * error / stroke for name, error in self.band.errors().items()}
            if parts["open"] > max(parts["misfit"], parts["noise"], 0.1) and not self.trustworthy:
                said.append(
                    f"On this trajectory open directions may cause an error of {parts['open']:.2g} % of the range; the "
                    f"model misses its own records by {parts['misfit']:.2g} % only, which says nothing of it."
                )
        return tuple(said)

    def as_dict(self) -> dict[str, Any]:
        """JSON values; lengths in metres."""
        told, bounds = self.directions, self.stiffness
        return {
            **self.evidence.as_dict(),
            "warnings": list(self.warnings()),
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
                **{f"{name}_m": error for name, error in self.band.errors().items()},
                "warnings": list(self.band.warnings)},
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
    if trajectory is not None and not repeats:
        raise ModelError("got a trajectory and no repeats, need 20 repeats at least to say how wrong it may come out")
    progress("reading the records beside the model")
    evidence = Evidence.of(actuator, records)
    allowed = actuator.limits if limits is None else limits
    wanted = None if trajectory is None else vector(trajectory, "trajectory")
    start = _homed(actuator, allowed)
    command = None
    if wanted is not None:
        command = Compensator(actuator, allowed).trajectory(wanted, state=start)
    free = intervals = None
    if repeats:
        intervals = resample(evidence, level=level, repeats=repeats, seed=seed, progress=progress)
        progress("looking for models that the records do not contradict")
        free = latitude(evidence, None if command is None else command.displacement, start)
    band = None
    if command is not None and intervals is not None and free is not None:

        def state(model: Actuator) -> State:
            return _homed(model, allowed)

        voltage = command.voltage
        band = Band(voltage, command.displacement, intervals.prediction(voltage, state),
                    free.prediction(voltage, state), _misfit(evidence), command.warnings)  # fmt: skip
    progress("ranking excitations")
    advice = () if allowed is None else advise(evidence, limits=allowed, seconds=seconds)
    homing = None if allowed is None else shortest_homing(actuator, limits=allowed, present=allowed[0], stiff_only=True)
    known = tuple(_knowledge(evidence, number) for number in range(len(evidence.comparisons)))
    return Insight(actuator, evidence, evidence.directions, intervals, free, advice, known, homing, band)


def _homed(actuator: Actuator, limits: tuple[float, float] | None) -> State:
    """The state at the top of the limits, after a rise through all of them."""
    ends = actuator.spring.displacement[[0, -1]]
    if limits is None:
        return actuator.turned(float(ends[1]))
    return actuator.simulate(np.array(limits), state=actuator.turned(float(ends[0]), rising=False)).state


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
