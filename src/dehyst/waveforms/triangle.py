"""The triangle with rounded turns: constant speed but for a stated share, within limits of speed and acceleration."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import get_args

import numpy as np

from dehyst._errors import RecordError
from dehyst.waveforms.excitation import positive
from dehyst.waveforms.profiles import Edge, Rounding, Travel, highest, least_blend, least_seconds
from dehyst.waveforms.scan import (
    CYCLE_SAMPLES,
    MotionLimits,
    Scan,
    below,
    between,
    one_of,
    samples_of,
    set_positive,
    share,
)

_TURNS = 0.1


@dataclass(frozen=True)
class Triangle(Scan):
    """Up and down between two displacements; begins at rest, at the lower one.

    Parameters
    ----------
    low, high : float
        Where it turns [m], exactly.
    frequency : float
        Cycles a second [Hz].
    turns : float, optional
        Share of the time of each leg that is spent turning, half of it at either end; above 0 and up to 1. By default
        as short as the acceleration allows, or 0.1 if that is not limited.
    speed, acceleration : float, optional
        Largest abs(dy/dt) [m/s] and abs(d2y/dt2) [m/s^2] allowed.
    rising : float
        Share of the time that it rises; another than 1/2 makes a saw-tooth.
    rounding : {"parabola", "cosine"}
        Turns of constant acceleration, or of one without jumps and twice as high, see `dehyst.waveforms.profiles.Edge`.
    sample_rate : float, optional
        Samples a second [Hz]; by default 400 a cycle. Both legs are whole numbers of samples.

    Raises
    ------
    RecordError
        If a number is impossible, or the limits cannot be kept: with what can be done.
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
        object.__setattr__(self, "low", low)
        object.__setattr__(self, "high", high)
        object.__setattr__(self, "frequency", positive(self.frequency, "frequency"))
        set_positive(self, "speed", "acceleration", "sample_rate")
        if self.turns is not None:
            object.__setattr__(self, "turns", share(self.turns, "turns"))
        object.__setattr__(self, "rising", share(self.rising, "rising"))
        if self.rising == 1:
            raise RecordError("rising: got 1, need a share below 1, for the way back takes time; try 0.9")
        one_of(self.rounding, "rounding", get_args(Rounding))
        _ = self.legs
        if self.turns is None and self.acceleration is not None:
            self._refuse_impossible()
        peaks = max(abs(edge.speed) for edge in self.edges), max(edge.acceleration for edge in self.edges)
        MotionLimits(self.speed, self.acceleration).refuse(f"a {self.what}", peaks, self.frequency, self.height)

    @property
    def height(self) -> float:
        """From the lower turn to the higher [m]."""
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
        return samples_of(self.rising / self.frequency, self.rate), samples_of(
            (1 - self.rising) / self.frequency, self.rate
        )

    @property
    def samples(self) -> int:
        """Of a period."""
        return sum(self.legs)

    @cached_property
    def edges(self) -> tuple[Edge, Edge]:
        """The rising and the falling leg."""
        up, down = (count / self.rate for count in self.legs)
        return self._edge(self.low, self.high, up), self._edge(self.high, self.low, down)

    @property
    def straight(self) -> tuple[float, float]:
        """Share of the time of each leg at constant speed, rising and falling."""
        up, down = (1 - 2 * edge.blend / edge.seconds for edge in self.edges)
        return up, down

    def travel(self, axis: str) -> Travel:
        """Displacement, velocity and acceleration at each sample."""
        parts = [edge.at(np.arange(count) / self.rate) for edge, count in zip(self.edges, self.legs, strict=True)]
        return Travel(*(np.concatenate(rows) for rows in zip(*parts, strict=True)))

    def _edge(self, start: float, end: float, seconds: float) -> Edge:
        if self.turns is None and self.acceleration is not None:
            blend = least_blend(self.height, seconds, self.acceleration, self.rounding)
        else:
            blend = 0.5 * seconds * (_TURNS if self.turns is None else self.turns)
        return Edge(start, end, seconds, blend, self.rounding)

    def _refuse_impossible(self) -> None:
        """With turns as long as they need be, only so much can be done."""
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
