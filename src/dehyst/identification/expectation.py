"""The error to expect on a path, and the verdict with its reasons, from the results of an identification."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np

from dehyst._types import Array
from dehyst._views.fields import json_values
from dehyst.identification.results import Check, RecordErrors, RemainingError, Trace, Verdict
from dehyst.identification.rules import RULES
from dehyst.model.identification import Outcome
from dehyst.model.promise import Validity, distances, legs
from dehyst.records import Record
from dehyst.records.signals import NOISE_PEAK, rms, turning_points, white_noise

_NEIGHBOURS = 20
# The middle of a line is known to this part of a step.
_APART = 0.15
# Held-out legs may go beyond the voltages of the others by this part of the range.
_BEYOND = 0.02


def remaining_error(trace: Trace) -> RemainingError:
    """Split the mean square of a record's residual.

    White noise is what differs from one sample to the next. Slow is what remains in means over a cycle: drift,
    temperature, creep that the model lacks. A line that the voltage does not have is a vibration. The rest repeats
    with the voltage: the model's own error.
    """
    residual = trace.residual - trace.residual.mean()
    total = float(np.mean(residual**2))
    if residual.size < 64 or not total:
        return RemainingError(trace.record, trace.role, float(np.sqrt(total)), 0.0, 0.0, 0.0, 0.0, 0.0)
    white = min(white_noise(trace.residual) ** 2, total)
    slow = _slow(trace, residual)
    fast = residual - slow
    frequency, line = _vibration(trace, fast)
    drifting = float(np.mean(slow**2))
    model = max(total - white - drifting - line, 0.0)
    # Estimates of parts may add up to more than the whole.
    scale = total / max(white + drifting + line + model, total)
    noise, drift, vibration, rest = (part * scale / total for part in (white, drifting, line, model))
    means = _means(trace, fast)
    return RemainingError(
        trace.record, trace.role, float(np.sqrt(total)), noise, drift, vibration, rest, frequency, means
    )


def _means(trace: Trace, residual: Array) -> tuple[float, ...]:
    """Return the mean residual by thirds of the displacements, where the voltage rises, then where it falls."""
    y = trace.simulated
    third = np.clip((3 * (y - y.min()) / max(float(np.ptp(y)), 1e-300)).astype(int), 0, 2)
    change = np.gradient(trace.voltage)
    places = [(change * way > 0) & (third == k) for way in (1, -1) for k in range(3)]
    return tuple(float(residual[place].mean()) if place.any() else 0.0 for place in places)


def _slow(trace: Trace, residual: Array) -> Array:
    """Return means over a cycle of the voltage (n,)."""
    turns = turning_points(trace.voltage, 0.02 * float(np.ptp(trace.voltage)))
    cycle = max(int(2 * residual.size / max(len(turns), 2)), 2)
    if cycle >= residual.size:
        return np.zeros(residual.size)
    padded = np.pad(residual, (cycle // 2, cycle - 1 - cycle // 2), mode="reflect")
    sums = np.cumsum(np.append(0.0, padded))
    return np.asarray((sums[cycle:] - sums[:-cycle]) / cycle)


def _vibration(trace: Trace, residual: Array) -> tuple[float, float]:
    """Return frequency [Hz] and mean square [m2] of the strongest line that the voltage does not have; 0 if none."""
    step = float(np.median(np.diff(trace.time)))
    window = np.hanning(residual.size)
    power = np.abs(np.fft.rfft(residual * window)) ** 2
    drive = np.abs(np.fft.rfft((trace.voltage - trace.voltage.mean()) * window)) ** 2
    k = int(np.argmax(power[2:])) + 2
    near = slice(max(k - 2, 1), k + 3)
    around = np.concatenate([power[max(k - _NEIGHBOURS, 1) : near.start], power[near.stop : k + _NEIGHBOURS]])
    share = float(power[near].sum()) / max(float(power[1:].sum()), 1e-300)
    driven = float(drive[near].max()) > RULES.driven_line * float(drive[1:].max(initial=0.0)) or _harmonic(drive, k)
    if driven or share < RULES.line_power or not around.size or power[k] < RULES.line_height * float(np.median(around)):
        return 0.0, 0.0
    frequency, amplitude = _line(residual, step, k / (step * residual.size))
    return frequency, 0.5 * amplitude**2


def _harmonic(drive: Array, k: int) -> bool:
    """Whether line k is a multiple of the one that holds most of the voltage: hysteresis makes those."""
    first = int(np.argmax(drive[1:])) + 1
    lines = np.arange(max(first - 2, 1), min(first + 3, drive.size))
    own = drive[lines]
    if first < RULES.fewest_periods or float(own.sum()) < RULES.periodic * float(drive[1:].sum()):
        return False
    middle = float(lines @ own / own.sum())
    multiple = max(round(k / middle), 1)
    within = _APART * multiple + 1
    # Beyond a quarter of the distance between multiples, any line would count as one.
    return abs(k - multiple * middle) <= within <= middle / 4


def _line(residual: Array, step: float, near: float) -> tuple[float, float]:
    """Return frequency [Hz] and amplitude [m] of the sine next to a frequency that holds most of a residual."""
    time = np.arange(residual.size) * step
    frequencies = near + np.linspace(-1, 1, 21) / time[-1]
    sizes = [2 * abs(np.mean(residual * np.exp(-2j * np.pi * f * time))) for f in frequencies]
    k = int(np.argmax(sizes))
    return float(frequencies[k]), float(sizes[k])


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
        Bounds that nine of ten paths should keep which turn anywhere within the recorded voltages [m]: see `Validity`.
    measured : float
        RMS error of the records from which that comes, as measured [m].
    noise : float
        Standard deviation of the sensor [m].
    stroke : float
        To which percentages refer [m].
    goal : float
        Allowed largest error [% of the stroke].
    basis : str
        "validation records" or parts of the training records, in words.
    reasons : tuple of str
        Why the model is not ready, besides its error: each a phrase.
    if_actuator_lags : (float, float), optional
        The same errors (rms, largest) [m] if the actuator, and not the sensor, lags: where the records leave that open.
    tested : bool
        Whether the errors are those of validation records.
    untested : tuple of str
        What the records do not test of such a path, each a sentence.
    """

    rms: float
    largest: float
    measured: float
    noise: float
    stroke: float
    goal: float
    basis: str
    reasons: tuple[str, ...] = ()
    if_actuator_lags: tuple[float, float] | None = None
    tested: bool = False
    untested: tuple[str, ...] = ()

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
        if self.largest_percent > RULES.useless:
            return Readiness.NOT_USABLE
        return Readiness.READY if self.largest_percent <= self.goal and not self.reasons else Readiness.USABLE

    @property
    def why_not_ready(self) -> tuple[str, ...]:
        """All that keeps the model from being ready, its error too: each a phrase."""
        above = self.largest_percent > self.goal
        return ("the largest error is above the goal", *self.reasons) if above else self.reasons

    @property
    def headline(self) -> str:
        """The verdict and the largest error to expect, which is the number to remember, with the RMS error."""
        return (
            f"{self.readiness.value.capitalize()}: expect an error of {_both(self.largest, self.stroke)} at most on a "
            f"path, {_both(self.rms, self.stroke)} RMS"
        )

    @property
    def origin(self) -> str:
        """What the expected errors come from, and what they are if not the actuator but the sensor lags."""
        missed, noise = (_percent(error, self.stroke) for error in (self.measured, self.noise))
        text = (
            f"Judged on {self.basis}; the goal is {self.goal:g} %. The records are missed by {missed} RMS, the "
            f"sensor's noise is {noise}."
        )
        if self.if_actuator_lags is None:
            return text
        rms, largest = (_percent(error, self.stroke) for error in self.if_actuator_lags)
        return f"{text} If the actuator lags, and not the sensor, expect {largest} at most and {rms} RMS."

    @property
    def reservations(self) -> tuple[str, ...]:
        """Why the model is not ready, besides its error, each a sentence."""
        return tuple(f"{one[0].upper()}{one[1:]}." for one in self.reasons)

    @property
    def sentence(self) -> str:
        """The verdict in one line, with its numbers and reasons."""
        text = (
            f"{self.readiness.value.capitalize()}: expect a path to be followed within {_both(self.rms, self.stroke)} "
            f"RMS and {_both(self.largest, self.stroke)} at most (from {self.basis}; goal {self.goal:g} %). "
            f"The records are missed by {_percent(self.measured, self.stroke)} RMS, the sensor's noise is "
            f"{_percent(self.noise, self.stroke)}."
        )
        if self.if_actuator_lags is not None:
            rms, largest = (_percent(error, self.stroke) for error in self.if_actuator_lags)
            text += f" That holds if the sensor lags; if the actuator does, expect {rms} RMS and {largest} at most."
        reasons = self.why_not_ready
        words = "; ".join(reasons)
        return f"{text} {words[0].upper()}{words[1:]}." if reasons else text

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        numbers = "rms_m=rms largest_m=largest measured_m=measured noise_m=noise goal_percent=goal"
        return {
            **json_values(self, "readiness sentence"),
            "rms_percent": 100 * self.rms / self.stroke,
            **json_values(
                self, f"largest_percent {numbers} basis tested reasons untested if_actuator_lags_m=if_actuator_lags"
            ),
        }


