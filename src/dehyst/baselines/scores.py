"""Scores of models on the same records: figures for each record, each model and the whole comparison."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from dehyst.baselines.tracking_trials import TrackingErrors

OURS = "dehyst"
# Keys of errors in JSON.
_KEYS = {
    "largest": "largest_percent",
    "rms": "rms_percent",
    "largest_without": "largest_without_constant_percent",
    "rms_without": "rms_without_constant_percent",
    "beyond": "beyond_voltage_percent",
}


@dataclass(frozen=True)
class RecordScore:
    """Measured minus simulated displacement of one record, in % of the training stroke.

    `role`: "training" or "validation". `samples`, `left_out`: samples that count, and samples that do not: before the
    voltage has been through its range, or in the lead-in. `largest`, `rms`: with one free constant for the record: its
    residual strain and its sensor's zero are not known. `largest_without`, `rms_without`: without it, on the model's
    own axis; after a lead-in, on the axis found from the lead-in.
    """

    record: str
    role: str
    samples: int
    left_out: int
    largest: float
    rms: float
    largest_without: float
    rms_without: float


@dataclass(frozen=True)
class ModelScore:
    """One model.

    Attributes
    ----------
    name : str
    failure : str
        Why there is no model or no figure, as a sentence; empty if there is none to report.
    parameters : int or None
        Number of coefficients.
    seconds : float or None
        Time that the fit took.
    scores : tuple of RecordScore
        One for each record, training first.
    tracking : Mapping
        Errors by virtual actuator; the model was fitted to that actuator's own records.
    simulate, compensate : float or None
        Nanoseconds a sample.
    """

    name: str
    failure: str = ""
    parameters: int | None = None
    seconds: float | None = None
    scores: tuple[RecordScore, ...] = ()
    tracking: Mapping[str, TrackingErrors] = field(default_factory=dict)
    simulate: float | None = None
    compensate: float | None = None

    def worst(self, role: str) -> RecordScore | None:
        """Return the score with the largest error among the records of that role."""
        return max((score for score in self.scores if score.role == role), key=lambda s: s.largest, default=None)

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {
            "model": self.name,
            "said": self.failure or None,
            "parameters": self.parameters,
            "fit_s": self.seconds,
            "errors": [
                {_KEYS.get(name, name): value for name, value in asdict(score).items()} for score in self.scores
            ],
            "tracking": {
                truth: {_KEYS[name]: value for name, value in errors._asdict().items()}
                for truth, errors in self.tracking.items()
            },
            "simulate_ns": self.simulate,
            "compensate_ns": self.compensate,
        }


@dataclass(frozen=True)
class ModelComparison:
    """A table with one row for each model.

    Attributes
    ----------
    rows : tuple of ModelScore
    stroke : float
        Stroke [m] to which the percentages refer.
    records, held_out, truths : tuple of str
        Names of the training records, of the held-out records and of the virtual actuators.
    lead : float
        Lead-in of the held-out records [s].
    """

    rows: tuple[ModelScore, ...]
    stroke: float
    records: tuple[str, ...]
    held_out: tuple[str, ...]
    truths: tuple[str, ...]
    lead: float = 0.0

    @property
    def note(self) -> str:
        """What models used of held-out records beside the voltage, as a sentence; empty if nothing."""
        if not (self.lead and self.held_out):
            return ""
        return (
            f"The first {self.lead:g} s of held-out records do not count. From the displacement measured there, "
            "the models of dehyst take their state and an offset of the voltage, every other model takes a constant: "
            "its mean error there."
        )

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {
            "stroke_m": self.stroke,
            "training": list(self.records),
            "validation": list(self.held_out),
            "truths": list(self.truths),
            "lead_s": self.lead,
            "note": self.note or None,
            "models": [row.as_dict() for row in self.rows],
        }
