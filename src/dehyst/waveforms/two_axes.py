"""Scans of two axes: raster, Lissajous figure and spiral."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import ceil, gcd, pi
from typing import Annotated, ClassVar, Literal, TypeAlias

import numpy as np

import dehyst.waveforms.scan as base
from dehyst._errors import RecordError
from dehyst._text import counted
from dehyst._types import Array
from dehyst._validation import keep
from dehyst.waveforms.excitation import positive, refuse_long
from dehyst.waveforms.one_axis import Triangle
from dehyst.waveforms.scan import Bridge, Edge, MotionLimits, PathPoint, Scan, ScanOption, Travel

Slow: TypeAlias = Literal["staircase", "ramp"]
# Fields of the triangle along x.
_FAST = ("low", "high", "frequency", "turns", "speed", "acceleration", "rising", "rounding", "sample_rate")
YLow: TypeAlias = Annotated[
    float, ScanOption("um", "Lowest displacement along y; the first line of a raster", "as along x")
]
YHigh: TypeAlias = Annotated[
    float, ScanOption("um", "Highest displacement along y; the last line of a raster", "as along x")
]


@dataclass(frozen=True)
class Raster(Scan):
    """Lines along x, each forth and back, at positions along y from `y_low` to `y_high`; then back to the first line.

    `low`, `high`, `frequency`, `turns` and `rising` define the `Triangle` along x; see `Scan` for the other fields.

    Parameters
    ----------
    lines : int
        2 or more.
    y_low, y_high : float, optional
        Positions of the first and the last line [m]; by default `low` and `high`. A ramp reaches them at the beginning
        of the first line and at the end of the last line.
    slow : {"staircase", "ramp"}
        "staircase": y goes to the next line, with the least jerk, while x returns. "ramp": y moves at constant speed.
    back : int, optional
        Periods of x after the last line, while y goes back to the first; by default the fewest within the limits, or
        without limits, within the largest speed and acceleration of x. A staircase also uses the way back of the last
        line. A ramp is joined smoothly, and overshoots a little on its way.
    """

    axes: ClassVar[tuple[str, ...]] = ("x", "y")

    low: base.Low
    high: base.High
    frequency: base.Frequency
    lines: Annotated[int, ScanOption("", "Lines of a raster", least=2)]
    y_low: YLow | None = None
    y_high: YHigh | None = None
    slow: Annotated[Slow, ScanOption("", "Motion of a raster along y")] = "staircase"
    back: Annotated[int, ScanOption("", "Lines that y of a raster takes back", "fewest", 0)] | None = None
    turns: base.Turns | None = None
    speed: base.Speed | None = None
    acceleration: base.Acceleration | None = None
    rising: base.Rising = 0.5
    rounding: base.Turning = "parabola"
    sample_rate: base.SampleRate | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        ends = self.low if self.y_low is None else self.y_low, self.high if self.y_high is None else self.y_high
        _ = self.fast
        y_low, y_high = base.between(*ends, ("y_low", "y_high"))
        keep(self, y_low=y_low, y_high=y_high)
        if self.slow == "staircase":
            height = self._height / (self.lines - 1)
            self.limits.refuse("a step to the next line", self._step.peaks, self.frequency, height)
        elif self.speed is not None and self._slope > self.speed:
            self.limits.refuse("the ramp", (self._slope, 1e-300), self.frequency, self._height)
        if self.back is not None:
            base.whole(self.back, "back", 0 if self.slow == "staircase" else 1)
            what = f"y on its way back in {counted(self.back, 'line')}"
            self.limits.refuse(what, self._return(self.back).peaks, self.frequency, self._height)
        refuse_long(self.samples, self.rate)

    @cached_property
    def fast(self) -> Triangle:
        """The triangle along x."""
        return Triangle(**{name: getattr(self, name) for name in _FAST})

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
        """Requested duration of a frame [s], with the way back."""
        return (self.lines + self.pause) / self.frequency

    def _travel(self, axis: str) -> Travel:
        if axis == "x":
            return Travel(*(np.tile(row, self.lines + self.pause) for row in self.fast.path().rows))
        if self.slow == "staircase":
            still, levels = np.zeros(self.fast.legs[0]), np.linspace(*self._ends, self.lines)
            line = Travel.joined([Travel(still, still, still), self._step.at(np.arange(self.fast.legs[1]) / self.rate)])
            y = levels[:-1, None] + line.displacement
            stairs = Travel(y.ravel(), *(np.tile(row, self.lines - 1) for row in line[1:]))
            parts = [stairs, Travel(still + levels[-1], still, still)]
        else:
            count = self.lines * self.fast.samples
            y = self._ends[0] + self._height * (np.arange(count) / count)
            parts = [Travel(y, np.full(count, self._slope), np.zeros(count))]
        rest = self.samples - sum(part.displacement.size for part in parts)
        return Travel.joined([*parts, self._return(self.pause).at(np.arange(rest) / self.rate)])

    @property
    def _usual_rate(self) -> float:
        return self.fast.rate

    @property
    def _step(self) -> Bridge:
        """Return y of a staircase from one line to the next, from 0."""
        return Bridge(PathPoint(0.0), PathPoint(self._height / (self.lines - 1)), self.fast.legs[1] / self.rate)

    def _return(self, back: int) -> Bridge:
        """Return y on its way back to the first line, in `back` periods of x and the rest of the last line."""
        (low, high), line = self._ends, self.fast.samples
        if self.slow == "staircase":
            return Bridge(PathPoint(high), PathPoint(low), (back * line + self.fast.legs[1]) / self.rate)
        return Bridge(PathPoint(high, self._slope), PathPoint(low, self._slope), back * line / self.rate)

    @property
    def _ends(self) -> tuple[float, float]:
        return base.between(self.y_low, self.y_high)

    @property
    def _height(self) -> float:
        return self._ends[1] - self._ends[0]

    @property
    def _slope(self) -> float:
        """Speed of a ramp [m/s]."""
        return self._height * self.rate / (self.lines * self.fast.samples)


@dataclass(frozen=True)
class Lissajous(Scan):
    """``x = cx + ax sin(2 pi p f t)``, ``y = cy + ay sin(2 pi q f t + phase)``.

    f is the `frequency`; the faster axis has 400 samples a period. See `Scan` for the fields that are not listed.

    Parameters
    ----------
    amplitude, centre : (float, float)
        a and c along x and y [m].
    ratio : (int, int)
        p and q, without a common factor.
    phase : float, optional
        [rad]; by default the phase at which the lines of the figure lie farthest apart. Such phases are pi/p apart;
        halfway between two of these phases, the figure retraces its own line.
    """

    axes: ClassVar[tuple[str, ...]] = ("x", "y")

    amplitude: Annotated[tuple[float, float], ScanOption("um", "Amplitudes along x and y")]
    frequency: base.Frequency
    ratio: Annotated[tuple[int, int], ScanOption("", "Cycles of x and y of a Lissajous figure", "1 1")] = (1, 1)
    phase: Annotated[float, ScanOption("degrees", "Phase of y of a Lissajous figure", "widest figure")] | None = None
    centre: base.Centre = (0.0, 0.0)
    speed: base.Speed | None = None
    acceleration: base.Acceleration | None = None
    sample_rate: base.SampleRate | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        keep(self, amplitude=tuple(positive(a, "amplitude") for a in self.amplitude))
        p, q = self.ratio
        if (common := gcd(p, q)) > 1:
            hint = f"try {p // common} and {q // common} at {self.frequency * common:.6g} Hz"
            need = "whole numbers without a common factor"
            raise RecordError(argument="ratio", got=f"{p} and {q}", need=need, hint=hint)
        # Backwards from c/2 on, c an odd multiple of pi/p, x is the same; so is y if q c + 2 phase is one of pi.
        widest = 0.5 * pi * (1 + (1 - q) / p)
        keep(self, phase=widest if self.phase is None else self.phase)
        # The harder axis first, so that the values in a message are possible for both.
        for axis in sorted((0, 1), key=lambda i: -self.amplitude[i] * self.ratio[i] ** 2):
            turning, a = 2 * pi * self.ratio[axis] / self.period, self.amplitude[axis]
            self.limits.refuse(f"{'xy'[axis]} of this figure", (a * turning, a * turning**2), self.frequency, a)

    @property
    def _usual_rate(self) -> float:
        return base.CYCLE_SAMPLES * self.frequency * max(self.ratio)

    @cached_property
    def samples(self) -> int:
        """Samples of a period."""
        _ = base.samples_of(0.5 / self.frequency / max(self.ratio), self.rate)
        return base.samples_of(1 / self.frequency, self.rate)

    def _travel(self, axis: str) -> Travel:
        i = int(axis == "y")
        turning, a = 2 * pi * self.ratio[i] / self.period, self.amplitude[i]
        # Whole turns are subtracted before the factor 2 pi: that keeps the digits.
        share = np.arange(self.samples) * self.ratio[i] % self.samples / self.samples
        angle = 2 * pi * share + (self.phase or 0.0 if i else 0.0)
        sin = a * np.sin(angle)
        return Travel(self.centre[i] + sin, a * turning * np.cos(angle), -(turning**2) * sin)


Constant: TypeAlias = Literal["linear", "angular"]

# Gauss's rule on panels of this many radians gives lengths to the last digits: r(phi) bends over one radian.
_PANEL, _NODES = 0.25, 10
_NEWTON = 8
_REVOLUTION_SAMPLES = 100
# Radians a sample at the centre: by default, and those above which there is a warning.
_STEP, _COARSE = 0.25, 0.6


@dataclass(frozen=True)
class Spiral(Scan):
    """Archimedes' spiral out to the radius, and back to the centre still turning the same way.

    ``x = r cos(phi), y = r sin(phi)`` about the centre; r grows evenly with phi, except where it turns at the rim. The
    way out takes `revolutions` + 1/4, and so does the way back: then the path through the centre is straight, and the
    scan closes. By default a revolution has 100 samples, or more so that a sample at the centre covers less than about
    1/4 rad. See `Scan` for the fields that are not listed.

    Parameters
    ----------
    radius : float
        [m], met exactly.
    revolutions : int
        1 or more.
    constant : {"linear", "angular"}
        Which speed is constant; with a constant angular speed, the centre is scanned slowly.
    centre : (float, float)
        [m].
    turns : float
        Share of the angle in which the radius turns, at the rim; above 0 and up to 1.
    """

    axes: ClassVar[tuple[str, ...]] = ("x", "y")

    radius: Annotated[float, ScanOption("um", "Radius of a spiral")]
    revolutions: Annotated[int, ScanOption("", "Revolutions of a spiral outwards; 1/4 is added")]
    frequency: base.Frequency
    constant: Annotated[Constant, ScanOption("", "Constant speed of a spiral")] = "linear"
    centre: base.Centre = (0.0, 0.0)
    turns: base.Turns = 0.1
    speed: base.Speed | None = None
    acceleration: base.Acceleration | None = None
    rounding: base.Turning = "parabola"
    sample_rate: base.SampleRate | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        keep(self, radius=positive(self.radius, "radius"))
        _ = self.samples
        if self.speed is not None or self.acceleration is not None:
            # The largest speed and acceleration of an axis, on four times the samples.
            motions = self._motions(4 * self.samples)
            speed, acceleration = (max(float(np.abs(axis[order]).max()) for axis in motions) for order in (1, 2))
            self.limits.refuse("this spiral", (speed, acceleration), self.frequency, self.radius)

    @property
    def _usual_rate(self) -> float:
        steady = _REVOLUTION_SAMPLES * self._half / pi
        # At constant linear speed the length each way is about half of the square of the angle, in units of r'.
        count = steady if self.constant == "angular" else max(steady, self._half**2 / _STEP)
        return self.frequency * 2 * ceil(0.5 * count * (1 - 1e-12))

    @cached_property
    def samples(self) -> int:
        """Samples of a period."""
        _ = base.samples_of(0.25 / self.frequency / (self.revolutions + 0.25), self.rate)
        # Two halves: one sample lies on the rim.
        return 2 * base.samples_of(0.5 / self.frequency, self.rate)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences about what differs from the request."""
        step = float(self._angles(self.samples)[1].max()) / self.rate
        if step <= _COARSE:
            return super().warnings
        coarse = (
            f"near the centre it turns by {step:.2g} rad a sample, which makes corners; try a sample rate of "
            f"{base.above(self.rate * step / _STEP)} Hz"
        )
        return (*super().warnings, coarse)

    def _travel(self, axis: str) -> Travel:
        return self._motions(self.samples)[axis == "y"]

    @property
    def _half(self) -> float:
        """Angle of the way out [rad]."""
        return 2 * pi * (self.revolutions + 0.25)

    @property
    def _rim(self) -> Edge:
        """The radius over the angle: from the rim, where it is negative, through the centre to the rim."""
        angle = 2 * self._half
        return Edge(-self.radius, self.radius, angle, 0.5 * self.turns * angle, self.rounding)

    def _radius(self, angle: Array) -> Travel:
        """Return r, dr/dphi and d2r/dphi2 at angles [rad] from the centre."""
        back = angle > self._half
        r, slope, bend = self._rim.at(np.where(back, 2 * self._half - angle, angle) + self._half)
        return Travel(r, np.where(back, -slope, slope), bend)

    def _motions(self, count: int) -> tuple[Travel, Travel]:
        """Return both axes at `count` equal parts of a period."""
        angle, rate, acceleration = self._angles(count)
        r, slope, bend = self._radius(angle)

        def along(centre: float, cos: Array, sin: Array) -> Travel:
            first, second = slope * cos - r * sin, (bend - r) * cos - 2 * slope * sin
            return Travel(centre + r * cos, first * rate, second * rate**2 + first * acceleration)

        cos, sin = np.cos(angle), np.sin(angle)
        return along(self.centre[0], cos, sin), along(self.centre[1], sin, -cos)

    def _angles(self, count: int) -> tuple[Array, Array, Array]:
        """Return the angle [rad], its rate [rad/s] and its acceleration [rad/s^2] at equal parts of a period."""
        share = np.arange(count) / count
        if self.constant == "angular":
            return 2 * self._half * share, np.full(count, 2 * self._half / self.period), np.zeros(count)

        def stride_of(angle: Array) -> Array:
            """Return the length of the track a radian [m]."""
            r, slope, _ = self._radius(angle)
            return np.hypot(r, slope)

        # The angles that cut the track into smooth panels, and its length up to each [m].
        half, blend = self._half, self._rim.blend
        corners = [0.0, half - blend, half, half + blend, 2 * half]
        parts = [np.linspace(a, b, ceil((b - a) / _PANEL) + 1)[:-1] for a, b in pairwise(corners)]
        ends = np.append(np.concatenate(parts), 2 * half)
        lengths = np.concatenate([[0.0], np.cumsum(_integral(stride_of, ends[:-1], ends[1:]))])
        angle = _inverse(stride_of, ends, lengths, share * lengths[-1])
        r, slope, bend = self._radius(angle)
        stride, speed = np.hypot(r, slope), lengths[-1] / self.period
        rate = speed / stride
        return angle, rate, -(rate**2) * slope * (r + bend) / stride**2


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
