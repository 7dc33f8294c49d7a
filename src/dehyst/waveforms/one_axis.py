"""Scans of one axis: a triangle with rounded turns, and steps between levels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import ceil, sqrt
from typing import Literal, TypeAlias, get_args

import numpy as np

from dehyst._errors import RecordError
from dehyst._validation import choice, keep
from dehyst.waveforms.excitation import positive, refuse_long, set_checked
from dehyst.waveforms.scan import (
    CYCLE_SAMPLES,
    Bridge,
    Edge,
    PathPoint,
    Rounding,
    Scan,
    Travel,
    above,
    below,
    between,
    highest,
    least_blend,
    least_seconds,
    length,
    samples_of,
    share,
)

_TURNS = 0.1


@dataclass(frozen=True)
class Triangle(Scan):
    """A path up and down between two displacements; it begins at rest, at the lower one.

    Parameters
    ----------
    low, high : float
        Turning points [m], met exactly.
    frequency : float
        Cycles a second [Hz].
    turns : float, optional
        Share of the time of each leg that is spent turning, half of it at either end; above 0 and up to 1. By default
        as short as the acceleration allows, or 0.1 if that is not limited.
    speed, acceleration : float, optional
        Largest abs(dy/dt) [m/s] and abs(d2y/dt2) [m/s^2] allowed.
    rising : float
        Share of the time that it rises; a share other than 1/2 makes a saw-tooth.
    rounding : {"parabola", "cosine"}
        Turns of constant acceleration, or of one without jumps and twice as high, see `dehyst.waveforms.scan.Edge`.
    sample_rate : float, optional
        Samples a second [Hz]; by default 400 a cycle. Both legs are whole numbers of samples.

    Raises
    ------
    RecordError
        If a number is impossible, or the limits cannot be kept; the message states what can be done.
    """

    low: float
    high: float
    frequency: float
    turns: float | None = None
    speed: float | None = None
    acceleration: float | None = None
    rising: float = 0.5
    rounding: Rounding = "parabola"
    sample_rate: float | None = None

    def __post_init__(self) -> None:
        low, high = between(self.low, self.high)
        keep(self, low=low, high=high)
        set_checked(self, positive, "frequency", optional=("speed", "acceleration", "sample_rate"))
        set_checked(self, share, "rising", optional=("turns",))
        if self.rising == 1:
            raise RecordError(
                argument="rising", got="1", need="a share below 1, because the way back takes time", hint="try 0.9"
            )
        choice(self.rounding, "rounding", get_args(Rounding), error=RecordError)
        _ = self.legs
        if self.turns is None and self.acceleration is not None:
            self._refuse_impossible()
        self.limits.refuse(f"a {self.what}", self.peaks, self.frequency, self.height)

    @property
    def height(self) -> float:
        """Displacement from the lower turn to the higher [m]."""
        return self.high - self.low

    @property
    def what(self) -> str:
        """The scan in words."""
        return f"triangle of {self.height * 1e6:.6g} um at {self.frequency:.6g} Hz"

    @property
    def rate(self) -> float:
        """Samples a second [Hz]."""
        return CYCLE_SAMPLES * self.frequency if self.sample_rate is None else self.sample_rate

    @cached_property
    def legs(self) -> tuple[int, int]:
        """Samples of the rising and of the falling leg."""
        up, down = (samples_of(share / self.frequency, self.rate) for share in (self.rising, 1 - self.rising))
        return up, down

    @property
    def samples(self) -> int:
        """Samples of a period."""
        return sum(self.legs)

    @cached_property
    def edges(self) -> tuple[Edge, Edge]:
        """The rising and the falling leg."""
        up, down = (count / self.rate for count in self.legs)
        return self._edge(self.low, self.high, up), self._edge(self.high, self.low, down)

    @property
    def peaks(self) -> tuple[float, float]:
        """Largest abs(velocity) [m/s] and abs(acceleration) [m/s^2]."""
        return max(abs(edge.speed) for edge in self.edges), max(edge.acceleration for edge in self.edges)

    @property
    def straight(self) -> tuple[float, float]:
        """Share of the time of each leg at constant speed, rising and falling."""
        up, down = (1 - 2 * edge.blend / edge.seconds for edge in self.edges)
        return up, down

    def travel(self, axis: str) -> Travel:
        """Return displacement, velocity and acceleration at each sample."""
        parts = [edge.at(np.arange(count) / self.rate) for edge, count in zip(self.edges, self.legs, strict=True)]
        return Travel(*(np.concatenate(rows) for rows in zip(*parts, strict=True)))

    def _edge(self, start: float, end: float, seconds: float) -> Edge:
        if self.turns is None and self.acceleration is not None:
            blend = least_blend(self.height, seconds, self.acceleration, self.rounding)
        else:
            blend = 0.5 * seconds * (_TURNS if self.turns is None else self.turns)
        return Edge(start, end, seconds, blend, self.rounding)

    def _refuse_impossible(self) -> None:
        """Raise RecordError if no turn, however long, keeps the acceleration."""
        part = min(self.rising, 1 - self.rising)
        needed = least_seconds(self.height, self.speed, self.acceleration, self.rounding)
        seconds = min(self.legs) / self.rate
        if seconds * (1 + 1e-9) >= needed:
            return
        possible = highest(part / self.frequency, self.speed, self.acceleration, self.rounding)
        raise RecordError(
            f"got {self.limits.words}, with which {self.height * 1e6:.6g} um take {needed:.4g} s at least, not "
            f"{seconds:.4g} s",
            argument="acceleration",
            hint=f"try {below(part / needed)} Hz or less in place of {self.frequency:.6g}, or "
            f"{below(possible * 1e6)} um in place of {self.height * 1e6:.6g}",
        )


Shape: TypeAlias = Literal["minimum-jerk", "trapezoid"]
_EDGE_SAMPLES = 50
# Largest speed and acceleration of the least jerk, over height per time and per time squared.
_FASTEST, _HARDEST = 1.875, 10 / sqrt(3)


@dataclass(frozen=True)
class Steps(Scan):
    """A path from level to level that rests on each; it begins at rest, on the first.

    Parameters
    ----------
    levels : sequence of float
        [m], 2 or more; no level twice in a row.
    dwell : float
        Time on each level [s], to the next sample.
    seconds : float, optional
        Time from one level to the next; by default each edge is as short as the limits allow.
    shape : {"minimum-jerk", "trapezoid"}
        Polynomials of least jerk, or straight lines with ends of constant acceleration, which take the whole edge if
        no acceleration is given.
    speed, acceleration : float, optional
        Largest abs(dy/dt) [m/s] and abs(d2y/dt2) [m/s^2] allowed.
    closed : bool
        Whether it goes back to the first level at the end, so that it can be repeated.
    sample_rate : float, optional
        Samples a second [Hz]; by default 50 in the shortest edge.

    Raises
    ------
    RecordError
        If a number is impossible, neither seconds nor an acceleration is given, or the limits cannot be kept; the
        message states what can be done.
    """

    levels: tuple[float, ...]
    dwell: float
    seconds: float | None = None
    shape: Shape = "minimum-jerk"
    speed: float | None = None
    acceleration: float | None = None
    closed: bool = True
    sample_rate: float | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.levels, Sequence | np.ndarray) or len(self.levels) < 2:
            raise RecordError(argument="levels", got=repr(self.levels), need="two displacements at least")
        keep(self, levels=tuple(length(level, "levels") for level in self.levels))
        set_checked(self, positive, "dwell", optional=("seconds", "speed", "acceleration", "sample_rate"))
        choice(self.shape, "shape", get_args(Shape), error=RecordError)
        if self.seconds is None and self.acceleration is None:
            raise RecordError(
                argument="seconds", got="none, and no acceleration", hint="give the time of an edge, or the limit"
            )
        ends = self._ends
        repeated = next((a for a, b in ends if a == b), None)
        if repeated is not None:
            raise RecordError(
                argument="levels",
                got=f"{repeated * 1e6:.9g} um twice in a row",
                need="different levels",
                hint="leave one out",
            )
        for a, b in ends:
            self._refuse_hard(abs(b - a))
        refuse_long(self.samples, self.rate)

    @property
    def frequency(self) -> float | None:  # type: ignore[override]
        """None: the duration follows from the levels."""
        return None

    @property
    def periodic(self) -> bool:
        """Whether it can be repeated."""
        return self.closed

    @property
    def rate(self) -> float:
        """Samples a second [Hz]."""
        if self.sample_rate is not None:
            return self.sample_rate
        return _EDGE_SAMPLES / min(self._needed(abs(b - a)) for a, b in self._ends)

    @property
    def samples(self) -> int:
        """Samples of all levels and edges."""
        return sum(self._counts) + len(self.levels) * self._dwell_samples

    def travel(self, axis: str) -> Travel:
        """Return displacement, velocity and acceleration at each sample."""
        parts, still = [], np.zeros(self._dwell_samples)
        for k, level in enumerate(self.levels):
            parts.append(Travel(still + level, still, still))
            if k < len(self._ends):
                count = self._counts[k]
                edge = self._edge(*self._ends[k], count / self.rate)
                parts.append(edge.at(np.arange(count) / self.rate))
        return Travel(*(np.concatenate(rows) for rows in zip(*parts, strict=True)))

    @property
    def _ends(self) -> list[tuple[float, float]]:
        """Start and end of each edge [m]."""
        return list(pairwise([*self.levels, self.levels[0]] if self.closed else self.levels))

    @property
    def _dwell_samples(self) -> int:
        return max(1, ceil(self.dwell * self.rate * (1 - 1e-12)))

    @cached_property
    def _counts(self) -> list[int]:
        """Samples of each edge."""
        return [samples_of(self._needed(abs(b - a)), self.rate) for a, b in self._ends]

    def _needed(self, height: float) -> float:
        """Return the seconds of an edge of this height [m]."""
        return self._least(height) if self.seconds is None else self.seconds

    def _least(self, height: float) -> float:
        """Return the least seconds that the limits allow for an edge of this height [m]."""
        if self.shape == "trapezoid":
            return least_seconds(height, self.speed, self.acceleration, "parabola")
        by_speed = 0.0 if self.speed is None else _FASTEST * height / self.speed
        by_acceleration = 0.0 if self.acceleration is None else sqrt(_HARDEST * height / self.acceleration)
        return max(by_speed, by_acceleration)

    def _edge(self, start: float, end: float, seconds: float) -> Edge | Bridge:
        if self.shape == "minimum-jerk":
            return Bridge(PathPoint(start), PathPoint(end), seconds)
        blend = 0.5 * seconds
        if self.acceleration is not None:
            blend = least_blend(abs(end - start), seconds, self.acceleration, "parabola")
        return Edge(start, end, seconds, blend)

    def _refuse_hard(self, height: float) -> None:
        least = self._least(height)
        if self.seconds is None or self.seconds >= least * (1 - 1e-9):
            return
        raise RecordError(
            f"got {self.seconds:.4g} s for {height * 1e6:.6g} um, which takes {least:.4g} s "
            f"at least within {self.limits.words}",
            argument="seconds",
            hint=f"try {above(least)} s, or none for the shortest",
        )
