"""The steady cycle of a scan, in which creep and smooth elements repeat, and the start-up into it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil, inf, log
from typing import Any

import numpy as np

from dehyst._native import EMPTY
from dehyst._text import counted
from dehyst._types import Array
from dehyst.control.compensator import Compensator
from dehyst.control.trajectory import Command
from dehyst.model import Actuator, DisplacementCreep, PathData, State
from dehyst.waveforms import ScanPath

# Enough for a contracting, piecewise smooth map; the linear one of Dahl's elements needs one.
_ROUNDS = 100
_EPS = float(np.finfo(np.float64).eps)
# Most difference of two steady cycles, as a share of the voltage range.
_REPEATS = 1e-9
# Of the range of the limits: a larger change of the voltage is no rounding.
_ROUNDING = 1e-12
MOST_CYCLES, MOST_SAMPLES = 1000, 5_000_000
# With clamped voltages: numbers of cycles to try, and most samples, as clamping is slow.
_CLAMPED, _MOST_CLAMPED = (3, 6, 12, 24, 48), 100_000


def timed(path: ScanPath) -> dict[str, Any]:
    """Return time and derivatives of a path, as arguments of `compensate` and `trajectory`."""
    return {"time": path.time, "velocity": path.velocity, "acceleration": path.acceleration}


def steady_state(actuator: Actuator, path: ScanPath, state: State) -> State:
    """Return the state at the first sample of a periodic path after infinitely many cycles.

    Creep and smooth elements are driven only by w, which follows from the path. So they are independent of each other
    and of the carts. A creep branch is linear: if a cycle from zero strain ends at D, its steady strain is ``d =
    exp(-T/tau) d + D``. The elongation of a smooth element after a cycle rises with the elongation before it, with
    slope below 1. Its only fixed point lies between the two extremes and is found by the Illinois method of false
    position. Raise `ModelError` if the state does not fit the actuator.

    `path`: one period. `state`: state at the path's first sample after at least two cycles, which erase the history of
    the carts.
    """
    cycle = path.repeated(1)
    if actuator.displacement_creep is not None:
        return _steady_behind(actuator, actuator.displacement_creep, cycle, state)
    if actuator.creep is not None:
        w = cycle.displacement + actuator.model.lead(cycle.displacement, PathData(**timed(cycle)))
        gained = actuator.creep.strains(cycle.time, w)[-1]
        state = replace(state, creep=gained / -np.expm1(-float(cycle.time[-1]) / actuator.creep.time_constants))
    return state if actuator.smooth is None else replace(state, smooth=_elongations(actuator, cycle, state))


def _steady_behind(actuator: Actuator, creep: DisplacementCreep, cycle: ScanPath, state: State) -> State:
    """Return the state at the first sample of a periodic path, with creep in displacement: that of its steady cycle.

    While creep settles, the path before it drifts. If it drifts one way, the carts keep its extremes as after a jump.
    """
    before, begun = creep.steady(cycle.time, cycle.displacement)
    strains = creep.strains(cycle.time, before, begun)
    slow = strains / creep.time_constants
    velocity = cycle.velocity - slow @ creep.gains
    acceleration = cycle.acceleration - (velocity[:, None] - slow) @ (creep.gains / creep.time_constants)
    closed = ScanPath(before, velocity, acceleration, cycle.sample_rate)
    plain, inner = actuator.before_creep, replace(state, displacement_creep=EMPTY)
    for _ in range(2):
        inner = plain.compensate(before, **timed(closed), state=inner, extrapolate=True).state
    once = ScanPath(before[:-1], velocity[:-1], acceleration[:-1], cycle.sample_rate)
    return replace(steady_state(plain, once, inner), displacement_creep=begun)


def _elongations(actuator: Actuator, cycle: ScanPath, state: State) -> Array:
    """Return the steady elongations q_l (L,) [m] of a cycle."""
    length = np.zeros(0) if actuator.smooth is None else actuator.smooth.length

    def gained(elongation: Array) -> Array:
        begin = replace(state, smooth=elongation)
        motion = actuator.compensate(cycle.displacement, **timed(cycle), state=begin, extrapolate=True)
        return np.asarray(motion.state.smooth - elongation)

    low, high = -length, length.copy()
    left, right = gained(low), gained(high)
    middle, side = 0.5 * (low + high), np.zeros(length.size)
    for _ in range(_ROUNDS):
        with np.errstate(invalid="ignore", divide="ignore"):
            middle = np.where(left == right, 0.5 * (low + high), (low * right - high * left) / (right - left))
        middle = np.clip(middle, low, high)
        gain = gained(middle)
        if np.all(np.abs(gain) <= 4 * _EPS * length) or np.all(high - low <= 4 * _EPS * length):
            break
        up = gain > 0
        right = np.where(up & (side > 0), 0.5 * right, np.where(up, right, gain))
        left = np.where(~up & (side < 0), 0.5 * left, np.where(up, gain, left))
        low, high, side = np.where(up, middle, low), np.where(up, high, middle), np.where(up, 1.0, -1.0)
    return middle


@dataclass(frozen=True, eq=False)
class StartUp:
    """A voltage to play (n,) [V], with the wanted and the expected displacement (n,) [m]."""

    voltage: Array
    displacement: Array
    expected: Array
    sample_rate: float

    def __len__(self) -> int:
        return self.voltage.size

    @property
    def time(self) -> Array:
        """Time of each sample (n,) [s], from 0."""
        return np.arange(len(self)) / self.sample_rate


@dataclass(frozen=True, eq=False)
class SteadyCycle:
    """Search for the steady cycle of a periodic path, and for the start-up that leads into it.

    It returns the fields of a `dehyst.control.WaveTable` that it determines.

    Attributes
    ----------
    compensator : Compensator
    path, way : ScanPath, ScanPath or None
        One period, and the lead-in to its first sample.
    start : State
        State before the lead-in.
    tolerance : float
        Largest allowed deviation of the first steady cycle from the later ones [m].
    present : float, optional
        Voltage before the first sample [V]; by default the voltage that holds the start.
    """

    compensator: Compensator
    path: ScanPath
    way: ScanPath | None
    start: State
    tolerance: float
    present: float | None = None

    def settled(self, cycles: int | None) -> dict[str, Any]:
        """Return the settled scan after `cycles` of start-up, by default as many as the tolerance requires."""
        return self._steady(cycles) or self._clamped(cycles)

    def _steady(self, cycles: int | None) -> dict[str, Any] | None:
        """Settle by computing the steady state; return None if the limits clamp the steady cycle."""
        size, actuator = len(self.path), self.compensator.actuator
        state = steady_state(actuator, self.path, self._begun(2).state)
        # In a cycle that repeats itself nothing limits the slew rate before the first sample.
        first = actuator.compensate(self.path.displacement, **timed(self.path), state=state, extrapolate=True)
        present = self.compensator.bounds.nearest(float(first.voltage[0]))
        three = self._follow(self.path.repeated(3), state, present)
        if three.clamped.any():
            return None
        # The middle cycle: at its ends the slope of the voltage is known from both sides, which a lag needs.
        voltage = three.voltage[size : 2 * size]
        repeats = float(np.abs(three.voltage[2 * size : 3 * size] - voltage).max())
        expected = self._cycle(voltage, state)
        count, error = self._needed(voltage, expected, cycles)
        command = self._begun(count)
        begun = self._towards(command.voltage[:-1], float(voltage[0]))
        held = self.compensator.held(self.start) if self.present is None else self.present
        change = np.abs(np.diff(np.concatenate([[held], begun, voltage[:1]])))
        if change.max() > self._step + _ROUNDING * float(np.ptp(self.compensator.limits)):
            # The start-up is too short to lead to the cycle.
            return None
        warnings = [*command.warnings, *self._not_settled(count, error)]
        if repeats > _REPEATS * float(np.ptp(voltage)):
            warnings.append(f"the steady cycle repeats itself to {repeats:.3g} V only")
        return {
            "start_up": self._start_up(count, begun, command.displacement[:-1]),
            "cycle": StartUp(voltage, self.path.displacement, expected[:-1], self.path.sample_rate),
            "cycles": count,
            "error": error,
            "state": state,
            "clamped": int(command.clamped[:-1].sum()),
            "warnings": tuple(warnings),
        }

    def _clamped(self, cycles: int | None) -> dict[str, Any]:
        """Settle by following the path until the clamped voltages repeat."""
        size, path = len(self.path), self.path
        tries = [count for count in _CLAMPED if count == _CLAMPED[0] or count * size <= _MOST_CLAMPED]
        for count in tries if cycles is None else (cycles + 1,):
            command = self._begun(count)
            end = command.voltage.size - 1
            last, before = command.voltage[end - size : end], command.voltage[end - 2 * size : end - size]
            if count > 1 and np.abs(last - before).max() <= _REPEATS * np.ptp(last):
                break
        voltage = self._towards(last, float(last[0]))
        twice = self._moved(np.concatenate([command.voltage[: end - size], voltage, voltage]), self.start)
        same = np.array_equal(voltage, last)
        expected = command.displacement[end - size : end] if same else twice[-2 * size : -size]
        error = float(np.abs(twice[-size:] - expected).max())
        miss = float(np.abs(expected - path.displacement).max())
        warnings = [
            f"CLAMPED: the steady cycle cannot be reached within the limits; each cycle misses the path by up to "
            f"{miss * 1e6:.4g} um",
            *command.warnings,
        ]
        if error > self.tolerance:
            warnings.append(
                f"{self._deviation(count - 1, error)}; with clamped voltages the required number is not known, and by "
                f"default {_CLAMPED[-1] - 1} cycles and {_MOST_CLAMPED:g} samples are tried at most; try {2 * count} "
                "cycles"
            )
        begun = slice(0, end - size)
        return {
            "start_up": self._start_up(count, command.voltage[begun], command.displacement[begun]),
            "cycle": StartUp(voltage, path.displacement, expected, path.sample_rate),
            "cycles": count - 1,
            "error": error,
            "state": command.state,
            "clamped": int(command.clamped[:-1].sum()),
            "warnings": tuple(warnings),
        }

    def _follow(self, path: ScanPath, state: State, present: float | None) -> Command:
        return self.compensator.trajectory(path.displacement, **timed(path), state=state, present=present)

    def _wanted(self, cycles: int) -> ScanPath:
        """Return the lead-in, the cycles, and the sample that closes the last cycle."""
        path = self.path.repeated(cycles)
        return path if self.way is None else self.way.then(path)

    def _begun(self, cycles: int) -> Command:
        return self._follow(self._wanted(cycles), self.start, self.present)

    def _start_up(self, cycles: int, voltage: Array, expected: Array) -> StartUp:
        wanted = self._wanted(cycles).displacement[: voltage.size]
        return StartUp(voltage, wanted, expected, self.path.sample_rate)

    def _needed(self, voltage: Array, expected: Array, cycles: int | None) -> tuple[int, float]:
        """Return the number of start-up cycles, and the deviation [m] of the first steady cycle."""
        most = max(1, min(MOST_CYCLES, MOST_SAMPLES // len(self.path))) if cycles is None else cycles
        before, state, sent, count = None, self.start, None, 0
        if self.way is not None:
            command = self._follow(self.way, self.start, self.present)
            before, state, sent = self.way.last, command.state, float(command.voltage[-1])
        while True:
            if cycles is None or count == cycles:
                error = float(np.abs(self._cycle(voltage, state, sent) - expected).max())
                if error <= self.tolerance or count >= most:
                    return count, error
            cycle = self.path if before is None else before.then(self.path)
            command = self._follow(cycle, state, sent)
            before, state, sent, count = self.path.last, command.state, float(command.voltage[-1]), count + 1

    @property
    def _step(self) -> float:
        """The largest change [V] in a sample."""
        slew = self.compensator.slew_rate
        return inf if slew is None else slew / self.path.sample_rate

    def _towards(self, voltage: Array, end: float) -> Array:
        """Return a voltage (n,) [V] with its last samples changed so that `end` [V] follows within the slew rate."""
        if self._step == inf:
            return voltage
        far = self._step * np.arange(voltage.size, 0, -1)
        # What keeps the slew rate keeps it between these two lines too.
        return np.clip(voltage, end - far, end + far)

    def _cycle(self, voltage: Array, state: State, sent: float | None = None) -> Array:
        """Return the displacement (n + 1,) [m] along a cycle, from its first sample or from the voltage before it."""
        closed = np.append(voltage, voltage[0])
        return self._moved(closed if sent is None else np.append(sent, closed), state)[-closed.size :]

    def _moved(self, voltage: Array, state: State) -> Array:
        """Return the displacement (n,) [m] that follows a state."""
        actuator = self.compensator.actuator
        time = np.arange(voltage.size) / self.path.sample_rate if actuator.needs_time else None
        return actuator.simulate(voltage, time=time, state=state, extrapolate=True).displacement

    def _not_settled(self, count: int, error: float) -> tuple[str, ...]:
        """Return the warning if the steady cycle begins too early."""
        if error <= self.tolerance:
            return ()
        warning, times = self._deviation(count, error), self.compensator.actuator.creep_times
        if not times.size:
            return (f"{warning}; give a start-up of more cycles",)
        period = len(self.path) / self.path.sample_rate
        more = ceil(float(times.max()) / period * log(error / self.tolerance))
        warning += f": creep takes {counted(more, 'cycle')} more, {more * period:.3g} s"
        most = MOST_SAMPLES // len(self.path)
        if count + more <= most:
            return (f"{warning}; give a start-up of {counted(count + more, 'cycle')}, or wait",)
        return (f"{warning}, but a start-up has {counted(most, 'cycle')} at most; play the table for that time first",)

    def _deviation(self, count: int, error: float) -> str:
        return (
            f"NOT SETTLED: after {counted(count, 'cycle')} of start-up the first steady cycle deviates by up to "
            f"{error * 1e6:.3g} um, need {self.tolerance * 1e6:.3g} um"
        )
