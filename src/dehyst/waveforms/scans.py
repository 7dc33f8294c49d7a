"""Scans: a triangle with rounded turns, steps between levels, and a raster of two axes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import ceil, sqrt
from typing import Annotated, Any, ClassVar, NamedTuple, TypeAlias

import numpy as np

import dehyst.waveforms.scan as base
from dehyst._errors import RecordError
from dehyst._validation import keep
from dehyst.waveforms.excitation import refuse_long
from dehyst.waveforms.scan import Edge, MotionLimits, Scan, ScanOption, Step, Travel

_TURNS = 0.1


@dataclass(frozen=True)
class Triangle(Scan):
    """A path up and down between two displacements; it begins at rest at the lower displacement.

    Both branches are whole numbers of samples. See `Scan` for the fields that are not listed.

    Parameters
    ----------
    low, high : float
        Turning points [m], met exactly.
    turns : float, optional
        Share of the time of each branch in which the path turns, half of it at either end; above 0 and up to 1. By
        default as short as the acceleration allows, or 0.1 without a limit.
    rising : float
        Share of the period in which the path rises; 1/2 gives a triangle, another value a saw-tooth.
    """

    low: base.Low
    high: base.High
    frequency: base.Frequency
    turns: base.Turns | None = None
    speed: base.Speed | None = None
    acceleration: base.Acceleration | None = None
    rising: base.Rising = 0.5
    sample_rate: base.SampleRate | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        base.between(self.low, self.high)
        if self.rising == 1:
            need = "a share below 1, because the falling branch takes time"
            raise RecordError(argument="rising", got="1", need=need, hint="try 0.9")
        _ = self.branches
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
    def branches(self) -> tuple[int, int]:
        """Samples of the rising and of the falling branch."""
        up, down = (base.samples_of(share / self.frequency, self.rate) for share in (self.rising, 1 - self.rising))
        return up, down

    @property
    def samples(self) -> int:
        """Samples of a period."""
        return sum(self.branches)

    @cached_property
    def edges(self) -> tuple[Edge, Edge]:
        """The rising and the falling branch."""
        up, down = (count / self.rate for count in self.branches)
        return self._edge(self.low, self.high, up), self._edge(self.high, self.low, down)

    def _edge(self, start: float, end: float, seconds: float) -> Edge:
        if self.turns is None and self.acceleration is not None:
            blend = base.least_blend(self.height, seconds, self.acceleration)
        else:
            blend = 0.5 * seconds * (_TURNS if self.turns is None else self.turns)
        return Edge(start, end, seconds, blend)

    @property
    def peaks(self) -> tuple[float, float]:
        """Largest abs(velocity) [m/s] and abs(acceleration) [m/s^2]."""
        return max(abs(edge.speed) for edge in self.edges), max(edge.acceleration for edge in self.edges)

    def _travel(self, axis: str) -> Travel:
        branches = zip(self.edges, self.branches, strict=True)
        return Travel.joined(edge.at(np.arange(count) / self.rate) for edge, count in branches)


_EDGE_SAMPLES = 50


@dataclass(frozen=True)
class Steps(Scan):
    """A path of least jerk from level to level with a rest on each level; it begins and ends on the first level.

    By default the shortest edge has 50 samples. See `Scan` for the fields that are not listed.

    Parameters
    ----------
    levels : sequence of float
        [m], 2 or more; two successive levels differ.
    dwell : float
        Time on each level [s], rounded up to a whole number of samples.
    edge : float, optional
        Time from one level to the next [s]; by default each edge is as short as the limits allow, which needs an
        acceleration.
    """

    levels: Annotated[tuple[float, ...], ScanOption("um", "Levels of steps")]
    dwell: Annotated[float, ScanOption("s", "Time on each level")]
    edge: Annotated[float, ScanOption("s", "Time between levels", "by the acceleration")] | None = None
    speed: base.Speed | None = None
    acceleration: base.Acceleration | None = None
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
                    f"got {self.edge:.4g} s for {abs(b - a) * 1e6:.6g} um, which needs at least {least:.4g} s within "
                    f"{self.limits.words}",
                    argument="edge",
                    hint=f"try {base.rounded(least, ceil)} s, or none for the shortest",
                )
        refuse_long(self.samples, self.rate)

    @property
    def frequency(self) -> float | None:  # type: ignore[override]
        """Always None: the levels determine the duration."""
        return None

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
            Step(a, b, count / self.rate).at(np.arange(count) / self.rate)
            for (a, b), count in zip(self._ends, self._counts, strict=True)
        ]
        parts = [part for pair in zip(rests, edges, strict=True) for part in pair]
        return Travel.joined(parts)

    @cached_property
    def _ends(self) -> list[tuple[float, float]]:
        """Start and end of each edge [m]."""
        return list(pairwise([*self.levels, self.levels[0]]))

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
        """Return the least time [s] that the limits allow for an edge of this height [m]."""
        by_speed = 0.0 if self.speed is None else base.FASTEST * height / self.speed
        by_acceleration = 0.0 if self.acceleration is None else sqrt(base.HARDEST * height / self.acceleration)
        return max(by_speed, by_acceleration)


# Fields of the triangle along x.
_FAST = ("low", "high", "frequency", "turns", "speed", "acceleration", "rising", "sample_rate")
YLow: TypeAlias = Annotated[
    float, ScanOption("um", "Lowest displacement along y; the first line of a raster", "as along x")
]
YHigh: TypeAlias = Annotated[
    float, ScanOption("um", "Highest displacement along y; the last line of a raster", "as along x")
]


@dataclass(frozen=True)
class Raster(Scan):
    """Lines along x, each forward and back, at positions along y from `y_low` to `y_high`; then y returns.

    `low`, `high`, `frequency`, `turns` and `rising` define the `Triangle` along x; see `Scan` for the other fields.

    Parameters
    ----------
    lines : int
        2 or more. y moves to the next line, with least jerk, while x returns. After the last line y returns to the
        first line in the least number of lines that the limits allow. Without limits, the largest speed and
        acceleration of x are the limits.
    y_low, y_high : float, optional
        Positions of the first and the last line [m]; by default `low` and `high`.
    """

    axes: ClassVar[tuple[str, ...]] = ("x", "y")

    low: base.Low
    high: base.High
    frequency: base.Frequency
    lines: Annotated[int, ScanOption("", "Lines of a raster", least=2)]
    y_low: YLow | None = None
    y_high: YHigh | None = None
    turns: base.Turns | None = None
    speed: base.Speed | None = None
    acceleration: base.Acceleration | None = None
    rising: base.Rising = 0.5
    sample_rate: base.SampleRate | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        ends = self.low if self.y_low is None else self.y_low, self.high if self.y_high is None else self.y_high
        _ = self.fast
        y_low, y_high = base.between(*ends, ("y_low", "y_high"))
        keep(self, y_low=y_low, y_high=y_high)
        height = self._height / (self.lines - 1)
        self.limits.refuse("a step to the next line", self._step.peaks, self.frequency, height)
        refuse_long(self.samples, self.rate)

    @cached_property
    def fast(self) -> Triangle:
        """The triangle along x."""
        return Triangle(**{name: getattr(self, name) for name in _FAST})

    @cached_property
    def pause(self) -> int:
        """Periods of x after the last line, for the way back."""
        speed, acceleration = self.fast.peaks
        limits = MotionLimits(self.speed or speed, self.acceleration or acceleration)
        # A longer return has a lower speed and acceleration.
        low, high = 0, 100 * self.lines - 1
        if limits.allow(self._return(high).peaks):
            while low < high:
                middle = (low + high) // 2
                low, high = (low, middle) if limits.allow(self._return(middle).peaks) else (middle + 1, high)
            return low
        need = f"limits that let y return within {100 * self.lines} lines"
        raise RecordError(argument="acceleration", got=self.limits.words, need=need)

    @property
    def samples(self) -> int:
        """Samples of a frame."""
        return (self.lines + self.pause) * self.fast.samples

    @property
    def requested_period(self) -> float | None:
        """Requested duration of a frame [s], including the return of y."""
        return (self.lines + self.pause) / self.frequency

    def _travel(self, axis: str) -> Travel:
        if axis == "x":
            return Travel(*(np.tile(row, self.lines + self.pause) for row in self.fast.path().rows))
        forth, retrace = self.fast.branches
        still, levels = np.zeros(forth), np.linspace(*self._ends, self.lines)
        line = Travel.joined([Travel(still, still, still), self._step.at(np.arange(retrace) / self.rate)])
        y = levels[:-1, None] + line.displacement
        stairs = Travel(y.ravel(), *(np.tile(row, self.lines - 1) for row in line[1:]))
        last = Travel(still + levels[-1], still, still)
        back = np.arange(retrace + self.pause * self.fast.samples) / self.rate
        return Travel.joined([stairs, last, self._return(self.pause).at(back)])

    @property
    def _usual_rate(self) -> float:
        return self.fast.rate

    @property
    def _step(self) -> Step:
        """Return the motion of y from one line to the next, counted from 0."""
        return Step(0.0, self._height / (self.lines - 1), self.fast.branches[1] / self.rate)

    def _return(self, back: int) -> Step:
        """Return the motion of y to the first line, in `back` periods of x and the rest of the last line."""
        seconds = (back * self.fast.samples + self.fast.branches[1]) / self.rate
        low, high = self._ends
        return Step(high, low, seconds)

    @property
    def _ends(self) -> tuple[float, float]:
        return base.between(self.y_low, self.y_high)

    @property
    def _height(self) -> float:
        return self._ends[1] - self._ends[0]


class ScanKind(NamedTuple):
    """A named scan: its class, and its required and optional options."""

    scan: Callable[..., Scan]
    needs: tuple[str, ...]
    may: tuple[str, ...]

    @property
    def takes(self) -> tuple[str, ...]:
        """All options of the scan."""
        return (*self.needs, *self.may)


_SCANS = Triangle, Raster, Steps
OPTIONS = {name: option for scan in _SCANS for name, option in base.options_of(scan).items() if name != "sample_rate"}


def _kind(scan: type[Scan]) -> ScanKind:
    own = [name for name in base.options_of(scan) if name in OPTIONS]
    needs = tuple(name for name in own if not hasattr(scan, name))
    return ScanKind(scan, needs, tuple(name for name in own if name not in needs))


SCANS = {scan.__name__.lower(): _kind(scan) for scan in _SCANS}


def scan_of(kind: str, options: Mapping[str, Any], sample_rate: float | None) -> Scan:
    """Return the scan of a `kind` in `SCANS` with `options` as `OPTIONS` declares them; refuse others."""
    scan = SCANS[kind]
    if missing := [name for name in scan.needs if name not in options]:
        raise RecordError(argument=", ".join(missing), got=f"none for a {kind}", need=", ".join(scan.needs))
    if foreign := [name for name in options if name not in scan.takes]:
        got = f"{options[foreign[0]]!r} for a {kind}, which takes {', '.join(scan.takes)}"
        raise RecordError(argument=foreign[0], got=got)
    return scan.scan(**{name: OPTIONS[name].in_si(value) for name, value in options.items()}, sample_rate=sample_rate)
