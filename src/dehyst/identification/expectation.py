"""The error to expect on a path, and the verdict with its reasons, from the results of an identification."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

from dehyst._views.fields import json_values
from dehyst._views.lines import percent
from dehyst.identification.results import Check, RecordErrors, RemainingError, Verdict
from dehyst.identification.rules import RULES
from dehyst.model import Outcome
from dehyst.records import NOISE_PEAK


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
        were held out. In either case with how far other structures disagree that explain the records as well.
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
    if_sensor_lags : (float, float), optional
        The same errors (rms, largest) [m] if the sensor, and not the actuator, lags: where the records leave that open.
    tested : bool
        Whether the errors are those of validation records.
    """

    rms: float
    largest: float
    measured: float
    noise: float
    stroke: float
    goal: float
    basis: str
    reasons: tuple[str, ...] = ()
    if_sensor_lags: tuple[float, float] | None = None
    tested: bool = False

    def __repr__(self) -> str:
        return f"<Expectation: {self.words}; goal {self.goal:g} %>"

    def __str__(self) -> str:
        return self.sentence

    @property
    def largest_percent(self) -> float:
        """Expected largest error [% of the stroke]."""
        return 100 * self.largest / self.stroke

    @property
    def readiness(self) -> Readiness:
        """The verdict."""
        if self.largest_percent > RULES.useless:
            return Readiness.NOT_USABLE
        return Readiness.USABLE if self.why_not_ready else Readiness.READY

    @property
    def why_not_ready(self) -> tuple[str, ...]:
        """All that keeps the model from being ready, its error too: each a phrase."""
        above = self.largest_percent > self.goal
        return ("the largest error is above the goal", *self.reasons) if above else self.reasons

    def _part(self, error: float) -> str:
        return percent(error, self.stroke)

    def _both(self, error: float) -> str:
        length = f"{error * 1e9:.3g} nm" if error < 1e-6 else f"{error * 1e6:.3g} um"
        return f"{self._part(error)} of the stroke ({length})"

    @property
    def words(self) -> str:
        """The verdict with its two numbers, in a few words."""
        errors = f"expect {self._part(self.rms)} RMS and {self._part(self.largest)} at most"
        return f"{self.readiness.value}; {errors} of {self.stroke * 1e6:.4g} um"

    @property
    def headline(self) -> str:
        """The verdict and the largest error to expect, which is the number to remember, with the RMS error."""
        return (
            f"{self.readiness.value.capitalize()}: expect an error of {self._both(self.largest)} at most on a path, "
            f"{self._both(self.rms)} RMS"
        )

    @property
    def _missed(self) -> str:
        return (
            f"The records are missed by {self._part(self.measured)} RMS, the sensor's noise is "
            f"{self._part(self.noise)}."
        )

    @property
    def origin(self) -> str:
        """What the expected errors come from, and what they are if not the actuator but the sensor lags."""
        text = f"Judged on {self.basis}; the goal is {self.goal:g} %. {self._missed}"
        if self.if_sensor_lags is None:
            return text
        rms, largest = map(self._part, self.if_sensor_lags)
        return f"{text} If the sensor lags, and not the actuator, expect {largest} at most and {rms} RMS."

    @property
    def reservations(self) -> tuple[str, ...]:
        """Why the model is not ready, besides its error, each a sentence."""
        return tuple(f"{one[0].upper()}{one[1:]}." for one in self.reasons)

    @property
    def sentence(self) -> str:
        """The verdict in one line, with its numbers and reasons."""
        text = (
            f"{self.readiness.value.capitalize()}: expect a path to be followed within {self._both(self.rms)} RMS and "
            f"{self._both(self.largest)} at most (from {self.basis}; goal {self.goal:g} %). {self._missed}"
        )
        if self.if_sensor_lags is not None:
            rms, largest = map(self._part, self.if_sensor_lags)
            text += f" That holds if the actuator lags; if the sensor does, expect {rms} RMS and {largest} at most."
        words = "; ".join(self.why_not_ready)
        return f"{text} {words[0].upper()}{words[1:]}." if words else text

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        numbers = "rms_m=rms largest_m=largest measured_m=measured noise_m=noise goal_percent=goal"
        return {
            **json_values(self, "readiness sentence"),
            "rms_percent": 100 * self.rms / self.stroke,
            **json_values(self, f"largest_percent {numbers} basis tested reasons if_sensor_lags_m=if_sensor_lags"),
        }