def _percent(error: float, stroke: float) -> str:
    percent = 100 * error / stroke
    return f"{percent:.2g} %" if percent < 100 else f"{percent:.0f} %"


def _both(error: float, stroke: float) -> str:
    length = f"{error * 1e9:.3g} nm" if error < 1e-6 else f"{error * 1e6:.3g} um"
    return f"{_percent(error, stroke)} of the stroke ({length})"


@dataclass(frozen=True)
class HeldOutErrors:
    """Errors on parts of the records that were not trained on; 0 where that was not tried.

    `in_time`: RMS error of parts of the training records that were held out in turn [m]. `disagreement`: RMS distance
    of other structures that explain the records as well, on a random path [m]. `noise`: standard deviation of the
    sensor in the samples that were compared [m]. `new`: see `Validity`.
    """

    in_time: float = 0.0
    disagreement: float = 0.0
    noise: float = 0.0
    new: tuple[float, float] = (0.0, 0.0)


def validity_of(
    records: Sequence[Record],
    errors: Sequence[RecordErrors],
    remaining: Sequence[RemainingError],
    held_out: HeldOutErrors,
    noise: float,
    lag: float = 0.0,
    *,
    validated: bool = True,
) -> Validity:
    """Return what records tested of a model.

    `records`, `errors`, `remaining`: one each, training first. `noise`: standard deviation of the sensor [m]. `lag` [s]
    that may be the sensor's. `validated`: whether validation records, if there are any, replace held-out parts.
    """
    training, validation = ([q for q, one in enumerate(errors) if one.role == r] for r in ("training", "validation"))
    new, judged = held_out.new, training
    voltages = [(records[q].time, records[q].voltage) for q in training]
    if validation and validated:
        judged = validation
        span = float(np.ptp(np.concatenate([voltage for _, voltage in voltages])))
        pairs = legs_of([(records[q].time, records[q].voltage) for q in validation], span), legs_of(voltages, span)
        other = new_legs(*map(np.concatenate, pairs))
        new = max(new[0], other[0]), max(new[1], other[1])
    vibration = max(remaining[q].vibration_amplitude for q in judged)
    # What the sensor adds, a path does not have, but for the part to which it is known.
    missed = max(_less(errors[q].settled_rms, remaining[q].sensed) for q in judged)
    if judged is training:
        missed = max(missed, _less(held_out.in_time, float(np.hypot(held_out.noise, vibration / 2**0.5))))
    largest = max(errors[q].settled_largest for q in judged) - NOISE_PEAK * noise - vibration
    return Validity.by_records(
        voltages,
        rms=float(np.hypot(missed, RULES.noise_known * noise)),
        largest=max(largest, 0.0),
        disagreement=held_out.disagreement,
        stroke=errors[0].stroke,
        new=new,
        lag=lag,
    )


