"""State bounds: an interval for the displacement and for every cart.

The history may be any that ended at rest. If y is known, the elements are independent; if only v is known the
displacement depends on all of them, and two simulations bound the carts (theory section 11). A transformer keeps the
order of voltages, and elements may be graded: a higher state stays the higher one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dehyst._errors import ModelError
from dehyst._native import slip_elongations
from dehyst._types import Array, Mask
from dehyst._validation import number, vector
from dehyst.control.major_loop import MajorLoop
from dehyst.model import Actuator, MaxwellSlip, State

Counts = NDArray[np.intp]
# Share of the range: well above rounding, well below the resolution of any sensor.
_TOLERANCE = 1e-12
_CHUNK = 4096


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
            raise ModelError("the carts of an actuator with dynamics follow w, not the displacement; give w and rho")
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
                raise ModelError(f"{name}: got {type(getattr(self, name)).__name__}, need a State")
        if self.lower.carts.size != self.upper.carts.size:
            raise ModelError(
                f"got {self.lower.carts.size} and {self.upper.carts.size} carts, need states of one actuator"
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
        raise ModelError(f"actuator: got {type(actuator).__name__}, need an Actuator")
    if moves_on(actuator):
        raise ModelError(
            f"bounds of the state follow the voltage alone, this actuator {moves_on(actuator)}; use "
            "dehyst.shortest_homing, which plays a voltage in time and reports how much stays unknown"
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
        raise ModelError(f"tolerance: got {tolerance}, need a positive number of metres: rounding leaves some width")
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
