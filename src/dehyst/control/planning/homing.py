"""The shortest homing: the voltage of least travel that leads from any state at rest to a known state.

If the order of voltages alone determines the state, the homing has a closed form. For actuators with creep, inertia,
lag or smooth elements, a voltage through the whole limits is simulated in time from the extreme states; its length
follows from the tolerance. A homing is played before a path, at its sample rate or a lower one, or step by step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import ModelError, RecordError
from dehyst._types import Array, Mask
from dehyst._validation import number
from dehyst.control.compensator import Compensator, allowed_limits
from dehyst.control.limits import VoltageLimits
from dehyst.control.planning.states import (
    MajorLoop,
    StateBounds,
    keeps_order,
    least_width,
    possible_states,
    time_dependence,
)
from dehyst.model import Actuator, GradedSlip, State
from dehyst.waveforms import Excitation, Leg, Sampling, volts
from dehyst.waveforms import homing as homing_through

# Least duration of a leg of a homing [s].
FASTEST_LEG = 0.5
# A homing of more samples has longer steps: this many a leg, and a period of a resonance.
_EVEN_SAMPLES, _LEG_SAMPLES, _RESONANCE_SAMPLES = 100_000, 200, 10
# If these are still too many, most samples of a hold are left out: their times grow by this factor.
_SPARSER = 1.02
# In time. Share of the range of the spring's knots: the error of a good model; creep takes long to leave less.
_TOLERANCE = 1e-3
# Duration of a leg: this share of the longest time constant, and at least this many periods of a resonance.
_LEG, _PERIODS = 0.05, 50.0
# A mass and a lag are at rest after this many of their time constants.
_RESTS = 12.0
# Most legs; two more are added if they reduce the spread to less than this share.
_MOST_LEGS, _FEWER = 12, 0.7
# Samples of a leg in rough simulations.
_SAMPLES = 60
# Longest hold that is tried, in longest time constants; a rough simulation is that good, and the hold found to a share.
_PATIENCE, _ROUGHLY, _NEARLY = 30.0, 0.95, 0.03


@dataclass(frozen=True, eq=False)
class Homing:
    """A voltage that leads from any state to a known state.

    Attributes
    ----------
    turns : tuple of float
        Voltages [V] to visit in this order, monotonically; the first one is the present voltage. If the state is known
        already, it is the only one.
    bounds : StateBounds
        Bounds of the state at the end, by two simulations.
    unknown : tuple of int
        Elements whose carts stay unknown, counted from 0.
    certified : bool
        Whether the displacement and every element with stiffness are known at the end; then all later motion is known
        too.
    remarks : tuple of str
        Remarks for the user, in sentences.
    played : Excitation or None
        The voltage over time, with holds, if the state depends on time. It is certified at this speed only.
    spread : float or None
        With `played`: largest difference of the displacement [m] between any two histories, at the end and along a
        further cycle through the limits. `certified` then refers to `spread`.
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
        """The state at the end: the middle of the bounds, which is the certified state if the homing is certified."""
        return self.bounds.middle

    @property
    def width(self) -> float:
        """The largest width [m] of the bounds at the end, including elements without stiffness."""
        return self.bounds.width

    @property
    def error(self) -> float:
        """Error bar of the displacement [m] after the homing: `spread`, or without it the width of the bounds."""
        return self.width if self.spread is None else self.spread

    @property
    def travel(self) -> float:
        """Travel: sum of all voltage changes [V]."""
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
    """Find the voltage of least travel that leads from any state at rest to a known state.

    Whether a state is known depends only on the extremes of the voltage (`MajorLoop.least_range`). Hence the shortest
    waveform is one of four: up, down, up and down, or down and up, each followed by the way to the end. The extremes
    have a closed form; two simulations certify the result.

    The homing is just long enough for the model. For a real actuator, add a few percent; a larger excursion homes it
    too.

    Parameters
    ----------
    actuator : Actuator
    limits : (float, float), optional
        Lowest and highest voltage [V]; default the actuator's.
    present, end : float, optional
        Present and final voltage [V]; default: 0, and back to the present voltage.
    tolerance : float, optional
        Allowed width of the state's bounds [m]; default: 1e-12 of the range of the spring's knots. If the state depends
        on time: allowed width of the displacement's bounds; default: 1e-3 of that range.
    stiff_only : bool, optional
        Leave out elements without stiffness, which never move the actuator. By default they are homed too if the limits
        allow it, so that the whole state is known.
    drive : Sampling, optional
        Speed and shape of the legs, if the state depends on time; default: legs of a twentieth of the longest creep
        time constant, and no shorter than fifty periods of a resonance.
    hold : float, optional
        Time [s] to wait at the last visit of either limit, if the state depends on time. Default: as long as the
        tolerance requires; if no hold suffices, the longest time constant of creep.

    Returns
    -------
    Homing
        If the limits are too narrow, the best homing within them, not certified, with a remark on the limits that would
        suffice. With creep, the remark includes an error bar and the hold that would suffice.

    Raises
    ------
    ModelError
        If there are no limits, `present` or `end` lies outside them, or a number is impossible.
    """
    if not isinstance(actuator, Actuator):
        raise ModelError(argument="actuator", got=type(actuator).__name__, need="an Actuator")
    allowed = allowed_limits(actuator, limits)
    start = _inside(present, "present", allowed)
    stop = start if end is None else _inside(end, "end", allowed)
    if time_dependence(actuator):
        return _homing_in_time(actuator, allowed, (start, stop), drive, hold, tolerance)
    task = _OrderedHoming(actuator, allowed, (start, stop), least_width(actuator, tolerance))
    turns = task.turns(task.stiff if stiff_only or not task.suffices(task.whole) else task.whole)
    bounds = StateBounds.at_rest(actuator, start).propagate(actuator, turns).bounds
    unknown = bounds.widths > task.tolerance
    stiff = unknown & task.has_stiffness
    certified = not stiff.any() and bounds.move_error <= task.tolerance
    remark = task.remark(turns, bounds, stiff if not certified else unknown, certified)
    return Homing(turns, bounds, tuple(np.flatnonzero(unknown).tolist()), certified, remark)


