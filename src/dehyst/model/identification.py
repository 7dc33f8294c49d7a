"""What an identification found out about its own result: how the numbers were found, and how wrong they were then."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from math import inf
from typing import Any

from dehyst._errors import ModelError
from dehyst._validation import keep, number
from dehyst.model.promise import Validity


class Outcome(Enum):
    """How an identification ended; the value is the sentence to show."""

    IDENTIFIED = "Identified: the program was solved to optimality, and the records determine every stiffness."
    WIDER = (
        "Identified: the program was solved to optimality, with more parts than plain Maxwell-slip has. Run dehyst "
        "insight to assess the model."
    )
    UNDETERMINED = (
        "Identified, but the records leave combinations of the stiffnesses open: predictions of motions other than the "
        "recorded ones may be wrong. Add minor loops with other turning points."
    )
    FLOOR_ACTIVE = (
        "Identified, but the spring's slope lies on its floor in places: the records do not determine it there, or "
        "the structure does not fit."
    )
    ASSUMPTION_I_IMPOSED = (
        "Identified, but only with Assumption I imposed: without it the spring would fall somewhere, and one voltage "
        "would have several displacements."
    )
    STIFFNESS_CLIPPED = (
        "Identified, but the closed form gave negative stiffnesses, which were set to zero: the loop is not "
        "that of Maxwell-slip elements with a linear spring."
    )
    INACCURATE = "Identified, but the model misses the records by more than 5 % of the range: do not use it."
    VALIDATION_MISSED = (
        "Identified, but the model misses a held-out record by more than 5 % of the range: do not use it for motions "
        "like that one."
    )
    FAILED = "Not identified: the solver found no optimum."

    @property
    def good(self) -> bool:
        """Whether the model may be used."""
        return self not in (Outcome.INACCURATE, Outcome.VALIDATION_MISSED, Outcome.FAILED)


def _flag(value: object, where: str) -> bool:
    if not isinstance(value, bool):
        raise ModelError(f"{where}: got {value!r}, need true or false")
    return value


def _text(value: object, where: str) -> str:
    if not isinstance(value, str):
        raise ModelError(f"{where}: got {value!r}, need text")
    return value


def _size(value: object, where: str) -> float:
    """Return a number of 0 or more."""
    size = number(value, where)
    if not 0 <= size < inf:
        raise ModelError(f"{where}: got {value!r}, need a finite number of 0 or more")
    return size


def _size_or_none(value: object, where: str) -> float | None:
    return None if value is None else _size(value, where)


def _outcome(value: object, where: str) -> Outcome | None:
    if value is None or isinstance(value, Outcome):
        return value
    if not isinstance(value, str) or value not in Outcome.__members__:
        raise ModelError(f"{where}: got {value!r}, need one of {', '.join(Outcome.__members__)}, or null")
    return Outcome[value]


def _validity(value: object, where: str) -> Validity | None:
    return value if value is None or isinstance(value, Validity) else Validity.from_dict(value)


# Of each field its key in a model file, and the check of its value.
_ENTRIES: dict[str, tuple[str, Callable[[object, str], Any]]] = {
    "method": ("method", _text),
    "norm": ("norm", _text),
    "slope_floor": ("slope_floor", _size),
    "shared_datum": ("shared_datum", _flag),
    "drift": ("drift", _flag),
    "sensor_lag": ("sensor_lag_s", _size),
    "ringing": ("ringing", _flag),
    "smoothing": ("smoothing", _size_or_none),
    "outcome": ("outcome", _outcome),
    "provisional": ("provisional", _flag),
    "largest_error": ("largest_error_m", _size_or_none),
    "goal": ("goal_percent", _size_or_none),
    "expected_rms": ("expected_rms_m", _size_or_none),
    "expected_largest": ("expected_largest_m", _size_or_none),
    "validated": ("tested", _flag),
    "validity": ("validity", _validity),
}


@dataclass(frozen=True)
class Identification:
    """How an actuator was identified, and how wrong it was then: what later judgements of the model read.

    A number that is not known is None.

    Attributes
    ----------
    method, norm : str
        As `dehyst.identify` takes them, and "fleet" of a prior; empty if not known.
    slope_floor : float
        Least slope that the spring was allowed, as a part of the mean slope of the widest loop.
    shared_datum : bool
        Whether the sensor kept its zero from record to record.
    drift : bool
        Whether records were allowed to drift.
    sensor_lag : float
        First-order lag of the sensor [s] that was removed from the records.
    ringing : bool
        Whether the elements follow what rings after steps of the voltage.
    smoothing : float or None
        `Structure.smoothing`.
    outcome : Outcome or None
    provisional : bool
        Whether the identification had not ended: a least-squares fit of few samples that was not checked.
    largest_error : float or None
        Largest error of the training records, simulated whole [m].
    goal : float or None
        Allowed largest error of a path [% of the stroke].
    expected_rms, expected_largest : float or None
        Errors of a path like the records that the verdict promised [m].
    validated : bool
        Whether they come from validation records.
    validity : Validity or None
        What the records tested: from it follows what to expect of a path.

    Raises
    ------
    ModelError
        If a value has another type, or a number is negative or not finite.
    """

    method: str = ""
    norm: str = ""
    slope_floor: float = 0.2
    shared_datum: bool = False
    drift: bool = True
    sensor_lag: float = 0.0
    ringing: bool = False
    smoothing: float | None = None
    outcome: Outcome | None = None
    provisional: bool = False
    largest_error: float | None = None
    goal: float | None = None
    expected_rms: float | None = None
    expected_largest: float | None = None
    validated: bool = False
    validity: Validity | None = None

    def __post_init__(self) -> None:
        keep(self, **{name: read(getattr(self, name), name) for name, (_, read) in _ENTRIES.items()})

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        values = {key: getattr(self, name) for name, (key, _) in _ENTRIES.items()}
        validity = None if self.validity is None else self.validity.as_dict()
        return {
            **values,
            "outcome": None if self.outcome is None else self.outcome.name,
            "validity": validity,
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Identification:
        """Rebuild from the `data` of `as_dict`; raise `ModelError` if a value is impossible."""
        return cls(**{name: data[key] for name, (key, _) in _ENTRIES.items() if key in data})

    @classmethod
    def from_entries(cls, entries: Mapping[str, Any]) -> Identification | None:
        """Return what a model file of version 1 or 2 holds among its free `entries`, which anybody may have written.

        Impossible values are left out; None if nothing is known.
        """
        structure = entries.get("structure")
        given = {**entries, "sensor_lag_s": entries.get("sensor_lag") or 0.0}
        given["smoothing"] = structure.get("smoothing") if isinstance(structure, Mapping) else None
        found = {}
        for name, (key, read) in _ENTRIES.items():
            with suppress(ModelError):
                found[name] = read(given.get(key, getattr(cls, name)), key)
        own = cls(**found)
        return None if own == cls() else own
