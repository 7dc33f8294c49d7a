"""The shortest homing: the voltage of least travel that leads from any state at rest to a known one, and as played.

If the order of voltages determines the state, it follows in closed form. For actuators with creep, inertia, lag or
smooth elements a voltage through all of the limits is played in time, from the extreme states (`timed_homing`). It is
played before a path, at its sample rate or a lower one, or step by step.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import ModelError, RecordError
from dehyst._types import Array, Mask
from dehyst._validation import interval, number
from dehyst.control.compensator import Compensator, allowed_limits
from dehyst.control.limits import VoltageLimits
from dehyst.control.planning.bounds import MajorLoop, StateBounds, first_move_error, least_width, moves_on
from dehyst.control.planning.timed_homing import TimedHoming, leg_seconds
from dehyst.model import Actuator, GradedSlip, State
from dehyst.waveforms import Excitation, Sampling
from dehyst.waveforms import homing as homing_through
from dehyst.waveforms.excitation import volts

# Least duration of a leg of a homing [s].
FASTEST_LEG = 0.5
# A homing of more samples has longer steps: this many a leg, and a period of a resonance.
_EVEN_SAMPLES, _LEG_SAMPLES, _RESONANCE_SAMPLES = 100_000, 200, 10
# If these are still too many, most samples of a hold are left out: their times grow by this factor.
_SPARSER = 1.02


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
    allowed = allowed_limits(actuator, limits)
    start = _inside(present, "present", allowed)
    stop = start if end is None else _inside(end, "end", allowed)
    if moves_on(actuator):
        timed = TimedHoming.shortest(actuator, allowed, (start, stop), drive=drive, hold=hold, tolerance=tolerance)
        unknown = timed.bounds.widths > timed.tolerance
        return Homing(
            timed.turns,
            timed.bounds,
            tuple(map(int, np.flatnonzero(unknown))),
            timed.spread <= timed.tolerance,
            timed.remarks(),
            timed.excitation,
            timed.spread,
        )
    task = _HomingTask(actuator, allowed, start, stop, least_width(actuator, tolerance))
    turns = task.turns(task.stiff if stiff_only or not task.suffices(task.whole) else task.whole)
    bounds = StateBounds.at_rest(actuator, start).propagate(actuator, turns).bounds
    unknown = bounds.widths > task.tolerance
    unknown_stiff = unknown & _stiff(actuator)
    certified = not unknown_stiff.any() and first_move_error(bounds) <= task.tolerance
    remark = task.remark(turns, bounds, unknown, unknown_stiff, certified)
    return Homing(turns, bounds, tuple(map(int, np.flatnonzero(unknown))), certified, (remark,) if remark else ())


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


def present_voltage(limits: tuple[float, float], present: float | None) -> float:
    """Return the present voltage [V], by default 0 or the nearest limit; raise `RecordError` if it lies outside."""
    allowed = VoltageLimits(*limits)
    return (
        allowed.nearest(0.0)
        if present is None
        else allowed.within(volts(present, "present"), "present", error=RecordError)
    )


def played_homing(
    compensator: Compensator,
    rate: float,
    leg: float,
    *,
    present: float | None = None,
    drive: Sampling | None = None,
    tolerance: float | None = None,
) -> tuple[Excitation | None, Homing, tuple[str, ...]]:
    """Return the shortest homing as an excitation, None if the state is known already; the homing, and remarks.

    Raise `RecordError` if the present voltage lies outside of the limits, or there are too many samples.

    Parameters
    ----------
    compensator : Compensator
        Its actuator, limits and slew rate.
    rate : float
        Sample rate [Hz].
    leg : float
        Duration of a leg [s]; with creep it is as long as the default of `shortest_homing`.
    present : float, optional
        [V]; by default 0 V or the nearest limit.
    drive : Sampling, optional
        Instead of `leg`: speed and shape.
    tolerance : float, optional
        As in `shortest_homing`.
    """
    actuator, limits = compensator.actuator, interval(compensator.limits or ())
    now = present_voltage(limits, present)
    if drive is None:
        drive = Sampling(frequency=0.5 / leg_seconds(actuator, leg), sample_rate=rate)
    lower = _lower_rate(actuator, drive, rate)
    drive = replace(drive, sample_rate=lower, base=now, present=now, limits=limits, slew_rate=compensator.slew_rate)

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
    return played, homing, (*remarks, *_extrapolation_warning(actuator, played.voltage), *played.warnings)


def _extrapolation_warning(actuator: Actuator, voltage: Array) -> tuple[str, ...]:
    """Warn of a homing (n,) [V] that leaves the voltages of the model's records: they may harm the actuator."""
    if actuator.limits is None:
        return ()
    (low, high), least, most = actuator.limits, float(voltage.min()), float(voltage.max())
    if low <= least and most <= high:
        return ()
    return (
        f"the homing goes from {least:.6g} to {most:.6g} V, outside of the identified range {low:.6g} to {high:.6g} V: "
        "extrapolated; check that the actuator allows these voltages, or choose narrower limits",
    )


