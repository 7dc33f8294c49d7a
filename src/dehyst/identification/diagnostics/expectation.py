"""The error to expect on a path like the records, and the reasons for care, from the results of an identification."""

from __future__ import annotations

from collections.abc import Sequence

from dehyst.model import Check, Expectation, Outcome, RecordErrors, Verdict
from dehyst.model.readiness import MOST_SET_ASIDE, WIDEST_GAP

# Largest error of a path in RMS errors, at least.
_PEAK = 3.0


def expectation(
    outcome: Outcome,
    errors: Sequence[RecordErrors],
    checks: Sequence[Check],
    held_out: float,
    noise: float,
    goal: float,
) -> Expectation:
    """Return what to expect.

    Parameters
    ----------
    outcome : Outcome
    errors, checks
        Those of a `Fit`.
    held_out : float
        RMS error of parts of the training records that were held out in turn [m].
    noise : float
        Standard deviation of the sensor [m].
    goal : float
        [% of the stroke].
    """
    training, validation = ([one for one in errors if one.role == role] for role in ("training", "validation"))
    # A model that misses its own records by too much is of no use, whatever it makes of others.
    by_others = bool(validation) and outcome is not Outcome.INACCURATE
    judged, basis = (validation, "validation records") if by_others else (training, "training records")
    rms, largest = max(one.rms for one in judged), max(one.largest for one in judged)
    if held_out > rms and not by_others:
        basis = "parts of the records held out in turn"
        rms = held_out
        largest = max(largest, _PEAK * rms)
    reasons = []
    aside = sum(one.left_out for one in training) / sum(one.left_out + one.samples for one in training)
    if aside > MOST_SET_ASIDE:
        reasons.append(f"{100 * aside:.0f} % of the samples were set aside")
    fitted = max(one.rms for one in training)
    if validation and rms > WIDEST_GAP * fitted:
        reasons.append(f"validation records are missed {rms / fitted:.1f} times as far as training records")
    drifted = max(abs(one.drifted_percent) for one in errors)
    if drifted > goal:
        reasons.append(f"a drift of {drifted:.2g} % was removed, which a path will show")
    if outcome is Outcome.UNDETERMINED:
        reasons.append("the records do not determine all stiffnesses")
    failed = [check.name for check in checks if check.verdict is Verdict.FAILS]
    if failed:
        reasons.append(f"failed checks: {', '.join(failed)}")
    return Expectation(rms, largest, noise, errors[0].stroke, goal, basis, tuple(reasons))
