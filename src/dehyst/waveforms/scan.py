"""Scans: a wanted path for each axis over a whole number of samples a period, and motion profiles."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import ceil, floor, inf, log10, pi, sqrt
from typing import ClassVar, Literal, NamedTuple, TypeAlias

import numpy as np

from dehyst._errors import RecordError
from dehyst._types import Array
from dehyst._validation import choice, count, keep, number, vector
from dehyst.waveforms.excitation import positive, refuse_long, set_checked

Rounding: TypeAlias = Literal["parabola", "cosine"]

# Of a rounded end: its displacement over speed times time, and its largest acceleration over speed per time.
_ROUNDED: dict[str, tuple[float, float]] = {"parabola": (0.5, 1.0), "cosine": (0.5 + 2 / pi**2, 2.0)}


class Travel(NamedTuple):
    """Displacement [m], velocity [m/s] and acceleration [m/s^2] (n,)."""

    displacement: Array
    velocity: Array
    acceleration: Array


class PathPoint(NamedTuple):
    """Displacement [m], velocity [m/s] and acceleration [m/s^2] at one time."""

    displacement: float
    velocity: float = 0.0
    acceleration: float = 0.0


@dataclass(frozen=True)
class Edge:
    """A motion from rest to rest: at constant speed except at both ends, where it speeds up and slows down.

    `start`, `end` [m]. `seconds`: duration. `blend`: duration of each end [s], where the speed changes; 0 to half of
    `seconds`. `rounding`: constant acceleration at the ends, or one that falls to 0 like half a cosine where the
    straight part begins: then it has no jump in the turn between two edges.
    """

    start: float
    end: float
    seconds: float
    blend: float
    rounding: Rounding = "parabola"

    @property
    def speed(self) -> float:
        """Velocity on the straight part [m/s]; negative if the edge falls."""
        way = _ROUNDED[self.rounding][0]
        return (self.end - self.start) / (self.seconds - 2 * (1 - way) * self.blend)

    @property
    def acceleration(self) -> float:
        """Largest abs(acceleration) [m/s^2]."""
        return _ROUNDED[self.rounding][1] * abs(self.speed) / self.blend if self.blend else inf

    def at(self, time: Array) -> Travel:
        """Return the motion at times (n,) [s] from its start."""
        # Counted from the nearer end, so that both ends are met exactly.
        late = time > 0.5 * self.seconds
        since = np.clip(np.where(late, self.seconds - time, time), 0.0, None)
        share, v = np.clip(since / self.blend, 0.0, 1.0), self.speed
        if self.rounding == "parabola":
            way, speed, push = 0.5 * share**2, share, np.where(share < 1, 1.0, 0.0)
        else:
            way = 0.5 * share**2 + (1 - np.cos(pi * share)) / pi**2
            speed = np.where(share < 1, share + np.sin(pi * share) / pi, 1.0)
            push = np.where(share < 1, 1 + np.cos(pi * share), 0.0)
        moved = v * (self.blend * way + np.clip(since - self.blend, 0.0, None))
        y = np.where(late, self.end - moved, self.start + moved)
        return Travel(y, v * speed, np.where(late, -1.0, 1.0) * push * v / self.blend)


def least_seconds(height: float, speed: float | None, acceleration: float | None, rounding: Rounding) -> float:
    """Return the shortest time [s] of an edge of `height` [m] within the limits [m/s, m/s^2]; 0 without limits."""
    way, most = _ROUNDED[rounding]
    v, a = speed or inf, acceleration or inf
    if 2 * way * most * v * (v / a) <= height:
        return height / v + 2 * (1 - way) * most * v / a
    return sqrt(2 * most * height / (way * a))


def highest(seconds: float, speed: float | None, acceleration: float | None, rounding: Rounding) -> float:
    """Return the height [m] of the highest edge of a duration [s] within the limits [m/s, m/s^2]."""
    way, most = _ROUNDED[rounding]
    v, a = speed or inf, acceleration or inf
    rounded = way * a * seconds**2 / (2 * most)
    if rounded <= v * way * seconds:
        return rounded
    return v * (seconds - 2 * (1 - way) * most * v / a)


def least_blend(height: float, seconds: float, acceleration: float, rounding: Rounding) -> float:
    """Return the shortest rounded end [s] that keeps the acceleration [m/s^2], or half of the seconds if none does.

    From ``acceleration blend (seconds - 2 (1 - way) blend) = most height``.
    """
    way, most = _ROUNDED[rounding]
    square = seconds**2 - 8 * (1 - way) * most * height / acceleration
    # The smaller root, without a difference of two nearly equal numbers.
    blend = 2 * most * height / acceleration / (seconds + sqrt(max(square, 0.0)))
    return min(blend, 0.5 * seconds)


@dataclass(frozen=True)
class Bridge:
    """The polynomial of fifth degree that joins two motions; from rest to rest it has the least jerk.

    `start`, `end`: displacement, velocity and acceleration at its ends. `seconds`: duration.
    """

    start: PathPoint
    end: PathPoint
    seconds: float

    @property
    def coefficients(self) -> Array:
        """Coefficients (6,) [m] of the powers 0 to 5 of time / `seconds`, relative to the start's displacement."""
        t, (y, v, a), (y1, v1, a1) = self.seconds, self.start, self.end
        way = (y1 - y) - v * t - 0.5 * a * t**2
        speed, push = (v1 - v) * t - a * t**2, (a1 - a) * t**2
        return np.array(
            [
                0.0,
                v * t,
                0.5 * a * t**2,
                10 * way - 4 * speed + 0.5 * push,
                -15 * way + 7 * speed - push,
                6 * way - 3 * speed + 0.5 * push,
            ]
        )

    def at(self, time: Array) -> Travel:
        """Return the motion at times (n,) [s] from its start."""
        polynomial = np.polynomial.Polynomial(self.coefficients)
        s, t = np.asarray(time) / self.seconds, self.seconds
        y, v, a = polynomial(s), polynomial.deriv(1)(s) / t, polynomial.deriv(2)(s) / t**2
        return Travel(self.start.displacement + y, v, a)

    @property
    def peaks(self) -> tuple[float, float]:
        """Largest abs(velocity) [m/s] and abs(acceleration) [m/s^2]."""
        polynomial = np.polynomial.Polynomial(self.coefficients)
        peaks = []
        for order in (1, 2):
            part = polynomial.deriv(order)
            roots = part.deriv().trim().roots()
            inside = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0) & (roots.real < 1)]
            peaks.append(float(np.abs(part(np.concatenate([[0.0, 1.0], inside]))).max()) / self.seconds**order)
        return peaks[0], peaks[1]


