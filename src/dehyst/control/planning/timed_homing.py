"""A homing in time, for actuators whose state depends on time: as long as the tolerance needs, from all histories."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from math import pi

import numpy as np

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst._validation import number
from dehyst.control.planning.bounds import StateBounds, bounds_of, keeps_order, moves_on, timed_states
from dehyst.model import Actuator, State
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
