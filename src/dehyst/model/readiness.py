"""How well a path will be followed, and whether that is good enough, by stated rules."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any

# Expected largest error beyond which a model is of no use [% of the stroke].
USELESS = 5.0
# More samples set aside than this part, or held-out errors this many times those of training, need a look.
MOST_SET_ASIDE, WIDEST_GAP = 0.1, 2.0


class Readiness(Enum):
    """Whether a model is good enough; the value is the words to show."""

    READY = "ready"
    USABLE = "usable, with care"
    NOT_USABLE = "not usable"


@dataclass(frozen=True)
class Expectation:
    """The error to expect on a path like the records, and the verdict.

    A model is ready if the expected largest error is within the goal, and nothing else speaks against it. It is not
    usable if that error exceeds 5 % of the stroke. Otherwise it is usable.

    Attributes
    ----------
    rms, largest : float
        Expected errors of a path [m], without what is the sensor's: from the validation records; without any the
        larger of those of the training records, of parts of them that were held out in time and of loops of sizes that
        were held out, and how far other structures disagree that explain the records as well.
    measured : float
        RMS error of the records from which that comes, as measured [m].
    noise : float
        Standard deviation of the sensor [m].
    stroke : float
        To which percentages refer [m].
    goal : float
        Allowed largest error [% of the stroke].
    basis : str
        "validation records", "training records" or parts of these, in words.
    reasons : tuple of str
        Why the model is not ready, besides its error: each a phrase.
    """

    rms: float
    largest: float
    measured: float
    noise: float
    stroke: float
    goal: float
    basis: str
    reasons: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"<Expectation: {self.words}; goal {self.goal:g} %>"

    def __str__(self) -> str:
        return self.sentence

    @property
    def words(self) -> str:
        """The verdict with its two numbers, in a few words."""
        rms, largest = (_percent(error, self.stroke) for error in (self.rms, self.largest))
        return f"{self.readiness.value}; expect {rms} RMS and {largest} at most of {self.stroke * 1e6:.4g} um"

    @property
    def largest_percent(self) -> float:
        """Expected largest error [% of the stroke]."""
        return 100 * self.largest / self.stroke

    @property
    def readiness(self) -> Readiness:
        """The verdict."""
        if self.largest_percent > USELESS:
            return Readiness.NOT_USABLE
        return Readiness.READY if self.largest_percent <= self.goal and not self.reasons else Readiness.USABLE

    @property
    def why_not_ready(self) -> tuple[str, ...]:
        """All that keeps the model from being ready, its error too: each a phrase."""
        above = self.largest_percent > self.goal
        return ("the largest error is above the goal", *self.reasons) if above else self.reasons

    @property
    def sentence(self) -> str:
        """The verdict in one line, with its numbers and reasons."""
        text = (
            f"{self.readiness.value.capitalize()}: expect a path to be followed within {_both(self.rms, self.stroke)} "
            f"RMS and {_both(self.largest, self.stroke)} at most (from {self.basis}; goal {self.goal:g} %). "
            f"The records are missed by {_percent(self.measured, self.stroke)} RMS, the sensor's noise is "
            f"{_percent(self.noise, self.stroke)}."
        )
        reasons = self.why_not_ready
        words = "; ".join(reasons)
        return f"{text} {words[0].upper()}{words[1:]}." if reasons else text

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {
            "readiness": self.readiness.name,
            "sentence": self.sentence,
            "rms_percent": 100 * self.rms / self.stroke,
            "largest_percent": 100 * self.largest / self.stroke,
            "rms_m": self.rms,
            "largest_m": self.largest,
            "measured_m": self.measured,
            "noise_m": self.noise,
            "goal_percent": self.goal,
            "basis": self.basis,
            "reasons": list(self.reasons),
        }


def _percent(error: float, stroke: float) -> str:
    percent = 100 * error / stroke
    return f"{percent:.2g} %" if percent < 100 else f"{percent:.0f} %"


def _both(error: float, stroke: float) -> str:
    length = f"{error * 1e9:.3g} nm" if error < 1e-6 else f"{error * 1e6:.3g} um"
    return f"{_percent(error, stroke)} of the stroke ({length})"
