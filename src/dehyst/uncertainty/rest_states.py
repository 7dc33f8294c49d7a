"""Where an actuator may be at rest before it is driven (Appendix A.1, Eq. 10).

At rest at a voltage V the elements may be strained: any elongations within their breakaways are held by the spring at
y = eta^-1(V - sum_i kappa_i s_i). The paper leaves g(x(0)) unknown and gets a polytope in (x, s, g). For an identified
actuator on its own axis g is known; since eta strictly increases y follows from s, and the set is one polytope in s
(in (y, s) it is a union of polytopes, one for each segment of the spring).

A transformer bends the voltage only; creep, inertia and lag are at rest. With graded or smooth elements the set is no
polytope in s: its range is known, and whether a state belongs to it.
"""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Integral

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst._validation import number, vector
from dehyst.control.major_loop import MajorLoop
from dehyst.identification.solvers.highs import linear_program
from dehyst.model import Actuator, GradedSlip, State

Indices = NDArray[np.intp]

ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class RestStates:
    """The states in which an actuator rests at a voltage: residual strain and charge (Appendix A.1).

    Parameters
    ----------
    actuator : Actuator
    voltage : float, optional
        [V] at which it rests.
    reachable : bool, optional
        Only the states that slow driving from the relaxed state can leave: ``abs(b_i - b_{i+1}) <= rho_{i+1} - rho_i``
        with b_0 = y and rho_0 = 0. An abrupt discharge may leave others.

    Raises
    ------
    ModelError
        If the actuator is none, the voltage is not finite or `reachable` is no bool.
    """

    actuator: Actuator
    voltage: float = 0.0
    reachable: bool = False

    def __post_init__(self) -> None:
        demand_actuator(self.actuator)
        object.__setattr__(self, "voltage", number(self.voltage, "voltage"))
        if not isinstance(self.reachable, bool):
            raise ModelError(f"reachable: got {self.reachable!r}, need True or False")

    def range(self) -> tuple[float, float]:
        """Lowest and highest displacement [m] on the model's axis, by two linear programs.

        They are ``eta^-1(V - sum f_i)`` and ``eta^-1(V + sum f_i)``, f_i = kappa_i rho_i, with and without `reachable`:
        those of the two outermost branches.
        """
        if self._bent:
            branch = MajorLoop(self.actuator)
            return branch.displacement(self.voltage, 1), branch.displacement(self.voltage, -1)
        kappa = self.actuator.slip.stiffness
        return self._at(self._farthest(kappa)).displacement, self._at(self._farthest(-kappa)).displacement

    def residual_range(self) -> tuple[float, float]:
        """Return it from where the spring alone holds the voltage [m]: the least and the largest residual strain."""
        low, high = self.range()
        at_rest = self.actuator.relaxed(self.voltage, extrapolate=True).displacement
        return low - at_rest, high - at_rest

    def state(self, elongation: ArrayLike) -> State:
        """Return the equilibrium with an `elongation` s_i (N,) [m] of each element.

        Raises
        ------
        ModelError
            If there is not one an element, or one is larger than its breakaway.
        """
        s, rho = vector(elongation, "elongation"), self.actuator.slip.breakaway
        if s.size != rho.size or np.any(np.abs(s) > rho * (1 + ROUNDING)):
            raise ModelError(f"elongation: got {s}, need one for each of {rho.size} elements, none beyond {rho}")
        return self._at(s)

    def vertex(self, direction: ArrayLike) -> State:
        """Return a state that goes farthest in a `direction` (N,) of the elongations, ``max sum_i direction_i s_i``.

        A corner of the polytope, by a linear program; where several are as far, one of them.

        Raises
        ------
        ModelError
            If the direction has not one number an element, or holds zeros only.
        """
        d = vector(direction, "direction")
        if d.size != len(self.actuator.slip) or not d.any():
            raise ModelError(
                f"direction: got {d}, need a number for each of {len(self.actuator.slip)} elements, not all of them 0"
            )
        return self._at(self._farthest(d))

    def random(self, count: int, *, seed: int = 0) -> list[State]:
        """States inside the set, uniform in the elongations.

        No random walk is needed: the set is a box, of elongations or, if `reachable`, of their increments. `count` and
        `seed` are integers.

        Raises
        ------
        ModelError
            If the count or the seed is no integer of at least 0.
        """
        for name, value in (("count", count), ("seed", seed)):
            if not isinstance(value, Integral) or isinstance(value, bool) or value < 0:
                raise ModelError(f"{name}: got {value!r}, need an integer of 0 or more")
        rho = self.actuator.slip.breakaway
        shares = np.random.default_rng(int(seed)).uniform(-1, 1, (int(count), rho.size))
        spread = np.cumsum(shares * np.diff(rho, prepend=0.0), axis=1) if self.reachable else shares * rho
        return [self._at(s) for s in spread]

    def holds(self, state: State, tolerance: float = 1e-9) -> bool:
        """Whether a `state` is one of these, to a share of the actuator's size (the spring and the largest breakaway).

        `tolerance` is that share.

        Raises
        ------
        ModelError
            If it is no state of this actuator, or the tolerance is negative.
        """
        if number(tolerance, "tolerance") < 0:
            raise ModelError(f"tolerance: got {tolerance}, need 0 or more")
        demand_state(self.actuator, state)
        rho, y = self.actuator.slip.breakaway, state.displacement
        allowed = tolerance * size_of(self.actuator)
        at_rest = self._off(state) <= allowed
        gaps = np.abs(np.diff(state.carts, prepend=y)) - np.diff(rho, prepend=0.0)
        return at_rest and (not self.reachable or bool(np.all(gaps <= allowed)))

    @property
    def _bent(self) -> bool:
        """Whether the set is no polytope."""
        return isinstance(self.actuator.slip, GradedSlip) or self.actuator.smooth is not None

    def _off(self, state: State) -> float:
        """How far a state lies from rest at the voltage [m]."""
        if not self._bent:
            return abs(self._at(state.displacement - state.carts).displacement - state.displacement)
        spring = self.actuator.spring
        mean = float(np.ptp(spring.voltage) / np.ptp(spring.displacement))
        return abs(self.actuator.voltage(state) - self.voltage) / mean

    def _at(self, elongation: Array) -> State:
        if self._bent:
            raise ModelError(
                "equilibria: with graded or smooth elements the set is no polytope of elongations; range() bounds it, "
                "holds(state) returns whether a state belongs to it"
            )
        held, tau = float(self.actuator.slip.stiffness @ elongation), self.actuator.transformer
        drive = self.voltage if tau is None else float(tau(self.voltage))
        y = self.actuator.core.spring_inverse(drive - held)
        return State(y, y - elongation)

    def _farthest(self, direction: Array) -> Array:
        """Elongations that go farthest; unknowns are s_i / rho_i, so that all numbers are of order 1."""
        rho, n = self.actuator.slip.breakaway, direction.size
        if not n:
            return np.zeros(0)
        cost = -direction * rho
        cost = cost / (np.abs(cost).max() or 1.0)
        rows, room = np.zeros((0, n)), np.zeros(0)
        if self.reachable:
            rows = (np.eye(n) - np.diag(rho[:-1] / rho[1:], -1))[1:]
            room = 1 - rho[:-1] / rho[1:]
        found, _, optimal, status, _ = linear_program(cost, (-np.ones(n), np.ones(n)), rows, (-room, room))
        if not optimal:
            raise ModelError(f"equilibria: the linear program was not solved ({status}); check the breakaways {rho}")
        return np.asarray(np.clip(found, -1, 1) * rho)


