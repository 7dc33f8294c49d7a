"""The raster: a fast triangle along x, and along y from line to line, in steps or on a ramp."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeAlias, get_args

import numpy as np

from dehyst._errors import RecordError
from dehyst._text import counted
from dehyst._types import Array
from dehyst._validation import choice, keep
from dehyst.waveforms.excitation import refuse_long
from dehyst.waveforms.profiles import Bridge, PathPoint, Rounding, Travel
from dehyst.waveforms.scan import MotionLimits, Scan, between, whole
from dehyst.waveforms.triangle import Triangle

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
            self._limits.refuse(what, self._return(self.back).peaks, self.frequency, self._height)
        refuse_long(self.samples, self.rate)

    @cached_property
    def fast(self) -> Triangle:
        """The triangle along x."""
        return Triangle(**{name: getattr(self, name) for name in _FAST})

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes."""
        return ("x", "y")

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
            f"back: got none, and y does not come back within {100 * self.lines} lines; give the number of lines that "
            "it may take, or wider limits"
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
        """Return y on its way back to the first line, in so many periods of x and the rest of the last line."""
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

    @property
    def _limits(self) -> MotionLimits:
        return MotionLimits(self.speed, self.acceleration)

    def _refuse_steep(self) -> None:
        if self.slow == "staircase":
            height = self._height / (self.lines - 1)
            step = Bridge(PathPoint(0.0), PathPoint(height), self.fast.legs[1] / self.rate)
            self._limits.refuse("a step to the next line", step.peaks, self.frequency, height)
        elif self.speed is not None and self._slope > self.speed:
            self._limits.refuse("the ramp", (self._slope, 1e-300), self.frequency, self._height)

    def _times(self, count: int) -> Array:
        return np.arange(count) / self.rate
