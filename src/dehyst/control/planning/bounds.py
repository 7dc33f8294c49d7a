"""Bounds of an unknown state: of the displacement and of every cart, and the possible states at a voltage.

Where a voltage alone determines the state, it keeps the order of states: the two extreme equilibria, on either branch
of the major loop, bound every state at rest, and two simulations propagate the bounds exactly (theory section 11). A
transformer and graded elements keep the order too. If the displacement is known, the elements are independent.

With creep the order of states holds too: a voltage that was never lower leaves no part of the actuator lower. So of all
histories within the limits, at any speed and of any duration, two states are the extremes: after resting for ever at
either limit. Smooth elements and a mass that acts on the voltage keep no order: for them the extremes are taken with
smooth elements pulled either way, and random histories besides.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dehyst._errors import ModelError
from dehyst._native import slip_elongations
from dehyst._types import Array, Mask
from dehyst._validation import interval, number, vector
from dehyst.model import Actuator, GradedSlip, MaxwellSlip, State
from dehyst.model.elements import on_curve
from dehyst.waveforms import Sampling

_ROUNDING = 1e-12
Counts = NDArray[np.intp]
# Share of the range: well above rounding, well below the resolution of any sensor.
_TOLERANCE = 1e-12
_CHUNK = 4096
# Random histories, and turns in each.
_HISTORIES, _TURNS = 12, 8


@dataclass(frozen=True, eq=False)
class MajorLoop:
    """Voltage over displacement on the rising (side 1) and the falling (side -1) branch of the major loop.

    `actuator`: its smooth elements bear their largest force everywhere.
    """

    actuator: Actuator

    @cached_property
    def friction(self) -> float:
        """The voltage [V] that plain and smooth elements bear on both branches."""
        slip, smooth = self.actuator.slip, self.actuator.smooth
        borne = 0.0 if smooth is None else float(smooth.stiffness @ smooth.length)
        return borne if isinstance(slip, GradedSlip) else borne + float(slip.friction.sum())

    def voltage(self, displacement: float, side: int) -> float:
        """Return the voltage [V] at a displacement [m]."""
        if not isinstance(self.actuator.slip, GradedSlip):
            internal = float(self.actuator.spring(displacement)) + side * self.friction
        else:
            y, borne = self._branch(side)
            internal = float(on_curve(y, borne, displacement))
        tau = self.actuator.transformer
        return internal if tau is None else float(tau.inverse(internal))

    def displacement(self, voltage: float, side: int) -> float:
        """Return the displacement [m] at a voltage [V]: no state lies lower on side 1, nor higher on side -1."""
        tau = self.actuator.transformer
        internal = voltage if tau is None else float(tau(voltage))
        if not isinstance(self.actuator.slip, GradedSlip):
            return self.actuator.core.spring_inverse(internal - side * self.friction)
        y, borne = self._branch(side)
        return float(on_curve(borne, y, internal))

    def bends(self, side: int) -> Array:
        """Return the displacements [m] at which the slope of the branch changes, in order."""
        tau = self.actuator.transformer
        more = [] if tau is None else [self.displacement(float(v), side) for v in tau.voltage]
        return np.unique(np.concatenate([self._element_bends(side), more]))

    def _element_bends(self, side: int) -> Array:
        """Return the bends [m] of spring and elements; those that differ by rounding are merged."""
        knots, slip = self.actuator.spring.displacement, self.actuator.slip
        if not isinstance(slip, GradedSlip):
            return knots
        y = np.unique(np.concatenate([knots, slip.knots, (slip.knots[:, None] + side * slip.breakaway).ravel()]))
        return np.asarray(y[np.diff(y, prepend=-np.inf) > _ROUNDING * np.ptp(y)])

    def _branch(self, side: int) -> tuple[Array, Array]:
        return self._branches[side]

    @cached_property
    def _branches(self) -> dict[int, tuple[Array, Array]]:
        return {side: self._tabulated(side) for side in (1, -1)}

    def _tabulated(self, side: int) -> tuple[Array, Array]:
        """Return the bends of a branch of graded elements, with a point beyond either end, and tau(v) [V] there."""
        slip, y = self.actuator.slip, self._element_bends(side)
        y = np.concatenate([[y[0] - np.ptp(y)], y, [y[-1] + np.ptp(y)]])
        borne = self.actuator.spring(y) + side * self.friction
        if isinstance(slip, GradedSlip):
            carts = y[:, None] - side * slip.breakaway
            borne = borne + (slip.internal_voltage(y[:, None]) - slip.internal_voltage(carts)).sum(axis=1)
        return y, borne


@dataclass(frozen=True, eq=False)
class KnownCarts:
    """Knowledge of the carts from a known displacement, with nothing known before.

    `breakaway` (N,): rho [m]. `running_range` (n,): R(t), the range of the displacements until now [m]. `tolerance`:
    width [m] up to which an element counts as known.
    """

    breakaway: Array
    running_range: Array
    tolerance: float

    @property
    def widths(self) -> Array:
        """Width (n, N) [m] of the interval of each elongation s_i: exactly max(0, 2 rho_i - R)."""
        return np.maximum(0.0, 2 * self.breakaway - self.running_range[:, None])

    @property
    def unknown(self) -> Counts:
        """Number of unknown elements (n,)."""
        known = np.searchsorted(2 * self.breakaway - self.tolerance, self.running_range, side="right")
        return np.asarray(self.breakaway.size - known)

    @property
    def first_known(self) -> int | None:
        """First sample from which every element is known; None if there is none."""
        return _first(self.unknown == 0)


def known_by_displacement(
    actuator: Actuator | ArrayLike, displacement: ArrayLike, *, tolerance: float | None = None
) -> KnownCarts:
    """Return what is known of each element if the displacement is known: measured, or commanded.

    Raise `ModelError` if the numbers are not finite, the breakaway elongations not positive and strictly increasing, or
    the tolerance is not positive; or the actuator has dynamics.

    `actuator`: the actuator, or only its breakaway elongations rho [m]. `displacement` (n,) [m]; nothing is known
    before the first sample. `tolerance`: width [m] up to which an element counts as known; default 1e-12 of 2 rho_N.
    With 0, rounding would decide whether an excursion of exactly 2 rho_N suffices.
    """
    if isinstance(actuator, Actuator):
        if actuator.dynamics is not None:
            raise ModelError(
                "the carts of an actuator with dynamics follow w, not the displacement", hint="give w and rho"
            )
        rho = actuator.slip.breakaway
    else:
        given = vector(actuator, "breakaway elongations")
        rho = MaxwellSlip(given, np.zeros(given.size)).breakaway
    y = vector(displacement, "displacement")
    least = _positive(tolerance, _TOLERANCE * 2 * float(rho.max(initial=0.0)))
    return KnownCarts(rho, np.maximum.accumulate(y) - np.minimum.accumulate(y), least)


@dataclass(frozen=True, eq=False)
class StateBounds:
    """Two states, `lower` and `upper`, that bound the actuator's: displacement and every cart, in absolute coordinates.

    A voltage keeps the order of states, so two simulations propagate the bounds; no width ever exceeds the largest one
    before. Elements without stiffness have carts too, and count like the others. Raise `ModelError` if they have
    different numbers of carts, or the lower one lies above the upper one somewhere.
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
        if self.lower.displacement > self.upper.displacement or np.any(self.lower.carts > self.upper.carts):
            raise ModelError("the lower state lies above the upper one: swap them, or start from StateBounds.at_rest")

    @classmethod
    def at_rest(cls, actuator: Actuator, voltage: float = 0.0) -> StateBounds:
        """Bound every state in which the `actuator` can rest at `voltage` [V], by its two extreme equilibria.

        They lie on the major loop; of a plain actuator at ``eta^-1(v - F)`` with every s_i = rho_i and at
        ``eta^-1(v + F)`` with every s_i = -rho_i, where F = sum kappa_i rho_i. Raise `ModelError` if `actuator` is not
        an Actuator, or the voltage is not finite.
        """
        v, slip = number(voltage, "voltage"), checked_actuator(actuator).slip
        branch = MajorLoop(actuator)
        lowest, highest = branch.displacement(v, 1), branch.displacement(v, -1)
        return cls(State(lowest, lowest - slip.breakaway), State(highest, highest + slip.breakaway))

    def propagate(self, actuator: Actuator, voltage: ArrayLike, *, tolerance: float | None = None) -> KnownState:
        """Propagate the bounds through a voltage; exact, by two simulations.

        Parameters
        ----------
        actuator : Actuator
        voltage : (n,) array_like
            [V], each reached monotonically from the one before; turning points suffice.
        tolerance : float, optional
            Width [m] up to which an element counts as known; default 1e-12 of the range of the spring's knots.

        Raises
        ------
        ModelError
            If the voltage is not finite, the bounds are of another actuator, or the tolerance is not positive.
        """
        v, least = vector(voltage, "voltage"), least_width(checked_actuator(actuator), tolerance)
        lowest, highest, width = np.empty_like(v), np.empty_like(v), np.empty_like(v)
        unknown, now = np.empty(v.size, dtype=np.intp), self
        for first in range(0, v.size, _CHUNK):
            part = slice(first, first + _CHUNK)
            y_low, carts_low, lower = _carts(actuator, v[part], now.lower)
            y_high, carts_high, upper = _carts(actuator, v[part], now.upper)
            lowest[part], highest[part] = np.minimum(y_low, y_high), np.maximum(y_low, y_high)
            widths = np.abs(carts_high - carts_low)
            width[part] = widths.max(axis=1, initial=0.0)
            unknown[part] = np.count_nonzero(widths > least, axis=1)
            now = _ordered(lower, upper)
        return KnownState(lowest, highest, width, unknown, now)

    @property
    def widths(self) -> Array:
        """Width of the bounds of each cart (N,) [m]."""
        return self.upper.carts - self.lower.carts

    @property
    def width(self) -> float:
        """The largest width [m] of a cart or of the displacement."""
        return float(max(self.widths.max(initial=0.0), first_move_error(self)))

    @property
    def middle(self) -> State:
        """The state halfway, with an error of half the width at most."""
        lower, upper = self.lower, self.upper
        more = (0.5 * (getattr(lower, name) + getattr(upper, name)) for name in ("creep", "motion", "smooth"))
        return State(0.5 * (lower.displacement + upper.displacement), 0.5 * (lower.carts + upper.carts), *more)

    def known(self, tolerance: float) -> bool:
        """Return whether every cart and the displacement are known to `tolerance` [m]."""
        return self.width <= _positive(tolerance, 0.0)