def legs_of(records: Sequence[tuple[Array, Array]], span: float) -> list[Array]:
    """Return the legs (k, 2) [V] of records, times [s] and voltages [V], of which the widest has a range of `span`."""
    return [voltage[legs(voltage, span)] for _, voltage in records]


def new_legs(held_out: Array, others: Array) -> tuple[float, float]:
    """Return how far held-out rises, and falls, are from others: `Validity.new`.

    Both are legs (k, 2) [V]. Held-out ones beyond the others' voltages do not count.
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
    """Return what to expect of a path that turns anywhere within the recorded voltages, at recorded speeds.

    `errors`, `checks`: those of a `Fit`. `validity`: see `validity_of`. `noise`: standard deviation of the sensor [m].
    `goal`: [% of the stroke]. `caveats`: more reasons for care, in words.
    """
    training, validation = ([one for one in errors if one.role == role] for role in ("training", "validation"))
    # A model that misses its own records by too much is of no use, whatever it makes of others.
    by_others = bool(validation) and outcome is not Outcome.INACCURATE
    judged, basis = (validation, "validation records") if by_others else (training, "parts of the records held out")
    measured = max(one.settled_rms for one in judged)
    reasons = [*caveats, *_reasons(training, errors, goal)]
    fitted = max(one.settled_rms for one in training)
    if by_others and measured > RULES.widest_gap * fitted:
        reasons.append(f"validation records are missed {measured / fitted:.1f} times as far as training records")
    if outcome is Outcome.UNDETERMINED:
        reasons.append("the records do not determine all stiffnesses")
    failed = [check.name for check in checks if check.verdict is Verdict.FAILS]
    if failed:
        reasons.append(f"failed checks: {', '.join(failed)}")
    found, stroke = validity.anywhere, errors[0].stroke
    return Expectation(
        found.rms,
        found.largest,
        measured,
        noise,
        stroke,
        goal,
        basis,
        tuple(reasons),
        found.if_actuator_lags,
        by_others,
        found.untested,
    )


def _reasons(training: Sequence[RecordErrors], errors: Sequence[RecordErrors], goal: float) -> list[str]:
    """Return the reasons for care that lie in the records."""
    reasons = []
    aside = sum(one.left_out for one in training) / sum(one.left_out + one.samples for one in training)
    if aside > RULES.most_set_aside:
        reasons.append(f"{100 * aside:.0f} % of the samples were set aside")
    drifted = max(abs(one.drifted_percent) for one in errors)
    if drifted > goal:
        reasons.append(f"a drift of {drifted:.2g} % was removed, which a path will show")
    return reasons


def _less(error: float, noise: float) -> float:
    """Return what is left of an RMS error without an independent part of it."""
    return float(max(error**2 - noise**2, 0.0) ** 0.5)
