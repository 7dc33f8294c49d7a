"""Scans of one axis: a triangle with rounded turns, and steps between levels."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import ceil, sqrt
from typing import Annotated, Literal, TypeAlias

import numpy as np

import dehyst.waveforms.scan as base
from dehyst._errors import RecordError
from dehyst.waveforms.excitation import refuse_long
from dehyst.waveforms.scan import Bridge, Edge, PathPoint, Scan, ScanOption, Travel

_TURNS = 0.1


@dataclass(frozen=True)
class Triangle(Scan):
    """A path up and down between two displacements; it begins at rest at the lower displacement.

    Both legs are whole numbers of samples. See `Scan` for the fields that are not listed.

    Parameters
    ----------
    low, high : float
        Turning points [m], met exactly.
    turns : float, optional
        Share of the time of each leg that is spent turning, half of it at either end; above 0 and up to 1. By default
        as short as the acceleration allows, or 0.1 without a limit.
    rising : float
        Share of the period in which the path rises; other than 1/2: a saw-tooth.
    """

    low: base.Low
    high: base.High
    frequency: base.Frequency
    turns: base.Turns | None = None
    speed: base.Speed | None = None
    acceleration: base.Acceleration | None = None
    rising: base.Rising = 0.5
    rounding: base.Turning = "parabola"
    sample_rate: base.SampleRate | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        base.between(self.low, self.high)
        if self.rising == 1:
            need = "a share below 1, because the way back takes time"
            raise RecordError(argument="rising", got="1", need=need, hint="try 0.9")
        _ = self.legs
        if self.turns is None and self.acceleration is not None:
            self._refuse_impossible()
        what = f"a triangle of {self.height * 1e6:.6g} um at {self.frequency:.6g} Hz"
        self.limits.refuse(what, self.peaks, self.frequency, self.height)

    @property
    def height(self) -> float:
        """Displacement between the turns [m]."""
        return self.high - self.low

    @property
    def _usual_rate(self) -> float:
        return base.CYCLE_SAMPLES * self.frequency

    @cached_property
    def legs(self) -> tuple[int, int]:
        """Samples of the rising and of the falling leg."""
        up, down = (base.samples_of(share / self.frequency, self.rate) for share in (self.rising, 1 - self.rising))
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

    def _edge(self, start: float, end: float, seconds: float) -> Edge:
        if self.turns is None and self.acceleration is not None:
            blend = base.least_blend(self.height, seconds, self.acceleration, self.rounding)
        else:
            blend = 0.5 * seconds * (_TURNS if self.turns is None else self.turns)
        return Edge(start, end, seconds, blend, self.rounding)

    @property
    def peaks(self) -> tuple[float, float]:
        """Largest abs(velocity) [m/s] and abs(acceleration) [m/s^2]."""
        return max(abs(edge.speed) for edge in self.edges), max(edge.acceleration for edge in self.edges)

    def _travel(self, axis: str) -> Travel:
        legs = zip(self.edges, self.legs, strict=True)
        return Travel.joined(edge.at(np.arange(count) / self.rate) for edge, count in legs)

    def _refuse_impossible(self) -> None:
        """Raise RecordError if no turn, however long, keeps the acceleration."""
        limits = self.speed, self.acceleration, self.rounding
        part = min(self.rising, 1 - self.rising)
        needed, seconds = base.least_seconds(self.height, *limits), min(self.legs) / self.rate
        if seconds * (1 + 1e-9) < needed:
            possible = base.highest(part / self.frequency, *limits)
            raise RecordError(
                f"got {self.limits.words}, with which {self.height * 1e6:.6g} um take {needed:.4g} s at least, not "
                f"{seconds:.4g} s",
                argument="acceleration",
                hint=f"try {base.below(part / needed)} Hz or less in place of {self.frequency:.6g}, or "
                f"{base.below(possible * 1e6)} um in place of {self.height * 1e6:.6g}",
            )


Shape: TypeAlias = Literal["minimum-jerk", "trapezoid"]
_EDGE_SAMPLES = 50
# Largest speed and acceleration of the least jerk, over height per time and per time squared.
_FASTEST, _HARDEST = 1.875, 10 / sqrt(3)


@dataclass(frozen=True)
class Steps(Scan):
    """A path from level to level that rests on each; it begins at rest on the first level.

    By default the shortest edge has 50 samples. See `Scan` for the fields that are not listed.

    Parameters
    ----------
    levels : sequence of float
        [m], 2 or more; no level twice in a row.
    dwell : float
        Time on each level [s], to the next sample.
    edge : float, optional
        Time from one level to the next [s]; by default each edge is as short as the limits allow, and an acceleration
        is needed.
    shape : {"minimum-jerk", "trapezoid"}
        Polynomials of least jerk, or straight lines with ends of constant acceleration; without an acceleration limit,
        these ends take the whole edge.
    closed : bool
        Whether the path returns to the first level at the end, so that it can be repeated.
    """

    levels: Annotated[tuple[float, ...], ScanOption("um", "Levels of steps")]
    dwell: Annotated[float, ScanOption("s", "Time on each level")]
    edge: Annotated[float, ScanOption("s", "Time between levels", "as the limits allow")] | None = None
    shape: Annotated[Shape, ScanOption("", "Shape of a change of level")] = "minimum-jerk"
    speed: base.Speed | None = None
    acceleration: base.Acceleration | None = None
    closed: bool = True
    sample_rate: base.SampleRate | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.edge is None and self.acceleration is None:
            hint = "give the time of an edge, or the limit"
            raise RecordError(argument="edge", got="none, and no acceleration", hint=hint)
        for a, b in self._ends:
            if a == b:
                got = f"{a * 1e6:.9g} um twice in a row"
                raise RecordError(argument="levels", got=got, need="different levels", hint="leave one out")
        for a, b in self._ends:
            least = self._least(abs(b - a))
            if self.edge is not None and self.edge < least * (1 - 1e-9):
                raise RecordError(
                    f"got {self.edge:.4g} s for {abs(b - a) * 1e6:.6g} um, which takes {least:.4g} s at least within "
                    f"{self.limits.words}",
                    argument="edge",
                    hint=f"try {base.above(least)} s, or none for the shortest",
                )
        refuse_long(self.samples, self.rate)

    @property
    def frequency(self) -> float | None:  # type: ignore[override]
        """None: the duration follows from the levels."""
        return None

    @property
    def periodic(self) -> bool:
        """Whether the path can be repeated."""
        return self.closed

    @property
    def _usual_rate(self) -> float:
        return _EDGE_SAMPLES / min(self._seconds)

    @property
    def samples(self) -> int:
        """Samples of all levels and edges."""
        return sum(self._counts) + len(self.levels) * self._dwell_samples

    def _travel(self, axis: str) -> Travel:
        still = np.zeros(self._dwell_samples)
        rests = [Travel(still + level, still, still) for level in self.levels]
        edges = [
            self._edge(a, b, count / self.rate).at(np.arange(count) / self.rate)
            for (a, b), count in zip(self._ends, self._counts, strict=True)
        ]
        parts = [part for pair in zip(rests, edges, strict=False) for part in pair]
        return Travel.joined(parts if self.closed else [*parts, rests[-1]])

    @cached_property
    def _ends(self) -> list[tuple[float, float]]:
        """Start and end of each edge [m]."""
        return list(pairwise([*self.levels, self.levels[0]] if self.closed else self.levels))

    @property
    def _dwell_samples(self) -> int:
        return max(1, ceil(self.dwell * self.rate * (1 - 1e-12)))

    @cached_property
    def _seconds(self) -> list[float]:
        """Requested time of each edge [s]."""
        return [self._least(abs(b - a)) if self.edge is None else self.edge for a, b in self._ends]

    @cached_property
    def _counts(self) -> list[int]:
        """Samples of each edge."""
        return [base.samples_of(seconds, self.rate) for seconds in self._seconds]

    def _least(self, height: float) -> float:
        """Return the least seconds that the limits allow for an edge of this height [m]."""
        if self.shape == "trapezoid":
            return base.least_seconds(height, self.speed, self.acceleration, "parabola")
        by_speed = 0.0 if self.speed is None else _FASTEST * height / self.speed
        by_acceleration = 0.0 if self.acceleration is None else sqrt(_HARDEST * height / self.acceleration)
        return max(by_speed, by_acceleration)

    def _edge(self, start: float, end: float, seconds: float) -> Edge | Bridge:
        if self.shape == "minimum-jerk":
            return Bridge(PathPoint(start), PathPoint(end), seconds)
        blend = 0.5 * seconds
        if self.acceleration is not None:
            blend = base.least_blend(abs(end - start), seconds, self.acceleration, "parabola")
        return Edge(start, end, seconds, blend)
