"""The spiral: out from the centre and back on evenly spaced tracks, at constant linear or angular speed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import ceil, pi
from typing import Literal, TypeAlias, get_args

import numpy as np

from dehyst._errors import RecordError
from dehyst._types import Array
from dehyst._validation import choice, keep
from dehyst.waveforms.excitation import positive, set_checked
from dehyst.waveforms.profiles import Edge, Rounding, Travel
from dehyst.waveforms.scan import MotionLimits, Scan, above, length, samples_of, share, whole

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
            limits = MotionLimits(self.speed, self.acceleration)
            limits.refuse("this spiral", self._peaks(), self.frequency, self.radius)

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes."""
        return ("x", "y")

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
        """Return both axes at so many equal parts of a period."""
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
