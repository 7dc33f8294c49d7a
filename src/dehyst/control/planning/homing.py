"""The shortest homing: the voltage of least travel that leads from any state at rest to a known one, certified.

If the order of voltages determines the state, it follows in closed form. For actuators with creep, inertia, lag or
smooth elements a voltage through all of the limits is played in time, from the extreme states.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from math import pi

import numpy as np

from dehyst._errors import ModelError
from dehyst._types import Array, Mask
from dehyst._validation import interval, number
from dehyst.control.planning.bounds import (
    MajorLoop,
    StateBounds,
    bounds_of,
    first_move_error,
    keeps_order,
    least_width,
    moves_on,
    timed_states,
)
from dehyst.model import Actuator, GradedSlip, State
from dehyst.waveforms import Excitation, Leg, Sampling

# Share of the range of the spring's knots: the error of a good model; creep takes long to leave less.
_TOLERANCE = 1e-3
# Duration of a leg: this share of the longest time constant, and at least this many periods of a resonance.
_LEG, _PERIODS = 0.05, 50.0
# A mass and a lag are at rest after this many of their time constants.
_RESTS = 12.0
# Most legs; two more are added if they reduce the spread to less than this share.
_MOST_LEGS, _WORTH = 12, 0.7
# Samples of a leg in rough simulations.
_SAMPLES = 60
# Longest hold that is tried, in longest time constants.
_PATIENCE = 30.0


@dataclass(frozen=True, eq=False)
class Homing:
    """A voltage that leads from any state to a known one.

    Attributes
    ----------
    turns : tuple of float
        Voltages [V] to visit in this order, the present one first; in between the voltage is monotone. The present one
        alone if the state is known already.
    bounds : StateBounds
        Of the state at the end, by two simulations.
    unknown : tuple of int
        Elements whose carts stay unknown, counted from 0.
    certified : bool
        Whether the displacement and every element with stiffness are known at the end, hence all later motion too.
    remarks : tuple of str
        Remarks for the user, in sentences.
    played : Excitation or None
        The voltage in time, with holds, if the state depends on time: it is certified at this speed only.
    spread : float or None
        With `played`: largest difference [m] of the displacement between any two histories, at the end and along a
        further cycle through the limits. `certified` refers to it.
    """

    turns: tuple[float, ...]
    bounds: StateBounds
    unknown: tuple[int, ...]
    certified: bool
    remarks: tuple[str, ...] = ()
    played: Excitation | None = None
    spread: float | None = None

    @property
    def state(self) -> State:
        """The state at the end, certified or only the middle of the bounds, with unknown carts halfway."""
        return self.bounds.middle

    @property
    def width(self) -> float:
        """The largest width [m] of the bounds at the end, including elements without stiffness."""
        return self.bounds.width

    @property
    def error(self) -> float:
        """Error bar [m] of a displacement after it: `spread`, or the width of the bounds."""
        return self.width if self.spread is None else self.spread

    @property
    def travel(self) -> float:
        """Length of the path [V]."""
        return _travel(self.turns)


def shortest_homing(
    actuator: Actuator,
    *,
    limits: Sequence[float] | None = None,
    present: float = 0.0,
    end: float | None = None,
    tolerance: float | None = None,
    stiff_only: bool = False,
    drive: Sampling | None = None,
    hold: float | None = None,
) -> Homing:
    """Find the voltage of least travel that leads from any state at rest to a known one.

    Whether a state is known depends on the extremes of the voltage alone (`least_range`), so no waveform of any shape
    is shorter than the best of: up, down, up and down, down and up, each then to the end. The extremes follow in
    closed form; the certificate is two simulations.

    It is just long enough for the model. Give a real actuator some percent more; a larger excursion also homes it.

    Parameters
    ----------
    actuator : Actuator
    limits : (float, float), optional
        Lowest and highest voltage [V]; default the actuator's.
    present, end : float, optional
        Present and final voltage [V]; default 0, and back to the present one.
    tolerance : float, optional
        Width [m] to which the state shall be known; default 1e-12 of the range of the spring's knots. If the state
        depends on time, width to which the displacement shall be known; default 1e-3 of that range.
    stiff_only : bool, optional
        Leave out elements without stiffness. They never move the actuator; by default they are homed too if the limits
        allow it, so that the whole state is known.
    drive : Sampling, optional
        Speed and shape of the legs, if the state depends on time; default: legs of a twentieth of the longest creep
        time constant, and no shorter than fifty periods of a resonance.
    hold : float, optional
        Seconds to wait at the last visit of either limit, if the state depends on time; default: as long as the
        tolerance requires, or if no hold suffices, the longest time constant of creep.

    Returns
    -------
    Homing
        If the limits are too narrow, the best within them, not certified, with a remark on what would suffice. For
        creep it includes an error bar, and how long a hold would suffice.

    Raises
    ------
    ModelError
        If there are no limits, present or end lie outside them, or a number is impossible.
    """
    if not isinstance(actuator, Actuator):
        raise ModelError(argument="actuator", got=type(actuator).__name__, need="an Actuator")
    allowed = _limits(actuator, limits)
    start = _inside(present, "present", allowed)
    stop = start if end is None else _inside(end, "end", allowed)
    if moves_on(actuator):
        ends = start, stop
        return _in_time(TimedHoming.shortest(actuator, allowed, ends, drive=drive, hold=hold, tolerance=tolerance))
    task = _HomingTask(actuator, allowed, start, stop, least_width(actuator, tolerance))
    turns = task.turns(task.stiff if stiff_only or not task.suffices(task.whole) else task.whole)
    bounds = StateBounds.at_rest(actuator, start).propagate(actuator, turns).bounds
    unknown = bounds.widths > task.tolerance
    unknown_stiff = unknown & _stiff(actuator)
    certified = not unknown_stiff.any() and first_move_error(bounds) <= task.tolerance
    remark = task.remark(turns, bounds, unknown, unknown_stiff, certified)
    return Homing(turns, bounds, tuple(map(int, np.flatnonzero(unknown))), certified, (remark,) if remark else ())


def _in_time(timed: TimedHoming) -> Homing:
    return Homing(
        timed.turns,
        timed.bounds,
        tuple(map(int, np.flatnonzero(timed.bounds.widths > timed.tolerance))),
        timed.spread <= timed.tolerance,
        timed.remarks(),
        timed.excitation,
        timed.spread,
    )


def _stiff(actuator: Actuator) -> Mask:
    """Return which elements (N,) have stiffness anywhere."""
    kappa = actuator.slip.stiffness
    return np.asarray((kappa > 0).any(axis=1) if isinstance(actuator.slip, GradedSlip) else kappa > 0)


@dataclass(frozen=True, eq=False)
class _HomingTask:
    """The task of a homing. A reach [m] is the `least_range` that homes the whole state, or the stiff elements."""

    actuator: Actuator
    limits: tuple[float, float]
    start: float
    stop: float
    tolerance: float

    @property
    def whole(self) -> float:
        return self._reach(self.actuator.slip.breakaway)

    @property
    def stiff(self) -> float:
        return self._reach(self.actuator.slip.breakaway[_stiff(self.actuator)])

    @property
    def slack(self) -> float:
        """The part of the tolerance [m] reserved for rounding."""
        return min(self.tolerance, least_width(self.actuator, None))

    def _reach(self, breakaway: Array) -> float:
        return 2 * float(breakaway.max()) - (self.tolerance - self.slack) if breakaway.size else -np.inf

    def suffices(self, reach: float) -> bool:
        return self._enough(*self.limits, reach)

    def _enough(self, low: float, high: float, reach: float) -> bool:
        # In an identified model the largest element needs exactly the full excursion: rounding must not decide.
        return self.branch.displacement(high, 1) - self.branch.displacement(low, -1) >= reach - 0.5 * self.slack

    def top(self, bottom: float, reach: float) -> float:
        """Return the highest voltage [V] that makes the least range `reach` if `bottom` is the lowest."""
        branch = self.branch
        return branch.voltage(branch.displacement(bottom, -1) + reach, 1)

    def bottom(self, top: float, reach: float) -> float:
        branch = self.branch
        return branch.voltage(branch.displacement(top, 1) - reach, -1)

    @cached_property
    def branch(self) -> MajorLoop:
        return MajorLoop(self.actuator)

    def extremes(self, reach: float) -> tuple[float, float]:
        """Return the lowest and highest voltage [V], as close together as `reach` allows; else the limits."""
        low, high = self.limits
        near, far = min(self.start, self.stop), max(self.start, self.stop)
        if self._enough(near, far, reach):
            return near, far
        if not self.suffices(reach):
            return low, high
        latest = near if self._enough(near, high, reach) else max(low, self.bottom(high, reach))
        # The top is piecewise linear in the bottom: the difference is least where the slope of either changes.
        bends = np.concatenate([self.branch.bends(-1), self.branch.bends(1) - reach])
        corners = [self.branch.voltage(float(bend), -1) for bend in bends]
        bottoms = np.clip([latest, low, self.bottom(far, reach), *corners], low, latest)
        tops = np.array([far if self._enough(b, far, reach) else min(high, self.top(b, reach)) for b in bottoms])
        # Of equal ranges the one with the highest bottom: a piezo stack bears compression better than tension.
        shortest = tops - bottoms <= (1 + 1e-12) * (tops - bottoms).min()
        best = int(np.argmax(np.where(shortest, bottoms, -np.inf)))
        return float(bottoms[best]), float(tops[best])

    def turns(self, reach: float) -> tuple[float, ...]:
        """Return the voltages [V] to visit, with the extremes in the shorter order; up first if both are equal."""
        low, high = self.extremes(reach)
        middle = (low, high) if self.stop > self.start else (high, low)
        visited = (self.start, *(turn for turn in middle if turn not in (self.start, self.stop)), self.stop)
        return visited[:1] if visited == (self.start, self.start) else visited

    def remark(
        self, turns: tuple[float, ...], bounds: StateBounds, unknown: Mask, unknown_stiff: Mask, certified: bool
    ) -> str | None:
        if not certified and self.suffices(self.stiff):
            return f"not certified: rounding leaves a width of {bounds.width:.3g} m; give a tolerance above that"
        if not certified:
            return f"not certified: {_unknown(bounds, unknown_stiff)}; {self._beyond(self.stiff)}"
        if unknown.any():
            remark = f"{_unknown(bounds, unknown)}, without stiffness, which no motion depends on"
            return remark if self.suffices(self.whole) else f"{remark}; {self._beyond(self.whole)}"
        travel, shorter = _travel(turns), _travel(self.turns(self.stiff))
        if shorter >= travel * (1 - 1e-9):
            return None
        return f"{travel - shorter:.4g} V of the {travel:.6g} V only home elements without stiffness (stiff_only)"

    def _beyond(self, reach: float) -> str:
        low, high = self.limits
        above, below = self.top(low, reach) - high, low - self.bottom(high, reach)
        return f"{above:.4g} V above {high:.6g} V, or {below:.4g} V below {low:.6g} V, would suffice"


def _limits(actuator: Actuator, limits: Sequence[float] | None) -> tuple[float, float]:
    chosen = actuator.limits if limits is None else limits
    if chosen is None:
        raise ModelError(
            "no voltage limits: the actuator has none and none were given",
            hint="give limits (low, high)",
            change=("limits",),
        )
    return interval(chosen)


def _inside(voltage: float, what: str, limits: tuple[float, float]) -> float:
    v = number(voltage, what)
    if not limits[0] <= v <= limits[1]:
        raise ModelError(
            argument=what, got=f"{v:.6g} V", need=f"a voltage within the limits {limits[0]:.6g} to {limits[1]:.6g} V"
        )
    return v


def _travel(turns: Sequence[float]) -> float:
    return float(sum(abs(b - a) for a, b in pairwise(turns)))


def _named(elements: Mask) -> str:
    """Return the elements in words, counted from 1."""
    numbers = [int(i) + 1 for i in np.flatnonzero(elements)]
    if len(numbers) > 2 and numbers[-1] - numbers[0] == len(numbers) - 1:
        return f"elements {numbers[0]} to {numbers[-1]}"
    return f"element{'s' * (len(numbers) > 1)} {', '.join(map(str, numbers))}"


def _unknown(bounds: StateBounds, unknown: Mask) -> str:
    widest = bounds.widths[unknown].max(initial=0.0) * 1e6
    return f"leaves {_named(unknown)} of {unknown.size} unknown, by up to {widest:.4g} um"


@dataclass(frozen=True, eq=False)
class TimedHoming:
    """A homing played in time, and the uncertainty that it leaves.

    Attributes
    ----------
    actuator : Actuator
    sampling : Sampling
    ends : (float, float)
        Present and last voltage [V].
    hold : float
        Seconds at the last visit of either limit.
    limits : (float, float)
        Range of all earlier voltages too.
    tolerance : float
        [m].
    legs : int
        Visits of the limits, two at least.
    states : tuple of State
        Possible states at the present voltage, after any history within the limits.
    """

    actuator: Actuator
    sampling: Sampling
    ends: tuple[float, float]
    hold: float
    limits: tuple[float, float]
    tolerance: float
    legs: int
    states: tuple[State, ...] = ()

    @classmethod
    def shortest(
        cls,
        actuator: Actuator,
        limits: tuple[float, float],
        ends: tuple[float, float],
        *,
        drive: Sampling | None,
        hold: float | None,
        tolerance: float | None,
    ) -> TimedHoming:
        """Find the shortest homing between the present and the last voltage, with as many legs as are worth it."""
        least = _TOLERANCE * float(np.ptp(actuator.spring.displacement)) if tolerance is None else tolerance
        given = None if hold is None else number(hold, "hold")
        for value, name in ((number(least, "tolerance"), "tolerance"), (1.0 if given is None else given, "hold")):
            if value < 0 or (name == "tolerance" and value == 0):
                raise ModelError(argument=name, got=value, need="a positive number")
        sampling = drive or Sampling(frequency=0.5 / leg_seconds(actuator))
        sampling = replace(sampling, base=ends[1], present=ends[0], limits=limits)
        wait = _rest_seconds(actuator) if given is None else given
        homing = cls(actuator, sampling, ends, wait, limits, float(least), 2)
        homing = replace(homing, states=timed_states(actuator, limits, ends[0], sampling.half))
        if hold is None and homing._longest:
            needed = homing.needed
            homing = replace(homing, hold=homing._longest if needed is None else needed)
        return homing._with_legs()

    def _with_legs(self) -> TimedHoming:
        """Return the homing with as many legs as are worth it."""
        homing = self
        for legs in range(4, _MOST_LEGS + 1, 2):
            if homing._rough_spread <= homing.tolerance:
                break
            longer = replace(homing, legs=legs)
            if longer._rough_spread > _WORTH * homing._rough_spread:
                break
            homing = longer
        return homing

    @cached_property
    def turns(self) -> tuple[float, ...]:
        """Voltages [V] to visit, the present one first."""
        return _turns(self.limits, *self.ends, self.legs)

    @cached_property
    def excitation(self) -> Excitation:
        """The voltage in time."""
        legs = self._legs(self.turns, self.hold)
        return self.sampling.play("homing", legs)

    @cached_property
    def bounds(self) -> StateBounds:
        """Bounds of the state at the end, over all simulated histories."""
        return self._outcome[0]

    @cached_property
    def spread(self) -> float:
        """Largest difference [m] of the displacement between histories, at the end and along a further cycle."""
        return self._outcome[1]

    @cached_property
    def _outcome(self) -> tuple[StateBounds, float]:
        return self._after(self.excitation.voltage, self.excitation.time)

    @cached_property
    def _rough_spread(self) -> float:
        """`spread` on few samples."""
        return self._after(*self._few(self._legs(self.turns, self.hold)))[1]

    @property
    def proven(self) -> bool:
        """Whether the two extreme states are proven to be the extremes."""
        return keeps_order(self.actuator)

    def remarks(self) -> tuple[str, ...]:
        """Return remarks for the user, in sentences."""
        remarks = []
        range_ = float(np.ptp(self.actuator.spring.displacement))
        if self.spread > self.tolerance:
            remarks.append(
                f"not certified to {_micro(self.tolerance)}: the history may leave {_micro(self.spread)} "
                f"({100 * self.spread / range_:.2g} % of the range), as this actuator {moves_on(self.actuator)}; "
                f"{self._remedy()}"
            )
        elif self._longest and self.hold > 0.1 * self._longest:
            remarks.append(self._shorter())
        if not self.proven:
            remarks.append(
                f"found by simulating {len(self.states)} extreme and random histories, not proven: the states of an "
                f"actuator that {moves_on(self.actuator)} keep no order"
            )
        return tuple(remarks)

    def _remedy(self) -> str:
        wait = self.needed
        if wait is not None:
            return f"holds of {wait:.3g} s at both limits instead of {self.hold:.3g} s would suffice"
        return "no hold suffices within these limits; wider limits may, or a larger tolerance"

    def _shorter(self) -> str:
        waits = [wait for wait in (0.0, 0.1 * self._longest, self._longest) if wait < 0.9 * self.hold]
        left = [f"{_micro(replace(self, hold=wait)._with_legs()._rough_spread)} after {wait:.3g} s" for wait in waits]
        return f"shorter holds would leave more: {', '.join(left)}"

    @property
    def _longest(self) -> float:
        """The longest time constant of creep [s]; 0 without any."""
        creep = self.actuator.creep
        return 0.0 if creep is None else float(creep.time_constants.max(initial=0.0))

    @cached_property
    def needed(self) -> float | None:
        """The hold [s] that keeps the tolerance; None if none does."""
        if not self._longest:
            return None
        low, high = 0.0, _PATIENCE * self._longest

        def misses(wait: float) -> bool:
            return replace(self, hold=wait)._with_legs()._rough_spread > 0.95 * self.tolerance

        if not misses(0.0):
            return 0.0
        if misses(high):
            return None
        if not misses(self.hold):
            high = self.hold
        while high - low > 0.03 * high:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if misses(middle) else (low, middle)
        return high

    def _legs(self, turns: tuple[float, ...], hold: float) -> list[Leg]:
        """Return legs through the turns, with a hold at the last visit of either limit."""
        legs = self.sampling.legs(turns)
        holds = [Leg(turns[k], turns[k], hold) for k in range(len(turns))]
        last = {turn: k for k, turn in enumerate(turns) if turn in self.limits and hold > 0}
        path = [holds[0]] if last.get(turns[0]) == 0 else []
        for k, leg in enumerate(legs, 1):
            path += [leg, holds[k]] if last.get(turns[k]) == k else [leg]
        return path

    def _few(self, legs: list[Leg]) -> tuple[Array, Array]:
        """Return few samples of legs: voltage and time."""
        voltage, time = [np.array([legs[0].start])], [np.zeros(1)]
        for leg in legs:
            share = np.arange(1, _SAMPLES + 1) / _SAMPLES
            if leg.start == leg.end:
                # Creep is fastest at the beginning.
                share = share**3
            voltage.append(leg.start + (leg.end - leg.start) * share)
            time.append(time[-1][-1] + leg.seconds * share)
        return np.concatenate(voltage), np.concatenate(time)

    def _after(self, voltage: Array, time: Array) -> tuple[StateBounds, float]:
        """Return the bounds of the states at the end, and the spread of displacements there and along a cycle."""
        cycle = self._few(self._legs(_turns(self.limits, self.ends[1], self.ends[1], 2), 0.0))
        ends, paths = [], []
        for state in self.states:
            end = self._simulate(voltage, time, state)[1]
            ends.append(end)
            paths.append(np.append(self._simulate(*cycle, end)[0], end.displacement))
        return bounds_of(ends), float(np.ptp(paths, axis=0).max())

    def _simulate(self, voltage: Array, time: Array, state: State) -> tuple[Array, State]:
        when = time if self.actuator.needs_time else None
        motion = self.actuator.simulate(voltage, time=when, state=state, extrapolate=True)
        return motion.displacement, motion.state


def _turns(limits: tuple[float, float], start: float, stop: float, legs: int) -> tuple[float, ...]:
    """Return the voltages [V] of a way through both limits, with `legs` visits; the shorter way, else up first."""
    low, high = limits
    ways = []
    for first, second in ((high, low), (low, high)):
        visited = [start]
        for turn in [first, second] * (legs // 2):
            if turn != visited[-1]:
                visited.append(turn)
        if visited[-1] != stop:
            visited.append(stop)
        ways.append(tuple(visited))
    travel = [sum(abs(b - a) for a, b in pairwise(way)) for way in ways]
    return ways[0] if travel[0] <= travel[1] else ways[1]


def leg_seconds(actuator: Actuator, otherwise: float = 0.5 / Sampling().frequency) -> float:
    """Return the default duration [s] of a leg: a share of the longest creep time constant, `otherwise` without creep.

    It is long enough for an amplifier's lag and a resonance to follow.
    """
    creep = actuator.creep
    seconds = otherwise if creep is None else _LEG * float(creep.time_constants.max(initial=0.0))
    if actuator.dynamics is not None:
        seconds = max(seconds, _PERIODS * 2 * pi / actuator.dynamics.frequency)
    return max(seconds, _RESTS * actuator.lag)


def _rest_seconds(actuator: Actuator) -> float:
    """Return the time [s] after which a mass and a lag are at rest."""
    seconds = [0.0, _RESTS * actuator.lag]
    dynamics = actuator.dynamics
    if dynamics is not None and dynamics.damping > 0:
        # Beyond critical damping the slower of two rates counts.
        zeta = dynamics.damping
        rate = dynamics.frequency * (zeta if zeta <= 1 else zeta - np.sqrt(zeta**2 - 1))
        seconds.append(_RESTS / float(rate))
    return max(seconds)


def _micro(length: float) -> str:
    return f"{length * 1e6:.3g} um"
