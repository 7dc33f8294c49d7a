"""What rivals made of play operators share: the operators with curves on them, low-passes of the voltage, a state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst._validation import number, vector
from dehyst.baselines._native_plays import PlayCore


@dataclass(frozen=True, eq=False)
class PlayState:
    """What play operators remember.

    Attributes
    ----------
    voltage : float
        [V].
    plays : (N,) array
        Outputs [V], each within its threshold of the voltage.
    lowpasses : (K,) array
        Outputs [V].
    time : float or None
        When this was [s], if it matters.
    """

    voltage: float
    plays: Array
    lowpasses: Array
    time: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "voltage", number(self.voltage, "state: voltage"))
        for name in ("plays", "lowpasses"):
            values = vector(getattr(self, name), f"state: {name}")
            values.flags.writeable = False
            object.__setattr__(self, name, values)


@dataclass(frozen=True, eq=False)
class PlayBank:
    """Curves of play operators and low-passes, ``y = offset + sum_i phi_i(z_i) + sum_k share_k q_k``.

    Parameters
    ----------
    thresholds : (N,) array_like
        r_i [V], 0 or more.
    knots : sequence of N array_like
        Places [V] where the slope of phi_i changes, increasing; none for a straight line through 0.
    slopes : sequence of N array_like
        Slopes of phi_i [m/V], 0 or more, one more than knots: below the first, between them, beyond the last. phi_i is
        0 at its first knot.
    offset : float
        [m].
    times, shares : (K,) array_like
        Of the low-passes: time constants [s], above 0, and shares [m/V], 0 or more.

    Raises
    ------
    ModelError
        If a number is impossible.
    """

    thresholds: Array
    knots: tuple[Array, ...]
    slopes: tuple[Array, ...]
    offset: float = 0.0
    times: Array = field(default_factory=lambda: np.zeros(0))
    shares: Array = field(default_factory=lambda: np.zeros(0))
    _core: PlayCore = field(init=False, repr=False)

    def __init__(
        self,
        thresholds: ArrayLike,
        knots: Sequence[ArrayLike],
        slopes: Sequence[ArrayLike],
        offset: float = 0.0,
        times: ArrayLike = (),
        shares: ArrayLike = (),
    ) -> None:
        given = {
            "thresholds": vector(thresholds, "thresholds"),
            "knots": tuple(vector(k, f"knots of play {i + 1}") for i, k in enumerate(knots)),
            "slopes": tuple(vector(s, f"slopes of play {i + 1}") for i, s in enumerate(slopes)),
            "offset": number(offset, "offset"),
            "times": vector(times, "times"),
            "shares": vector(shares, "shares"),
        }
        for name, value in given.items():
            object.__setattr__(self, name, value)
        self._check()
        object.__setattr__(self, "_core", self._compiled())

    def _check(self) -> None:
        sizes = {len(self.knots), len(self.slopes), self.thresholds.size}
        if len(sizes) > 1 or any(s.size != k.size + 1 for k, s in zip(self.knots, self.slopes, strict=True)):
            raise ModelError("plays: need knots and slopes for each threshold, and one slope more than knots")
        if np.any(self.thresholds < 0) or any(np.any(np.diff(k) <= 0) for k in self.knots):
            raise ModelError("plays: need thresholds of 0 or more, and increasing knots")
        if any(np.any(s < 0) for s in self.slopes) or np.any(self.shares < 0):
            raise ModelError("plays: got a negative slope or share; more voltage must not be less displacement")
        if self.times.size != self.shares.size or np.any(self.times <= 0):
            raise ModelError("low-passes: need a time above 0 and a share for each")

    def _compiled(self) -> PlayCore:
        # A straight line is a curve of one knot, the same on both sides.
        knots = [k if k.size else np.zeros(1) for k in self.knots]
        slopes = [s if s.size > 1 else np.repeat(s, 2) for s in self.slopes]
        first = np.cumsum([0, *(k.size for k in knots)]).astype(np.intc)
        values = [np.cumsum(np.append(0.0, s[1:-1] * np.diff(k))) for k, s in zip(knots, slopes, strict=True)]
        none = np.zeros(0)
        knot, value, slope = (np.concatenate([none, *parts]) for parts in (knots, values, slopes))
        return PlayCore(self.thresholds, first, knot, value, slope, self.times, self.shares, self.offset)

    def risen(self, voltage: float) -> PlayState:
        """The state after a long rise to a voltage [V] and a rest there."""
        return PlayState(voltage, voltage - self.thresholds, np.full(self.times.size, voltage))

    def descended(self, voltage: float) -> PlayState:
        """The state after a long descent to a voltage [V] and a rest there."""
        return PlayState(voltage, voltage + self.thresholds, np.full(self.times.size, voltage))

    def simulate(self, v: Array, state: PlayState, time: ArrayLike | None) -> tuple[Array, PlayState]:
        """Displacement (n,) [m] that a voltage (n,) [V] causes, and the state at its end."""
        after, steps = self._timed(state, time, v.size)
        y, plays, passed = self._core.simulate(v, steps, state.voltage, state.plays, state.lowpasses)
        return y, replace(after, voltage=float(v[-1]) if v.size else state.voltage, plays=plays, lowpasses=passed)

    def compensate(self, y: Array, state: PlayState, time: ArrayLike | None) -> tuple[Array, PlayState]:
        """Voltage (n,) [V] for a displacement (n,) [m], and the state at its end; exact."""
        after, steps = self._timed(state, time, y.size)
        v, plays, passed = self._core.compensate(y, steps, state.voltage, state.plays, state.lowpasses)
        return v, replace(after, voltage=float(v[-1]) if v.size else state.voltage, plays=plays, lowpasses=passed)

    def check(self, state: PlayState) -> None:
        """Refuse a state that is not this bank's.

        Raises
        ------
        ModelError
        """
        if not isinstance(state, PlayState):
            raise ModelError(f"state: got {type(state).__name__}, need one that this model handed back")
        if state.plays.size != self.thresholds.size or state.lowpasses.size != self.times.size:
            raise ModelError(
                f"state: got {state.plays.size} plays and {state.lowpasses.size} low-passes, need "
                f"{self.thresholds.size} and {self.times.size}; use one that this model handed back"
            )
        slack = 1e-9 * (abs(state.voltage) + float(self.thresholds.max(initial=0.0)))
        if np.any(np.abs(state.plays - state.voltage) > self.thresholds + slack):
            raise ModelError("state: a play lies farther from the voltage than its threshold")

    def _timed(self, state: PlayState, time: ArrayLike | None, count: int) -> tuple[PlayState, Array]:
        """The state with the time at its end, and the seconds (n,) before each sample; none without low-passes."""
        self.check(state)
        if not self.times.size or not count:
            return state, np.zeros(0)
        if time is None:
            raise ModelError("this model creeps: it needs the time of each sample; give time=, in seconds")
        return _stepped(state, vector(time, "time"), count)

    @property
    def parameters(self) -> int:
        """Numbers that a fit chooses: slopes, shares and the offset."""
        return sum(s.size for s in self.slopes) + self.shares.size + 1


def _stepped(state: PlayState, time: Array, count: int) -> tuple[PlayState, Array]:
    """A time that begins after the state's goes on from there; another follows it by its own first interval."""
    if time.size != count:
        raise ModelError(f"time: got {time.size} samples, need {count}, one for each")
    gaps = np.diff(time)
    if np.any(gaps <= 0):
        raise ModelError(f"time: does not increase at sample {int(np.argmax(gaps <= 0)) + 1}; need seconds, in order")
    # Even sampling stays even where rounding made the steps differ: the core keeps what belongs to one step.
    rounding = 4 * np.finfo(np.float64).eps * float(np.abs(time).max())
    usual = float(np.median(gaps)) if gaps.size else 0.0
    gaps = np.where(np.abs(gaps - usual) <= rounding, usual, gaps)
    if state.time is None:
        first = 0.0
    elif time[0] > state.time:
        first = float(time[0]) - state.time
    else:
        first = float(gaps[0]) if gaps.size else 0.0
    return replace(state, time=float(time[-1])), np.concatenate([[first], gaps])