def _inside(voltage: float, what: str, limits: tuple[float, float]) -> float:
    v = number(voltage, what)
    if not limits[0] <= v <= limits[1]:
        raise ModelError(
            argument=what, got=f"{v:.6g} V", need=f"a voltage within the limits {limits[0]:.6g} to {limits[1]:.6g} V"
        )
    return v


def _travel(turns: Sequence[float]) -> float:
    return float(sum(abs(b - a) for a, b in pairwise(turns)))


class _OrderedHoming:
    """The homing of an actuator whose state depends only on the order of voltages.

    `reach` [m]: the required `MajorLoop.least_range` of the voltages to home the whole state, or only the stiff
    elements.
    """

    def __init__(
        self, actuator: Actuator, limits: tuple[float, float], ends: tuple[float, float], tolerance: float
    ) -> None:
        self.limits, self.ends, self.tolerance = limits, ends, tolerance
        self.loop, slip = MajorLoop(actuator), actuator.slip
        kappa = slip.stiffness
        self.has_stiffness = (kappa > 0).any(axis=1) if isinstance(slip, GradedSlip) else kappa > 0
        # The part of the tolerance [m] reserved for rounding.
        self.slack = min(tolerance, least_width(actuator))
        self.whole, self.stiff = (
            2 * float(rho.max()) - (tolerance - self.slack) if rho.size else -np.inf
            for rho in (slip.breakaway, slip.breakaway[self.has_stiffness])
        )

    def suffices(self, reach: float, low: float | None = None, high: float | None = None) -> bool:
        """Return whether voltages from low to high [V], by default the limits, provide a `reach` [m]."""
        low, high = self.limits[0] if low is None else low, self.limits[1] if high is None else high
        # In an identified model the largest element needs exactly the full excursion: rounding must not decide.
        return self.loop.least_range(low, high) >= reach - 0.5 * self.slack

    def top(self, bottom: float, reach: float) -> float:
        """Return the highest voltage [V] required for a `reach` [m] if `bottom` [V] is the lowest."""
        return self.loop.voltage(self.loop.displacement(bottom, -1) + reach, 1)

    def bottom(self, top: float, reach: float) -> float:
        """Return the lowest voltage [V] required for a `reach` [m] if `top` [V] is the highest."""
        return self.loop.voltage(self.loop.displacement(top, 1) - reach, -1)

    def turns(self, reach: float) -> tuple[float, ...]:
        """Return the voltages [V] to visit, with the extremes in the shorter order; up first if both are equal."""
        (start, stop), (low, high) = self.ends, self._extremes(reach)
        middle = (low, high) if stop > start else (high, low)
        visited = (start, *(turn for turn in middle if turn not in (start, stop)), stop)
        return visited[:1] if visited == (start, start) else visited

    def _extremes(self, reach: float) -> tuple[float, float]:
        """Return the lowest and highest voltage [V] with the least travel that provide `reach`; else the limits."""
        (low, high), near, far = self.limits, min(self.ends), max(self.ends)
        if self.suffices(reach, near, far):
            return near, far
        if not self.suffices(reach):
            return low, high
        latest = near if self.suffices(reach, near) else max(low, self.bottom(high, reach))
        # The top is piecewise linear in the bottom: the difference is least where the slope of either changes.
        bends = np.concatenate([self.loop.bends(-1), self.loop.bends(1) - reach])
        corners = [self.loop.voltage(float(bend), -1) for bend in bends]
        bottoms = np.clip([latest, low, self.bottom(far, reach), *corners], low, latest)
        tops = np.array([far if self.suffices(reach, b, far) else min(high, self.top(b, reach)) for b in bottoms])
        # Of equal ranges the one with the highest bottom: a piezo stack bears compression better than tension.
        shortest = tops - bottoms <= (1 + 1e-12) * (tops - bottoms).min()
        best = int(np.argmax(np.where(shortest, bottoms, -np.inf)))
        return float(bottoms[best]), float(tops[best])

    def remark(self, turns: Sequence[float], bounds: StateBounds, unknown: Mask, certified: bool) -> tuple[str, ...]:
        """Return what stays unknown and which limits suffice; or the travel only for elements without stiffness."""
        if not certified and self.suffices(self.stiff):
            return (f"not certified: rounding leaves a width of {bounds.width:.3g} m; give a tolerance above that",)
        widest = bounds.widths[unknown].max(initial=0.0) * 1e6
        left = f"leaves {_named(unknown)} of {unknown.size} unknown, by up to {widest:.4g} um"
        if not certified:
            return (f"not certified: {left}; {self._beyond(self.stiff)}",)
        if unknown.any():
            remark = f"{left}, without stiffness, which no motion depends on"
            return (remark if self.suffices(self.whole) else f"{remark}; {self._beyond(self.whole)}",)
        travel, shorter = _travel(turns), _travel(self.turns(self.stiff))
        if shorter >= travel * (1 - 1e-9):
            return ()
        return (f"{travel - shorter:.4g} V of the {travel:.6g} V only serve elements without stiffness (stiff_only)",)

    def _beyond(self, reach: float) -> str:
        low, high = self.limits
        above, below = self.top(low, reach) - high, low - self.bottom(high, reach)
        return f"{above:.4g} V above {high:.6g} V, or {below:.4g} V below {low:.6g} V, would suffice"