# Samples a period, as `Sampling` has by default, and the fewest for each part of a period.
CYCLE_SAMPLES = 400
LEG_SAMPLES = 4
# A limit may be exceeded by this share, so that a motion that meets it exactly passes.
SLACK = 1e-9
_MOST_METRES = 1.0
_MOST_WHOLE = 10**7


@dataclass(frozen=True, eq=False)
class ScanPath:
    """A wanted displacement on uniform samples.

    Parameters
    ----------
    displacement, velocity, acceleration : (n,) array_like
        [m], [m/s], [m/s^2]; velocity and acceleration are the true derivatives. Kept as read-only copies.
    sample_rate : float
        Samples a second [Hz].
    periodic : bool
        Whether the sample after the last one is the first again.

    Raises
    ------
    RecordError
        If the rows are empty or not of one length, or hold what is not finite.
    """

    displacement: Array
    velocity: Array
    acceleration: Array
    sample_rate: float
    periodic: bool = True

    def __post_init__(self) -> None:
        for name in ("displacement", "velocity", "acceleration"):
            row = vector(getattr(self, name), name, error=RecordError)
            if not row.size or row.size != np.size(self.displacement):
                raise RecordError(
                    argument=name,
                    got=f"{row.size} values for {np.size(self.displacement)} displacements",
                    need="as many, and one at least",
                )
            keep(self, **{name: row})
        set_checked(self, positive, "sample_rate")

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

    @property
    def first(self) -> PathPoint:
        """The motion at the first sample."""
        return PathPoint(float(self.displacement[0]), float(self.velocity[0]), float(self.acceleration[0]))

    @property
    def last(self) -> ScanPath:
        """The last sample alone."""
        y, v, a = (row[-1:] for row in self.rows)
        return ScanPath(y, v, a, self.sample_rate, periodic=False)

    def repeated(self, cycles: int) -> ScanPath:
        """Return whole periods and the sample that closes the last one; for 0 periods the first sample.

        `cycles` counts the periods. Raise `RecordError` if the path is not periodic, `cycles` is no number of cycles,
        or there are more than 5e7 samples.
        """
        if not self.periodic:
            raise RecordError(argument="cycles", got="a path that ends elsewhere than it begins", need="a periodic one")
        times = whole(cycles, "cycles", 0)
        refuse_long(times * len(self) + 1, self.sample_rate)
        y, v, a = (np.append(np.tile(row, times), row[0]) for row in self.rows)
        return ScanPath(y, v, a, self.sample_rate, periodic=False)

    def then(self, other: ScanPath) -> ScanPath:
        """Append another path to this one. `other` comes second."""
        y, v, a = (np.concatenate(pair) for pair in zip(self.rows, other.rows, strict=True))
        return ScanPath(y, v, a, self.sample_rate, periodic=False)


