"""The error to expect on a path like the records, and the reasons for care, from the results of an identification."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dehyst.model import Check, Expectation, Outcome, RecordErrors, RemainingError, Verdict
from dehyst.model.readiness import MOST_SET_ASIDE, WIDEST_GAP
from dehyst.records.metrics import NOISE_PEAK

# Largest error of a path in RMS errors, at least.
_PEAK = 3.0
# What is subtracted as noise is known to this part.
_KNOWN = 0.1


@dataclass(frozen=True)
class HeldOutErrors:
    """Errors on parts of the records that were not trained on; 0 where that was not tried.

    Attributes
    ----------
    in_time : float
        RMS error of parts of the training records that were held out in turn [m].
    by_size : float
        RMS error of cycles of sizes that were held out [m].
    disagreement : float
        RMS distance of other structures that explain the records as well, on a random path [m].
    noise : float
        Standard deviation of the sensor in the samples that were compared [m].
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
    doubts: Sequence[str] = (),
) -> Expectation:
    """Return what to expect.

    Parameters
    ----------
    outcome : Outcome
    errors, checks
        Those of a `Fit`.
    held_out : HeldOutErrors
    remaining : sequence of RemainingError
        One for each of the errors.
    noise : float
        Standard deviation of the sensor [m].
    goal : float
        [% of the stroke].
    doubts : sequence of str, optional
        More reasons for care, in words.
    """
    training, validation = ([one for one in errors if one.role == role] for role in ("training", "validation"))
    # A model that misses its own records by too much is of no use, whatever it makes of others.
    by_others = bool(validation) and outcome is not Outcome.INACCURATE
    judged, basis = (validation, "validation records") if by_others else (training, "training records")
    causes = [cause for cause in remaining if cause.role == judged[0].role]
    vibration = max(cause.vibration_amplitude for cause in causes)
    # What the sensor adds, a path does not have.
    rms = max(_less(one.rms, cause.sensed) for one, cause in zip(judged, causes, strict=True))
    if not by_others:
        rms, basis = _beyond(rms, basis, held_out, vibration)
    # Validation records may hold the same kind of loops as those that were trained on; a path does not.
    rms = (rms**2 + held_out.disagreement**2 + (_KNOWN * noise) ** 2) ** 0.5
    largest = max(max(one.largest for one in judged) - NOISE_PEAK * noise - vibration, _PEAK * rms)
    measured = max(one.rms for one in judged)
    reasons = [*doubts, *_reasons(training, errors, goal)]
    fitted = max(one.rms for one in training)
    if by_others and measured > WIDEST_GAP * fitted:
        reasons.append(f"validation records are missed {measured / fitted:.1f} times as far as training records")
    if outcome is Outcome.UNDETERMINED:
        reasons.append("the records do not determine all stiffnesses")
    failed = [check.name for check in checks if check.verdict is Verdict.FAILS]
    if failed:
        reasons.append(f"failed checks: {', '.join(failed)}")
    return Expectation(rms, largest, measured, noise, errors[0].stroke, goal, basis, tuple(reasons))


def _beyond(rms: float, basis: str, held_out: HeldOutErrors, vibration: float) -> tuple[float, str]:
    """Return the RMS error [m] and its basis where what was held out is missed by more; `vibration`: amplitude [m]."""
    sensed = (held_out.noise**2 + 0.5 * vibration**2) ** 0.5
    for part, name in (
        (held_out.in_time, "parts of the records held out in turn"),
        (held_out.by_size, "loops of sizes held out"),
    ):
        rms, basis = max((rms, basis), (_less(part, sensed), name))
    return rms, basis


def _reasons(training: Sequence[RecordErrors], errors: Sequence[RecordErrors], goal: float) -> list[str]:
    """Return the reasons for care that lie in the records."""
    reasons = []
    aside = sum(one.left_out for one in training) / sum(one.left_out + one.samples for one in training)
    if aside > MOST_SET_ASIDE:
        reasons.append(f"{100 * aside:.0f} % of the samples were set aside")
    drifted = max(abs(one.drifted_percent) for one in errors)
    if drifted > goal:
        reasons.append(f"a drift of {drifted:.2g} % was removed, which a path will show")
    return reasons


def _less(error: float, noise: float) -> float:
    """Return what is left of an RMS error without an independent part of it."""
    return float(max(error**2 - noise**2, 0.0) ** 0.5)