def sliding_order(actuator: Actuator, state: State) -> tuple[Indices, Array]:
    """Return the order in which the elements first slide when the displacement rises (Sec. 3, Appendix A.1).

    Cart i slides once y passes ``b_i + rho_i``. From a reachable state element i + 1 is never before element i.

    Returns
    -------
    (N,) int array, (N,) array
        Numbers of the elements from 0, the first to slide first, and the displacement [m] at which each begins.
        Places that differ by rounding count as one; elements that begin at one place come in increasing order.

    Raises
    ------
    ModelError
        If the actuator is none or the state does not fit it.
    """
    demand_actuator(actuator)
    demand_state(actuator, state)
    begin = state.carts + actuator.slip.breakaway
    ascending = np.argsort(begin, kind="stable")
    places = begin[ascending]
    rounding = ROUNDING * (size_of(actuator) + abs(state.displacement))
    ties = np.cumsum(np.diff(places, prepend=places[:1]) > rounding)
    return ascending[np.lexsort((ascending, ties))], places


def shift(actuator: Actuator, state: State) -> float:
    """By how much a loop from `state` lies above the one from the relaxed state [m] (Eq. 10).

    The sensor reads y - y(0), and once every element has slid y does not depend on the start (Lemma 1). So the rest of
    the loop is moved in the (v, y) plane by ``-(y(0) - y_relaxed)``, y_relaxed being where the spring alone holds the
    voltage at which `state` rests. At 0 V it is the paper's ``-(keq/km) x(0)``, with x counted from where the spring
    holds 0 V, as in `Actuator.physical`.

    Raises
    ------
    ModelError
        If the actuator is none or the state does not fit it.
    """
    demand_actuator(actuator)
    at_rest = actuator.relaxed(demand_state(actuator, state), extrapolate=True)
    return at_rest.displacement - state.displacement


def size_of(actuator: Actuator) -> float:
    """Length [m] to which rounding and tolerances refer."""
    return float(np.ptp(actuator.spring.displacement) + actuator.slip.breakaway.max(initial=0.0))


def demand_actuator(actuator: object) -> None:
    """Refuse what is no Actuator."""
    if not isinstance(actuator, Actuator):
        raise ModelError(f"actuator: got {type(actuator).__name__}, need an Actuator, such as the one of a Fit")


def demand_state(actuator: Actuator, state: object) -> float:
    """Voltage [V] at which the state rests; refuses what is no state of the actuator."""
    if not isinstance(state, State):
        raise ModelError(f"state: got {type(state).__name__}, need a State, such as the one a Motion hands back")
    return actuator.voltage(state)
