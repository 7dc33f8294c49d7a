"""Homing: a voltage through the limits that leads from any state to a known state.

It is simulated in time from the states that bound all histories; its holds follow from the tolerance, or from the time
that it may take.

If the order of voltages alone determines the state, every voltage keeps the order of states. Then the two extreme
equilibria, on either branch of the major loop, bound every state at rest, and two simulations propagate the bounds
exactly (theory section 11). A transformer and graded elements keep the order too.

With creep the order of states holds too: of two voltage histories, the one that is never lower leaves no part of the
actuator lower. Hence two states bound all histories within the limits, at any speed and of any duration: the states
after resting infinitely long at either limit. Smooth elements and a mass that acts on the voltage do not keep the
order. For them, the bounding states are the extremes with smooth elements strained either way, and states after random
histories.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from itertools import cycle, pairwise

import numpy as np
from numpy.typing import ArrayLike

from dehyst._types import Array
from dehyst._validation import Numbers, interval, number
from dehyst._views.lines import percent
from dehyst.control.axis import allowed_limits
from dehyst.control.limits import VoltageLimits
from dehyst.model import Actuator, State, creep_times, knots_of, quasistatic, stroke_of, turned, voltages_of
from dehyst.waveforms import Branch, Excitation, Sampling

# Least duration of a branch of a homing [s].
FASTEST_BRANCH = 0.5
# The error of a good model, as a part of the range of the spring's knots; with creep, a smaller error would take long.
_TOLERANCE = 1e-3
# Duration of a branch: as a part of the longest time constant; at least this number of periods of a resonance.
_BRANCH, _PERIODS = 0.05, 50.0
# A mass and a lag are at rest after this number of their time constants.
_REST_TIME_CONSTANTS = 12.0
# Number of samples of a branch in rough simulations; least number of samples of a cycle of a `Sampling`.
_SAMPLES, _LEAST_CYCLE = 60, 8
# Longest hold, in longest time constants; relative accuracy of a rough simulation; relative tolerance of the hold.
_LONGEST_HOLD, _ROUGH_ACCURACY, _HOLD_TOLERANCE = 30.0, 0.95, 0.03
# The time [s] that a homing may take.
HOME_WITHIN = Numbers(positive=True, optional=True)
# Factors by which branches become faster until a homing is short enough: least factor of a step, largest in all.
_FASTER, _FASTEST = 1.1, 1e6
# Number of random histories, and of turns in each.
_HISTORIES, _TURNS = 12, 8


@dataclass(frozen=True, eq=False, repr=False)
class Homing:
    """A voltage that leads from any state to a known state.

    Attributes
    ----------
    turns : tuple of float
        Voltages [V] to visit in this order, monotonically; the first one is the present voltage. If the state is known
        already, it is the only one.
    state : State
        State at the end: the middle of the states that simulations reach from the states that bound all histories.
    certified : bool
        Whether `spread` is within the tolerance.
    remarks : tuple of str
        Remarks for the user, in sentences.
    played : Excitation
        The voltage over time, with holds. If the state depends on time, it is certified at this speed only.
    spread : float
        Largest difference of the displacement [m] between any two histories, at the end and along a further cycle
        through the limits.
    """

    turns: tuple[float, ...]
    state: State
    certified: bool
    remarks: tuple[str, ...]
    played: Excitation
    spread: float


def shortest_homing(
    actuator: Actuator,
    *,
    limits: Sequence[float] | None = None,
    present: float = 0.0,
    tolerance: float | None = None,
    drive: Sampling | None = None,
    within: float | None = None,
    past: tuple[float, float] | None = None,
) -> Homing:
    """Find a short voltage that leads from any state to a known state.

    It goes through the limits, or only through the range of the model's records where that is narrower and suffices.
    Its branches and holds are just long enough for the model; a larger excursion homes the actuator too.

    Parameters
    ----------
    actuator : Actuator
    limits : (float, float), optional
        Lowest and highest voltage [V]; default the actuator's.
    present : float, optional
        Present voltage [V], to which the homing returns.
    tolerance : float, optional
        Allowed difference of the displacement [m] of any two histories; default: 1e-3 of the spring's range.
    drive : Sampling, optional
        Speed and shape of the branches; default: 50 s, or a twentieth of the longest creep time constant, and at least
        fifty periods of a resonance.
    within : float, optional
        Longest duration [s]: holds become shorter, and branches as fast as slew rate and sample rate allow; default: as
        long as the tolerance requires.
    past : (float, float), optional
        Range of all voltages before [V]; default: the limits.

    Returns
    -------
    Homing
        If limits or time do not suffice, the best homing: not certified, with remarks on its error and a remedy.

    Raises
    ------
    ModelError
        If there are no limits, `present` lies outside them, or a number is impossible.
    """
    allowed = allowed_limits(actuator, limits)
    start = VoltageLimits(*allowed).within(present, "present")
    usual = _TOLERANCE * float(np.ptp(actuator.spring.displacement))
    least = usual if tolerance is None else Numbers(positive=True)(tolerance, "tolerance")
    within = HOME_WITHIN(within, "home_within")
    sampling = drive or Sampling(frequency=0.5 / branch_seconds(actuator))
    given = replace(sampling, base=start, present=start, limits=allowed)
    low, high = actuator.limits or allowed
    recorded = max(low, allowed[0]), min(high, allowed[1])
    for through in [recorded, allowed] if recorded[0] < recorded[1] and recorded != allowed else [allowed]:
        found = _TimedHoming(actuator, past or allowed, through, start, given, least).homing(within)
        if found.certified:
            break
    return found


@dataclass
class _TimedHoming:
    """A homing over time through both `limits`, from the states that bound all histories within the `past` [V].

    `start`: first and last voltage [V]. Its parameter is the hold [s] at the last visit of either limit.
    """

    actuator: Actuator
    past: tuple[float, float]
    limits: tuple[float, float]
    start: float
    sampling: Sampling
    tolerance: float

    def __post_init__(self) -> None:
        self.states = possible_states(self.actuator, self.start, self.past, self.sampling.half)
        # The longest time constant of creep [s], and the voltages to visit, the shorter way first.
        self.longest = float(creep_times(self.actuator).max(initial=0.0))
        low, high = self.limits
        ways = [self.start, high, low, self.start], [self.start, low, high, self.start]
        turns = min(ways, key=lambda way: sum(abs(b - a) for a, b in pairwise(way)))
        self.turns = tuple(volts for k, volts in enumerate(turns) if not k or volts != turns[k - 1])
        self._cycle = self._few(self.sampling.branches(self.turns))

    def homing(self, within: float | None) -> Homing:
        """Return the shortest homing, or if possible a homing that takes no longer than `within` [s]."""
        start = self.start
        known, spread = self.left(np.array([start]), np.zeros(1))
        if spread <= self.tolerance:
            return Homing((start,), known, True, (), self.sampling.play("homing", [Branch(start, start, 0.0)]), spread)
        wait = _rest_seconds(self.actuator)
        if self.longest:
            needed = self.needed()
            wait = self.longest if needed is None else needed
        excitation = self.sampling.play("homing", self.path(wait))
        if within is not None and excitation.duration > within:
            wait, excitation = self.shortened(within)
        state, spread = self.left(excitation.voltage, excitation.time)
        remarks = tuple(self.remarks(wait, spread))
        return Homing(self.turns, state, spread <= self.tolerance, remarks, excitation, spread)

    def shortened(self, within: float) -> tuple[float, Excitation]:
        """Return holds [s] and voltage of a homing that takes at most `within` [s], or is as fast as possible."""
        excitation = self.sampling.play("homing", self.path(0.0))
        if excitation.duration <= within:
            wait = (within - excitation.duration) / max(1, len(self.path(math.inf)) - len(self.path(0.0)))
            return wait, self.sampling.play("homing", self.path(wait))
        most = (self.sampling.sample_rate or _FASTEST * self.sampling.frequency) / _LEAST_CYCLE
        # Branches at the slew rate get no faster; the others do.
        while excitation.duration > within and self.sampling.frequency < most:
            faster = self.sampling.frequency * max(excitation.duration / within, _FASTER)
            self.sampling = replace(self.sampling, frequency=min(faster, most))
            excitation = self.sampling.play("homing", self.path(0.0))
        return 0.0, excitation

    def remarks(self, wait: float, spread: float) -> Iterator[str]:
        """Yield remarks on a homing with holds [s] that leaves a `spread` [m]."""
        reasons = time_dependence(self.actuator)
        if spread > self.tolerance:
            remedy = "no hold suffices within these limits; try wider limits or a larger tolerance"
            if (needed := self.needed()) is not None:
                remedy = f"holds of {needed:.3g} s at both limits instead of {wait:.3g} s would suffice"
            stroke, least = stroke_of(self.actuator), self.tolerance
            yield (
                f"this homing leaves up to {percent(spread, stroke, least)} of the stroke on the worst path, need "
                f"{percent(least, stroke)}{reasons and f', as this actuator {reasons}'}; {remedy}"
            )
        if not keeps_order(self.actuator):
            yield (
                f"a known end is simulated from {len(self.states)} extreme and random histories, but not proven: "
                f"this actuator {reasons}"
            )

    def needed(self) -> float | None:
        """Return holds [s] that keep the tolerance; None if there are none."""
        low, high = 0.0, _LONGEST_HOLD * self.longest

        def misses(seconds: float) -> bool:
            return self.left(*self._few(self.path(seconds)))[1] > _ROUGH_ACCURACY * self.tolerance

        if not self.longest:
            return None
        if not misses(0.0):
            return 0.0
        if misses(high):
            return None
        while high - low > _HOLD_TOLERANCE * high:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if misses(middle) else (low, middle)
        return high

    def path(self, hold: float) -> list[Branch]:
        """Return the branches through the turns, with a hold at the last visit of either limit."""
        turns = self.turns
        # A hold shorter than a sample is left out.
        last = {turn: k for k, turn in enumerate(turns) if turn in self.limits and hold * self.sampling.rate > 1}
        path: list[Branch] = []
        for k, branch in enumerate([None, *self.sampling.branches(turns)]):
            path += [] if branch is None else [branch]
            path += [Branch(turns[k], turns[k], hold)] if last.get(turns[k]) == k else []
        return path

    def left(self, voltage: Array, time: Array) -> tuple[State, float]:
        """Return the middle of the states at the end, and the spread [m] there and along a further cycle."""
        played = partial(self.actuator.simulate, extrapolate=True)
        ends = [played(voltage, time=time, state=state).state for state in self.states]
        again, clock = self._cycle
        paths = [np.append(played(again, time=clock, state=end).displacement, end.deformation) for end in ends]
        return middle_of(ends), float(np.ptp(paths, axis=0).max())

    def _few(self, branches: Sequence[Branch]) -> tuple[Array, Array]:
        """Return a coarse sampling of branches: voltage [V] and time [s]."""
        voltage, time = [np.array([branches[0].start])], [np.zeros(1)]
        for branch in branches:
            share = np.arange(1, _SAMPLES + 1) / _SAMPLES
            if branch.start == branch.end:
                # Creep is fastest at the beginning.
                share = share**3
            voltage.append(branch.start + (branch.end - branch.start) * share)
            time.append(time[-1][-1] + branch.seconds * share)
        return np.concatenate(voltage), np.concatenate(time)


def branch_seconds(actuator: Actuator, otherwise: float = 0.5 / Sampling().frequency) -> float:
    """Return the default duration [s] of a branch: a share of the longest creep time constant, or `otherwise`.

    It is long enough for an amplifier's lag and a resonance to follow.
    """
    times = creep_times(actuator)
    seconds = _BRANCH * float(times.max()) if times.size else otherwise
    if actuator.dynamics is not None:
        seconds = max(seconds, _PERIODS / actuator.dynamics.frequency)
    return max(seconds, _REST_TIME_CONSTANTS * actuator.lag)


def _rest_seconds(actuator: Actuator) -> float:
    """Return the time [s] after which a mass and a lag are at rest."""
    seconds, dynamics = _REST_TIME_CONSTANTS * actuator.lag, actuator.dynamics
    if dynamics is None or not dynamics.damping:
        return seconds
    # Beyond critical damping the slower of two rates counts.
    zeta = dynamics.damping
    rate = dynamics.omega * (zeta if zeta <= 1 else zeta - np.sqrt(zeta**2 - 1))
    return max(seconds, _REST_TIME_CONSTANTS / float(rate))


def _on_major_loop(actuator: Actuator, voltage: float, side: int) -> State:
    """Return the state at a voltage [V] on the major loop: side 1 is the rising branch, -1 the falling one.

    Its displacement is the lowest, or the highest, of any state; smooth elements hold their largest voltage.
    """
    plain = quasistatic(replace(actuator, displacement_creep=None, state=None))  # type: ignore[arg-type]
    low, high = knots_of(plain)
    # The motion is long enough that every element slides.
    way = high - low + 2 * float(plain.slip.breakaway.max(initial=0.0))
    while side * (voltage - plain.voltage(turned(plain, low - side * way, rising=side > 0))) < 0:
        way *= 2
    far = turned(plain, low - side * 3 * way, rising=side > 0)
    reached: State = plain.simulate([voltage], state=far, extrapolate=True).state
    return reached


def middle_of(states: Sequence[State]) -> State:
    """Return the state in the middle of `states` of one actuator, with an error of at most half their range."""

    def middle(name: str) -> Array:
        values = np.array([getattr(state, name) for state in states])
        return np.asarray(0.5 * (values.min(axis=0) + values.max(axis=0)))

    return State(float(middle("deformation")), *(middle(entry.name) for entry in fields(State)[1:]))


def time_dependence(actuator: Actuator) -> str:
    """Return as text why the order of voltages does not determine the state; empty if it does."""
    parts = {
        "creeps": creep_times(actuator).size > 0,
        "has inertia": actuator.dynamics is not None,
        "lags": actuator.lag > 0,
        "has smooth elements": actuator.smooth is not None,
    }
    return " and ".join(words for words, there in parts.items() if there)


def keeps_order(actuator: Actuator) -> bool:
    """Return whether the two extreme states provably bound all states."""
    dynamics = actuator.dynamics
    return actuator.smooth is None and (dynamics is None or not dynamics.series)


def possible_states(
    actuator: Actuator, voltage: float, limits: tuple[float, float] | None = None, half: float = Sampling().half
) -> tuple[State, ...]:
    """Return states at a voltage that bound all states in which an actuator of unknown history may rest there.

    There are two states, the lower one first, if these provably bound all others. There are more for an actuator with
    smooth elements or a mass that acts on the voltage. `limits` [V]: range of all earlier voltages, widened to include
    the `voltage` [V], for an actuator that depends on time; default: the actuator's limits. `half` [s]:
    approximate duration of the branches of random histories. Raise `ModelError` if the voltage is not finite, or the
    limits are no interval.
    """
    v = number(voltage, "voltage")
    lengths = np.zeros(0) if actuator.smooth is None else actuator.smooth.length
    if not time_dependence(actuator):
        return tuple(_on_major_loop(actuator, v, side) for side in (1, -1))
    low, high = voltages_of(actuator) if limits is None else interval(limits)
    low, high = min(low, v), max(high, v)
    still = quasistatic(actuator)

    def played(state: State, voltages: ArrayLike, seconds: Array) -> State:
        reached: State = still.simulate(voltages, time=seconds, state=state, extrapolate=True).state
        return reached

    # The states after an infinite rest at either limit.
    rested = [
        still._evaluator.complete_state(State(end.deformation, end.carts, smooth=share * lengths))
        for end in (_on_major_loop(actuator, low, 1), _on_major_loop(actuator, high, -1))
        for share in ((1.0, 0.0, -1.0) if lengths.size else (1.0,))
    ]
    # The last branch takes no time.
    now = np.zeros(1)
    states = [played(state, [v], now) for state in rested]
    if not keeps_order(actuator):
        random, seconds = np.random.default_rng(0), np.cumsum(np.geomspace(0.01, 10, _TURNS) * half)
        turns = [random.uniform(low, high, _TURNS) for _ in range(_HISTORIES)]
        begins = zip(cycle(tuple(states)), turns, strict=False)
        states += [played(played(start, visited, seconds), [v], now) for start, visited in begins]
    if actuator.dynamics is None:
        return tuple(states)
    return tuple(replace(state, motion=np.array([state.deformation, 0.0])) for state in states)
