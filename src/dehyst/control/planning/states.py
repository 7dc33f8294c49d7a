"""The possible states of an actuator at a voltage, and their bounds.

If the order of voltages alone determines the state, every voltage keeps the order of states. Then the two extreme
equilibria, on either branch of the major loop, bound every state at rest, and two simulations propagate the bounds
exactly (theory section 11). A transformer and graded elements keep the order too. If the displacement is known, the
elements are independent.

With creep the order of states holds too: of two voltage histories, the one that is never lower leaves no part of the
actuator lower. Hence two states bound all histories within the limits, at any speed and of any duration: the states
after resting infinitely long at either limit. Smooth elements and a mass that acts on the voltage do not keep the
order. For them, the bounding states are the extremes with smooth elements strained either way, and states after random
histories.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._native import slip_elongations
from dehyst._types import Array
from dehyst._validation import interval, number, vector
from dehyst.model import Actuator, GradedSlip, State, on_curve
from dehyst.waveforms import Sampling

_ROUNDING = 1e-12
# Share of the range of displacements: well above rounding, well below the resolution of any sensor.
_TOLERANCE = 1e-12
_CHUNK = 4096
# Random histories, and turns in each.
_HISTORIES, _TURNS = 12, 8


class MajorLoop:
    """Voltage over displacement on the rising (side 1) and the falling (side -1) branch of the major loop.

    Smooth elements are taken to hold their largest voltage everywhere.
    """

    def __init__(self, actuator: Actuator) -> None:
        slip, smooth = actuator.slip, actuator.smooth
        self._actuator, self._tau = actuator, actuator.transformer
        graded = isinstance(slip, GradedSlip)
        held = 0.0 if smooth is None else float(smooth.stiffness @ smooth.length)
        # The voltage [V] that plain and smooth elements hold on both branches.
        self._friction = held if graded else held + float(slip.friction.sum())
        self._tables = {side: self._tabulated(side) for side in (1, -1)} if graded else {}

    def voltage(self, displacement: float, side: int) -> float:
        """Return the voltage [V] at a displacement [m]."""
        if self._tables:
            y, held = self._tables[side]
            internal = float(on_curve(y, held, displacement))
        else:
            internal = float(self._actuator.spring(displacement)) + side * self._friction
        return internal if self._tau is None else float(self._tau.inverse(internal))

    def displacement(self, voltage: float, side: int) -> float:
        """Return the displacement [m] at a voltage [V]: the lowest of any state on side 1, the highest on side -1."""
        internal = voltage if self._tau is None else float(self._tau(voltage))
        if self._tables:
            y, held = self._tables[side]
            return float(on_curve(held, y, internal))
        return self._actuator.core.spring_inverse(internal - side * self._friction)

    def least_range(self, lowest: float, highest: float) -> float:
        """Return the least range of the displacement [m] if the voltage covers `lowest` to `highest` [V].

        D = eta^-1(highest - F) - eta^-1(lowest + F), F = sum kappa_i rho_i; it may be negative. From an unknown state,
        any path that covers exactly these voltages leaves a largest cart width of exactly max(0, 2 rho_N - D). The
        reason: at `highest` the lower extreme state has every s_i = rho_i, at `lowest` the upper one has every s_i =
        -rho_i, and these two extremes of y determine cart N. Neither the order nor the number of turns matters.
        """
        return self.displacement(highest, 1) - self.displacement(lowest, -1)

    def bends(self, side: int) -> Array:
        """Return the displacements [m] at which the slope of the branch changes, in order."""
        more = [] if self._tau is None else [self.displacement(float(v), side) for v in self._tau.voltage]
        return np.unique(np.concatenate([self._element_bends(side), more]))

    def _element_bends(self, side: int) -> Array:
        """Return the bends [m] of spring and elements; those that differ by rounding are merged."""
        knots, slip = self._actuator.spring.displacement, self._actuator.slip
        if not isinstance(slip, GradedSlip):
            return knots
        y = np.unique(np.concatenate([knots, slip.knots, (slip.knots[:, None] + side * slip.breakaway).ravel()]))
        return np.asarray(y[np.diff(y, prepend=-np.inf) > _ROUNDING * np.ptp(y)])

    def _tabulated(self, side: int) -> tuple[Array, Array]:
        """Return the bends [m] of a branch of graded elements and a point beyond either end, with their tau(v) [V]."""
        slip, y = self._actuator.slip, self._element_bends(side)
        y = np.concatenate([[y[0] - np.ptp(y)], y, [y[-1] + np.ptp(y)]])
        held = self._actuator.spring(y) + side * self._friction
        if isinstance(slip, GradedSlip):
            carts = y[:, None] - side * slip.breakaway
            held = held + (slip.internal_voltage(y[:, None]) - slip.internal_voltage(carts)).sum(axis=1)
        return y, held


@dataclass(frozen=True, eq=False)
class StateBounds:
    """Two states, `lower` and `upper`, that bound the actuator's displacement and the position of every cart.

    A voltage keeps the order of states, so two simulations propagate the bounds. No width ever exceeds the largest
    width before. Carts of elements without stiffness count too. Raise `ModelError` if the states have different numbers
    of carts, or the lower state exceeds the upper one somewhere.
    """

    lower: State
    upper: State

    def __post_init__(self) -> None:
        for name in ("lower", "upper"):
            if not isinstance(getattr(self, name), State):
                raise ModelError(argument=name, got=type(getattr(self, name)).__name__, need="a State")
        if self.lower.carts.size != self.upper.carts.size:
            raise ModelError(
                got=f"{self.lower.carts.size} and {self.upper.carts.size} carts", need="states of one actuator"
            )
        if self.lower.deformation > self.upper.deformation or np.any(self.lower.carts > self.upper.carts):
            raise ModelError("the lower state lies above the upper one: swap them, or start from StateBounds.at_rest")

    @classmethod
    def at_rest(cls, actuator: Actuator, voltage: float = 0.0) -> StateBounds:
        """Bound every state in which the `actuator` can rest at `voltage` [V], by its two extreme equilibria.

        They lie on the major loop. For an actuator of Maxwell-slip elements and a spring, they are at ``eta^-1(v - F)``
        with every s_i = rho_i and at ``eta^-1(v + F)`` with every s_i = -rho_i, where F = sum kappa_i rho_i. Raise
        `ModelError` if `actuator` is not an Actuator, or the voltage is not finite.
        """
        v, loop = number(voltage, "voltage"), MajorLoop(_ordered(actuator))
        lowest, highest, rho = loop.displacement(v, 1), loop.displacement(v, -1), actuator.slip.breakaway
        return cls(State(lowest, lowest - rho), State(highest, highest + rho))

    @classmethod
    def of(cls, states: Sequence[State]) -> StateBounds:
        """Return the tightest bounds of `states` of one actuator."""
        names, ends = ("carts", "creep", "motion", "smooth", "displacement_creep"), []
        for order in (np.min, np.max):
            arrays = (order([getattr(state, name) for state in states], axis=0) for name in names)
            ends.append(State(float(order([state.deformation for state in states])), *arrays))
        return cls(*ends)

    def propagate(self, actuator: Actuator, voltage: ArrayLike) -> KnownState:
        """Propagate the bounds through a voltage; exact, by two simulations.

        `voltage` (n,) [V]: each reached monotonically from the one before; turning points suffice. Raise `ModelError`
        if it is not finite, or the bounds are not of the `actuator`.
        """
        v, rho = vector(voltage, "voltage"), _ordered(actuator).slip.breakaway
        lowest, highest, width, now = np.empty_like(v), np.empty_like(v), np.empty_like(v), self
        for first in range(0, v.size, _CHUNK):
            part = slice(first, first + _CHUNK)
            motions = [actuator.simulate(v[part], state=one, extrapolate=True) for one in (now.lower, now.upper)]
            low, high = (motion.displacement for motion in motions)
            carts_low, carts_high = (
                motion.displacement[:, None] - slip_elongations(rho, one.carts, motion.displacement)[0]
                for motion, one in zip(motions, (now.lower, now.upper), strict=True)
            )
            # Bounds that have met may differ either way by rounding.
            lowest[part], highest[part] = np.minimum(low, high), np.maximum(low, high)
            width[part] = np.abs(carts_high - carts_low).max(axis=1, initial=0.0)
            now = StateBounds.of([motion.state for motion in motions])
        return KnownState(lowest, highest, width, now)

    @property
    def widths(self) -> Array:
        """Width of the bounds of each cart (N,) [m]."""
        return self.upper.carts - self.lower.carts

    @property
    def move_error(self) -> float:
        """Width of the bounds of the displacement [m]: the error bar of a first move from an unknown state.

        A sensor that reads zero at the start shows y(t) - y(0), and y(0) is anywhere within the bounds. Once the state
        is known, only this error remains: readings of y(t) - y(0) from different starts differ by up to this width, and
        some differ by exactly this width. Before, the bounds of y(t) add to it: readings lie between ``lowest -
        upper.deformation`` and ``highest - lower.deformation``.
        """
        return self.upper.deformation - self.lower.deformation

    @property
    def width(self) -> float:
        """The largest width [m] of a cart or of the displacement."""
        return float(max(self.widths.max(initial=0.0), self.move_error))

    @property
    def middle(self) -> State:
        """The state in the middle of the bounds, with an error of at most half the width."""
        names = [one.name for one in fields(State)]
        return State(*(0.5 * (getattr(self.lower, name) + getattr(self.upper, name)) for name in names))


class KnownState(NamedTuple):
    """Knowledge of the state after each sample of a voltage.

    `lowest`, `highest` (n,): tight bounds of the displacement [m]. `width` (n,): largest width of any cart's bounds
    [m]; it never grows, and the width of the displacement never exceeds it. `bounds`: bounds of the state after the
    last sample.
    """

    lowest: Array
    highest: Array
    width: Array
    bounds: StateBounds

    def first_known(self, tolerance: float) -> int | None:
        """Return the first sample after which the whole state is known to a `tolerance` [m]; None if there is none."""
        known = self.width <= tolerance
        return int(known.argmax()) if known.any() else None


def first_known_by_displacement(breakaway: Array, displacement: ArrayLike) -> int | None:
    """Return the first sample after which a measured displacement determines each element from an unknown state.

    The interval of an elongation s_i has exactly the width max(0, 2 rho_i - R), where R is the range of the
    displacements (n,) [m] so far. `breakaway` (N,): rho [m]. None if there is no such sample.
    """
    y, largest = vector(displacement, "displacement"), 2 * float(breakaway.max(initial=0.0))
    # Rounding must not decide whether an excursion of exactly 2 rho_N suffices.
    known = np.maximum.accumulate(y) - np.minimum.accumulate(y) >= largest - _TOLERANCE * largest
    return int(known.argmax()) if known.any() else None


def time_dependence(actuator: Actuator) -> str:
    """Return as text why the order of voltages does not determine the state; empty if it does."""
    parts = {
        "creeps": actuator.creep_times.size > 0,
        "has inertia": actuator.dynamics is not None,
        "lags": actuator.lag > 0,
        "has smooth elements": actuator.smooth is not None,
    }
    return " and ".join(words for words, there in parts.items() if there)


def _ordered(actuator: Actuator) -> Actuator:
    """Return the actuator; raise `ModelError` unless the order of voltages determines its state."""
    if not isinstance(actuator, Actuator):
        raise ModelError(argument="actuator", got=type(actuator).__name__, need="an Actuator")
    if reasons := time_dependence(actuator):
        raise ModelError(
            f"these bounds need a state that follows from the order of voltages alone, but this actuator {reasons}",
            hint="use dehyst.shortest_homing, which plays a voltage in time and reports how much stays unknown",
        )
    return actuator


def keeps_order(actuator: Actuator) -> bool:
    """Return whether the two extreme states provably bound all states."""
    dynamics = actuator.dynamics
    return actuator.smooth is None and (dynamics is None or not dynamics.series)


def least_width(actuator: Actuator, tolerance: float | None = None) -> float:
    """Return the tolerance [m]: the given one, or 1e-12 of the range of the knots."""
    if tolerance is None:
        return _TOLERANCE * float(np.ptp(actuator.spring.displacement))
    if number(tolerance, "tolerance") <= 0:
        raise ModelError(
            argument="tolerance", got=tolerance, need="a positive number of metres: rounding leaves some width"
        )
    return float(tolerance)


def possible_states(
    actuator: Actuator,
    voltage: float,
    limits: tuple[float, float] | None = None,
    half: float = Sampling().half,
) -> tuple[State, ...]:
    """Return states at a voltage that bound all states in which an actuator of unknown history may rest there.

    There are two states, the lower one first, if these provably bound all others. There are more for an actuator with
    smooth elements or a mass that acts on the voltage. `limits` [V]: range of all earlier voltages, widened to include
    the `voltage` [V], for an actuator that depends on time; default: the actuator's `voltage_range`. `half` [s]:
    approximate duration of the legs of random histories. Raise `ModelError` if the voltage is not finite, or the limits
    are no interval.
    """
    v = number(voltage, "voltage")
    if not time_dependence(actuator):
        bounds = StateBounds.at_rest(actuator, v)
        return bounds.lower, bounds.upper
    low, high = actuator.voltage_range if limits is None else interval(limits)
    low, high = min(low, v), max(high, v)
    still = actuator.quasistatic()

    def played(state: State, voltages: ArrayLike, seconds: Array) -> State:
        time = seconds if still.needs_time else None
        reached: State = still.simulate(voltages, time=time, state=state, extrapolate=True).state
        return reached

    # After resting for ever at either limit.
    loop, rho = MajorLoop(actuator), actuator.slip.breakaway
    length = np.zeros(0) if actuator.smooth is None else actuator.smooth.length
    rested = [
        still.model.complete_state(State(y, y - side * rho, smooth=share * length))
        for side, y in ((1, loop.displacement(low, 1)), (-1, loop.displacement(high, -1)))
        for share in ((1.0, 0.0, -1.0) if length.size else (1.0,))
    ]
    # The last leg takes no time.
    now = np.zeros(1)
    states = [played(state, [v], now) for state in rested]
    if not keeps_order(actuator):
        random, seconds = np.random.default_rng(0), np.cumsum(np.geomspace(0.01, 10, _TURNS) * half)
        turns = [random.uniform(low, high, _TURNS) for _ in range(_HISTORIES)]
        begun = list(states)
        states += [played(played(begun[k % len(begun)], one, seconds), [v], now) for k, one in enumerate(turns)]
    if actuator.dynamics is None:
        return tuple(states)
    return tuple(replace(state, motion=np.array([state.deformation, 0.0])) for state in states)