class Scan(ABC):
    """A path for each axis.

    The number of samples of a period is rounded up: a scan is never faster than requested. `axes`: their names.
    """

    axes: ClassVar[tuple[str, ...]] = ("x",)
    frequency: float | None
    speed: float | None
    acceleration: float | None
    sample_rate: float | None

    @property
    def limits(self) -> MotionLimits:
        """Largest speed and acceleration allowed."""
        return MotionLimits(self.speed, self.acceleration)

    @property
    def periodic(self) -> bool:
        """Whether it can be repeated."""
        return True

    @property
    @abstractmethod
    def rate(self) -> float:
        """Samples a second [Hz]."""

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
        """Sentences about what differs from the request."""
        requested = self.requested_period
        if requested is None or abs(self.period / requested - 1) <= 1e-9:
            return ()
        return (
            f"a period takes {self.samples} samples at {self.rate:.9g} Hz: {1 / self.period:.9g} Hz for "
            f"{1 / requested:.9g} Hz",
        )

    def path(self, axis: str = "x") -> ScanPath:
        """Return one period of an `axis`, or the whole scan if it is not periodic.

        Raise `RecordError` if there is no such axis.
        """
        choice(axis, "axis", self.axes, error=RecordError)
        return ScanPath(*self.travel(axis), self.rate, self.periodic)

    @abstractmethod
    def travel(self, axis: str) -> Travel:
        """Return displacement, velocity and acceleration at each sample of the `axis` (n,)."""


