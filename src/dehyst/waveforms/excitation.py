"""A voltage to play, on uniform samples, and the checks of its numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError, RecordError
from dehyst._text import counted
from dehyst._types import Array
from dehyst._validation import keep, number, vector

_MOST_SAMPLES = 50_000_000
# No actuator or amplifier goes beyond, and within them nothing overflows.
_MOST_VOLTS = 1e6
_LEAST, _MOST = 1e-12, 1e12


@dataclass(frozen=True, eq=False, repr=False)
class Excitation:
    """A voltage to play.

    Parameters
    ----------
    name : str
        Its kind.
    voltage : (n,) array_like
        [V], n >= 2; kept as a read-only copy.
    sample_rate : float
        Samples a second [Hz].
    warnings : tuple of str
        Sentences about what takes longer than requested; empty if nothing does.

    Raises
    ------
    RecordError
        If the voltage is not a row of at least two finite numbers, or the sample rate is not positive.
    """

    name: str
    voltage: Array
    sample_rate: float
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        voltage = voltages(self.voltage, "voltage")
        if voltage.size < 2:
            raise RecordError(f"voltage: got {counted(voltage.size, 'sample')}, need 2 at least; give a longer one")
        keep(self, voltage=voltage)
        set_checked(self, positive, "sample_rate")

    def __len__(self) -> int:
        return self.voltage.size

    def __repr__(self) -> str:
        low, high = self.voltage_range
        return f"<Excitation '{self.name}': {len(self)} samples, {self.duration:.6g} s, {low:.6g} to {high:.6g} V>"

    @property
    def time(self) -> Array:
        """Time of each sample (n,) [s], from 0."""
        return np.arange(len(self)) / self.sample_rate

    @property
    def duration(self) -> float:
        """Time from the first sample to the last [s]."""
        return (len(self) - 1) / self.sample_rate

    @property
    def voltage_range(self) -> tuple[float, float]:
        """Lowest and highest voltage [V]."""
        return float(self.voltage.min()), float(self.voltage.max())

    @property
    def turns(self) -> Array:
        """Voltages (k,) [V] between which it only rises or only falls: the first, those where it turns, the last."""
        steps = np.diff(self.voltage)
        moving = np.flatnonzero(steps)
        rises = steps[moving] > 0
        turning = moving[1:][rises[1:] != rises[:-1]]
        return self.voltage[[0, *turning, -1]]

    def then(self, other: Excitation) -> Excitation:
        """Append another excitation to this one, without a pause. `other` comes second.

        Raise `RecordError` if the other one has another sample rate, begins at another voltage, or makes the result too
        long.
        """
        if other.sample_rate != self.sample_rate:
            raise RecordError(
                f"sample rates: got {self.sample_rate:.9g} and then {other.sample_rate:.9g} Hz, need one; "
                "make both with the same sampling"
            )
        end, begin = float(self.voltage[-1]), float(other.voltage[0])
        if begin != end:
            raise RecordError(
                f"'{self.name}' ends at {end:.9g} V, but '{other.name}' begins at {begin:.9g} V; "
                f"make that one with present={end:.9g}"
            )
        refuse_long(len(self) + len(other) - 1, self.sample_rate)
        voltage = np.concatenate([self.voltage, other.voltage[1:]])
        return Excitation(f"{self.name}+{other.name}", voltage, self.sample_rate, (*self.warnings, *other.warnings))


def refuse_long(samples: int, rate: float) -> None:
    """Raise RecordError for more than 5e7 samples; `rate` [Hz] is for the message."""
    if samples > _MOST_SAMPLES:
        raise RecordError(
            f"got {samples:.4g} samples, {samples / rate:.4g} s at {rate:g} Hz, need {_MOST_SAMPLES:g} at most; lower "
            "the sample rate, or request fewer or faster legs"
        )


def voltages(values: ArrayLike, what: str) -> Array:
    """Return `values` as a copy of finite voltages (n,) [V]; raise RecordError if they are none."""
    try:
        array = vector(values, what, "V")
    except ModelError as error:
        raise RecordError(f"{error}; give voltages in V") from error
    if np.abs(array).max(initial=0.0) > _MOST_VOLTS:
        raise RecordError(f"{what}: got {np.abs(array).max():g} V, need {_MOST_VOLTS:g} V at most; check the unit")
    return array


def volts(value: object, what: str) -> float:
    """Return `value` as a finite voltage [V]; raise RecordError if it is none."""
    return float(voltages([number(value, what, "V", error=RecordError)], what)[0])


def positive(value: object, what: str) -> float:
    """Return `value` as a number from 1e-12 to 1e12; raise RecordError if it is none."""
    result = number(value, what, error=RecordError)
    if not _LEAST <= result <= _MOST:
        raise RecordError(f"{what}: got {result:g}, need a number above 0, {_LEAST:g} to {_MOST:g}")
    return result


def set_checked(owner: object, check: Callable[[Any, str], object], *names: str, optional: Sequence[str] = ()) -> None:
    """Replace fields of a frozen dataclass by what ``check(value, name)`` returns; an optional one may be None."""
    for name in (*names, *optional):
        if name in names or getattr(owner, name) is not None:
            object.__setattr__(owner, name, check(getattr(owner, name), name))
