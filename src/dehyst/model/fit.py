"""What an identification returns: the actuator, errors, checks and outcome."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from math import isfinite
from typing import Any

from dehyst._types import Array

# Of the range a decade; and what of a decade must have been seen.
MOST_CREEP, FEWEST_DECADES = 20.0, 0.5


class Outcome(Enum):
    """How an identification ended; the value is the sentence to show."""

    IDENTIFIED = "Identified: the program was solved to optimality, and the records determine every stiffness."
    WIDER = (
        "Identified: the program was solved to optimality, in a wider class than the paper's. How far to trust it, "
        "dehyst insight tells."
    )
    UNDETERMINED = (
        "Identified, but the records leave directions of the stiffnesses open: other motions than the recorded ones "
        "may be predicted wrongly. Add minor loops with other turning points."
    )
    FLOOR_ACTIVE = (
        "Identified, but the spring's slope lies on its floor in places: the records do not tell it there, or the "
        "model class does not fit."
    )
    ASSUMPTION_I_IMPOSED = (
        "Identified, but only with Assumption I imposed: without it the spring would fall somewhere, and no voltage "
        "would have one displacement."
    )
    STIFFNESS_CLIPPED = (
        "Identified, but the closed form gave negative stiffnesses, which were set to zero: the loop is not that of "
        "Maxwell-slip elements with a linear spring."
    )
    INACCURATE = "Identified, but the model misses the records by more than 5 % of the range: do not use it."
    VALIDATION_MISSED = (
        "Identified, but the model misses a held-out record by more than 5 % of the range: do not use it for motions "
        "like that one."
    )
    FAILED = "Not identified: the solver found no optimum."

    @property
    def good(self) -> bool:
        """Whether the model may be used."""
        return self not in (Outcome.INACCURATE, Outcome.VALIDATION_MISSED, Outcome.FAILED)


@dataclass(frozen=True)
class RecordErrors:
    """Measured minus simulated displacement of one record, where its state is known.

    Attributes
    ----------
    largest, rms : float
        [m], after the reported drift of the record was set aside.
    rms_with_drift : float
        [m], with the drift left in.
    stroke : float
        The range of the widest training loop [m], to which the percentages refer.
    drift : float
        That was set aside [m a decade of time since the record's start].
    decades : float
        Of that time, which the samples that count cover.
    """

    record: str
    role: str
    samples: int
    left_out: int
    largest: float
    rms: float
    largest_with_drift: float
    rms_with_drift: float
    stroke: float
    offset: float
    datum: float
    drift: float
    decades: float = 1.0

    @property
    def drifted_percent(self) -> float:
        """How far the drift moved the samples that count, in % of the stroke."""
        return 100 * self.drift * self.decades / self.stroke

    @property
    def creeps(self) -> bool:
        """Whether the drift may be called a creep, and its rate be told."""
        return may_creep(100 * self.drift / self.stroke, self.decades)

    @property
    def largest_percent(self) -> float:
        """Largest error in % of the stroke."""
        return 100 * self.largest / self.stroke

    @property
    def rms_percent(self) -> float:
        """RMS error in % of the stroke."""
        return 100 * self.rms / self.stroke

    def as_dict(self) -> dict[str, Any]:
        """JSON values, lengths in metres."""
        return {
            "record": self.record,
            "role": self.role,
            "samples": self.samples,
            "left_out": self.left_out,
            "largest_percent": self.largest_percent,
            "rms_percent": self.rms_percent,
            "largest_m": self.largest,
            "rms_m": self.rms,
            "largest_with_drift_percent": 100 * self.largest_with_drift / self.stroke,
            "rms_with_drift_percent": 100 * self.rms_with_drift / self.stroke,
            "offset_V": self.offset,
            "datum_m": self.datum,
            "drift_percent": 100 * self.drift / self.stroke,
            "drift_decades": self.decades,
        }


def may_creep(rate: float, decades: float) -> bool:
    """Whether a drift may be called a creep, by its rate [% of the range a decade] and the decades seen.

    Piezoelectric actuators creep by some percent a decade; what drifts by more is something else. A rate that is told
    from a small part of a decade is an extrapolation.
    """
    return abs(rate) <= MOST_CREEP and decades >= FEWEST_DECADES


@dataclass(frozen=True, eq=False)
class Trace:
    """One record beside its simulation: time [s], voltage as it acted [V], displacements [m] on the model's axis."""

    record: str
    role: str
    time: Array
    voltage: Array
    measured: Array
    simulated: Array

    @property
    def residual(self) -> Array:
        """Measured minus simulated displacement (n,) [m]."""
        return self.measured - self.simulated


class Verdict(Enum):
    """Whether something that a model takes for granted holds; the value is the word to show."""

    HOLDS = "holds"
    FAILS = "does not hold"
    UNKNOWN = "not known"


@dataclass(frozen=True)
class Check:
    """One thing that a model takes for granted, looked for in the records.

    Attributes
    ----------
    name : str
        What is taken for granted: "Assumption I", "Anti-symmetry", ...
    verdict : Verdict
    value, floor : float or None
        What was found, and what noise alone would give (the least that was allowed, for Assumption I); None where there
        is no such number.
    unit : str
        Of both.
    sentence : str
        What was found and what it means.
    """

    name: str
    verdict: Verdict
    value: float | None
    floor: float | None
    unit: str
    sentence: str

    def as_dict(self) -> dict[str, Any]:
        """JSON values."""
        return {
            "name": self.name,
            "verdict": self.verdict.name,
            "value": self.value,
            "floor": self.floor,
            "unit": self.unit,
            "sentence": self.sentence,
        }


@dataclass(frozen=True, eq=False)
class Fit:
    """What an identification found.

    Attributes
    ----------
    actuator : AbstractModel or None
        None only when the outcome is `Outcome.FAILED`.
    outcome : Outcome
    errors : tuple of RecordErrors
        One a record, training first, then validation.
    repairs : tuple of str
        Sentences: what was left out, shifted or set aside before or during the fit.
    remarks : tuple of str
        Sentences: what else the user should know.
    traces : tuple of Trace
        Measured and simulated, record by record.
    status : str
        The solver's word.
    gap : float
        Duality gap, relative to the sum of the absolute weighted voltages.
    options : Mapping
        What was asked for and what it became.
    checks : tuple of Check
        What the model takes for granted, and whether the records bear it out.
    trials : tuple of dehyst.identification.structure_selection.Trial
        Structures that were tried, if one was looked for.
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

    def as_dict(self) -> dict[str, Any]:
        """JSON values without the traces."""
        return {
            "outcome": self.outcome.name,
            "sentence": self.outcome.value,
            "good": self.outcome.good,
            "errors": [error.as_dict() for error in self.errors],
            "checks": [check.as_dict() for check in self.checks],
            "repairs": list(self.repairs),
            "remarks": list(self.remarks),
            "solver": {"status": self.status, "duality_gap": self.gap if isfinite(self.gap) else None},
            "options": dict(self.options),
            "trials": [trial.as_dict() for trial in self.trials],
        }