def _named(elements: Mask) -> str:
    """Return the elements as text, counted from 1."""
    numbers = [int(i) + 1 for i in np.flatnonzero(elements)]
    if len(numbers) > 2 and numbers[-1] - numbers[0] == len(numbers) - 1:
        return f"elements {numbers[0]} to {numbers[-1]}"
    return f"element{'s' * (len(numbers) > 1)} {', '.join(map(str, numbers))}"


def _homing_in_time(
    actuator: Actuator,
    limits: tuple[float, float],
    ends: tuple[float, float],
    drive: Sampling | None,
    hold: float | None,
    tolerance: float | None,
) -> Homing:
    """Return the shortest homing of an actuator whose state depends on time."""
    range_ = float(np.ptp(actuator.spring.displacement))
    least = _TOLERANCE * range_ if tolerance is None else number(tolerance, "tolerance")
    if least <= 0:
        raise ModelError(argument="tolerance", got=least, need="a positive number")
    if hold is not None and number(hold, "hold") < 0:
        raise ModelError(argument="hold", got=hold, need="a positive number")
    sampling = drive or Sampling(frequency=0.5 / leg_seconds(actuator))
    task = _TimedHoming(actuator, limits, ends, replace(sampling, base=ends[1], present=ends[0], limits=limits), least)
    wait, longest = _rest_seconds(actuator) if hold is None else float(hold), task.longest
    if hold is None and longest:
        needed = task.needed(wait)
        wait = longest if needed is None else needed
    legs, _ = task.best(wait)
    excitation = task.sampling.play("homing", task.path(legs, wait))
    bounds, spread = task.left(excitation.voltage, excitation.time)
    remarks, reasons = [], time_dependence(actuator)
    if spread > least:
        needed = task.needed(wait)
        remedy = "no hold suffices within these limits; wider limits may, or a larger tolerance"
        if needed is not None:
            remedy = f"holds of {needed:.3g} s at both limits instead of {wait:.3g} s would suffice"
        remarks.append(
            f"not certified to {_micro(least)}: the history may leave {_micro(spread)} ({100 * spread / range_:.2g} % "
            f"of the range), as this actuator {reasons}; {remedy}"
        )
    elif longest and wait > 0.1 * longest:
        shorter = [seconds for seconds in (0.0, 0.1 * longest, longest) if seconds < 0.9 * wait]
        left = ", ".join(f"{_micro(task.best(seconds)[1])} after {seconds:.3g} s" for seconds in shorter)
        remarks.append(f"shorter holds would leave more: {left}")
    if not keeps_order(actuator):
        remarks.append(
            f"simulated from {len(task.states)} extreme and random histories to end in a known state, not proven: this "
            f"actuator {reasons}"
        )
    unknown = np.flatnonzero(bounds.widths > least).tolist()
    turns = task.turns(legs)
    return Homing(turns, bounds, tuple(unknown), spread <= least, tuple(remarks), excitation, spread)


