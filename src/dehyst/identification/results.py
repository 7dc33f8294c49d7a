"""The results of an identification: errors and traces of records, checks."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from enum import Enum
from typing import Any

import numpy as np

from dehyst._text import counted, escaped
from dehyst._types import Array, Mask
from dehyst._views.fields import json_values
from dehyst._views.lines import length
from dehyst.identification.rules import RULES
from dehyst.model import State
from dehyst.records import largest, turning_points

# Least part of a decade that determines a rate of creep.
FEWEST_DECADES = 0.5


@dataclass(frozen=True)
class RecordErrors:
    """Measured minus simulated displacement of one `record`, where its state is known.

    `role` is training or validation. `samples`, `left_out`: numbers of samples that were and were not compared.
    `largest_with_drift` [m] is the largest error with the drift included. `offset` [V] is the constant that was
    removed. `zero` [m] is the zero of the sensor.

    Attributes
    ----------
    largest, rms : float
        Errors [m] after the reported drift of the record was removed.
    rms_with_drift : float
        RMS error [m] with the drift included.
    stroke : float
        The range of the widest training loop [m], to which the percentages refer.
    drift : float
        Removed drift [m per decade of the time since the record's start].
    decades : float
        Number of decades of this time that the used samples cover.
    steady : bool
        Whether the drift is linear in time; its total is `drift` times `decades`.
    settled_largest, settled_rms : float
        Errors after the second turning point of the voltage [m]: the largest one without outliers, one sample in a
        thousand; the RMS error over time or over the travel of the voltage, whichever is larger.
    starts : tuple of State
        State at the first compared sample of each piece of the record, on the model's axis; the simulations start from
        them.
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
    zero: float
    drift: float
    settled_largest: float
    settled_rms: float
    decades: float = 1.0
    steady: bool = False
    starts: tuple[State, ...] = field(default=(), compare=False)

    def __repr__(self) -> str:
        errors = f"largest {self.largest_percent:.3g} %, RMS {self.rms_percent:.3g} %"
        return f"<RecordErrors '{escaped(self.record)}' ({self.role}): {errors}, {counted(self.samples, 'sample')}>"

    @property
    def drifted_percent(self) -> float:
        """Drift over the used samples, in % of the stroke."""
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
            **json_values(self, "record role samples left_out largest_percent rms_percent largest_m=largest rms_m=rms"),
            "largest_with_drift_percent": 100 * self.largest_with_drift / self.stroke,
            "rms_with_drift_percent": 100 * self.rms_with_drift / self.stroke,
            **json_values(self, "offset_V=offset zero_m=zero"),
            "drift_percent": 100 * self.drift / self.stroke,
            **json_values(self, "drift_decades=decades drift_steady=steady starts"),
            **json_values(self, "settled_largest_m=settled_largest settled_rms_m=settled_rms"),
        }


def may_creep(rate: float, decades: float) -> bool:
    """Return whether a drift can be creep, by its rate [% of the stroke per decade] and the decades covered.

    Piezoelectric actuators creep by a few percent per decade; a larger drift has another cause. A rate from a small
    part of a decade is an extrapolation.
    """
    return abs(rate) <= RULES.most_creep and decades >= FEWEST_DECADES


@dataclass(frozen=True, eq=False)
class Trace:
    """A `record` and its simulation: `time` [s], acting `voltage` [V], displacements [m] on the model's axis.

    `role` is training or validation. `measured` and `simulated` are (n,) [m]. `began` is the time of the first sample
    of the record [s], whether it was compared or not. `counts` (n,): samples that count in an error; None: all. Between
    them the residual is interpolated over time.
    """

    record: str
    role: str
    time: Array
    voltage: Array
    measured: Array
    simulated: Array
    began: float = float("inf")
    counts: Mask | None = None

    def __repr__(self) -> str:
        size, most = counted(self.counted.time.size, "sample"), length(largest(self.counted.residual))
        return f"<Trace '{escaped(self.record)}' ({self.role}): {size}, largest residual {most}>"

    @property
    def residual(self) -> Array:
        """Measured minus simulated displacement (n,) [m]."""
        return self.measured - self.simulated

    @property
    def settled(self) -> Trace:
        """The trace after the second turning point of its voltage, if it has enough turns; else the whole trace."""
        turns = turning_points(self.voltage, 0.02 * float(np.ptp(self.voltage)))
        later = turns[turns > 0]
        return self._at(slice(int(later[1]) if len(later) > 2 else 0, None))

    @property
    def counted(self) -> Trace:
        """The trace at the samples that count: only these may enter an error."""
        return self if self.counts is None else self._at(self.counts)

    def _at(self, rows: slice[Any, Any, None] | Mask) -> Trace:
        columns = {name: getattr(self, name) for name in ("time", "voltage", "measured", "simulated", "counts")}
        return replace(self, **{name: values[rows] for name, values in columns.items() if values is not None})


class Verdict(Enum):
    """Whether a property holds; the value is the word to show."""

    HOLDS = "holds"
    FAILS = "does not hold"
    UNKNOWN = "not known"


@dataclass(frozen=True)
class Check:
    """A property that a model or its residuals must have.

    Attributes
    ----------
    name : str
        "Width", "Middle line" or "No drift".
    verdict : Verdict
    value, floor : float or None
        The measured value, and the largest value due to noise alone; None if there is no such number.
    unit : str
        Unit of `value` and `floor`.
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
