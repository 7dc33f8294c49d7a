"""The scan of steps between levels."""

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
from dehyst.waveforms.profiles import Bridge, Edge, PathPoint, Travel, least_blend, least_seconds
from dehyst.waveforms.scan import MotionLimits, Scan, above, length, samples_of

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
            raise RecordError(f"levels: got {self.levels!r}, need two displacements at least")
        keep(self, levels=tuple(length(level, "levels") for level in self.levels))
        set_checked(self, positive, "dwell", optional=("seconds", "speed", "acceleration", "sample_rate"))
        choice(self.shape, "shape", get_args(Shape), error=RecordError)
        if self.seconds is None and self.acceleration is None:
            raise RecordError("seconds: got none, and no acceleration; give the time of an edge, or the limit")
        ends = self._ends
        repeated = next((a for a, b in ends if a == b), None)
        if repeated is not None:
            raise RecordError(f"levels: got {repeated:.9g} m twice in a row, need different levels; leave one out")
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
            f"seconds: got {self.seconds:.4g} s for {height * 1e6:.6g} um, which takes {least:.4g} s at least within "
            f"{MotionLimits(self.speed, self.acceleration).words}; try {above(least)} s, or none for the shortest"
        )
