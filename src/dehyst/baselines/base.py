"""What all baselines share: fit and predict; and the weighted plays of those that are inverted in closed form."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst._validation import demand_result, keep, number, vector
from dehyst.baselines._native import PlayCore
from dehyst.baselines.training import Training
from dehyst.model import AbstractModel, Motion


class AbstractBaseline(AbstractModel):
    """A model that others published, behind the common interface.

    Its `fit` takes `records`, a Record or a sequence of them: loops, each with an offset of its own; none needs to
    start relaxed. `delay` [s] is that by which the displacement lags the voltage; default: estimated. With `drift` a
    record may creep by a logarithm of the time since its start; the drift is then removed. It raises `RecordError` if a
    record cannot be used, and `IdentifyError` if no sample counts or an option is impossible.

    `state`: default start of a motion. `delay`: seconds by which the measured displacement lagged the voltage;
    `simulate` and `compensate` do not apply it.
    """

    state: Any
    delay: float

    def simulate(self, voltage: ArrayLike, *, state: Any = None, time: ArrayLike | None = None) -> Motion:
        """Return the displacement (n,) [m] that a voltage (n,) [V] causes.

        Raise `ModelError` if the voltage is not a path of finite numbers, the state is not one of this model, a model
        with creep gets no increasing time, or a displacement is too large to be computed.

        `voltage` (n,) [V]. `state`: state before the first sample, as a motion of this model returned it; default: the
        model's own. `time` (n,) [s], increasing; models without creep ignore it.
        """
        v = vector(voltage, "voltage")
        y, after = self._run(v, self.state if state is None else state, time, inverse=False)
        demand_result(y, "displacement")
        return Motion(v, y, after)

    def compensate(self, displacement: ArrayLike, *, state: Any = None, time: ArrayLike | None = None) -> Motion:
        """Return the voltage (n,) [V] for a displacement (n,) [m]; arguments as `simulate`.

        Raise `ModelError` as `simulate`, and if no voltage reaches a displacement.
        """
        y = vector(displacement, "displacement")
        v, after = self._run(y, self.state if state is None else state, time, inverse=True)
        demand_result(v, "voltage")
        return Motion(v, y, after)

    @abstractmethod
    def _run(self, drive: Array, state: Any, time: ArrayLike | None, *, inverse: bool) -> tuple[Array, Any]:
        """Return displacements (n,) [m] for voltages (n,) [V], inverse: voltages for displacements; and the state."""


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


@dataclass(frozen=True, eq=False)
class PlayBank:
    """Curves of play operators and low-passes, ``y = offset + sum_i phi_i(z_i) + sum_k share_k q_k``.

    Raise `ModelError` if a number is impossible.

    `thresholds` (N,): r_i [V], 0 or more. `knots`: places [V] where the slope of phi_i changes, increasing; none for a
    straight line through 0. `slopes`: slopes of phi_i [m/V], 0 or more, one more than knots: below the first, between
    them, beyond the last. phi_i is 0 at its first knot. `offset`: [m]. `times`, `shares` (K,): of the low-passes: time
    constants [s], above 0, and shares [m/V], 0 or more.
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
        keep(self, **given)
        self._check()
        keep(self, _core=self._compiled())

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

    def state_after_rise(self, voltage: float) -> PlayState:
        """Return the state after a long rise to a voltage [V] and a rest there."""
        return PlayState(voltage, voltage - self.thresholds, np.full(self.times.size, voltage))

    def state_after_descent(self, voltage: float) -> PlayState:
        """Return the state after a long descent to a voltage [V] and a rest there."""
        return PlayState(voltage, voltage + self.thresholds, np.full(self.times.size, voltage))

    def simulate(self, v: Array, state: PlayState, time: ArrayLike | None) -> tuple[Array, PlayState]:
        """Return the displacement (n,) [m] that a voltage (n,) [V] causes, and the state at its end."""
        after, steps = self._timed(state, time, v.size)
        y, plays, passed = self._core.simulate(v, steps, state.voltage, state.plays, state.lowpasses)
        return y, replace(after, voltage=float(v[-1]) if v.size else state.voltage, plays=plays, lowpasses=passed)

    def compensate(self, y: Array, state: PlayState, time: ArrayLike | None) -> tuple[Array, PlayState]:
        """Return the voltage (n,) [V] for a displacement (n,) [m], and the state at its end; exact."""
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
            raise ModelError(f"state: got {type(state).__name__}, need one that this model returned")
        if state.plays.size != self.thresholds.size or state.lowpasses.size != self.times.size:
            raise ModelError(
                f"state: got {state.plays.size} plays and {state.lowpasses.size} low-passes, need "
                f"{self.thresholds.size} and {self.times.size}; use one that this model returned"
            )
        slack = 1e-9 * (abs(state.voltage) + float(self.thresholds.max(initial=0.0)))
        if np.any(np.abs(state.plays - state.voltage) > self.thresholds + slack):
            raise ModelError("state: a play lies farther from the voltage than its threshold")

    def _timed(self, state: PlayState, time: ArrayLike | None, count: int) -> tuple[PlayState, Array]:
        """Return the state with the time at its end and, with low-passes, the seconds (n,) before each sample."""
        self.check(state)
        if not self.times.size or not count:
            return state, np.zeros(0)
        if time is None:
            raise ModelError(
                "this model creeps: it needs the time of each sample", hint="give the time [s]", change=("time",)
            )
        return _time_steps(state, vector(time, "time"), count)

    @property
    def parameters(self) -> int:
        """Number of coefficients: slopes, shares and the offset."""
        return sum(s.size for s in self.slopes) + self.shares.size + 1


