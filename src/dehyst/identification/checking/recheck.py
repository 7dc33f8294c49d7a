"""The result of a check: whether a model is still true of its actuator."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np

from dehyst._views import lines
from dehyst.identification.checking.changes import Change
from dehyst.model import Trace
from dehyst.records.metrics import NOISE_PEAK, percent

# An error this many times that of the identification is another one.
_WORSE = 1.5
# Parts of the gain and of the stroke beyond which a record is not of the model's actuator, or in other units.
_ANOTHER = 0.5


class Standing(Enum):
    """Whether a model is still true; the value is the words to show."""

    STILL_TRUE = "still true"
    RECALIBRATE = "recalibrate"
    NEVER_MET = "no worse than at its identification, but above the goal"
    DRIFTS = "still true, but the record drifts"


@dataclass(frozen=True, eq=False)
class Recheck:
    """A model beside a new record.

    Attributes
    ----------
    record : str
        Name of the record.
    model : str
        Name of the model.
    record_id, model_id : str
        Hashes of their numbers, whatever their names.
    samples, left_out : int
        Samples of the record that were compared, and others.
    largest, rms : float
        Measured less simulated displacement [m]; an offset and, of a model without creep, a drift are set aside.
    noise : float
        Standard deviation of the sensor [m].
    before : float or None
        Largest error on the records that the model was identified from [m]; None if the model file lacks it.
    stroke : float
        To which percentages refer: the displacement between the model's limits [m].
    goal : float
        Allowed largest error [% of the stroke].
    drift : float
        What was set aside as a drift, over the record [m].
    changes : tuple of Change
        What may have changed, each with its standard error.
    remarks : tuple of str
        Sentences: what limits the result, and what was repaired.
    trace : Trace
        Measured and simulated displacement.
    """

    record: str
    model: str
    record_id: str
    model_id: str
    samples: int
    left_out: int
    largest: float
    rms: float
    noise: float
    before: float | None
    stroke: float
    goal: float
    drift: float
    changes: tuple[Change, ...]
    remarks: tuple[str, ...]
    trace: Trace

    @property
    def without_noise(self) -> float:
        """Largest error less the peaks of the sensor's noise [m]: what is compared with the goal."""
        return max(self.largest - NOISE_PEAK * self.noise, 0.0)

    @property
    def ratio(self) -> float | None:
        """Largest error, of that at the identification; None if that is not known."""
        return self.largest / self.before if self.before else None

    @property
    def changed(self) -> tuple[Change, ...]:
        """The changes that count, the largest effect first."""
        counted = [change for change in self.changes if change.counts]
        return tuple(sorted(counted, key=lambda change: -abs(change.effect)))

    @property
    def standing(self) -> Standing:
        """The judgement."""
        allowed = self.goal / 100 * self.stroke
        if self.mismatch:
            return Standing.RECALIBRATE
        if self.without_noise > allowed:
            same = self.ratio is not None and self.ratio <= _WORSE
            return Standing.NEVER_MET if same else Standing.RECALIBRATE
        return Standing.DRIFTS if abs(self.drift) > allowed else Standing.STILL_TRUE

    @property
    def good(self) -> bool:
        """Whether the model itself may be used as before."""
        return self.standing in (Standing.STILL_TRUE, Standing.DRIFTS)

    @property
    def mismatch(self) -> str:
        """Why the record is plainly not of the model's actuator, in a sentence; empty if it may be."""
        gain = next((one.value for one in self.changed if one.name == "gain"), 0.0)
        reasons = []
        if abs(gain) > _ANOTHER:
            reasons.append(f"the gain differs by {100 * gain:+.3g} %")
        if self.without_noise > _ANOTHER * self.stroke:
            reasons.append(f"the largest error is {self._percent(self.without_noise)} of the stroke")
        found = " and ".join(reasons)
        if not found:
            return ""
        return (
            f"{self.record}: is plainly not a record of the model's actuator, or in other units: {found}, "
            f"more than {100 * _ANOTHER:g} %; check that model and record belong together, and the scales"
        )

    @property
    def sentence(self) -> str:
        """The judgement in one line, with its numbers."""
        text = (
            f"{self.standing.value.capitalize()}: the largest error is {self._percent(self.without_noise)} of the "
            f"stroke without the sensor's noise (goal {self.goal:g} %)"
        )
        if self.ratio is not None and self.before is not None:
            text += f"; with it {self._percent(self.largest)}, then {self._percent(self.before)}"
        return f"{text}. {self._advice()}"

    def _advice(self) -> str:
        if self.mismatch:
            return "Check that model and record belong together."
        if self.standing is Standing.RECALIBRATE:
            return "Identify the model again from new records."
        if self.standing is Standing.NEVER_MET:
            return "The same records again would give the same error: record more loops, or allow a wider structure."
        if self.standing is Standing.DRIFTS:
            moved = self._percent(abs(self.drift))
            return (
                f"No new model is needed; the drift is {moved} of the stroke, which a path will show: let the actuator "
                "warm up and rest."
            )
        return "No new model is needed."

    def _percent(self, length: float) -> str:
        return lines.percent(length, self.stroke)

    def change_sentences(self) -> tuple[str, ...]:
        """Return a sentence for each change that counts, the largest first."""
        return tuple(change.sentence(self.stroke) for change in self.changed)

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values without the trace."""
        ratio = self.ratio
        return {
            "standing": self.standing.name,
            "sentence": self.sentence,
            "good": self.good,
            "model": self.model,
            "record": self.record,
            "model_id": self.model_id,
            "record_id": self.record_id,
            "samples": self.samples,
            "left_out": self.left_out,
            "largest_percent": percent(self.largest, self.stroke),
            "rms_percent": percent(self.rms, self.stroke),
            "without_noise_percent": percent(self.without_noise, self.stroke),
            "before_percent": None if self.before is None else percent(self.before, self.stroke),
            "ratio": None if ratio is None or not np.isfinite(ratio) else ratio,
            "goal_percent": self.goal,
            "drift_percent": percent(self.drift, self.stroke),
            "largest_m": self.largest,
            "rms_m": self.rms,
            "noise_m": self.noise,
            "stroke_m": self.stroke,
            "changes": [change.as_dict(self.stroke) for change in self.changes],
            "changed": [change.name for change in self.changed],
            "remarks": list(self.remarks),
        }