@dataclass(frozen=True, eq=False)
class KnownState:
    """Knowledge of the state after each sample of a voltage.

    `lowest`, `highest` (n,): attained bounds of the displacement [m]. `width` (n,): the largest width of any cart [m];
    it never grows, and the displacement's is never larger. `unknown` (n,): number of unknown elements; usually all of
    them until the displacement is known. `bounds`: after the last sample.
    """

    lowest: Array
    highest: Array
    width: Array
    unknown: Counts
    bounds: StateBounds

    @property
    def first_known(self) -> int | None:
        """First sample from which the whole state is known; None if there is none."""
        return _first(self.unknown == 0)


def first_move_error(bounds: StateBounds) -> float:
    """Return the error bar [m] of a first move from an unknown state: the width of the displacement's bounds before it.

    A sensor that reads zero at the start shows y(t) - y(0), and y(0) is anywhere within the bounds. Once the state is
    known only this error remains: readings of y(t) - y(0) from different starts differ by up to this width, which is
    attained. Before that the bounds of y(t) add to it: readings lie between ``lowest - upper.displacement`` and
    ``highest - lower.displacement``.
    """
    return bounds.upper.displacement - bounds.lower.displacement


def least_range(actuator: Actuator, lowest: float, highest: float) -> float:
    """Return the range [m] that the displacement covers at least while the voltage covers `lowest` to `highest` [V].

    D = eta^-1(highest - F) - eta^-1(lowest + F), F = sum kappa_i rho_i; it may be negative. In general the first is the
    displacement on the rising branch of the major loop, the second that on the falling one. From an unknown state the
    largest width of a cart is exactly max(0, 2 rho_N - D) after any path that covers just these voltages: at the
    highest the lower extreme state has every s_i = rho_i, at the lowest the upper one has every s_i = -rho_i, and
    these two extremes of y determine cart N. Neither the order nor the number of turns matters. Raise `ModelError` if
    `actuator` is not an Actuator, or a voltage is not finite.
    """
    branch = MajorLoop(checked_actuator(actuator))
    return branch.displacement(number(highest, "highest"), 1) - branch.displacement(number(lowest, "lowest"), -1)