class _TimedHoming:
    """A homing over time through both limits, from the states that bound all histories within the limits.

    Its parameters are the number of legs, and the holds [s] at the last visit of either limit.
    """

    def __init__(
        self,
        actuator: Actuator,
        limits: tuple[float, float],
        ends: tuple[float, float],
        sampling: Sampling,
        tolerance: float,
    ) -> None:
        self.actuator, self.limits, self.ends, self.sampling = actuator, limits, ends, sampling
        self.tolerance = tolerance
        self.states = possible_states(actuator, ends[0], limits, sampling.half)
        # The longest time constant of creep [s].
        self.longest = float(actuator.creep_times.max(initial=0.0))
        self._cycle = self._few(self.sampling.legs(_way_through(limits, ends[1], ends[1], 2)))

    def best(self, hold: float) -> tuple[int, float]:
        """Return the best number of legs with these holds, and roughly the spread [m]."""
        legs, spread = 2, self._rough_spread(2, hold)
        for more in range(4, _MOST_LEGS + 1, 2):
            if spread <= self.tolerance:
                break
            less = self._rough_spread(more, hold)
            if less > _FEWER * spread:
                break
            legs, spread = more, less
        return legs, spread

    def needed(self, hold: float) -> float | None:
        """Return holds [s] that keep the tolerance; None if there are none. `hold` [s]: tried first."""
        low, high = 0.0, _PATIENCE * self.longest

        def misses(seconds: float) -> bool:
            return self.best(seconds)[1] > _ROUGHLY * self.tolerance

        if not self.longest:
            return None
        if not misses(0.0):
            return 0.0
        if misses(high):
            return None
        if not misses(hold):
            high = hold
        while high - low > _NEARLY * high:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if misses(middle) else (low, middle)
        return high

    def turns(self, legs: int) -> tuple[float, ...]:
        """Return the voltages [V] to visit, the present voltage first."""
        return _way_through(self.limits, *self.ends, legs)

    def path(self, legs: int, hold: float) -> list[Leg]:
        """Return the legs through the turns, with a hold at the last visit of either limit."""
        turns = self.turns(legs)
        last = {turn: k for k, turn in enumerate(turns) if turn in self.limits and hold > 0}
        path: list[Leg] = []
        for k, leg in enumerate([None, *self.sampling.legs(turns)]):
            path += [] if leg is None else [leg]
            path += [Leg(turns[k], turns[k], hold)] if last.get(turns[k]) == k else []
        return path

    def left(self, voltage: Array, time: Array) -> tuple[StateBounds, float]:
        """Return the bounds of the states at the end, and the spread [m] there and along a further cycle."""
        ends, paths = [], []
        for state in self.states:
            end = self._played(voltage, time, state)[1]
            ends.append(end)
            paths.append(np.append(self._played(*self._cycle, end)[0], end.deformation))
        return StateBounds.of(ends), float(np.ptp(paths, axis=0).max())

    def _rough_spread(self, legs: int, hold: float) -> float:
        return self.left(*self._few(self.path(legs, hold)))[1]

    def _few(self, legs: Sequence[Leg]) -> tuple[Array, Array]:
        """Return a coarse sampling of legs: voltage [V] and time [s]."""
        voltage, time = [np.array([legs[0].start])], [np.zeros(1)]
        for leg in legs:
            share = np.arange(1, _SAMPLES + 1) / _SAMPLES
            if leg.start == leg.end:
                # Creep is fastest at the beginning.
                share = share**3
            voltage.append(leg.start + (leg.end - leg.start) * share)
            time.append(time[-1][-1] + leg.seconds * share)
        return np.concatenate(voltage), np.concatenate(time)

    def _played(self, voltage: Array, time: Array, state: State) -> tuple[Array, State]:
        when = time if self.actuator.needs_time else None
        motion = self.actuator.simulate(voltage, time=when, state=state, extrapolate=True)
        return motion.displacement, motion.state