@dataclass(frozen=True)
class MotionLimits:
    """Largest abs(velocity) [m/s] and abs(`acceleration`) [m/s^2] of an axis, each or None. `speed` [m/s]."""

    speed: float | None = None
    acceleration: float | None = None

    def refuse(self, what: str, peaks: tuple[float, float], frequency: float, height: float) -> None:
        """Raise RecordError if a shape of this `frequency` [Hz] and `height` [m] exceeds a limit.

        `peaks` are its largest speed [m/s], which grows with the frequency, and its largest acceleration [m/s^2], which
        grows with the square of the frequency; both grow with the height. `what` names the shape.
        """
        v, a = (self.speed or inf) / peaks[0], (self.acceleration or inf) / peaks[1]
        if min(v, a) >= 1 - SLACK:
            return
        name, worst, unit = ("speed", 0, "um/s") if v < a else ("acceleration", 1, "um/s^2")
        raise RecordError(
            argument=name,
            got=f"{getattr(self, name) * 1e6:.6g} {unit}, but {what} takes {peaks[worst] * 1e6:.6g} {unit}",
            hint=f"try {below(frequency * min(v, sqrt(a)))} Hz or less in place of {frequency:.6g}, or "
            f"{below(height * min(v, a) * 1e6)} um in place of {height * 1e6:.6g}",
        )

    @property
    def words(self) -> str:
        """The limits that are given, in words."""
        given = (self.acceleration, "um/s^2"), (self.speed, "um/s")
        return " and ".join(f"{value * 1e6:.6g} {unit}" for value, unit in given if value is not None)

    def allow(self, peaks: tuple[float, float]) -> bool:
        """Return whether `peaks`, a speed [m/s] and an acceleration [m/s^2], are within the limits."""
        return all(
            limit is None or peak <= limit * (1 + SLACK)
            for peak, limit in zip(peaks, (self.speed, self.acceleration), strict=True)
        )


def below(value: float) -> str:
    """Write a positive number with four digits, rounded down, so that the value in a message is possible."""
    unit = 10.0 ** (floor(log10(value)) - 3)
    return f"{floor(value * (1 - 1e-6) / unit) * unit:.6g}"


def above(value: float) -> str:
    """Write a positive number with four digits, rounded up."""
    unit = 10.0 ** (floor(log10(value)) - 3)
    return f"{ceil(value * (1 + 1e-6) / unit) * unit:.6g}"


def length(value: object, what: str) -> float:
    """Return `value` as a displacement [m]; raise RecordError for anything else."""
    metres = number(value, what, "m", error=RecordError)
    if abs(metres) > _MOST_METRES:
        raise RecordError(
            argument=what, got=f"{metres * 1e6:g} um", need=f"{_MOST_METRES * 1e6:g} um at most", hint="check its unit"
        )
    return metres


def between(low: object, high: object, names: tuple[str, str] = ("low", "high")) -> tuple[float, float]:
    """Return two displacements [m], the lower one first; raise RecordError for anything else."""
    bottom, top = length(low, names[0]), length(high, names[1])
    if not bottom < top:
        raise RecordError(
            argument=f"{names[0]}, {names[1]}",
            got=f"{bottom * 1e6:.6g} and {top * 1e6:.6g} um",
            need="the lower one first",
        )
    return bottom, top


def share(value: object, what: str, most: float = 1.0) -> float:
    """Return `value` as a share above 0 and up to `most`; raise RecordError for anything else."""
    result = positive(value, what)
    if result > most:
        raise RecordError(argument=what, got=f"{result:g}", need=f"a share above 0 and up to {most:g}")
    return result


def whole(value: object, what: str, least: int = 1) -> int:
    """Return `value` as a whole number from `least` to 1e7; raise RecordError for anything else."""
    return count(value, what, least, _MOST_WHOLE, error=RecordError)


def samples_of(seconds: float, rate: float) -> int:
    """Return the number of samples of a duration [s], rounded up.

    Raise `RecordError` if they are fewer than a leg needs, or more than 5e7.
    """
    samples = seconds * rate * (1 - 1e-12)
    if samples > LEG_SAMPLES - 1:
        refuse_long(int(min(samples, 1e15)) + 1, rate)
        return int(np.ceil(samples))
    few = f"{samples:.3g}"
    raise RecordError(
        argument="sample_rate",
        got=f"{rate:g} Hz, {few} sample{'s' * (few != '1')} for {seconds:.4g} s",
        need=f"{LEG_SAMPLES} at least",
        hint=f"try {LEG_SAMPLES / seconds:.4g} Hz",
    )