@dataclass(frozen=True)
class HeldOutErrors:
    """Errors on parts of the records that were not trained on; 0 where that was not tried.

    `in_time`: RMS error of parts of the training records that were held out in turn [m]. `by_size`: RMS error of cycles
    of sizes that were held out [m]. `disagreement`: RMS distance of other structures that explain the records as well,
    on a random path [m]. `noise`: standard deviation of the sensor in the samples that were compared [m].
    """

    in_time: float = 0.0
    by_size: float = 0.0
    disagreement: float = 0.0
    noise: float = 0.0


def expectation(
    outcome: Outcome,
    errors: Sequence[RecordErrors],
    checks: Sequence[Check],
    held_out: HeldOutErrors,
    remaining: Sequence[RemainingError],
    noise: float,
    goal: float,
    caveats: Sequence[str] = (),
    lagging: tuple[float, float] | None = None,
) -> Expectation:
    """Return what to expect.

    `errors`, `checks`: those of a `Fit`. `remaining`: one for each of the errors. `noise`: standard deviation of the
    sensor [m]. `goal`: [% of the stroke]. `caveats`: more reasons for care, in words. `lagging`: RMS and largest
    displacement [m] within a lag that may be the sensor's: a path is missed by as much if it is.
    """
    training, validation = ([one for one in errors if one.role == role] for role in ("training", "validation"))
    # A model that misses its own records by too much is of no use, however well it predicts others.
    by_others = bool(validation) and outcome is not Outcome.INACCURATE
    judged, basis = (validation, "validation records") if by_others else (training, "training records")
    causes = [cause for cause in remaining if cause.role == judged[0].role]
    vibration = max(cause.vibration_amplitude for cause in causes)
    # What the sensor adds, a path does not have.
    rms = max(_less(one.rms, cause.sensed) for one, cause in zip(judged, causes, strict=True))
    if not by_others:
        sensed = (held_out.noise**2 + 0.5 * vibration**2) ** 0.5
        in_time = _less(held_out.in_time, sensed), "parts of the records held out in turn"
        rms, basis = max((rms, basis), in_time)
        rms, basis = max((rms, basis), (_less(held_out.by_size, sensed), "loops of sizes held out"))
    # Validation records may hold the same kind of loops as those that were trained on; a path does not.
    rms = (rms**2 + held_out.disagreement**2 + (RULES.noise_known * noise) ** 2) ** 0.5
    largest = max(max(one.largest for one in judged) - NOISE_PEAK * noise - vibration, RULES.peak * rms)
    measured, fitted = max(one.rms for one in judged), max(one.rms for one in training)
    reasons = [*caveats]
    aside = sum(one.left_out for one in training) / sum(one.left_out + one.samples for one in training)
    if aside > RULES.most_set_aside:
        reasons.append(f"{100 * aside:.0f} % of the samples were set aside")
    drifted = max(abs(one.drifted_percent) for one in errors)
    if drifted > goal:
        reasons.append(f"a drift of {drifted:.2g} % was removed, which a path will show")
    if by_others and measured > RULES.widest_gap * fitted:
        reasons.append(f"validation records are missed {measured / fitted:.1f} times as far as training records")
    if outcome is Outcome.UNDETERMINED:
        reasons.append("the records do not determine all stiffnesses")
    failed = [check.name for check in checks if check.verdict is Verdict.FAILS]
    if failed:
        reasons.append(f"failed checks: {', '.join(failed)}")
    if_lags = None if lagging is None else ((rms**2 + lagging[0] ** 2) ** 0.5, largest + lagging[1])
    return Expectation(rms, largest, measured, noise, errors[0].stroke, goal, basis, tuple(reasons), if_lags, by_others)


def _less(error: float, noise: float) -> float:
    """Return what is left of an RMS error without an independent part of it."""
    return float(max(error**2 - noise**2, 0.0) ** 0.5)
