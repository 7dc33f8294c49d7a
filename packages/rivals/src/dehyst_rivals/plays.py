"""Sums of plays with curves and low-passes, for several models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from dehyst import ModelError
from dehyst._types import Array
from dehyst._validation import keep, number, vector
from dehyst_rivals import _rivals as compiled

EMPTY = np.zeros(0)


@dataclass(frozen=True, eq=False)
class PlayState:
    """Memory of play operators and low-passes.

    `voltage` [V]. `plays` (N,): outputs [V], each within its threshold of the voltage. `lowpasses` (K,): outputs [V].
    `time`: time of this state [s]; only low-passes need it.
    """

    voltage: float
    plays: Array
    lowpasses: Array
    time: float | None = None

    def __post_init__(self) -> None:
        keep(self, voltage=number(self.voltage, "state: voltage"))
        keep(self, **{name: vector(getattr(self, name), f"state: {name}") for name in ("plays", "lowpasses")})


class _ClosedForm(NamedTuple):
    """The inverse of weighted plays: their weights w, the weights of the inverse, and its plays."""

    weights: Array
    back: Array
    plays: compiled.Plays


@dataclass(frozen=True, eq=False)
class PlayBank:
    """Curves of play operators and low-passes, ``y = offset + sum_i phi_i(z_i) + sum_k share_k q_k``.

    Raise `ModelError` if a number is impossible.

    `thresholds` (N,): r_i [V], 0 or more. `knots`: places [V] where the slope of phi_i changes, increasing; empty for a
    straight line through 0. `slopes`: slopes of phi_i [m/V], 0 or more, one more than knots: below the first knot,
    between knots, beyond the last knot. phi_i is 0 at its first knot. `offset`: [m]. `times`, `shares` (K,): of the
    low-passes: time constants [s], above 0, and shares [m/V], 0 or more. The arrays are array-like.
    """

    thresholds: Array
    knots: Sequence[Array]
    slopes: Sequence[Array] | Array
    offset: float = 0.0
    times: Array = field(default_factory=lambda: EMPTY)
    shares: Array = field(default_factory=lambda: EMPTY)

    def __post_init__(self) -> None:
        keep(
            self,
            thresholds=vector(self.thresholds, "thresholds"),
            knots=tuple(vector(k, f"knots of play {i + 1}") for i, k in enumerate(self.knots)),
            slopes=tuple(vector(s, f"slopes of play {i + 1}") for i, s in enumerate(self.slopes)),
            offset=number(self.offset, "offset"),
            times=vector(self.times, "times"),
            shares=vector(self.shares, "shares"),
        )
        sizes = {len(self.knots), len(self.slopes), self.thresholds.size}
        if len(sizes) > 1 or any(s.size != k.size + 1 for k, s in zip(self.knots, self.slopes, strict=True)):
            raise ModelError("plays: need knots and slopes for each threshold, and one slope more than knots")
        if np.any(self.thresholds < 0) or any(np.any(np.diff(k) <= 0) for k in self.knots):
            raise ModelError("plays: need thresholds of 0 or more, and increasing knots")
        if any(np.any(s < 0) for s in self.slopes) or np.any(self.shares < 0):
            raise ModelError("plays: got a negative slope or share; a rising voltage must not lower the displacement")
        if self.times.size != self.shares.size or np.any(self.times <= 0):
            raise ModelError("low-passes: need a time above 0 and a share for each low-pass")

    @cached_property
    def _core(self) -> compiled.Plays:
        """The compiled plays: equations and names are in `core/plays.h`."""
        # A straight line is a curve with one knot and the same slope on both sides.
        knots = [k if k.size else np.zeros(1) for k in self.knots]
        slopes = [s if s.size > 1 else np.repeat(s, 2) for s in self.slopes]
        first = np.cumsum([0, *(k.size for k in knots)]).astype(np.intc)
        values = [np.cumsum(np.append(0.0, s[1:-1] * np.diff(k))) for k, s in zip(knots, slopes, strict=True)]
        knot, value, slope = (np.concatenate([EMPTY, *parts]) for parts in (knots, values, slopes))
        return compiled.Plays(self.thresholds, first, knot, value, slope, self.times, self.shares, self.offset)

    @cached_property
    def _closed_form(self) -> _ClosedForm | None:
        """The inverse of ``y = offset + sum_i w_i play_i[v]``, r_0 = 0 < r_1 < ..., w_0 > 0; None for other banks.

        ``v = sum_i w'_i play_{r'_i}[y - offset]`` with
        ``r'_i = sum_{j<=i} w_j (r_i - r_j)``, ``w'_0 = 1 / w_0`` and ``w'_i = 1 / W_i - 1 / W_{i-1}``, W_i the sum of
        w_0 ... w_i.
        """
        r, weights = self.thresholds, np.concatenate([EMPTY, *self.slopes])
        straight = not self.times.size and weights.size == r.size > 0
        if not straight or r[0] != 0 or np.any(np.diff(r) <= 0) or weights[0] <= 0:
            return None
        summed = np.cumsum(weights)
        thresholds = np.concatenate([[0.0], np.cumsum(summed[:-1] * np.diff(r))])
        back, zeros = np.diff(1 / summed, prepend=0.0), np.zeros(r.size)
        first, slopes = np.arange(r.size + 1, dtype=np.intc), np.repeat(back, 2)
        return _ClosedForm(weights, back, compiled.Plays(thresholds, first, zeros, zeros, slopes, EMPTY, EMPTY, 0.0))

    @property
    def parameters(self) -> int:
        """Number of coefficients: slopes, shares and the offset."""
        return sum(s.size for s in self.slopes) + self.shares.size + 1

    def state_after_descent(self, voltage: float) -> PlayState:
        """Return the state after a long descent to a voltage [V] and a rest there."""
        return PlayState(voltage, voltage + self.thresholds, np.full(self.times.size, voltage))

    def simulate(self, v: Array, state: PlayState, time: ArrayLike | None = None) -> tuple[Array, PlayState]:
        """Return the displacement (n,) [m] that a voltage (n,) [V] causes, and the state at its end."""
        at, steps = self._timed(state, time, v.size)
        y, _, voltage, plays, passed = self._core.simulate(v, steps, state.voltage, state.plays, state.lowpasses)
        return y, PlayState(voltage, plays, passed, at)

    def compensate(self, y: Array, state: PlayState, time: ArrayLike | None = None) -> tuple[Array, PlayState]:
        """Return the voltage (n,) [V] for a displacement (n,) [m], and the state at its end; exact.

        A closed form is used if there is one, and if the state can result from a history: then neighbouring outputs
        differ by no more than their thresholds.
        """
        at, steps = self._timed(state, time, y.size)
        apart = np.diff(self.thresholds) + 1e-9 * self.thresholds.max(initial=0.0)
        if y.size and self._closed_form is not None and np.all(np.abs(np.diff(state.plays)) <= apart):
            weights, back, plays_back = self._closed_form
            start = _through(weights, np.concatenate([[state.voltage], state.plays[1:]]))
            v, _, _, z, _ = plays_back.simulate(y - self.offset, EMPTY, float(start[0]), start, EMPTY)
            return v, PlayState(float(v[-1]), _through(back, z), EMPTY, at)
        v, reached, voltage, plays, passed = self._core.compensate(
            y, steps, state.voltage, state.plays, state.lowpasses
        )
        if reached < y.size:
            raise ModelError(
                f"displacement: {y[reached] * 1e6:.6g} um at index {reached} is beyond the reach of this model at any "
                "voltage; stay within the range of the records it was fitted to"
            )
        return v, PlayState(voltage, plays, passed, at)

    def _timed(self, state: PlayState, time: ArrayLike | None, samples: int) -> tuple[float | None, Array]:
        """Return the time at the end and, with low-passes, the seconds (n,) before each sample; check the state."""
        if state.plays.size != self.thresholds.size or state.lowpasses.size != self.times.size:
            raise ModelError(
                f"state: got {state.plays.size} plays and {state.lowpasses.size} low-passes, need "
                f"{self.thresholds.size} and {self.times.size}; use one that this model returned"
            )
        slack = 1e-9 * (abs(state.voltage) + float(self.thresholds.max(initial=0.0)))
        if np.any(np.abs(state.plays - state.voltage) > self.thresholds + slack):
            raise ModelError("state: a play lies farther from the voltage than its threshold")
        if not self.times.size or not samples:
            return state.time, EMPTY
        if time is None:
            raise ModelError(
                "this model creeps: it needs the time of each sample", hint="give the times [s]", change=("time",)
            )
        return _time_steps(state, vector(time, "time"), samples)


def _time_steps(state: PlayState, time: Array, samples: int) -> tuple[float, Array]:
    """Return time steps that continue from the state's time, or begin one interval later if `time` is not after it."""
    if time.size != samples:
        raise ModelError(argument="time", got=f"{time.size} samples", need=f"{samples}, one for each")
    gaps = np.diff(time)
    if np.any(gaps <= 0):
        raise ModelError(f"time: does not increase at sample {int(np.argmax(gaps <= 0)) + 1}; need seconds, in order")
    # Make steps equal that differ only by rounding: the core stores the numbers of one step.
    rounding = 4 * np.finfo(np.float64).eps * float(np.abs(time).max())
    usual = float(np.median(gaps)) if gaps.size else 0.0
    gaps = np.where(np.abs(gaps - usual) <= rounding, usual, gaps)
    first = 0.0
    if state.time is not None and time[0] > state.time:
        first = float(time[0]) - state.time
    elif state.time is not None and gaps.size:
        first = float(gaps[0])
    return float(time[-1]), np.concatenate([[first], gaps])


def _through(weights: Array, z: Array) -> Array:
    """Return the outputs of the inverse operator's plays: sum_{j<=i} w_j z_i + sum_{j>i} w_j z_j."""
    product = weights * z
    return np.asarray(np.cumsum(weights) * z + product.sum() - np.cumsum(product))
