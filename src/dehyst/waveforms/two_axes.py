"""Scans of two axes: raster, Lissajous figure and spiral."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import ceil, gcd, pi
from typing import ClassVar, Literal, TypeAlias, get_args

import numpy as np

from dehyst._errors import RecordError
from dehyst._text import counted
from dehyst._types import Array
from dehyst._validation import choice, keep
from dehyst.waveforms.excitation import positive, refuse_long, set_checked
from dehyst.waveforms.one_axis import Triangle
from dehyst.waveforms.scan import (
    CYCLE_SAMPLES,
    Bridge,
    Edge,
    MotionLimits,
    PathPoint,
    Rounding,
    Scan,
    Travel,
    above,
    between,
    length,
    samples_of,
    share,
    whole,
)

Slow: TypeAlias = Literal["staircase", "ramp"]
# Fields of the triangle along x.
_FAST = ("low", "high", "frequency", "turns", "speed", "acceleration", "rising", "rounding", "sample_rate")


@dataclass(frozen=True)
class Raster(Scan):
    """Lines along x, each forth and back, at places along y from `y_low` to `y_high`; then back to the first line.

    Parameters
    ----------
    low, high, frequency, turns, speed, acceleration, rising, rounding, sample_rate
        Of the triangle along x, as in `Triangle`; the frequency is that of lines [Hz]. The limits of speed and
        acceleration apply along y too.
    lines : int
        2 or more.
    y_low, y_high : float, optional
        Places of the first and the last line [m]; by default `low` and `high`. A ramp is there at the beginning of the
        first line and at the end of the last.
    slow : {"staircase", "ramp"}
        Whether y stands still on the way forth and goes to the next line on the way back, with the least jerk; or
        moves at constant speed.
    back : int, optional
        Periods of x after the last line, while y goes back to the first; by default the fewest that keep the limits of
        speed and acceleration, or, where these are not given, the largest speed and acceleration of x. A staircase
        also uses the way back of the last line. A ramp is joined smoothly, and overshoots a little on its way.

    Raises
    ------
    RecordError
        If a number is impossible, or the limits cannot be kept; the message states what can be done.
    """

    axes: ClassVar[tuple[str, ...]] = ("x", "y")

    low: float
    high: float
    frequency: float
    lines: int
    y_low: float | None = None
    y_high: float | None = None
    slow: Slow = "staircase"
    back: int | None = None
    turns: float | None = None
    speed: float | None = None
    acceleration: float | None = None
    rising: float = 0.5
    rounding: Rounding = "parabola"
    sample_rate: float | None = None

    def __post_init__(self) -> None:
        keep(self, **{name: getattr(self.fast, name) for name in _FAST})
        ends = self.low if self.y_low is None else self.y_low, self.high if self.y_high is None else self.y_high
        y_low, y_high = between(*ends, ("y_low", "y_high"))
        keep(self, y_low=y_low, y_high=y_high, lines=whole(self.lines, "lines", 2))
        choice(self.slow, "slow", get_args(Slow), error=RecordError)
        self._refuse_steep()
        if self.back is not None:
            keep(self, back=whole(self.back, "back", 0 if self.slow == "staircase" else 1))
            what = f"y on its way back in {counted(self.back, 'line')}"
            self.limits.refuse(what, self._return(self.back).peaks, self.frequency, self._height)
        refuse_long(self.samples, self.rate)

    @cached_property
    def fast(self) -> Triangle:
        """The triangle along x."""
        return Triangle(**{name: getattr(self, name) for name in _FAST})

    @property
    def rate(self) -> float:
        """Samples a second [Hz]."""
        return self.fast.rate

    @cached_property
    def pause(self) -> int:
        """Periods of x after the last line, for the way back."""
        if self.back is not None:
            return self.back
        speed, acceleration = self.fast.peaks
        limits = MotionLimits(self.speed or speed, self.acceleration or acceleration)
        # The longer it takes, the gentler it is.
        low, high = 0 if self.slow == "staircase" else 1, 100 * self.lines - 1
        if limits.allow(self._return(high).peaks):
            while low < high:
                middle = (low + high) // 2
                low, high = (low, middle) if limits.allow(self._return(middle).peaks) else (middle + 1, high)
            return low
        raise RecordError(
            f"got none, and y does not come back within {100 * self.lines} lines",
            argument="back",
            hint="give the number of lines that it may take, or wider limits",
        )

    @property
    def samples(self) -> int:
        """Samples of a frame."""
        return (self.lines + self.pause) * self.fast.samples

    @property
    def requested_period(self) -> float | None:
        """Requested duration of a frame [s]."""
        return (self.lines + self.pause) / self.frequency

    def travel(self, axis: str) -> Travel:
        """Return displacement, velocity and acceleration at each sample of a frame."""
        if axis == "x":
            return Travel(*(np.tile(row, self.lines + self.pause) for row in self.fast.travel("x")))
        parts = self._stairs() if self.slow == "staircase" else [self._ramp()]
        back = self._return(self.pause)
        parts.append(back.at(self._times(self.samples - sum(part[0].size for part in parts))))
        return Travel(*(np.concatenate(rows) for rows in zip(*parts, strict=True)))

    def _stairs(self) -> list[Travel]:
        """Return y on all lines, without the way back to the first."""
        forth, retrace = self.fast.legs
        levels, still = self.levels, np.zeros(forth)
        step = Bridge(PathPoint(0.0), PathPoint(self._height / (self.lines - 1)), retrace / self.rate).at(
            self._times(retrace)
        )
        line = Travel(*(np.concatenate([still, row]) for row in step))
        y = levels[:-1, None] + line.displacement
        v, a = (np.tile(row, self.lines - 1) for row in line[1:])
        return [Travel(y.ravel(), v, a), Travel(still + levels[-1], still, still)]

    @property
    def levels(self) -> Array:
        """Places of the lines of a staircase along y (lines,) [m]."""
        return np.linspace(*self._ends, self.lines)

    def _ramp(self) -> Travel:
        count = self.lines * self.fast.samples
        y = self._ends[0] + self._height * (np.arange(count) / count)
        return Travel(y, np.full(count, self._slope), np.zeros(count))

    def _return(self, back: int) -> Bridge:
        """Return y on its way back to the first line, in `back` periods of x and the rest of the last line."""
        (low, high), line = self._ends, self.fast.samples
        if self.slow == "staircase":
            return Bridge(PathPoint(high), PathPoint(low), (back * line + self.fast.legs[1]) / self.rate)
        return Bridge(PathPoint(high, self._slope), PathPoint(low, self._slope), back * line / self.rate)

    @property
    def _ends(self) -> tuple[float, float]:
        return between(self.y_low, self.y_high)

    @property
    def _height(self) -> float:
        return self._ends[1] - self._ends[0]

    @property
    def _slope(self) -> float:
        """Speed of a ramp [m/s]."""
        return self._height * self.rate / (self.lines * self.fast.samples)

    def _refuse_steep(self) -> None:
        if self.slow == "staircase":
            height = self._height / (self.lines - 1)
            step = Bridge(PathPoint(0.0), PathPoint(height), self.fast.legs[1] / self.rate)
            self.limits.refuse("a step to the next line", step.peaks, self.frequency, height)
        elif self.speed is not None and self._slope > self.speed:
            self.limits.refuse("the ramp", (self._slope, 1e-300), self.frequency, self._height)

    def _times(self, count: int) -> Array:
        return np.arange(count) / self.rate


@dataclass(frozen=True)
class Lissajous(Scan):
    """``x = cx + ax sin(2 pi p f t)``, ``y = cy + ay sin(2 pi q f t + phase)``.

    Parameters
    ----------
    amplitude, centre : (float, float)
        a and c along x and y [m].
    frequency : float
        f, periods of the whole figure a second [Hz].
    ratio : (int, int)
        p and q, without a common factor.
    phase : float, optional
        [rad]; by default the phase at which the lines of the figure lie farthest apart. Such phases are pi/p apart;
        halfway between two of them the figure retraces its own line.
    speed, acceleration : float, optional
        Largest abs(dx/dt) [m/s] and abs(d2x/dt2) [m/s^2] allowed, of either axis.
    sample_rate : float, optional
        Samples a second [Hz]; by default 400 a period of the faster axis.

    Raises
    ------
    RecordError
        If a number is impossible, or the limits cannot be kept; the message states what can be done.
    """

    axes: ClassVar[tuple[str, ...]] = ("x", "y")

    amplitude: tuple[float, float]
    frequency: float
    ratio: tuple[int, int] = (1, 1)
    phase: float | None = None
    centre: tuple[float, float] = (0.0, 0.0)
    speed: float | None = None
    acceleration: float | None = None
    sample_rate: float | None = None

    def __post_init__(self) -> None:
        set_checked(self, positive, "frequency")
        for name in ("amplitude", "centre", "ratio"):
            if not isinstance(getattr(self, name), Sequence) or len(getattr(self, name)) != 2:
                raise RecordError(argument=name, got=repr(getattr(self, name)), need="a pair, for x and y")
        keep(self, amplitude=tuple(positive(length(a, "amplitude"), "amplitude") for a in self.amplitude))
        keep(self, centre=tuple(length(c, "centre") for c in self.centre))
        p, q = (whole(part, "ratio") for part in self.ratio)
        if gcd(p, q) > 1:
            raise RecordError(
                argument="ratio",
                got=f"{p} and {q}",
                need="whole numbers without a common factor",
                hint=f"try {p // gcd(p, q)} and {q // gcd(p, q)} at {self.frequency * gcd(p, q):.6g} Hz",
            )
        set_checked(self, positive, optional=("speed", "acceleration", "sample_rate"))
        # Backwards from c/2 on, c an odd multiple of pi/p, x is the same; so is y if q c + 2 phase is one of pi.
        widest = 0.5 * pi * (1 + (1 - q) / p)
        keep(self, phase=widest if self.phase is None else _angle(self.phase))
        # The harder axis first, so that the values in a message are possible for both.
        for axis in sorted((0, 1), key=lambda i: -self.amplitude[i] * self.ratio[i] ** 2):
            turning, a = 2 * pi * self.ratio[axis] / self.period, self.amplitude[axis]
            self.limits.refuse(f"{'xy'[axis]} of this figure", (a * turning, a * turning**2), self.frequency, a)

    @property
    def rate(self) -> float:
        """Samples a second [Hz]."""
        return CYCLE_SAMPLES * self.frequency * max(self.ratio) if self.sample_rate is None else self.sample_rate

    @cached_property
    def samples(self) -> int:
        """Samples of a period."""
        _ = samples_of(0.5 / self.frequency / max(self.ratio), self.rate)
        return samples_of(1 / self.frequency, self.rate)

    def travel(self, axis: str) -> Travel:
        """Return displacement, velocity and acceleration at each sample."""
        i = int(axis == "y")
        turning, a = 2 * pi * self.ratio[i] / self.period, self.amplitude[i]
        # Whole turns are subtracted before the factor 2 pi: that keeps the digits.
        share = np.arange(self.samples) * self.ratio[i] % self.samples / self.samples
        angle = 2 * pi * share + (self.phase or 0.0 if i else 0.0)
        sin = a * np.sin(angle)
        return Travel(self.centre[i] + sin, a * turning * np.cos(angle), -(turning**2) * sin)


def _angle(value: object) -> float:
    if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= 1e3:
        return float(value)
    raise RecordError(argument="phase", got=repr(value), need="an angle in radians")


Constant: TypeAlias = Literal["linear", "angular"]

# Gauss's rule on panels of this many radians gives lengths to the last digits: r(phi) bends over one radian.
_PANEL, _NODES = 0.25, 10
_NEWTON = 8
_REVOLUTION_SAMPLES = 100
# Radians a sample at the centre: by default, and those above which there is a warning.
_CENTRE, _COARSE = 0.25, 0.6


@dataclass(frozen=True)
class Spiral(Scan):
    """Archimedes' spiral out to the radius, and back to the centre still turning the same way.

    ``x = r cos(phi), y = r sin(phi)`` about the centre; r grows evenly with phi, except where it turns at the rim. The
    way out takes `revolutions` + 1/4, and so does the way back: then the path through the centre is straight, and the
    scan closes.

    Parameters
    ----------
    radius : float
        [m], met exactly.
    revolutions : int
        1 or more.
    frequency : float
        Ways out and back a second [Hz].
    constant : {"linear", "angular"}
        The speed that is constant; with a constant angular speed the centre is scanned slowly.
    centre : (float, float)
        [m].
    turns : float
        Share of the angle in which the radius turns, at the rim; above 0 and up to 1.
    speed, acceleration : float, optional
        Largest abs(dx/dt) and abs(d2x/dt2) allowed, of either axis.
    rounding : {"parabola", "cosine"}
        How the radius turns, as in `Triangle`.
    sample_rate : float, optional
        Samples a second [Hz]; by default 100 a revolution, or more if a sample at the centre would take more than
        about 1/4 rad.

    Raises
    ------
    RecordError
        If a number is impossible, or the limits cannot be kept; the message states what can be done.
    """

    axes: ClassVar[tuple[str, ...]] = ("x", "y")

    radius: float
    revolutions: int
    frequency: float
    constant: Constant = "linear"
    centre: tuple[float, float] = (0.0, 0.0)
    turns: float = 0.1
    speed: float | None = None
    acceleration: float | None = None
    rounding: Rounding = "parabola"
    sample_rate: float | None = None

    def __post_init__(self) -> None:
        keep(self, radius=positive(length(self.radius, "radius"), "radius"))
        set_checked(self, positive, "frequency", optional=("speed", "acceleration", "sample_rate"))
        set_checked(self, share, "turns")
        set_checked(self, whole, "revolutions")
        x, y = self.centre
        keep(self, centre=(length(x, "centre"), length(y, "centre")))
        choice(self.constant, "constant", get_args(Constant), error=RecordError)
        choice(self.rounding, "rounding", get_args(Rounding), error=RecordError)
        _ = self.samples
        if self.speed is not None or self.acceleration is not None:
            self.limits.refuse("this spiral", self._peaks(), self.frequency, self.radius)

    @property
    def rate(self) -> float:
        """Samples a second [Hz]."""
        if self.sample_rate is not None:
            return self.sample_rate
        steady = _REVOLUTION_SAMPLES * self._half / pi
        # At constant linear speed the length each way is about half of the square of the angle, in units of r'.
        count = steady if self.constant == "angular" else max(steady, self._half**2 / _CENTRE)
        return self.frequency * 2 * ceil(0.5 * count * (1 - 1e-12))

    @cached_property
    def samples(self) -> int:
        """Samples of a period."""
        _ = samples_of(0.25 / self.frequency / (self.revolutions + 0.25), self.rate)
        # Two halves: one sample lies on the rim.
        return 2 * samples_of(0.5 / self.frequency, self.rate)

    @property
    def pitch(self) -> float:
        """Distance from one track to the next on the way out [m]."""
        return float(self._rim.speed) * 2 * pi

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences about what differs from the request."""
        step = float(self._angles(self.samples)[1].max()) / self.rate
        if step <= _COARSE:
            return super().warnings
        coarse = (
            f"near the centre it turns by {step:.2g} rad a sample, which makes corners; try a sample rate of "
            f"{above(self.rate * step / _CENTRE)} Hz"
        )
        return (*super().warnings, coarse)

    def travel(self, axis: str) -> Travel:
        """Return displacement, velocity and acceleration at each sample."""
        return self._travel(self.samples)[axis == "y"]

    @property
    def _half(self) -> float:
        """Angle of the way out [rad]."""
        return 2 * pi * (self.revolutions + 0.25)

    @property
    def _rim(self) -> Edge:
        """The radius over the angle: from the rim, where it is negative, through the centre to the rim."""
        seconds = 2 * self._half
        return Edge(-self.radius, self.radius, seconds, 0.5 * self.turns * seconds, self.rounding)

    def _radius(self, angle: Array) -> Travel:
        """Return r, dr/dphi and d2r/dphi2 at angles [rad] from the centre."""
        back = angle > self._half
        r, slope, bend = self._rim.at(np.where(back, 2 * self._half - angle, angle) + self._half)
        return Travel(r, np.where(back, -slope, slope), bend)

    def _travel(self, count: int) -> tuple[Travel, Travel]:
        """Return both axes at `count` equal parts of a period."""
        angle, rate, acceleration = self._angles(count)
        r, slope, bend = self._radius(angle)
        axes = []
        for centre, cos, sin in zip(
            self.centre, (np.cos(angle), np.sin(angle)), (np.sin(angle), -np.cos(angle)), strict=True
        ):
            along = slope * cos - r * sin
            second = (bend - r) * cos - 2 * slope * sin
            axes.append(Travel(centre + r * cos, along * rate, second * rate**2 + along * acceleration))
        return axes[0], axes[1]

    def _angles(self, count: int) -> tuple[Array, Array, Array]:
        """Return the angle [rad], its rate [rad/s] and its acceleration [rad/s^2] at equal parts of a period."""
        share = np.arange(count) / count
        if self.constant == "angular":
            return 2 * self._half * share, np.full(count, 2 * self._half / self.period), np.zeros(count)
        ends, lengths = self._lengths()
        angle = _inverse(self._stride, ends, lengths, share * lengths[-1])
        r, slope, bend = self._radius(angle)
        stride, speed = np.hypot(r, slope), lengths[-1] / self.period
        rate = speed / stride
        return angle, rate, -(rate**2) * slope * (r + bend) / stride**2

    def _stride(self, angle: Array) -> Array:
        """Return the length of the track a radian [m]."""
        r, slope, _ = self._radius(angle)
        return np.hypot(r, slope)

    def _lengths(self) -> tuple[Array, Array]:
        """Return the angles that cut the track into smooth panels, and its length up to each [m]."""
        half, blend = self._half, self._rim.blend
        corners = [0.0, half - blend, half, half + blend, 2 * half]
        parts = [np.linspace(a, b, ceil((b - a) / _PANEL) + 1)[:-1] for a, b in pairwise(corners)]
        ends = np.append(np.concatenate(parts), 2 * half)
        return ends, np.concatenate([[0.0], np.cumsum(_integral(self._stride, ends[:-1], ends[1:]))])

    def _peaks(self) -> tuple[float, float]:
        """Return the largest speed and acceleration of an axis, on four times the samples."""
        axes = self._travel(4 * self.samples)
        speed = max(float(np.abs(axis.velocity).max()) for axis in axes)
        return speed, max(float(np.abs(axis.acceleration).max()) for axis in axes)


def _integral(function: Callable[[Array], Array], start: Array, stop: Array) -> Array:
    """Return the integrals from each start to its stop, by Gauss's rule."""
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    half = 0.5 * (stop - start)
    values = function((start + half)[:, None] + half[:, None] * nodes)
    return np.asarray(half * (values @ weights))


def _inverse(function: Callable[[Array], Array], ends: Array, integrals: Array, wanted: Array) -> Array:
    """Return where the integral of a positive function reaches each wanted value, by Newton's rule in its panel."""
    panel = np.clip(np.searchsorted(integrals, wanted, side="right") - 1, 0, ends.size - 2)
    start, stop, rest = ends[panel], ends[panel + 1], wanted - integrals[panel]
    at = start + (stop - start) * rest / (integrals[panel + 1] - integrals[panel])
    for _ in range(_NEWTON):
        at = np.clip(at - (_integral(function, start, at) - rest) / function(at), start, stop)
    return at
