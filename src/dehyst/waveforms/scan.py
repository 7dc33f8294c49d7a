"""The base of all scans: a wanted path for each axis, with a whole number of samples a period."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import ceil, floor, inf, log10, sqrt

import numpy as np

from dehyst._errors import RecordError
from dehyst._types import Array
from dehyst._validation import choice, count, keep, number, vector
from dehyst.waveforms.excitation import positive, refuse_long, set_checked
from dehyst.waveforms.profiles import PathPoint, Travel

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
                    f"{name}: got {row.size} values for {np.size(self.displacement)} displacements, need as many, and "
                    "one at least"
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
        """Return so many periods and the sample that closes the last one; for 0 periods the first sample.

        `cycles` counts the periods. Raise `RecordError` if the path is not periodic, `cycles` is no number of cycles,
        or there are more than 5e7 samples.
        """
        if not self.periodic:
            raise RecordError("cycles: got a path that ends elsewhere than it begins, need a periodic one")
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

    The number of samples of a period is rounded up: a scan is never faster than requested.
    """

    frequency: float | None
    sample_rate: float | None

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes."""
        return ("x",)

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
        name, worst, unit = ("speed", 0, "m/s") if v < a else ("acceleration", 1, "m/s^2")
        raise RecordError(
            f"{name}: got {_both(getattr(self, name), unit)}, but {what} takes {_both(peaks[worst], unit)}; try "
            f"{below(frequency * min(v, sqrt(a)))} Hz or less in place of {frequency:.6g}, or "
            f"{below(height * min(v, a) * 1e6)} um in place of {height * 1e6:.6g}"
        )

    @property
    def words(self) -> str:
        """The limits that are given, in words."""
        given = (self.acceleration, "m/s^2"), (self.speed, "m/s")
        return " and ".join(_both(value, unit) for value, unit in given if value is not None)

    def allow(self, peaks: tuple[float, float]) -> bool:
        """Return whether `peaks`, a speed [m/s] and an acceleration [m/s^2], are within the limits."""
        return all(
            limit is None or peak <= limit * (1 + SLACK)
            for peak, limit in zip(peaks, (self.speed, self.acceleration), strict=True)
        )


def _both(value: float, unit: str) -> str:
    return f"{value:.4g} {unit} ({value * 1e6:.6g} u{unit})"


def below(value: float) -> str:
    """Write a positive number with four digits, rounded down, so that the value in a message is possible."""
    unit = 10.0 ** (floor(log10(value)) - 3)
    return f"{floor(value * (1 - 1e-6) / unit) * unit:.6g}"


def above(value: float) -> str:
    """Write a positive number with four digits, rounded up."""
    unit = 10.0 ** (floor(log10(value)) - 3)
    return f"{ceil(value * (1 + 1e-6) / unit) * unit:.6g}"


def length(value: object, what: str) -> float:
    """Return `value` as a displacement [m]; raise RecordError if it is none."""
    metres = number(value, what, "m", error=RecordError)
    if abs(metres) > _MOST_METRES:
        raise RecordError(f"{what}: got {metres:g} m, need {_MOST_METRES:g} m at most; give metres, such as 5e-6")
    return metres


def between(low: object, high: object, names: tuple[str, str] = ("low", "high")) -> tuple[float, float]:
    """Return two displacements [m], the lower one first; raise RecordError for anything else."""
    bottom, top = length(low, names[0]), length(high, names[1])
    if not bottom < top:
        raise RecordError(f"{names[0]}, {names[1]}: got {bottom:g} and {top:g} m, need the lower one first")
    return bottom, top


def share(value: object, what: str, most: float = 1.0) -> float:
    """Return `value` as a share above 0 and up to `most`; raise RecordError for anything else."""
    result = positive(value, what)
    if result > most:
        raise RecordError(f"{what}: got {result:g}, need a share above 0 and up to {most:g}")
    return result


def whole(value: object, what: str, least: int = 1) -> int:
    """Return `value` as a whole number from `least` to 1e7; raise RecordError for anything else."""
    return count(value, what, least, _MOST_WHOLE, error=RecordError)


def samples_of(seconds: float, rate: float) -> int:
    """Return the number of samples that so many seconds take, rounded up.

    Raise `RecordError` if they are fewer than a leg needs, or more than 5e7.
    """
    samples = seconds * rate * (1 - 1e-12)
    if samples > LEG_SAMPLES - 1:
        refuse_long(int(min(samples, 1e15)) + 1, rate)
        return int(np.ceil(samples))
    few = f"{samples:.3g}"
    raise RecordError(
        f"sample_rate: got {rate:g} Hz, {few} sample{'s' * (few != '1')} for {seconds:.4g} s, need {LEG_SAMPLES} at "
        f"least; try {LEG_SAMPLES / seconds:.4g} Hz"
    )
