"""Common parts of all scans: declared options, motions of an axis, limits of motion, sampled paths."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields
from functools import cache, partial
from math import ceil, floor, inf, log10, sqrt
from typing import Annotated, Any, ClassVar, NamedTuple, TypeAlias, get_args, get_type_hints

import numpy as np

from dehyst._errors import RecordError
from dehyst._text import counted
from dehyst._types import Array
from dehyst._validation import Numbers, choice, count, keep, vector
from dehyst.waveforms.excitation import positive, refuse_long

# Default number of samples of a period, as in `Sampling`; least number for each part of a period.
CYCLE_SAMPLES, BRANCH_SAMPLES = 400, 4
# Largest speed and acceleration of a motion of least jerk, as multiples of height / time and height / time squared.
FASTEST, HARDEST = 1.875, 10 / sqrt(3)
# A motion may exceed a limit by this share, so that rounding does not refuse a motion at the limit.
SLACK = 1e-9
# Largest whole number.
_MOST_WHOLE = 10**7


# Checks of a displacement [m], and of a share.
length = Numbers(least=-1.0, most=1.0, hint="check its unit", error=RecordError)
share = Numbers(least=1e-12, most=1.0, error=RecordError)


def between(low: object, high: object, names: tuple[str, str] = ("low", "high")) -> tuple[float, float]:
    """Return two displacements [m], the lower one first; raise RecordError for anything else."""
    bottom, top = length(low, names[0]), length(high, names[1])
    if not bottom < top:
        got = f"{bottom * 1e6:.6g} and {top * 1e6:.6g} um"
        raise RecordError(argument=", ".join(names), got=got, need="the lower one first")
    return bottom, top


def whole(value: object, what: str, least: int = 1) -> int:
    """Return `value` as a whole number from `least` to 1e7; raise RecordError for anything else."""
    return count(value, what, least, _MOST_WHOLE, error=RecordError)


def rounded(value: float, towards: Callable[[float], int]) -> str:
    """Write a positive number with four digits, rounded by `floor` or `ceil`: the limits allow a suggested value."""
    unit = 10.0 ** (floor(log10(value)) - 3)
    return f"{towards(value * (1 - 1e-6 if towards is floor else 1 + 1e-6) / unit) * unit:.6g}"


def samples_of(seconds: float, rate: float) -> int:
    """Return the number of samples of a duration [s], rounded up; raise `RecordError` for under 4 or over 5e7."""
    samples = seconds * rate * (1 - 1e-12)
    if samples > BRANCH_SAMPLES - 1:
        refuse_long(int(min(samples, 1e15)) + 1, rate)
        return ceil(samples)
    few = f"{samples:.3g}"
    raise RecordError(
        argument="sample_rate",
        got=f"{rate:g} Hz, {few} sample{'s' * (few != '1')} for {seconds:.4g} s",
        need=f"{BRANCH_SAMPLES} at least",
        hint=f"try {BRANCH_SAMPLES / seconds:.4g} Hz",
    )


class ScanOption(NamedTuple):
    """An option of scans, declared in the annotation of a field; the type of the field gives the `kind`."""

    unit: str
    help: str
    default: str = ""
    least: int = 1
    kind: type | tuple[str, ...] | str = float

    def in_si(self, value: Any) -> Any:
        """Return a value, or several values, converted from `unit` to SI."""
        if not self.unit.startswith("um") or isinstance(value, str | None):
            return value
        return tuple(1e-6 * each for each in value) if isinstance(value, list | tuple) else 1e-6 * value

    def checked(self, value: Any, name: str) -> Any:
        """Return the value of a field; raise RecordError if it is impossible."""
        if isinstance(self.kind, tuple):
            choice(value, name, self.kind, error=RecordError)
            return value
        if self.kind == "numbers" and (not isinstance(value, Sequence | np.ndarray) or len(value) < 2):
            got = repr(value) if np.ndim(value) == 0 else counted(len(value), "value")
            raise RecordError(argument=name, got=got, need="two at least, such as 0,10,20")
        check = _CHECKS.get(self.unit) or partial(whole, least=self.least)
        return tuple(check(each, name) for each in value) if self.kind == "numbers" else check(value, name)


_CHECKS: dict[str, Callable[[Any, str], Any]] = {
    **{"um": length, "share": share},
    **dict.fromkeys(("Hz", "s", "um/s", "um/s2"), positive),
}


@cache
def options_of(scan: type[Scan]) -> dict[str, ScanOption]:
    """Return the options that the fields of a scan declare, by their names."""
    hints = get_type_hints(scan, include_extras=True)
    found = {}
    for entry in fields(scan):  # type: ignore[arg-type]
        for hint in (hints[entry.name], *get_args(hints[entry.name])):
            if isinstance(option := getattr(hint, "__metadata__", (None,))[0], ScanOption):
                kind, words = hint.__origin__, get_args(hint.__origin__)
                if words:
                    kind = words if isinstance(words[0], str) else "numbers"
                found[entry.name] = option._replace(kind=kind)
    return found


# Fields of several scans.
Low: TypeAlias = Annotated[float, ScanOption("um", "Lowest displacement, along x")]
High: TypeAlias = Annotated[float, ScanOption("um", "Highest displacement, along x")]
Frequency: TypeAlias = Annotated[float, ScanOption("Hz", "Cycles or lines a second")]
_DEFAULT_TURNS = "0.1, or as short as the acceleration allows"
Turns: TypeAlias = Annotated[float, ScanOption("share", "Share of the time spent turning", _DEFAULT_TURNS)]
Speed: TypeAlias = Annotated[float, ScanOption("um/s", "Largest speed of an axis")]
Acceleration: TypeAlias = Annotated[float, ScanOption("um/s2", "Largest acceleration of an axis")]
Rising: TypeAlias = Annotated[float, ScanOption("share", "Share of the time spent rising", "0.5")]
SampleRate: TypeAlias = Annotated[float, ScanOption("Hz", "Samples a second")]


class Travel(NamedTuple):
    """Displacement [m], velocity [m/s] and acceleration [m/s^2] (n,)."""

    displacement: Array
    velocity: Array
    acceleration: Array

    @classmethod
    def joined(cls, parts: Iterable[Travel]) -> Travel:
        """Return successive motions as one."""
        return cls(*map(np.concatenate, zip(*parts, strict=True)))


@dataclass(frozen=True)
class Edge:
    """A motion from rest to rest: at constant speed except at both ends, where its acceleration is constant.

    `start`, `end` [m]. `seconds`: duration. `blend`: duration of each end [s], 0 to half of `seconds`.
    """

    start: float
    end: float
    seconds: float
    blend: float

    @property
    def speed(self) -> float:
        """Velocity on the straight part [m/s]; negative if the edge falls."""
        return (self.end - self.start) / (self.seconds - self.blend)

    @property
    def acceleration(self) -> float:
        """Largest abs(acceleration) [m/s^2]."""
        return abs(self.speed) / self.blend if self.blend else inf

    def at(self, time: Array) -> Travel:
        """Return the motion at times (n,) [s] from its start."""
        # The time counts from the nearer end, so that the motion is exact at both ends.
        late = time > 0.5 * self.seconds
        since = np.clip(np.where(late, self.seconds - time, time), 0.0, None)
        share, v = np.clip(since / self.blend, 0.0, 1.0), self.speed
        moved = v * (self.blend * 0.5 * share**2 + np.clip(since - self.blend, 0.0, None))
        y = np.where(late, self.end - moved, self.start + moved)
        push = np.where(share < 1, 1.0, 0.0)
        return Travel(y, v * share, np.where(late, -1.0, 1.0) * push * v / self.blend)


def least_blend(height: float, seconds: float, acceleration: float) -> float:
    """Return the shortest `blend` [s] within the acceleration [m/s^2]; half of the seconds if no blend is possible.

    It solves ``acceleration blend (seconds - blend) = height``.
    """
    square = seconds**2 - 4 * height / acceleration
    # This form of the smaller root has no difference of two nearly equal numbers.
    blend = 2 * height / acceleration / (seconds + sqrt(max(square, 0.0)))
    return min(blend, 0.5 * seconds)


@dataclass(frozen=True)
class Step:
    """The motion of least jerk from rest to rest, a polynomial of fifth degree: `start`, `end` [m], `seconds`."""

    start: float
    end: float
    seconds: float

    def at(self, time: Array) -> Travel:
        """Return the motion at times (n,) [s] from its start."""
        height, s, t = self.end - self.start, np.asarray(time) / self.seconds, self.seconds
        way = np.polynomial.Polynomial([0.0, 0.0, 0.0, 10 * height, -15 * height, 6 * height])
        return Travel(self.start + way(s), way.deriv(1)(s) / t, way.deriv(2)(s) / t**2)

    @property
    def peaks(self) -> tuple[float, float]:
        """Largest abs(velocity) [m/s] and abs(acceleration) [m/s^2]."""
        height = abs(self.end - self.start)
        return FASTEST * height / self.seconds, HARDEST * height / self.seconds**2


@dataclass(frozen=True, eq=False)
class ScanPath:
    """A wanted displacement on uniform samples.

    Parameters
    ----------
    displacement, velocity, acceleration : (n,) array_like
        [m], [m/s], [m/s^2]; velocity and acceleration are the true derivatives. Kept as read-only copies.
    sample_rate : float
        [Hz].
    periodic : bool
        Whether the path continues from the last sample to the first sample.

    Raises
    ------
    RecordError
        If the rows are empty, have different lengths, or hold values that are not finite.
    """

    displacement: Array
    velocity: Array
    acceleration: Array
    sample_rate: float
    periodic: bool = True

    def __post_init__(self) -> None:
        for name in Travel._fields:
            row = vector(getattr(self, name), name, error=RecordError)
            if not row.size or row.size != np.size(self.displacement):
                got = f"{row.size} values for {np.size(self.displacement)} displacements"
                raise RecordError(argument=name, got=got, need="the same number, at least one")
            keep(self, **{name: row})
        keep(self, sample_rate=positive(self.sample_rate, "sample_rate"))

    def __len__(self) -> int:
        return self.displacement.size

    @property
    def time(self) -> Array:
        """Time of each sample (n,) [s], from 0."""
        return np.arange(len(self)) / self.sample_rate

    @property
    def rows(self) -> Travel:
        """Displacement, velocity and acceleration (n,)."""
        return Travel(self.displacement, self.velocity, self.acceleration)

    @property
    def range(self) -> tuple[float, float]:
        """Lowest and highest displacement [m]."""
        return float(self.displacement.min()), float(self.displacement.max())

    def repeated(self, cycles: int) -> ScanPath:
        """Return a number of periods and the sample that closes the last period; for 0 periods the first sample.

        Raise `RecordError` if the path is not periodic, `cycles` is invalid, or there are more than 5e7 samples.
        """
        if not self.periodic:
            raise RecordError(argument="cycles", got="a path that ends elsewhere than it begins", need="a periodic one")
        times = whole(cycles, "cycles", 0)
        refuse_long(times * len(self) + 1, self.sample_rate)
        rows = Travel(*(np.append(np.tile(row, times), row[0]) for row in self.rows))
        return ScanPath(*rows, self.sample_rate, periodic=False)


class Scan(ABC):
    """A path for each axis (`axes`: names of the axes); the fields are the options of the scan.

    Fields of most scans: `frequency`: periods per second [Hz]. `speed` [m/s], `acceleration` [m/s^2]: largest allowed
    values of any axis. `sample_rate` [Hz]: by default 400 samples per cycle. The number of samples of a period is
    rounded up, so a scan is never faster than requested. It raises `RecordError`, with a remedy, if a number is
    impossible or the limits cannot be kept.
    """

    axes: ClassVar[tuple[str, ...]] = ("x",)
    frequency: float | None
    speed: float | None
    acceleration: float | None
    sample_rate: float | None

    def __post_init__(self) -> None:
        for name, option in options_of(type(self)).items():
            if (value := getattr(self, name)) is not None or getattr(type(self), name, 0) is not None:
                keep(self, **{name: option.checked(value, name)})

    @property
    def limits(self) -> MotionLimits:
        """Largest speed and acceleration allowed."""
        return MotionLimits(self.speed, self.acceleration)

    @property
    def rate(self) -> float:
        """Sample rate [Hz]."""
        return self._usual_rate if self.sample_rate is None else self.sample_rate

    @property
    @abstractmethod
    def _usual_rate(self) -> float: ...

    @property
    @abstractmethod
    def samples(self) -> int:
        """Samples of a period."""

    @property
    def period(self) -> float:
        """Duration of a period in whole samples [s]."""
        return self.samples / self.rate

    @property
    def requested_period(self) -> float | None:
        """Requested duration of a period [s]; None if none was requested."""
        return None if self.frequency is None else 1 / self.frequency

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences about differences of the scan from the request."""
        requested = self.requested_period
        if requested is None or abs(self.period / requested - 1) <= 1e-9:
            return ()
        return (
            f"a period takes {self.samples} samples at {self.rate:.9g} Hz: {1 / self.period:.9g} Hz instead of "
            f"{1 / requested:.9g} Hz",
        )

    def path(self, axis: str = "x") -> ScanPath:
        """Return one period of an `axis`; raise `RecordError` if there is no such axis."""
        choice(axis, "axis", self.axes, error=RecordError)
        return ScanPath(*self._travel(axis), self.rate)

    @abstractmethod
    def _travel(self, axis: str) -> Travel: ...


