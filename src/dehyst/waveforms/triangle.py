"""The triangle with rounded turns: constant speed but for a stated share, within limits of speed and acceleration."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import get_args

import numpy as np

from dehyst._errors import RecordError
from dehyst._validation import choice, keep
from dehyst.waveforms.excitation import positive, set_checked
from dehyst.waveforms.profiles import Edge, Rounding, Travel, highest, least_blend, least_seconds
from dehyst.waveforms.scan import CYCLE_SAMPLES, MotionLimits, Scan, below, between, samples_of, share

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
        Turns of constant acceleration, or of one without jumps and twice as high, see `dehyst.waveforms.profiles.Edge`.
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
            raise RecordError("rising: got 1, need a share below 1, because the way back takes time; try 0.9")
        choice(self.rounding, "rounding", get_args(Rounding), error=RecordError)
        _ = self.legs
        if self.turns is None and self.acceleration is not None:
            self._refuse_impossible()
        limits = MotionLimits(self.speed, self.acceleration)
        limits.refuse(f"a {self.what}", self.peaks, self.frequency, self.height)

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
        limits = MotionLimits(self.speed, self.acceleration).words
        raise RecordError(
            f"acceleration: got {limits}, with which {self.height * 1e6:.6g} um take {needed:.4g} s at "
            f"least, not {seconds:.4g} s; try {below(part / needed)} Hz or less in place of {self.frequency:.6g}, or "
            f"{below(possible * 1e6)} um in place of {self.height * 1e6:.6g}"
        )
