"""Motion profiles: a straight edge with rounded ends, and a polynomial that joins two motions."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, pi, sqrt
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from dehyst._types import Array

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
    """Return the height [m] of the highest edge that takes so many seconds within the limits [m/s, m/s^2]."""
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