@dataclass(frozen=True)
class MotionLimits:
    """Largest abs(velocity) `speed` [m/s] and abs(`acceleration`) [m/s^2] of an axis; None: not limited."""

    speed: float | None = None
    acceleration: float | None = None

    def refuse(self, what: str, peaks: tuple[float, float], frequency: float, height: float) -> None:
        """Raise RecordError if `what`, of a frequency [Hz], a height [m] and `peaks`, exceeds a limit."""
        v, a = (self.speed or inf) / peaks[0], (self.acceleration or inf) / peaks[1]
        if min(v, a) >= 1 - SLACK:
            return
        name, worst, unit = ("speed", 0, "um/s") if v < a else ("acceleration", 1, "um/s^2")
        raise RecordError(
            argument=name,
            got=f"{getattr(self, name) * 1e6:.6g} {unit}, but {what} needs {peaks[worst] * 1e6:.6g} {unit}",
            hint=f"try {rounded(frequency * min(v, sqrt(a)), floor)} Hz or less in place of {frequency:.6g}, or "
            f"{rounded(height * min(v, a) * 1e6, floor)} um in place of {height * 1e6:.6g}",
        )

    @property
    def words(self) -> str:
        """The limits that are given, in words."""
        given = (self.acceleration, "um/s^2"), (self.speed, "um/s")
        return " and ".join(f"{value * 1e6:.6g} {unit}" for value, unit in given if value is not None)

    def allow(self, peaks: tuple[float, float]) -> bool:
        """Return whether `peaks`, a speed [m/s] and an acceleration [m/s^2], are within the limits."""
        pairs = zip(peaks, (self.speed, self.acceleration), strict=True)
        return all(limit is None or peak <= limit * (1 + SLACK) for peak, limit in pairs)
