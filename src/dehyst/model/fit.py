"""The result of an identification: the actuator, errors, checks and outcome."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from enum import Enum
from math import isfinite
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from dehyst._text import counted, escaped
from dehyst._types import Array
from dehyst._views import tables
from dehyst._views.lines import length
from dehyst._views.pictures import plotted
from dehyst.model import fit_summary
from dehyst.model.base import State
from dehyst.model.readiness import Expectation, Readiness

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame

# Largest creep [% of the range a decade]; least part of a decade from which a rate is reported.
MOST_CREEP, FEWEST_DECADES = 20.0, 0.5


class Outcome(Enum):
    """How an identification ended; the value is the sentence to show."""

    IDENTIFIED = "Identified: the program was solved to optimality, and the records determine every stiffness."
    WIDER = (
        "Identified: the program was solved to optimality, with more parts than plain Maxwell-slip has. Run dehyst "
        "insight to assess the model."
    )
    UNDETERMINED = (
        "Identified, but the records leave combinations of the stiffnesses open: predictions of motions other than the "
        "recorded ones may be wrong. Add minor loops with other turning points."
    )
    FLOOR_ACTIVE = (
        "Identified, but the spring's slope lies on its floor in places: the records do not determine it there, or "
        "the structure does not fit."
    )
    ASSUMPTION_I_IMPOSED = (
        "Identified, but only with Assumption I imposed: without it the spring would fall somewhere, and one voltage "
        "would have several displacements."
    )
    STIFFNESS_CLIPPED = (
        "Identified, but the closed form gave negative stiffnesses, which were set to zero: the loop is not "
        "that of Maxwell-slip elements with a linear spring."
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
    """Measured minus simulated displacement of one `record`, where its state is known.

    `role` is training or validation. `samples` were compared. `left_out` samples were not compared.
    `largest_with_drift` [m] is as `rms_with_drift`. `offset` [m] is the constant that was set aside. `datum` [m] is
    that of the sensor.

    Attributes
    ----------
    largest, rms : float
        [m], with the reported drift of the record removed.
    rms_with_drift : float
        [m], with the drift included.
    stroke : float
        The range of the widest training loop [m], to which the percentages refer.
    drift : float
        Removed drift [m a decade of time since the record's start].
    decades : float
        Decades of that time that the used samples cover.
    steady : bool
        Whether the drift is in proportion to time; `drift` times `decades` is all of it.
    starts : tuple of State
        The states on the model's axis from which the record was simulated, one for each of its pieces: at the first
        sample that was compared.
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
    steady: bool = False
    starts: tuple[State, ...] = field(default=(), compare=False)

    def __repr__(self) -> str:
        errors = f"largest {self.largest_percent:.3g} %, RMS {self.rms_percent:.3g} %"
        return f"<RecordErrors '{escaped(self.record)}' ({self.role}): {errors}, {counted(self.samples, 'sample')}>"

    @property
    def drifted_percent(self) -> float:
        """Displacement by drift over the used samples, in % of the stroke."""
        return 100 * self.drift * self.decades / self.stroke

    @property
    def creeps(self) -> bool:
        """Whether the drift can be creep, so that its rate is reported."""
        return not self.steady and may_creep(100 * self.drift / self.stroke, self.decades)

    @property
    def largest_percent(self) -> float:
        """Largest error in % of the stroke."""
        return 100 * self.largest / self.stroke

    @property
    def rms_percent(self) -> float:
        """RMS error in % of the stroke."""
        return 100 * self.rms / self.stroke

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values, lengths in metres."""
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
            "drift_steady": self.steady,
            "starts": [state.as_dict() for state in self.starts],
        }


def may_creep(rate: float, decades: float) -> bool:
    """Return whether a drift can be creep, by its rate [% of the range a decade] and the decades covered.

    Piezoelectric actuators creep by a few percent a decade; a larger drift has another cause. A rate from a small part
    of a decade is an extrapolation.
    """
    return abs(rate) <= MOST_CREEP and decades >= FEWEST_DECADES


@dataclass(frozen=True, eq=False)
class Trace:
    """A `record` and its simulation: `time` [s], acting `voltage` [V], displacements [m] on the model's axis.

    `role` is training or validation. `measured` and `simulated` are (n,) [m]. `began` is the time of the record's first
    sample [s], compared or not.
    """

    record: str
    role: str
    time: Array
    voltage: Array
    measured: Array
    simulated: Array
    began: float = float("inf")

    def __repr__(self) -> str:
        largest = float(np.abs(self.residual).max(initial=0.0))
        size = counted(self.time.size, "sample")
        return f"<Trace '{escaped(self.record)}' ({self.role}): {size}, largest residual {length(largest)}>"

    @property
    def residual(self) -> Array:
        """Measured minus simulated displacement (n,) [m]."""
        return self.measured - self.simulated

    def to_dataframe(self) -> DataFrame:
        """Return the columns time_s, voltage_V, measured_um and simulated_um as a pandas DataFrame.

        Raise `MissingExtraError` if pandas is not installed.
        """
        lengths = {"measured_um": self.measured * 1e6, "simulated_um": self.simulated * 1e6}
        columns = {"time_s": self.time, "voltage_V": self.voltage, **lengths}
        return tables.frame(columns, record=self.record, role=self.role)


@dataclass(frozen=True)
class RemainingError:
    """Where the error of a record comes from: shares of the power of its residual.

    Attributes
    ----------
    record, role : str
    rms : float
        RMS of the residual less its mean [m].
    noise, slow, vibration, model : float
        Shares of white noise, of drift and the like, of a line that the voltage does not have, and of the model.
    frequency : float
        That of the line [Hz]; 0 without one.
    means : tuple of float
        Mean residual, its slow part aside [m]: where the voltage rises, in the lowest, middle and highest third of the
        displacements, then where it falls. Empty without an error.
    """

    record: str
    role: str
    rms: float
    noise: float
    slow: float
    vibration: float
    model: float
    frequency: float
    means: tuple[float, ...] = ()

    @property
    def vibration_amplitude(self) -> float:
        """Amplitude of the line [m]."""
        return self.rms * float(np.sqrt(2 * self.vibration))

    @property
    def sensed(self) -> float:
        """RMS of what is the sensor's: white noise and vibration [m]."""
        return self.rms * float(np.sqrt(self.noise + self.vibration))

    def sentence(self, stroke: float) -> str:
        """Return the record and its `causes`; lengths are parts of `stroke` [m]."""
        return f"{self.record}: of the remaining error's power, {self.causes(stroke)}"

    def causes(self, stroke: float) -> str:
        """Return the shares in words, lengths as parts of `stroke` [m], with what would reduce the largest one."""
        parts = [(self.noise, "white noise"), (self.slow, "drift or another slow cause"), (self.model, "the model")]
        if self.vibration:
            size = f"{100 * self.vibration_amplitude / stroke:.2g} % of the stroke, which the voltage does not cause"
            parts.append((self.vibration, f"a vibration of {self.frequency:.3g} Hz, {size}"))
        parts.sort(reverse=True)
        shares = ", ".join(f"{100 * share:.0f} % {cause}" for share, cause in parts)
        remedy = _REMEDIES[parts[0][1].split()[0]]
        if self.noise == parts[0][0] and self.model > _WORTH:
            remedy = "A quieter sensor or averaged cycles would reduce it; a better model, its own part."
        return f"{shares}.{self._where(stroke)} {remedy}"

    def _where(self, stroke: float) -> str:
        """Return where the model's part is largest, if it is a part worth naming."""
        if self.model < _NAMED or not self.means:
            return ""
        worst = max(range(len(self.means)), key=lambda k: abs(self.means[k]))
        way, third = ("rising", "falling")[worst // 3], ("lowest", "middle", "highest")[worst % 3]
        mean = f"{100 * self.means[worst] / stroke:+.2g} % of the stroke"
        return f" The model's part is largest where {way} in the {third} third: {mean} on average."

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return asdict(self)


# The model's part is located if it is the first share, and worth a better model if it is the second.
_NAMED, _WORTH = 0.1, 0.25
# By the first word of the largest part.
_REMEDIES = {
    "white": "A quieter sensor or averaged cycles would reduce it; a better model would not.",
    "drift": "Let the actuator warm up, record at a constant temperature, or zero the sensor in time.",
    "the": "More elements, grades or loops that turn elsewhere may reduce it.",
    "a": "Isolate the stage, or close the loop: no model of the voltage can follow it.",
}


class Verdict(Enum):
    """Whether an assumption of a model holds; the value is the word to show."""

    HOLDS = "holds"
    FAILS = "does not hold"
    UNKNOWN = "not known"


@dataclass(frozen=True)
class Check:
    """An assumption of a model, tested on the records.

    Attributes
    ----------
    name : str
        The assumption: "Assumption I", "Anti-symmetry", ...
    verdict : Verdict
    value, floor : float or None
        The measured value, and the value that noise alone would give (for Assumption I the least allowed); None where
        there is no such number.
    unit : str
        Unit of both.
    sentence : str
        The finding and its meaning.
    """

    name: str
    verdict: Verdict
    value: float | None
    floor: float | None
    unit: str
    sentence: str

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {**asdict(self), "verdict": self.verdict.name}


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
        Sentences: what was left out, shifted or removed before or during the fit.
    remarks : tuple of str
        Sentences: limits of the result.
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
        How well a path will be followed, and the verdict; None when the outcome is `Outcome.FAILED`.
    remaining : tuple of RemainingError
        Where the error of each record comes from.
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

    def __repr__(self) -> str:
        records = ", ".join(f"'{escaped(error.record)}'" for error in self.errors[:3])
        more = f" and {len(self.errors) - 3} more" if len(self.errors) > 3 else ""
        verdict = "" if self.expectation is None else f"{self.expectation.words}; "
        return f"<Fit of {records or 'no record'}{more}: {verdict}{self.outcome.name}>"

    def __str__(self) -> str:
        return escaped(fit_summary.one_line(self))

    def _repr_html_(self) -> str:
        return fit_summary.as_html(self)

    def summary(self) -> str:
        """Return what `dehyst identify` prints: verdict, errors, structures, parts, repairs and remarks, in lines."""
        return "\n".join(escaped(line) for line in fit_summary.lines(self))

    def to_dataframe(self) -> DataFrame:
        """Return the errors as a pandas DataFrame, a row a record: in % of the stroke and in nm.

        Raise `MissingExtraError` if pandas is not installed.
        """
        names = "record", "role", "samples", "left_out", "largest_percent", "rms_percent"
        columns = {name: [getattr(error, name) for error in self.errors] for name in names}
        lengths = {f"{name}_nm": [getattr(error, name) * 1e9 for error in self.errors] for name in ("largest", "rms")}
        drift = [error.drifted_percent for error in self.errors]
        return tables.frame({**columns, **lengths, "drifted_percent": drift})

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
            "loops": displacement over voltage. "hysteresis": the same less the straight line through the measured
            loops, which shows hysteresis and misfit enlarged. "residuals": measured minus simulated over displacement,
            rising and falling branches apart. "residuals in time".
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
        """Whether the model may be used: neither its outcome nor what is expected of it forbids that."""
        usable = self.expectation is None or self.expectation.readiness is not Readiness.NOT_USABLE
        return self.outcome.good and usable

    @property
    def starts(self) -> dict[str, tuple[State, ...]]:
        """The states from which each record was simulated, by its name; one for each of its pieces."""
        return {error.record: error.starts for error in self.errors}

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values without the traces."""
        return {
            "outcome": self.outcome.name,
            "sentence": self.outcome.value,
            "good": self.good,
            "verdict": None if self.expectation is None else self.expectation.as_dict(),
            "remaining": [one.as_dict() for one in self.remaining],
            "errors": [error.as_dict() for error in self.errors],
            "checks": [check.as_dict() for check in self.checks],
            "repairs": list(self.repairs),
            "remarks": list(self.remarks),
            "solver": {"status": self.status, "duality_gap": self.gap if isfinite(self.gap) else None},
            "options": dict(self.options),
            "trials": [trial.as_dict() for trial in self.trials],
        }
