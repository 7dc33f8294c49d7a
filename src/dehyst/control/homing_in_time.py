"""Homing where time has a say: a swing through the limits, played in time from the extreme states there are.

With creep the order of states holds: a voltage that was never lower leaves no part of the actuator lower. So of all
that may have been within the limits, at any speed and for however long, two states are the extremes: after resting for
ever at either limit. They bracket the displacement from then on. Smooth elements and a mass that pulls at the voltage
keep no order: there the extremes are simulated with smooth elements pulled all ways, and random pasts besides.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from math import pi

import numpy as np

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst._validation import number
from dehyst.control.major_loop import MajorLoop
from dehyst.control.state_bounds import StateBounds, moves_on
from dehyst.model import Actuator, State
from dehyst.waveforms import Excitation, Leg, Sampling

# Of the range of the spring's knots: what a good model misses; creep takes long to leave less.
_TOLERANCE = 1e-3
# Legs take this part of the longest time constant, and so many periods of a resonance.
_LEG, _PERIODS = 0.05, 50.0
# A mass and a lag rest after so many of their own times.
_RESTS = 12.0
_PASTS, _TURNS = 12, 8
# Legs are added as long as two more leave less than this part of what was left before.
_MOST_LEGS, _WORTH = 12, 0.7
# Of a leg, where many swings are compared.
_SAMPLES = 60
# A hold that would do is looked for up to so many times the longest time constant.
_PATIENCE = 30.0


@dataclass(frozen=True, eq=False)
class Swing:
    """A voltage played in time, and what it leaves unknown.

    Attributes
    ----------
    actuator : Actuator
    drive : Sampling
    ends : (float, float)
        Present and last voltage [V].
    hold : float
        Seconds at either end of the limits, at the last visit.
    limits : (float, float)
        Between which every voltage before was, too.
    tolerance : float
        [m].
    legs : int
        Visits to either end of the limits, two at least.
    states : tuple of State
        Where the actuator may be at the present voltage, after whatever happened within the limits.
    """

    actuator: Actuator
    drive: Sampling
    ends: tuple[float, float]
    hold: float
    limits: tuple[float, float]
    tolerance: float
    legs: int
    states: tuple[State, ...] = ()

    @classmethod
    def of(
        cls,
        actuator: Actuator,
        limits: tuple[float, float],
        ends: tuple[float, float],
        *,
        drive: Sampling | None,
        hold: float | None,
        tolerance: float | None,
    ) -> Swing:
        """The shortest swing between the present voltage and the last; more of them while that is worth it."""
        least = _TOLERANCE * float(np.ptp(actuator.spring.displacement)) if tolerance is None else tolerance
        held = None if hold is None else number(hold, "hold")
        for value, name in ((number(least, "tolerance"), "tolerance"), (1.0 if held is None else held, "hold")):
            if value < 0 or (name == "tolerance" and value == 0):
                raise ModelError(f"{name}: got {value}, need a positive number")
        shown = drive or Sampling(frequency=0.5 / leg_seconds(actuator))
        shown = replace(shown, base=ends[1], present=ends[0], limits=limits)
        wait = _rest(actuator) if held is None else held
        found = cls(actuator, shown, ends, wait, limits, float(least), 2)
        found = replace(found, states=tuple(found._pasts()))
        if hold is None and found._longest:
            needed = found.needed
            found = replace(found, hold=found._longest if needed is None else needed)
        return found._enough()

    def _enough(self) -> Swing:
        """The same with as many legs as are worth it."""
        found = self
        for legs in range(4, _MOST_LEGS + 1, 2):
            if found._roughly <= found.tolerance:
                break
            more = replace(found, legs=legs)
            if more._roughly > _WORTH * found._roughly:
                break
            found = more
        return found

    @cached_property
    def turns(self) -> tuple[float, ...]:
        """Voltages [V] to visit, the present one first."""
        return _turns(self.limits, *self.ends, self.legs)

    @cached_property
    def excitation(self) -> Excitation:
        """The voltage in time."""
        legs = self._legs(self.turns, self.hold)
        return self.drive.play("homing", legs)

    @cached_property
    def bracket(self) -> StateBounds:
        """Of the state at the end, from every past that was simulated."""
        return self._reached[0]

    @cached_property
    def left(self) -> float:
        """How far apart the displacement may be [m] at the end and along a further cycle."""
        return self._reached[1]

    @cached_property
    def _reached(self) -> tuple[StateBounds, float]:
        return self._after(self.excitation.voltage, self.excitation.time)

    @cached_property
    def _roughly(self) -> float:
        """`left` on few samples."""
        return self._after(*self._few(self._legs(self.turns, self.hold)))[1]

    @property
    def proven(self) -> bool:
        """Whether the two extremes are proven to be the extremes."""
        dynamics = self.actuator.dynamics
        return self.actuator.smooth is None and (dynamics is None or not dynamics.series)

    def remarks(self) -> tuple[str, ...]:
        """What else the user should know, in sentences."""
        said = []
        range_ = float(np.ptp(self.actuator.spring.displacement))
        if self.left > self.tolerance:
            said.append(
                f"not certified to {_micro(self.tolerance)}: {_micro(self.left)} ({100 * self.left / range_:.2g} % of "
                f"the range) may be left of what was before, for this actuator {moves_on(self.actuator)}; {self._way()}"
            )
        elif self._longest and self.hold > 0.1 * self._longest:
            said.append(self._shorter())
        if not self.proven:
            said.append(
                f"found by simulating {len(self.states)} extreme and random pasts, not proven: the states of an "
                f"actuator that {moves_on(self.actuator)} keep no order"
            )
        return tuple(said)

    def _way(self) -> str:
        """What would do, or what cannot be helped."""
        wait = self.needed
        if wait is not None:
            return f"holds of {wait:.3g} s at both limits in place of {self.hold:.3g} s would do"
        return "no hold would do within these limits; wider ones may, or a larger tolerance"

    def _shorter(self) -> str:
        """What shorter holds would leave."""
        waits = [wait for wait in (0.0, 0.1 * self._longest, self._longest) if wait < 0.9 * self.hold]
        left = [f"{_micro(replace(self, hold=wait)._enough()._roughly)} after {wait:.3g} s" for wait in waits]
        return f"shorter holds would leave more: {', '.join(left)}"

    @property
    def _longest(self) -> float:
        """The longest time constant of creep [s]; 0 without any."""
        creep = self.actuator.creep
        return 0.0 if creep is None else float(creep.time_constants.max(initial=0.0))

    @cached_property
    def needed(self) -> float | None:
        """The hold [s] after which the tolerance is kept; None if none does."""
        if not self._longest:
            return None
        low, high = 0.0, _PATIENCE * self._longest

        def misses(wait: float) -> bool:
            return replace(self, hold=wait)._enough()._roughly > 0.95 * self.tolerance

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

    def _pasts(self) -> list[State]:
        """What `states` shall be: the extremes, and where they keep no order, random pasts too."""
        still = replace(self.actuator, dynamics=None, lag=0.0, state=None)  # type: ignore[arg-type]
        found = [self._arrived(still, state, []) for state in self._rested()]
        if not self.proven:
            random = np.random.default_rng(0)
            found += [
                self._arrived(still, found[k % len(found)], random.uniform(*self.limits, _TURNS).tolist())
                for k in range(_PASTS)
            ]
        return found if self.actuator.dynamics is None else [_at_rest(state) for state in found]

    def _rested(self) -> Iterator[State]:
        """After resting for ever at either limit."""
        branch, rho, smooth = MajorLoop(self.actuator), self.actuator.slip.breakaway, self.actuator.smooth
        length = np.zeros(0) if smooth is None else smooth.length
        for side, limit in ((1, self.limits[0]), (-1, self.limits[1])):
            y = branch.displacement(limit, side)
            for share in (1.0, 0.0, -1.0) if length.size else (1.0,):
                yield State(y, y - side * rho, smooth=share * length)

    def _arrived(self, still: Actuator, state: State, turns: list[float]) -> State:
        """At the present voltage from a state, by a detour; the last leg takes no time."""
        reached = still.model.complete_state(state)
        if turns:
            seconds = np.cumsum(np.geomspace(0.01, 10, len(turns)) * self.drive.half)
            when = seconds if still.needs_time else None
            reached = still.simulate(turns, time=when, state=reached, extrapolate=True).state
        now = np.zeros(1) if still.needs_time else None
        present: State = still.simulate(self.ends[:1], time=now, state=reached, extrapolate=True).state
        return present

    def _legs(self, turns: tuple[float, ...], hold: float) -> list[Leg]:
        """Legs through the turns, with a hold at either end of the limits, each time at the last visit."""
        legs = self.drive.legs(turns)
        held = [Leg(turns[k], turns[k], hold) for k in range(len(turns))]
        last = {turn: k for k, turn in enumerate(turns) if turn in self.limits and hold > 0}
        found = [held[0]] if last.get(turns[0]) == 0 else []
        for k, leg in enumerate(legs, 1):
            found += [leg, held[k]] if last.get(turns[k]) == k else [leg]
        return found

    def _few(self, legs: list[Leg]) -> tuple[Array, Array]:
        """Few samples of legs: voltage and time."""
        voltage, time = [np.array([legs[0].start])], [np.zeros(1)]
        for leg in legs:
            share = np.arange(1, _SAMPLES + 1) / _SAMPLES
            if leg.start == leg.end:
                # Creep is fast at first.
                share = share**3
            voltage.append(leg.start + (leg.end - leg.start) * share)
            time.append(time[-1][-1] + leg.seconds * share)
        return np.concatenate(voltage), np.concatenate(time)

    def _after(self, voltage: Array, time: Array) -> tuple[StateBounds, float]:
        """Bracket of the states at the end, and how far apart displacements lie there and along a further cycle."""
        further = self._few(self._legs(_turns(self.limits, self.ends[1], self.ends[1], 2), 0.0))
        reached, paths = [], []
        for state in self.states:
            end = self._run(voltage, time, state)[1]
            reached.append(end)
            paths.append(np.append(self._run(*further, end)[0], end.displacement))
        return _about(reached), float(np.ptp(paths, axis=0).max())

    def _run(self, voltage: Array, time: Array, state: State) -> tuple[Array, State]:
        when = time if self.actuator.needs_time else None
        motion = self.actuator.simulate(voltage, time=when, state=state, extrapolate=True)
        return motion.displacement, motion.state


def _turns(limits: tuple[float, float], start: float, stop: float, legs: int) -> tuple[float, ...]:
    """Through both limits, `legs` visits in all, the shorter way; up first if both are as long."""
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


def _about(states: list[State]) -> StateBounds:
    """The least bracket about states."""
    names = ("carts", "creep", "motion", "smooth")
    ends = []
    for order in (np.min, np.max):
        arrays = (order([getattr(state, name) for state in states], axis=0) for name in names)
        ends.append(State(float(order([state.displacement for state in states])), *arrays))
    return StateBounds(*ends)


def _at_rest(state: State) -> State:
    return State(state.displacement, state.carts, state.creep, [state.displacement, 0.0], state.smooth)


def leg_seconds(actuator: Actuator, otherwise: float = 0.5 / Sampling().frequency) -> float:
    """Seconds of a leg, where the drive does not say: a part of the longest creep time constant, `otherwise` without.

    It is no shorter than an amplifier's lag and a resonance take to follow.
    """
    creep = actuator.creep
    seconds = otherwise if creep is None else _LEG * float(creep.time_constants.max(initial=0.0))
    if actuator.dynamics is not None:
        seconds = max(seconds, _PERIODS * 2 * pi / actuator.dynamics.frequency)
    return max(seconds, _RESTS * actuator.lag)


def _rest(actuator: Actuator) -> float:
    """Seconds after which a mass and a lag have come to rest."""
    found = [0.0, _RESTS * actuator.lag]
    dynamics = actuator.dynamics
    if dynamics is not None and dynamics.damping > 0:
        # Beyond critical damping the slower of two rates counts.
        zeta = dynamics.damping
        rate = dynamics.frequency * (zeta if zeta <= 1 else zeta - np.sqrt(zeta**2 - 1))
        found.append(_RESTS / float(rate))
    return max(found)


def _micro(length: float) -> str:
    return f"{length * 1e6:.3g} um"
