"""The record of an identification: how the numbers were found, and their errors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from functools import partial
from typing import TYPE_CHECKING, Any

from dehyst._errors import ModelError
from dehyst._validation import choice
from dehyst.model.entries import Entries, Numbers, entry, flag, instance, text
from dehyst.model.promise import Validity

if TYPE_CHECKING:
    from dehyst.model.actuator import Actuator


class Outcome(Enum):
    """How an identification ended; the value is the sentence to show."""

    IDENTIFIED = "Identified."
    UNDETERMINED = (
        "Identified, but the records leave combinations of the stiffnesses open: predictions of motions other than the "
        "recorded ones may be wrong. Add minor loops with other turning points."
    )
    INACCURATE = "Identified, but the model misses the records by more than 5 % of the stroke: do not use it."
    VALIDATION_MISSED = (
        "Identified, but the model misses a held-out record by more than 5 % of the stroke: do not use it for motions "
        "like that one."
    )

    @property
    def good(self) -> bool:
        """Whether the model may be used."""
        return self not in (Outcome.INACCURATE, Outcome.VALIDATION_MISSED)


_SIZE, _RATE = Numbers(least=0.0), Numbers(positive=True, plausible=1e11, optional=True)


def _outcome(value: object, where: str) -> Outcome | None:
    if value is None or isinstance(value, Outcome):
        return value
    return Outcome[choice(value, where, Outcome.__members__, error=ModelError)]


@dataclass(frozen=True)
class Identification(Entries):
    """How an actuator was identified, and the errors then; an error that is not known is None.

    Attributes
    ----------
    lag_of : str
        Source of the lag in the records, as in `dehyst.identify`; empty if not known.
    shared_zero : bool
        Whether the sensor kept its zero from record to record.
    drift : bool
        Whether records were allowed to drift.
    sensor_lag : float
        First-order lag of the sensor [s] that was removed from the records.
    lead : float
        Time [s] by which the voltages of the records were moved earlier: half a sample for a converter that holds.
    ringing : bool
        Whether the elements follow the ringing displacement after steps of the voltage.
    outcome : Outcome or None
    largest_error : float or None
        Largest error of the training records, simulated whole [m].
    goal : float or None
        Allowed largest error of a path [% of the stroke].
    slew_rate : float or None
        Largest abs(dv/dt) [V/s] of the records, with a margin of 5 %.
    validity : Validity or None
        What the records tested; it determines the promised error of a path.
    allowed_slew_rate, columns : float or None, str
        Defaults of commands: largest slew rate [V/s] of paths, and columns of the records as the text of `Columns`.

    Raises
    ------
    ModelError
        If a value has another type, or a number is negative or not finite.
    """

    _part = "identification"
    lag_of: str = entry("lag_of", partial(choice, among=("", "actuator", "sensor"), error=ModelError), "")
    shared_zero: bool = entry("shared_datum", flag, False)
    drift: bool = entry("drift", flag, True)
    sensor_lag: float = entry("sensor_lag_s", _SIZE, 0.0)
    lead: float = entry("lead_s", _SIZE, 0.0)
    ringing: bool = entry("ringing", flag, False)
    outcome: Outcome | None = entry("outcome", _outcome, None)
    largest_error: float | None = entry("largest_error_m", replace(_SIZE, optional=True), None)
    goal: float | None = entry("goal_percent", replace(_SIZE, optional=True), None)
    slew_rate: float | None = entry("slew_rate_V_per_s", _RATE, None)
    validity: Validity | None = entry("validity", instance(Validity, optional=True), None)
    allowed_slew_rate: float | None = entry("allowed_slew_rate_V_per_s", _RATE, None)
    columns: str = entry("columns", text, "")


def with_identification(actuator: Actuator, **entries: Any) -> Actuator:
    """Return an actuator whose identification holds `entries`, fields of `Identification`."""
    return replace(actuator, identification=replace(actuator.identification, **entries))