def checked_actuator(actuator: Actuator) -> Actuator:
    """Return an Actuator whose states keep their order under any voltage; raises ModelError for all others."""
    if not isinstance(actuator, Actuator):
        raise ModelError(argument="actuator", got=type(actuator).__name__, need="an Actuator")
    if moves_on(actuator):
        raise ModelError(
            f"bounds of the state follow the voltage alone, this actuator {moves_on(actuator)}",
            hint="use dehyst.shortest_homing, which plays a voltage in time and reports how much stays unknown",
        )
    return actuator


def moves_on(actuator: Actuator) -> str:
    """Return in words why the order of voltages does not determine the state; empty if it does."""
    parts = {
        "creeps": actuator.creep is not None,
        "has inertia": actuator.dynamics is not None,
        "lags": actuator.lag > 0,
        "has smooth elements": actuator.smooth is not None,
    }
    return " and ".join(words for words, there in parts.items() if there)


def _positive(tolerance: float | None, default: float) -> float:
    if tolerance is None:
        return default
    if number(tolerance, "tolerance") <= 0:
        raise ModelError(
            argument="tolerance", got=tolerance, need="a positive number of metres: rounding leaves some width"
        )
    return float(tolerance)


def least_width(actuator: Actuator, tolerance: float | None) -> float:
    """Return the tolerance [m]: the given one, or 1e-12 of the range of the knots."""
    return _positive(tolerance, _TOLERANCE * float(np.ptp(actuator.spring.displacement)))


