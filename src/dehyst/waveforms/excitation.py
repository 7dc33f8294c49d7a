"""Voltages to play on uniform samples: branches between turning points, within limits and a slew rate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from dehyst._errors import RecordError
from dehyst._text import counted
from dehyst._types import Array
from dehyst._validation import Numbers, interval, keep

_MOST_SAMPLES = 50_000_000
# No actuator or amplifier exceeds this voltage, and no computation within it overflows.
_MOST_VOLTS = 1e6


def refuse_long(samples: int, rate: float) -> None:
    """Raise RecordError for more than 5e7 samples; `rate` [Hz] is for the message."""
    if samples > _MOST_SAMPLES:
        got = f"{samples:.4g} samples, {samples / rate:.4g} s at {rate:g} Hz"
        hint = "lower the sample rate, or ask for fewer or faster branches"
        raise RecordError(got=got, need=f"{_MOST_SAMPLES:g} at most", hint=hint, change=("sample_rate", "slew_rate"))


# Checks of given voltages [V], of a single voltage, and of a positive number.
voltages = Numbers(1, least=-_MOST_VOLTS, most=_MOST_VOLTS, hint="give voltages in V", error=RecordError)
volts = replace(voltages, dimensions=0)
positive = Numbers(least=1e-12, most=1e12, error=RecordError)


@dataclass(frozen=True, eq=False, repr=False)
class Excitation:
    """A voltage to play.

    Parameters
    ----------
    name : str
        Kind of the excitation.
    voltage : (n,) or (n, axes) array_like
        Voltage [V], n >= 2, with one column for each of several axes; kept as a read-only copy. Other shapes raise
        `RecordError`.
    sample_rate : float
        [Hz].
    warnings : tuple of str
        Sentences about branches that take longer than requested.
    axes : tuple of str
        Names of several axes.
    parts : tuple of (str, int, int)
        Name, first sample and the sample after the last of each part, if it has parts.
    """

    name: str
    voltage: Array
    sample_rate: float
    warnings: tuple[str, ...] = ()
    axes: tuple[str, ...] = ()
    parts: tuple[tuple[str, int, int], ...] = ()

    def __post_init__(self) -> None:
        several = getattr(self.voltage, "ndim", 1) == 2
        voltage = voltages(np.ravel(self.voltage) if several else self.voltage, "voltage")
        if several:
            voltage = voltage.reshape(np.shape(self.voltage))
        if len(voltage) < 2:
            got = counted(len(voltage), "sample")
            raise RecordError(argument="voltage", got=got, need="2 at least", hint="give a longer one")
        keep(self, voltage=voltage, sample_rate=positive(self.sample_rate, "sample_rate"))

    def __len__(self) -> int:
        return len(self.voltage)

    def __repr__(self) -> str:
        low, high = self.voltage_range
        return f"<Excitation '{self.name}': {len(self)} samples, {self.duration:.6g} s, {low:.6g} to {high:.6g} V>"

    @property
    def time(self) -> Array:
        """Time of each sample (n,) [s], from 0."""
        return np.arange(len(self)) / self.sample_rate

    @property
    def duration(self) -> float:
        """Time from the first sample to the last [s]."""
        return (len(self) - 1) / self.sample_rate

    @property
    def voltage_range(self) -> tuple[float, float]:
        """Lowest and highest voltage [V]."""
        return float(self.voltage.min()), float(self.voltage.max())

    @property
    def turns(self) -> Array:
        """Turning points (k,) [V]: first voltage, voltages at which it turns, and last voltage."""
        steps = np.diff(self.voltage)
        moving = np.flatnonzero(steps)
        turning = moving[1:][np.diff(steps[moving] > 0)]
        return self.voltage[[0, *turning, -1]]


_CYCLE_SAMPLES, _BRANCH_SAMPLES = 400, 4
# Largest slope of a branch over its mean slope.
STEEPEST = math.pi / 2
# Rounding may add this share of the largest voltage to a step: the argument of the cosine is rounded twice.
_ROUNDING = 32 * float(np.finfo(np.float64).eps)
# A branch may exceed the slew rate by this share, so that rounding does not change a branch at the slew rate.
_SLACK = 9e-10


class Branch(NamedTuple):
    """A monotone part of a voltage from `start` to `end` [V], or a hold; `requested`: whether `seconds` was given."""

    start: float
    end: float
    seconds: float
    requested: bool = True

    def sampled(self, count: int) -> Array:
        """Return `count` voltages [V] after the start, half a cosine: monotone, within the ends, exact at the end."""
        if self.start == self.end:
            return np.full(count, self.end)
        rising = self.end > self.start
        low, high = sorted((self.start, self.end))
        k = np.arange(1, count + 1)
        share = 0.5 - 0.5 * np.cos(np.pi * (k if rising else k + count) / count)
        values = np.clip(low + (high - low) * share, low, high)
        values[-1] = self.end
        # Near a turning point rounding can reverse the order of two samples.
        return np.maximum.accumulate(values) if rising else np.minimum.accumulate(values)


@dataclass(frozen=True)
class Sampling:
    """Speed and sampling of a voltage, for every kind of excitation.

    Parameters
    ----------
    frequency : float
        Cycles per second [Hz]. A branch between two turning points is half a cosine (paper, Sec. 3); it takes half a
        cycle, to the nearest sample, whatever its height.
    sample_rate : float, optional
        [Hz]; by default 400 samples per cycle, or 1000 for the recommended excitation.
    base : float
        Voltage [V] at which a protocol starts and ends.
    present : float, optional
        Present voltage [V] of the actuator, by default the base; a ramp of half a cycle at most leads to the base.
    limits : (float, float), optional
        Lowest and highest voltage [V] allowed. A voltage outside is an error and not clipped, as clipped tops would
        change the protocol.
    slew_rate : float, optional
        Largest abs(dv/dt) [V/s]; steeper branches are made slower, with a warning.

    Raises
    ------
    RecordError
        If a number is not finite, frequency, sample rate or slew rate are not positive, a cycle has fewer than 8
        samples, or the limits are not an interval or do not include base and present voltage.
    """

    frequency: float = 0.01
    sample_rate: float | None = None
    base: float = 0.0
    present: float | None = None
    limits: tuple[float, float] | None = None
    slew_rate: float | None = None

    def __post_init__(self) -> None:
        for name in ("frequency", "sample_rate", "slew_rate"):
            if name == "frequency" or getattr(self, name) is not None:
                keep(self, **{name: positive(getattr(self, name), name)})
        if self.rate < 2 * _BRANCH_SAMPLES * self.frequency:
            got, hint = f"{self.rate:g} Hz for {self.frequency:g} Hz", f"try {_CYCLE_SAMPLES * self.frequency:g} Hz"
            raise RecordError(argument="sample_rate", got=got, need="8 a cycle", hint=hint, change=("frequency",))
        if self.limits is not None:
            low, high = interval(self.limits, error=RecordError)
            keep(self, limits=(volts(low, "limits"), volts(high, "limits")))
        for name in ("base", "present"):
            if name == "base" or self.present is not None:
                keep(self, **{name: volts(getattr(self, name), name)})
                self._refuse_outside([getattr(self, name)], name)

    @property
    def rate(self) -> float:
        """Sample rate [Hz]."""
        return _CYCLE_SAMPLES * self.frequency if self.sample_rate is None else self.sample_rate

    @property
    def half(self) -> float:
        """Half a cycle [s]."""
        return 0.5 / self.frequency

    @property
    def start(self) -> float:
        """Voltage [V] at which a record begins."""
        return self.base if self.present is None else self.present

    def lead_in(self, highest: float) -> list[Branch]:
        """Return the branch from the present voltage to the base, at the mean speed of a branch of `highest` [V].

        It takes at most half a cycle; there is no branch if the present voltage is the base.
        """
        way = abs(self.start - self.base)
        return [Branch(self.start, self.base, self.half * way / max(way, highest), requested=False)] if way else []

    def branches(self, path: Sequence[float]) -> list[Branch]:
        """Return the branches between the voltages of a `path` (m,) [V], m >= 2.

        Raise `RecordError` if two successive voltages are equal.
        """
        for a, b in pairwise(path):
            if a == b:
                got = f"{a:.9g} V twice in a row"
                raise RecordError(argument="turns", got=got, need="different voltages", hint="leave one out")
        return [Branch(a, b, self.half) for a, b in pairwise(path)]

    def play(self, name: str, branches: Sequence[Branch], otherwise: float | None = None) -> Excitation:
        """Return the excitation `name` of successive `branches`; it is checked before memory is allocated.

        `otherwise`: its duration [s] without a slew rate, by default that of the branches as requested. Raise
        `RecordError` if a voltage lies outside of the limits, there are more than 5e7 samples, or the slew rate is so
        low that rounding loses the steps between samples.
        """
        ends = [branches[0].start, *(branch.end for branch in branches)]
        self._refuse_outside(ends, name)
        step, requested = self._largest_step(max(map(abs, ends))), [self._requested(branch) for branch in branches]
        steepest = [STEEPEST * abs(branch.end - branch.start) for branch in branches]
        counts = [max(n, math.ceil(height / step)) for n, height in zip(requested, steepest, strict=True)]
        total = sum(counts)
        refuse_long(1 + total, self.rate)
        voltage = np.concatenate([ends[:1], *map(Branch.sampled, branches, counts)])
        planned = zip(branches, requested, counts, strict=True)
        longer = [(n, m) for branch, n, m in planned if branch.requested and m > 1.000001 * n]
        if not longer:
            return Excitation(name, voltage, self.rate)
        n, m = max(longer, key=lambda pair: pair[1] / pair[0])
        moving = sum(branch.requested and branch.start != branch.end for branch in branches)
        intended = (total - sum(m - n for n, m in longer)) / self.rate if otherwise is None else otherwise
        warning = (
            f"{len(longer)} of {moving} branches are slower than requested, to keep {self.slew_rate:g} V/s: up to "
            f"{m / self.rate:.4g} s instead of {n / self.rate:.4g} s, and {total / self.rate:.5g} s instead of "
            f"{intended:.5g} s in all"
        )
        return Excitation(name, voltage, self.rate, (warning,))

    def _requested(self, branch: Branch) -> int:
        """Return the number of samples for the requested time."""
        samples = branch.seconds * self.rate
        if branch.start == branch.end:
            return max(1, math.ceil(samples * (1 - 1e-12)))
        return max(_BRANCH_SAMPLES, math.floor(samples + 0.5))

    def _largest_step(self, highest: float) -> float:
        """Return the largest step [V] from one sample to the next, for voltages up to `highest`."""
        if self.slew_rate is None:
            return math.inf
        step, lost = self.slew_rate / self.rate, _ROUNDING * highest
        if lost > 0.5 * step:
            raise RecordError(
                f"got {self.slew_rate:g} V/s at {self.rate:g} Hz, steps of {step:.3g} V, which are lost in the "
                f"rounding of {highest:g} V",
                argument="slew_rate",
                hint="lower the sample rate",
            )
        return (1 + _SLACK) * step - lost

    def _refuse_outside(self, values: Sequence[float], what: str) -> None:
        low, high = self.limits or (-math.inf, math.inf)
        worst = max(values, key=lambda v: max(low - v, v - high))
        if not low <= worst <= high:
            hint = "ask for less, or widen the limits if actuator and amplifier allow it"
            need = f"{low:g} to {high:g} V, the limits"
            raise RecordError(argument=what, got=f"{worst:.9g} V", need=need, hint=hint, change=("limits",))
