"""The error to expect on a path, and the verdict with its reasons, from the results of an identification."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np

from dehyst._types import Array
from dehyst._views.fields import json_values
from dehyst._views.lines import length, percent
from dehyst.identification.checks import REMEDIES, RemainingError
from dehyst.identification.results import Check, RecordErrors, Trace, Verdict
from dehyst.identification.rules import RULES
from dehyst.model import Outcome, Promise, Validity, branches_of, distances, paces_of, temperature_range
from dehyst.records import NOISE_PEAK, Record, rms

# Relative error of the subtracted noise.
_NOISE_KNOWN = 0.1
# Held-out branches may go beyond the voltages of the others by this part of the range.
_BEYOND = 0.02
# Branches below this part of the fastest pace are slow; least numbers of slow and fast branches for a growth of error.
_SLOW, _FEW = 1 / 3, 6


class Readiness(Enum):
    """Whether a model is good enough; the value is the words to show."""

    READY = "ready"
    USABLE = "usable, with care"
    NOT_USABLE = "not usable"


@dataclass(frozen=True)
class Expectation:
    """The error to expect on any path within the recorded voltages, and the verdict.

    A model is ready if the expected largest error is within the goal, and `reasons` is empty. It is not usable if that
    error exceeds 5 % of the stroke. Otherwise it is usable.

    Attributes
    ----------
    promise : Promise
        Promised error of any path like the records.
    measured : float
        RMS error of the records that determine the promise [m].
    noise : float
        Standard deviation of the sensor [m].
    goal : float
        Allowed largest error [% of the stroke].
    basis : str
        "validation records" or parts of the training records, in words.
    reasons : tuple of str
        Reasons why the model is not ready, other than its error.
    """

    promise: Promise
    measured: float
    noise: float
    goal: float
    basis: str
    reasons: tuple[str, ...] = ()

    @property
    def rms(self) -> float:
        """Promised RMS error [m]."""
        return self.promise.rms

    @property
    def largest(self) -> float:
        """Promised largest error [m]."""
        return self.promise.largest

    @property
    def stroke(self) -> float:
        """Reference of percentages [m]."""
        return self.promise.stroke

    def __repr__(self) -> str:
        return f"<Expectation: {self.readiness.value}; {self.promise!r}; goal {self.goal:g} %>"

    @property
    def largest_percent(self) -> float:
        """Expected largest error [% of the stroke]."""
        return 100 * self.largest / self.stroke

    @property
    def readiness(self) -> Readiness:
        """The verdict."""
        if self.promise.unusable:
            return Readiness.NOT_USABLE
        return Readiness.USABLE if self.why_not_ready else Readiness.READY

    @property
    def why_not_ready(self) -> tuple[str, ...]:
        """All reasons why the model is not ready, including its error."""
        return ("the largest error is above the goal",) * (self.largest_percent > self.goal) + self.reasons

    @property
    def headline(self) -> str:
        """The verdict, with the largest and the RMS error to expect."""
        largest, rms = (
            f"{percent(error, self.stroke, goal=self.goal)} of the stroke ({length(error)})"
            for error in (self.largest, self.rms)
        )
        verdict, missed = self.readiness.value.capitalize(), self.largest_percent > self.goal
        beside = f" (goal {self.goal:g} %)" if missed else ""
        return f"{verdict}: expect an error of {largest} at most on a path{beside}, {rms} RMS, {self.promise.apart}"

    @property
    def origin(self) -> str:
        """Origin of the expected errors."""
        missed, noise = (percent(error, self.stroke) for error in (self.measured, self.noise))
        found = f"The records are missed by {missed} RMS, the sensor's noise is {noise}."
        return f"Judged on {self.basis}; the goal is {self.goal:g} %. {found}"

    @property
    def reservations(self) -> tuple[str, ...]:
        """Sentences with the reasons why the model is not ready, other than its error."""
        return tuple(f"{reason[0].upper()}{reason[1:]}." for reason in self.reasons)

    @property
    def sentence(self) -> str:
        """The verdict in one line, with its numbers and reasons."""
        return " ".join((f"{self.headline}.", self.origin, *self.reservations))

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        numbers = "rms_m=rms largest_m=largest measured_m=measured noise_m=noise goal_percent=goal"
        return {
            **json_values(self, "readiness sentence"),
            "rms_percent": 100 * self.rms / self.stroke,
            **json_values(self, f"largest_percent {numbers} basis reasons promise"),
        }


@dataclass(frozen=True)
class HeldOutErrors:
    """Errors on held-out parts of the records; 0 if not computed.

    `in_time`: RMS error of parts of the training records that were held out in turn [m]. `disagreement`: RMS distance
    on a random path from models with other structures that explain the records as well [m]. `noise`: standard deviation
    of the sensor in the compared samples [m]. `new`: see `Validity`.
    """

    in_time: float = 0.0
    disagreement: float = 0.0
    noise: float = 0.0
    new: tuple[float, float] = (0.0, 0.0)


def validity_of(
    records: Sequence[Record],
    errors: Sequence[RecordErrors],
    remaining: Sequence[RemainingError],
    traces: Sequence[Trace],
    held_out: HeldOutErrors,
    noise: float,
    *,
    validated: bool = True,
    **lags: Any,
) -> Validity:
    """Return the domain of validity of a model from its records.

    `records`, `errors`, `remaining`, `traces`: training records first. `noise`: standard deviation of the sensor [m].
    `validated`: whether validation records, if given, replace held-out parts. `lags`: entries of `Validity`.
    """
    training, validation = ([q for q, each in enumerate(errors) if each.role == r] for r in ("training", "validation"))
    new, judged = held_out.new, training
    voltages = [(records[q].time, records[q].voltage) for q in training]
    span = float(np.ptp(np.concatenate([voltage for _, voltage in voltages])))
    if validation and validated:
        judged = validation
        pairs = [record.voltage[branches_of(record.voltage, span)] for record in records]
        other = new_branches(*(np.concatenate([pairs[q] for q in part]) for part in (validation, training)))
        new = max(new[0], other[0]), max(new[1], other[1])
    vibration = max(remaining[q].vibration_amplitude for q in judged)
    # The error of a path has no sensor noise: the known part of the noise is subtracted.
    missed = max(_less(errors[q].settled_rms, remaining[q].sensed) for q in judged)
    if judged is training:
        missed = max(missed, _less(held_out.in_time, float(np.hypot(held_out.noise, vibration / 2**0.5))))
    # The growth with the pace is left out here: the promise adds it by the pace of the path.
    grown, share = growth([traces[q] for q in judged], span)
    missed *= (1 - share) ** 0.5
    largest = max(errors[q].settled_largest for q in judged) - NOISE_PEAK * noise - vibration
    return Validity.by_records(
        voltages,
        rms=float(np.hypot(missed, _NOISE_KNOWN * noise)),
        largest=max(largest, 0.0),
        disagreement=held_out.disagreement,
        drift=max(abs(errors[q].drift * errors[q].decades) for q in judged),
        growth=grown,
        stroke=errors[0].stroke,
        new=new,
        temperatures=temperature_range(records[q] for q in training),
        **lags,
    )


def growth(traces: Sequence[Trace], span: float) -> tuple[float, float]:
    """Return the growth of the RMS error [m] from slow to the fastest branches, and its share of the mean square.

    `span`: range of the voltages [V].
    """
    found = []
    for trace in (trace.counted.settled for trace in traces):
        at, error = branches_of(trace.voltage, span), np.square(trace.residual - trace.residual.mean())
        squares = [error[first : last + 1].mean() for first, last in at.tolist()]
        found.append(np.column_stack([paces_of(trace.time, trace.voltage, at), squares, np.diff(at, axis=1)]))
    every = np.concatenate(found)
    pace = (every[:, :2] / every[:, :2].max(axis=0, initial=1e-300)).max(axis=1, initial=0.0)
    slow, (square, samples) = pace < _SLOW, every[:, 2:].T
    if min(np.count_nonzero(slow), np.count_nonzero(~slow)) < _FEW:
        return 0.0, 0.0
    grown = max((square[~slow].mean() - square[slow].mean()) / np.mean(pace[~slow] ** 2), 0.0)
    return float(grown**0.5), float(min(grown * (pace**2 @ samples) / max(square @ samples, 1e-300), 1.0))


def new_branches(held_out: Array, others: Array) -> tuple[float, float]:
    """Return the distances of held-out rises, and of held-out falls, from others: `Validity.new`.

    Both are branches (k, 2) [V]. Held-out branches beyond the voltages of the others do not count.
    """
    if not len(others):
        return 0.0, 0.0
    low, high = float(others.min()), float(others.max())
    own, known = ((given - low) / max(high - low, 1e-300) for given in (held_out, others))
    own = own[np.all((own > -_BEYOND) & (own < 1 + _BEYOND), axis=1)]
    apart, rising = distances(own, known), own[:, 1] > own[:, 0]
    return rms(apart[rising]), rms(apart[~rising])


def expectation(
    outcome: Outcome,
    errors: Sequence[RecordErrors],
    checks: Sequence[Check],
    validity: Validity,
    noise: float,
    goal: float,
    caveats: Sequence[str] = (),
) -> Expectation:
    """Return the errors to expect on a path that turns anywhere within the recorded voltages, at recorded speeds.

    `errors`, `checks`: as in `Fit`. `validity`: see `validity_of`. `noise`: standard deviation of the sensor [m].
    `goal`: allowed largest error [% of the stroke]. `caveats`: further reasons for care, in words.
    """
    training, validation = ([error for error in errors if error.role == role] for role in ("training", "validation"))
    # A model that misses its training records by too much is not usable, even if it predicts validation records.
    by_others = bool(validation) and outcome is not Outcome.INACCURATE
    judged, basis = (
        (validation, "validation records") if by_others else (training, "parts of the records held out in turn")
    )
    measured = max(error.rms for error in judged)
    reasons = [*caveats]
    aside = sum(error.left_out for error in training) / sum(error.left_out + error.samples for error in training)
    if aside > RULES.most_set_aside:
        reasons.append(f"{100 * aside:.0f} % of the samples were left out")
    drifted = max(abs(error.drifted_percent) for error in errors)
    if drifted > goal:
        reasons.append(f"a drift of {percent(drifted, 100, goal=goal)} was removed, which will also occur on a path")
    if outcome is Outcome.UNDETERMINED:
        reasons.append("the records do not determine all stiffnesses")
    failed = [f"{check.name} ({REMEDIES[check.name]})" for check in checks if check.verdict is Verdict.FAILS]
    if failed:
        reasons.append(f"failed checks: {', '.join(failed)}")
    return Expectation(validity.anywhere, measured, noise, goal, basis, tuple(reasons))


def _less(error: float, noise: float) -> float:
    """Return an RMS error without an independent part of it."""
    return float(max(error**2 - noise**2, 0.0) ** 0.5)
