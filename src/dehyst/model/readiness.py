"""How well a path will be followed, and whether that is good enough, by stated rules."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any

# Expected largest error beyond which a model is of no use [% of the stroke].
USELESS = 5.0
# More samples set aside than this part, or held-out errors this many times those of training, need a look.
MOST_SET_ASIDE, WIDEST_GAP = 0.1, 2.0
# Peaks of white noise, in standard deviations: they are the sensor's, not the model's.
_PEAK = 4.0


class Readiness(Enum):
    """Whether a model is good enough; the value is the words to show."""

    READY = "ready"
    USABLE = "usable, with care"
    NOT_USABLE = "not usable"


@dataclass(frozen=True)
class Expectation:
    """The error to expect on a path like the records, and the verdict.

    A model is ready if the expected largest error, less four standard deviations of the sensor's noise, is within the
    goal, and nothing else speaks against it. It is not usable if that error exceeds 5 % of the stroke. Otherwise it is
    usable.

    Attributes
    ----------
    rms, largest : float
        Expected errors [m]: those of the validation records, simulated whole; without any the larger of those of the
        training records, simulated whole, and of parts of the records that were held out in turn.
    noise : float
        Standard deviation of the sensor [m].
    stroke : float
        To which percentages refer [m].
    goal : float
        Allowed largest error [% of the stroke].
    basis : str
        "validation records", "held-out parts" or "training records".
    reasons : tuple of str
        Why the model is not ready, besides its error: each a phrase.
    """

    rms: float
    largest: float
    noise: float
    stroke: float
    goal: float
    basis: str
    reasons: tuple[str, ...] = ()

    @property
    def model_percent(self) -> float:
        """Expected largest error without the sensor's peaks [% of the stroke]."""
        return 100 * max(self.largest - _PEAK * self.noise, 0.0) / self.stroke

    @property
    def readiness(self) -> Readiness:
        """The verdict."""
        if 100 * self.largest / self.stroke > USELESS:
            return Readiness.NOT_USABLE
        return Readiness.READY if self.model_percent <= self.goal and not self.reasons else Readiness.USABLE

    @property
    def sentence(self) -> str:
        """The verdict in one line, with its numbers and reasons."""
        share = f"of which the sensor's noise is {100 * self.noise / self.stroke:.2g} %"
        text = (
            f"{self.readiness.value.capitalize()}: expect a path to be followed within {_both(self.rms, self.stroke)} "
            f"RMS, {share}, and {_both(self.largest, self.stroke)} at most (from {self.basis}; goal {self.goal:g} %)."
        )
        reasons = list(self.reasons)
        if self.readiness is not Readiness.READY and self.model_percent > self.goal:
            reasons.insert(0, "the largest error is above the goal")
        return f"{text} {'; '.join(reasons).capitalize()}." if reasons else text

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {
            "readiness": self.readiness.name,
            "sentence": self.sentence,
            "rms_percent": 100 * self.rms / self.stroke,
            "largest_percent": 100 * self.largest / self.stroke,
            "rms_m": self.rms,
            "largest_m": self.largest,
            "noise_m": self.noise,
            "goal_percent": self.goal,
            "basis": self.basis,
            "reasons": list(self.reasons),
        }


def _both(error: float, stroke: float) -> str:
    return f"{100 * error / stroke:.2g} % of the stroke ({error * 1e9:.3g} nm)"