def _first(known: Mask) -> int | None:
    return int(known.argmax()) if known.any() else None


def _ordered(a: State, b: State) -> StateBounds:
    """Return the bounds of two states; those that have met may differ either way by rounding."""
    ends = ((order(a.displacement, b.displacement), order(a.carts, b.carts)) for order in (np.minimum, np.maximum))
    return StateBounds(*(State(float(y), carts) for y, carts in ends))


def _carts(actuator: Actuator, voltage: Array, state: State) -> tuple[Array, Array, State]:
    """Return displacement (n,), carts (n, N) and the state reached."""
    motion = actuator.simulate(voltage, state=state, extrapolate=True)
    elongations, _ = slip_elongations(actuator.slip.breakaway, state.carts, motion.displacement)
    return motion.displacement, motion.displacement[:, None] - elongations, motion.state


def possible_states(actuator: Actuator, voltage: float, limits: tuple[float, float] | None = None) -> tuple[State, ...]:
    """Return states at a voltage that bound all those in which an actuator of unknown history may stand there.

    Two states if they are proven to be the extremes, the lower one first; more for an actuator with smooth elements or
    a mass that acts on the voltage.

    Parameters
    ----------
    actuator : Actuator
    voltage : float
        [V].
    limits : (float, float), optional
        Range of all earlier voltages [V], for an actuator that moves in time; default the actuator's `voltage_range`.
        It is widened to the voltage.

    Raises
    ------
    ModelError
        If the voltage is not finite, or the limits are no interval.
    """
    v = number(voltage, "voltage")
    if not moves_on(actuator):
        bounds = StateBounds.at_rest(actuator, v)
        return bounds.lower, bounds.upper
    low, high = actuator.voltage_range if limits is None else interval(limits)
    return timed_states(actuator, (min(low, v), max(high, v)), v, Sampling().half)


def middle_of(states: Sequence[State]) -> State:
    """Return the state halfway between the extremes of some states of one actuator."""
    return states[0] if len(states) == 1 else bounds_of(states).middle


def bounds_of(states: Sequence[State]) -> StateBounds:
    """Return the tightest bounds of states."""
    names = ("carts", "creep", "motion", "smooth")
    ends = []
    for order in (np.min, np.max):
        arrays = (order([getattr(state, name) for state in states], axis=0) for name in names)
        ends.append(State(float(order([state.displacement for state in states])), *arrays))
    return StateBounds(*ends)


def keeps_order(actuator: Actuator) -> bool:
    """Return whether the two extreme states are proven to be the extremes."""
    dynamics = actuator.dynamics
    return actuator.smooth is None and (dynamics is None or not dynamics.series)


def timed_states(actuator: Actuator, limits: tuple[float, float], present: float, half: float) -> tuple[State, ...]:
    """Return the extreme states at the `present` voltage [V] of an actuator that moves in time.

    If states keep no order, those after random histories too, with legs of `half` seconds and about.
    """
    still = replace(actuator, dynamics=None, lag=0.0, state=None)  # type: ignore[arg-type]
    states = [_moved(still, state, present) for state in _rested(actuator, limits)]
    if not keeps_order(actuator):
        random, seconds = np.random.default_rng(0), np.cumsum(np.geomspace(0.01, 10, _TURNS) * half)
        states += [
            _moved(still, states[k % len(states)], present, random.uniform(*limits, _TURNS), seconds)
            for k in range(_HISTORIES)
        ]
    if actuator.dynamics is None:
        return tuple(states)
    return tuple(replace(state, motion=np.array([state.displacement, 0.0])) for state in states)


def _rested(actuator: Actuator, limits: tuple[float, float]) -> Iterator[State]:
    """Yield the states after resting for ever at either limit."""
    branch, rho, smooth = MajorLoop(actuator), actuator.slip.breakaway, actuator.smooth
    length = np.zeros(0) if smooth is None else smooth.length
    for side, limit in ((1, limits[0]), (-1, limits[1])):
        y = branch.displacement(limit, side)
        for share in (1.0, 0.0, -1.0) if length.size else (1.0,):
            yield State(y, y - side * rho, smooth=share * length)


def _moved(
    still: Actuator, state: State, present: float, turns: Array | None = None, seconds: Array | None = None
) -> State:
    """Return the state at the present voltage, from a state through turns [V]; the last leg takes no time."""
    reached = still.model.complete_state(state)
    if turns is not None:
        when = seconds if still.needs_time else None
        reached = still.simulate(turns, time=when, state=reached, extrapolate=True).state
    now = np.zeros(1) if still.needs_time else None
    last: State = still.simulate([present], time=now, state=reached, extrapolate=True).state
    return last