def _way_through(limits: tuple[float, float], start: float, stop: float, legs: int) -> tuple[float, ...]:
    """Return the voltages [V] of the shorter way through both limits with `legs` visits; up first if both are equal."""
    low, high = limits
    ways = []
    for first, second in ((high, low), (low, high)):
        visited = [start]
        for turn in [*[first, second] * (legs // 2), stop]:
            if turn != visited[-1]:
                visited.append(turn)
        ways.append(tuple(visited))
    return min(ways, key=_travel)


def leg_seconds(actuator: Actuator, otherwise: float = 0.5 / Sampling().frequency) -> float:
    """Return the default duration [s] of a leg: a share of the longest creep time constant; without creep, `otherwise`.

    It is long enough for an amplifier's lag and a resonance to follow.
    """
    times = actuator.creep_times
    seconds = _LEG * float(times.max()) if times.size else otherwise
    if actuator.dynamics is not None:
        seconds = max(seconds, _PERIODS * 2 * math.pi / actuator.dynamics.frequency)
    return max(seconds, _RESTS * actuator.lag)


def _rest_seconds(actuator: Actuator) -> float:
    """Return the time [s] after which a mass and a lag are at rest."""
    seconds, dynamics = _RESTS * actuator.lag, actuator.dynamics
    if dynamics is None or not dynamics.damping:
        return seconds
    # Beyond critical damping the slower of two rates counts.
    zeta = dynamics.damping
    rate = dynamics.frequency * (zeta if zeta <= 1 else zeta - np.sqrt(zeta**2 - 1))
    return max(seconds, _RESTS / float(rate))


def _micro(length: float) -> str:
    return f"{length * 1e6:.3g} um"


def present_voltage(bounds: VoltageLimits, present: float | None) -> float:
    """Return the present voltage [V], by default 0 or the nearest limit; raise `RecordError` outside the limits."""
    if present is None:
        return bounds.nearest(0.0)
    return bounds.within(volts(present, "present"), "present", error=RecordError)


def played_homing(
    compensator: Compensator,
    rate: float,
    leg: float,
    *,
    present: float | None = None,
    drive: Sampling | None = None,
    tolerance: float | None = None,
) -> tuple[Excitation | None, Homing, tuple[str, ...]]:
    """Return the shortest homing as an excitation (None if the state is known already), its `Homing`, and remarks.

    Raise `RecordError` if the present voltage lies outside of the limits, or there are too many samples.

    `compensator`: source of actuator, limits and slew rate. `rate` [Hz]: sample rate. `leg` [s]: duration of a leg;
    with creep, the default of `shortest_homing` replaces it. `present` [V]: by default 0 V or the nearest limit.
    `drive`: speed and shape, instead of `leg`. `tolerance`: as in `shortest_homing`.
    """
    actuator, limits, now = compensator.actuator, compensator.limits, present_voltage(compensator.bounds, present)
    if drive is None:
        drive = Sampling(frequency=0.5 / leg_seconds(actuator, leg), sample_rate=rate)
    drive = replace(drive, base=now, present=now, limits=limits, slew_rate=compensator.slew_rate)
    # A long homing has a sample rate of its own: that of the path over a whole number.
    needed = 2 * _LEG_SAMPLES * drive.frequency
    if actuator.dynamics is not None:
        needed = max(needed, _RESONANCE_SAMPLES * actuator.dynamics.frequency / (2 * math.pi))
    drive = replace(drive, sample_rate=rate / max(1, int(rate / needed)))

    def found(drive: Sampling) -> Homing:
        return shortest_homing(actuator, limits=limits, present=now, stiff_only=True, drive=drive, tolerance=tolerance)

    homing = found(drive)
    if homing.played is None or homing.played.duration * rate <= _EVEN_SAMPLES:
        drive = replace(drive, sample_rate=rate)
        homing = found(drive)
    remarks = () if homing.certified and homing.played is None else homing.remarks
    if len(homing.turns) < 2:
        return None, homing, remarks
    played = homing.played or homing_through(turns=homing.turns, drive=drive)
    low, high = actuator.limits or (-np.inf, np.inf)
    least, most = float(played.voltage.min()), float(played.voltage.max())
    if least < low or most > high:
        remarks += (
            f"the homing goes from {least:.6g} to {most:.6g} V, outside of the identified range {low:.6g} to "
            f"{high:.6g} V: extrapolated; check that the actuator allows these voltages, or choose narrower limits",
        )
    # No remark on legs that take longer to keep the slew rate: no speed was requested.
    return played, homing, remarks


def rows_of(voltage: Array) -> NDArray[np.int64]:
    """Return the samples (k,) of a homing's voltage (n,) [V] to play: all, or sparser ones in a long hold."""
    rows = np.arange(voltage.size)
    if rows.size <= _EVEN_SAMPLES:
        return rows
    held = np.zeros(rows.size, dtype=bool)
    held[1:] = voltage[1:] == voltage[:-1]
    moving = np.flatnonzero(~held)
    since = rows - np.repeat(moving, np.diff(moving, append=rows.size))
    steps = np.unique(np.round(_SPARSER ** np.arange(int(math.log(rows.size) / math.log(_SPARSER)) + 2)))
    kept: NDArray[np.bool_] = (since == 0) | np.isin(since, steps)
    kept[:-1] |= since[1:] == 0
    return rows[kept]
