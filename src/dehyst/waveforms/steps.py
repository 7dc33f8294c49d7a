"""Steps between levels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import ceil, sqrt
from typing import Literal, TypeAlias, get_args

import numpy as np

from dehyst._errors import RecordError
from dehyst.waveforms.excitation import positive, refuse_long
from dehyst.waveforms.profiles import Bridge, Edge, PathPoint, Travel, least_blend, least_seconds
from dehyst.waveforms.scan import MotionLimits, Scan, above, length, one_of, samples_of, set_positive

Shape: TypeAlias = Literal["minimum-jerk", "trapezoid"]
_EDGE_SAMPLES = 50
# Largest speed and acceleration of the least jerk, over height per time and per time squared.
_FASTEST, _HARDEST = 1.875, 10 / sqrt(3)


@dataclass(frozen=True)
class Steps(Scan):
    """From level to level, standing still on each; begins at rest, on the first.

    Parameters
    ----------
    levels : sequence of float
        [m], 2 or more; no level twice in a row.
    dwell : float
        Time on each level [s], to the next sample.
    seconds : float, optional
        Time from one level to the next; by default as short as the limits allow, each edge of its own.
    shape : {"minimum-jerk", "trapezoid"}
        Polynomials of least jerk, or straight with ends of constant acceleration: the whole of the edge if no
        acceleration is given.
    speed, acceleration : float, optional
        Largest abs(dy/dt) [m/s] and abs(d2y/dt2) [m/s^2] allowed.
    closed : bool
        Whether it goes back to the first level at the end, and so can be repeated.
    sample_rate : float, optional
        Samples a second [Hz]; by default 50 in the shortest edge.

    Raises
    ------
    RecordError
        If a number is impossible, neither seconds nor an acceleration is given, or the limits cannot be kept: with
        what can be done.
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
            raise RecordError(f"levels: got {self.levels!r}, need two displacements at least")
        object.__setattr__(self, "levels", tuple(length(level, "levels") for level in self.levels))
        object.__setattr__(self, "dwell", positive(self.dwell, "dwell"))
        set_positive(self, "seconds", "speed", "acceleration", "sample_rate")
        one_of(self.shape, "shape", get_args(Shape))
        if self.seconds is None and self.acceleration is None:
            raise RecordError("seconds: got none, and no acceleration; give the time of an edge, or the limit")
        ways = self._ways
        if any(a == b for a, b in ways):
            at = next(a for a, b in ways if a == b)
            raise RecordError(f"levels: got {at:.9g} m twice in a row, need different levels; leave one out")
        for a, b in ways:
            self._refuse_hard(abs(b - a))
        refuse_long(self.samples, self.rate)

    @property
    def frequency(self) -> float | None:  # type: ignore[override]
        """None is asked for: the levels take as long as they take."""
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
        return _EDGE_SAMPLES / min(self._needed(abs(b - a)) for a, b in self._ways)

    @property
    def samples(self) -> int:
        """Of all levels and edges."""
        return sum(self._counts) + len(self.levels) * self._waits

    def travel(self, axis: str) -> Travel:
        """Displacement, velocity and acceleration at each sample."""
        parts, still = [], np.zeros(self._waits)
        for k, level in enumerate(self.levels):
            parts.append(Travel(still + level, still, still))
            if k < len(self._ways):
                count = self._counts[k]
                edge = self._edge(*self._ways[k], count / self.rate)
                parts.append(edge.at(np.arange(count) / self.rate))
        return Travel(*(np.concatenate(rows) for rows in zip(*parts, strict=True)))

    @property
    def _ways(self) -> list[tuple[float, float]]:
        """From where to where each edge goes."""
        return list(pairwise([*self.levels, self.levels[0]] if self.closed else self.levels))

    @property
    def _waits(self) -> int:
        return max(1, ceil(self.dwell * self.rate * (1 - 1e-12)))

    @cached_property
    def _counts(self) -> list[int]:
        """Samples of each edge."""
        return [samples_of(self._needed(abs(b - a)), self.rate) for a, b in self._ways]

    def _needed(self, height: float) -> float:
        """Seconds of an edge."""
        return self._least(height) if self.seconds is None else self.seconds

    def _least(self, height: float) -> float:
        """Seconds that the limits ask for."""
        if self.shape == "trapezoid":
            return least_seconds(height, self.speed, self.acceleration, "parabola")
        by_speed = 0.0 if self.speed is None else _FASTEST * height / self.speed
        by_push = 0.0 if self.acceleration is None else sqrt(_HARDEST * height / self.acceleration)
        return max(by_speed, by_push)

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
            f"seconds: got {self.seconds:.4g} s for {height * 1e6:.6g} um, which takes {least:.4g} s at least within "
            f"{MotionLimits(self.speed, self.acceleration).words}; try {above(least)} s, or none for the shortest"
        )
