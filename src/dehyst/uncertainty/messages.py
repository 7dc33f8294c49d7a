"""What must be known before a model is used, in sentences: the same for plain and wider actuators."""

from __future__ import annotations

import numpy as np

from dehyst.control import Homing
from dehyst.identification.validation import RecordComparison
from dehyst.model import Actuator
from dehyst.records.metrics import largest

# A model that misses records by more than this part of their range [%] is no model of them.
_MISSED = 5.0
# Nor is one that misses them by more than this [%] and this many times as far as those it was identified from.
_WORTH, _TIMES = 0.5, 3.0
# Limits may be wider than the recorded voltages by this part, for a rounded number's sake.
_WIDER = 0.01


def misfit_of(actuator: Actuator, comparisons: tuple[RecordComparison, ...]) -> float:
    """Return the largest error of a model on records [m]."""
    errors = [played[2] - played[3] for one in comparisons for _, _, played in one.played(actuator)]
    return largest(np.concatenate(errors))


def of_another(actuator: Actuator, misfit: float, stroke: float) -> str | None:
    """Return A warning if records are of another actuator than the model."""
    range_ = float(np.ptp(actuator.spring.displacement))
    missed, own = 100 * misfit / stroke, actuator.provenance.get("largest_error_m", np.inf)
    if missed <= _MISSED and not (missed > _WORTH and misfit > _TIMES * own):
        return None
    return (
        f"The model misses these records by up to {missed:.3g} % of their range, {stroke * 1e6:.4g} um (its own is "
        f"{range_ * 1e6:.4g} um): they are of another actuator, or in other units. Nothing below holds for them."
    )


def beyond(actuator: Actuator, limits: tuple[float, float] | None) -> str | None:
    """Return A warning if limits [V] go beyond the voltages that were recorded."""
    recorded = actuator.limits
    if recorded is None or limits is None:
        return None
    over = max(recorded[0] - limits[0], limits[1] - recorded[1])
    if over <= _WIDER * (recorded[1] - recorded[0]):
        return None
    return (
        f"The limits, {limits[0]:.6g} to {limits[1]:.6g} V, go {over:.4g} V beyond those of the records, "
        f"{recorded[0]:.6g} to {recorded[1]:.6g} V: all results for voltages there are extrapolated."
    )


def not_homed(homing: Homing | None) -> str | None:
    """Return A warning if the rise before a trajectory leaves the state unknown."""
    if homing is None or homing.certified:
        return None
    return (
        "The trajectory is taken to start after a rise through all of the limits, which does not make the "
        f"state known ({'; '.join(homing.remarks)}): what was done before may show in it."
    )