def rows_of(voltage: Array) -> NDArray[np.int64]:
    """Return the samples (k,) of a homing's voltage (n,) [V] to play: all, or ever fewer of a long hold."""
    rows = np.arange(voltage.size)
    return rows if rows.size <= _EVEN_SAMPLES else rows[_thinned(voltage)]


def _thinned(voltage: Array) -> NDArray[np.bool_]:
    """Return which samples (n,) to keep: those that move, and in a hold ever fewer."""
    held = np.zeros(voltage.size, dtype=np.int64)
    held[1:] = voltage[1:] == voltage[:-1]
    moving = np.flatnonzero(held == 0)
    since = np.arange(voltage.size) - np.repeat(moving, np.diff(moving, append=voltage.size))
    steps = np.unique(np.round(_SPARSER ** np.arange(int(math.log(voltage.size) / math.log(_SPARSER)) + 2)))
    kept: NDArray[np.bool_] = (since == 0) | np.isin(since, steps)
    kept[:-1] |= since[1:] == 0
    return kept


def _lower_rate(actuator: Actuator, drive: Sampling, rate: float) -> float:
    """Return the sample rate [Hz] of a long homing: `rate` over a whole number."""
    needed = 2 * _LEG_SAMPLES * drive.frequency
    if actuator.dynamics is not None:
        needed = max(needed, _RESONANCE_SAMPLES * actuator.dynamics.frequency / (2 * math.pi))
    return rate / max(1, int(rate / needed))


def homing_steps(homing: Homing, limits: VoltageLimits, period: float) -> Iterator[tuple[float, float]]:
    """Yield the voltages [V] of a homing without the present one, each with its duration [s], `period` at least."""
    largest = limits.largest_step(period)
    for (start, _), (end, seconds) in pairwise(_corners(homing, period)):
        count = max(1, math.ceil(abs(end - start) / largest * (1 - 1e-12)))
        for voltage in np.linspace(start, end, count + 1)[1:]:
            yield limits.nearest(float(voltage)), max(seconds / count, period)


def _corners(homing: Homing, period: float) -> list[tuple[float, float]]:
    """Return the voltages [V] that straight ramps join, the present one first, with their seconds; 0 if free."""
    if homing.played is None:
        return [(voltage, 0.0) for voltage in homing.turns]
    voltage, rate = homing.played.voltage, homing.played.sample_rate
    # No more often than a host can follow, but always at turns and at both ends of a hold.
    bends = np.flatnonzero(np.diff(np.sign(np.diff(voltage)))) + 1
    kept = np.unique([0, voltage.size - 1, *bends, *range(0, voltage.size, max(1, round(period * rate)))])
    seconds = np.diff(kept, prepend=0) / rate
    return list(zip(voltage[kept].tolist(), seconds.tolist(), strict=True))
