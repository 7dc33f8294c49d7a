"""The record of an identification: how the numbers were found, and their errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from enum import Enum
from math import inf
from typing import TYPE_CHECKING, Any

from dehyst._errors import ModelError
from dehyst._validation import keep, number
from dehyst._views.fields import json_value
from dehyst.model.promise import Validity

if TYPE_CHECKING:
    from dehyst.model.actuator import Actuator


class Outcome(Enum):
    """How an identification ended; the value is the sentence to show."""

    IDENTIFIED = "Identified. Run dehyst insight to assess the model."
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


def _flag(value: object, where: str) -> bool:
    if not isinstance(value, bool):
        raise ModelError(f"{where}: got {value!r}, need true or false")
    return value


def _text(value: object, where: str) -> str:
    if not isinstance(value, str):
        raise ModelError(f"{where}: got {value!r}, need text")
    return value


def _size(value: object, where: str) -> float:
    """Return a number after checking that it is 0 or more."""
    size = number(value, where)
    if not 0 <= size < inf:
        raise ModelError(f"{where}: got {value!r}, need a finite number of 0 or more")
    return size


def _size_or_none(value: object, where: str) -> float | None:
    return None if value is None else _size(value, where)


def _rate_or_none(value: object, where: str) -> float | None:
    rate = _size_or_none(value, where)
    if rate == 0:
        raise ModelError(argument=where, got=rate, need="a positive number of volts a second, or None")
    return rate


def _outcome(value: object, where: str) -> Outcome | None:
    if value is None or isinstance(value, Outcome):
        return value
    if not isinstance(value, str) or value not in Outcome.__members__:
        raise ModelError(f"{where}: got {value!r}, need one of {', '.join(Outcome.__members__)}, or null")
    return Outcome[value]


def _validity(value: object, where: str) -> Validity | None:
    return value if value is None or isinstance(value, Validity) else Validity.from_dict(value)


def _entry(default: Any, read: Callable[[object, str], Any], key: str = "") -> Any:
    """Return a dataclass field with the check of its value and its key in a model file, by default its name."""
    return field(default=default, metadata={"read": read, "key": key})


@dataclass(frozen=True)
class Identification:
    """How an actuator was identified, and its errors then; later judgements of the model depend on it.

    A number that is not known is None.

    Attributes
    ----------
    lag_of : str
        Whose the lag of the records is, as in `dehyst.identify`; empty if not known.
    shared_datum : bool
        Whether the sensor kept its zero from record to record.
    drift : bool
        Whether records were allowed to drift.
    sensor_lag : float
        First-order lag of the sensor [s] that was removed from the records.
    ringing : bool
        Whether the elements follow the ringing displacement after steps of the voltage.
    outcome : Outcome or None
    provisional : bool
        Whether the model is an early one, before the end of its identification: a least-squares fit of few samples that
        was not checked.
    largest_error : float or None
        Largest error of the training records, simulated whole [m].
    goal : float or None
        Allowed largest error of a path [% of the stroke].
    slew_rate : float or None
        Largest abs(dv/dt) [V/s] of the records, with a margin of 5 %.
    validity : Validity or None
        What the records tested; it determines the promised error of a path.

    Raises
    ------
    ModelError
        If a value has another type, or a number is negative or not finite.
    """

    lag_of: str = _entry("", _text)
    shared_datum: bool = _entry(False, _flag)
    drift: bool = _entry(True, _flag)
    sensor_lag: float = _entry(0.0, _size, "sensor_lag_s")
    ringing: bool = _entry(False, _flag)
    outcome: Outcome | None = _entry(None, _outcome)  # noqa: RUF009
    provisional: bool = _entry(False, _flag)
    largest_error: float | None = _entry(None, _size_or_none, "largest_error_m")
    goal: float | None = _entry(None, _size_or_none, "goal_percent")
    slew_rate: float | None = _entry(None, _rate_or_none, "slew_rate_V_per_s")
    validity: Validity | None = _entry(None, _validity)  # noqa: RUF009

    def __post_init__(self) -> None:
        keep(self, **{one.name: one.metadata["read"](getattr(self, one.name), one.name) for one in fields(self)})

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {key: json_value(getattr(self, name)) for key, name in self.keys().items()}

    @classmethod
    def keys(cls) -> dict[str, str]:
        """Return the field name of each key in a model file."""
        return {one.metadata["key"] or one.name: one.name for one in fields(cls)}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Identification:
        """Rebuild from the `data` of `as_dict`; raise `ModelError` if a value is impossible."""
        return cls(**{name: data[key] for key, name in cls.keys().items()})


def with_identification(actuator: Actuator, **entries: Any) -> Actuator:
    """Return an actuator whose identification holds `entries`, fields of `Identification`."""
    return replace(actuator, identification=replace(actuator.identification or Identification(), **entries))


def slew_rate_of_records(actuator: Actuator) -> float | None:
    """Return the largest abs(dv/dt) [V/s] of the records of an `actuator`; None if it is not known."""
    return None if actuator.identification is None else actuator.identification.slew_rate