def _time_steps(state: PlayState, time: Array, count: int) -> tuple[PlayState, Array]:
    """Continue from the state's time if `time` begins after it, else let it begin one interval later."""
    if time.size != count:
        raise ModelError(argument="time", got=f"{time.size} samples", need=f"{count}, one for each")
    gaps = np.diff(time)
    if np.any(gaps <= 0):
        raise ModelError(f"time: does not increase at sample {int(np.argmax(gaps <= 0)) + 1}; need seconds, in order")
    # Even sampling stays even where rounding made the steps differ: the core caches the numbers of one step.
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


@dataclass(frozen=True, eq=False)
class PlayInverse:
    """Closed-form inverse of ``y = offset + sum_i w_i play_i[v]``, r_0 = 0 < r_1 < ..., w_0 > 0, other w_i >= 0.

    ``v = sum_i w'_i play_{r'_i}[y - offset]`` with
    ``r'_i = sum_{j<=i} w_j (r_i - r_j)``, ``w'_0 = 1 / w_0`` and ``w'_i = 1 / W_i - 1 / W_{i-1}``, W_i the sum of
    w_0 ... w_i. Raise `ModelError` if the bank has no such inverse.
    """

    bank: PlayBank
    weights: Array = field(init=False)
    _back: Array = field(init=False, repr=False)
    _core: PlayCore = field(init=False, repr=False)

    def __post_init__(self) -> None:
        r = self.bank.thresholds
        if not r.size or r[0] != 0 or np.any(np.diff(r) <= 0) or any(k.size for k in self.bank.knots):
            raise ModelError("no closed-form inverse: need plays of increasing thresholds from 0, on straight lines")
        if self.bank.times.size or self.bank.slopes[0][0] <= 0:
            raise ModelError("no closed-form inverse: need a positive weight at threshold 0 and no low-passes")
        w = np.concatenate(self.bank.slopes)
        summed = np.cumsum(w)
        thresholds = np.concatenate([[0.0], np.cumsum(summed[:-1] * np.diff(r))])
        back = np.diff(1 / summed, prepend=0.0)
        zeros, none = np.zeros(r.size), np.zeros(0)
        core = PlayCore(
            thresholds, np.arange(r.size + 1, dtype=np.intc), zeros, zeros, np.repeat(back, 2), none, none, 0.0
        )
        keep(self, weights=w, _back=back, _core=core)

    def compensate(self, y: Array, state: PlayState) -> tuple[Array, PlayState]:
        """Return the voltage (n,) [V] for a displacement (n,) [m], and the state at its end; equals `bank.compensate`.

        The closed form does not hold from a state that no history leads to, in which neighbours lie farther apart than
        their thresholds; then `bank.compensate` is used.
        """
        self.bank.check(state)
        steps = np.diff(self.bank.thresholds)
        if not y.size or np.any(np.abs(np.diff(state.plays)) > steps + 1e-9 * self.bank.thresholds.max()):
            return self.bank.compensate(y, state, None)
        start = _through(self.weights, np.concatenate([[state.voltage], state.plays[1:]]))
        none = np.zeros(0)
        v, z, _ = self._core.simulate(y - self.bank.offset, none, float(start[0]), start, none)
        return v, PlayState(float(v[-1]), _through(self._back, z), none, state.time)


def _through(weights: Array, z: Array) -> Array:
    """Return the outputs of the inverse operator's plays: sum_{j<=i} w_j z_i + sum_{j>i} w_j z_j."""
    product = weights * z
    return np.asarray(np.cumsum(weights) * z + product.sum() - np.cumsum(product))


@dataclass(frozen=True, eq=False)
class AbstractPlayModel(AbstractBaseline):
    """A bank of play operators behind the common interface.

    `bank`: its operators. `state`: default start: after a long descent to the lowest voltage of its records. `remarks`:
    repairs of the records, as sentences.
    """

    bank: PlayBank
    state: PlayState
    delay: float = 0.0
    remarks: tuple[str, ...] = ()

    @property
    def parameters(self) -> int:
        """Number of coefficients."""
        return self.bank.parameters

    def _run(self, drive: Array, state: PlayState, time: ArrayLike | None, *, inverse: bool) -> tuple[Array, PlayState]:
        return (self.bank.compensate if inverse else self.bank.simulate)(drive, state, time)

    @classmethod
    def _from_bank(cls, bank: PlayBank, training: Training) -> Self:
        """Return the model of a bank fitted to these records."""
        return cls(bank, bank.state_after_descent(training.limits[0]), training.delay, training.sentences)
