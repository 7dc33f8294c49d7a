"""The steady cycle of a scan, in which creep and smooth elements end as they began, and the start-up into it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil, inf, log
from typing import Any

import numpy as np

from dehyst._errors import RecordError
from dehyst._text import counted
from dehyst._types import Array
from dehyst.control.compensator import Compensator
from dehyst.control.trajectory import Command
from dehyst.model import Actuator, State
from dehyst.model.evaluator import PathData
from dehyst.waveforms import ScanPath
from dehyst.waveforms.scan import whole

# Enough for a contracting, piecewise smooth map; the linear one of Dahl's elements needs one.
_ROUNDS = 100
_EPS = float(np.finfo(np.float64).eps)
# Most difference of two steady cycles, as a share of the voltage range.
_REPEATS = 1e-9
# Of the range of the limits: a larger change of the voltage is no rounding.
_ROUNDING = 1e-12
_MOST_CYCLES, _MOST_SAMPLES = 1000, 5_000_000
# With clamped voltages: numbers of cycles to try, and most samples, as clamping is slow.
_CLAMPED, _MOST_CLAMPED = (3, 6, 12, 24, 48), 100_000


def steady_state(actuator: Actuator, path: ScanPath, state: State) -> State:
    """Return the state at the first sample of a periodic path after infinitely many cycles.

    Creep and smooth elements are driven by w alone, which follows from the path, so both are independent of each other
    and of the carts. A branch of creep is linear: if a cycle from zero strain ends at D, its steady strain is
    ``d = exp(-T/tau) d + D``. A smooth element's end rises with its beginning, with slope below 1: its only fixed point
    lies between the two extremes. Raise `ModelError` if the state does not fit the actuator.

    `path`: periodic. `state`: at the path's first sample, after two cycles at least, which erase the history of the
    carts.
    """
    if actuator.creep is not None:
        state = replace(state, creep=_strains(actuator, path))
    return state if actuator.smooth is None else replace(state, smooth=_elongations(actuator, path, state))


def _strains(actuator: Actuator, path: ScanPath) -> Array:
    """Return the steady strains d_j (J,) [m] of a cycle."""
    creep, cycle = actuator.creep, path.repeated(1)
    data = PathData(**timed(cycle))
    w = cycle.displacement + actuator.model.lead(cycle.displacement, data)
    if creep is None:
        return np.zeros(0)
    gained = creep.strains(cycle.time, w)[-1]
    return np.asarray(gained / -np.expm1(-float(cycle.time[-1]) / creep.time_constants))


def _elongations(actuator: Actuator, path: ScanPath, state: State) -> Array:
    """Return the steady elongations q_l (L,) [m] of a cycle, by the Illinois method of false position."""
    cycle, length = path.repeated(1), np.zeros(0) if actuator.smooth is None else actuator.smooth.length

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
class Settled:
    """A start-up and the steady cycle after it, as in `dehyst.control.planning.wave_table.WaveTable`."""

    start_up: StartUp
    cycle: StartUp
    cycles: int
    error: float
    state: State
    clamped: int
    warnings: tuple[str, ...]


def start_up_cycles(cycles: object, path: ScanPath) -> int:
    """Return `cycles` if a start-up may have as many; raises RecordError."""
    count, most = whole(cycles, "cycles", 0), _MOST_SAMPLES // len(path)
    if count > most:
        raise RecordError(
            argument="cycles",
            got=f"{count}, {count * len(path):.4g} samples of start-up",
            need=f"{most} at most ({_MOST_SAMPLES:g} samples)",
            hint="try fewer, or a lower sample rate",
        )
    return count


def settle(
    compensator: Compensator,
    path: ScanPath,
    way: ScanPath | None,
    start: State,
    tolerance: float,
    cycles: int | None = None,
    present: float | None = None,
) -> Settled:
    """Find the steady cycle of a periodic path, and the start-up that leads into it.

    Parameters
    ----------
    compensator : Compensator
    path, way : Path, ScanPath or None
        One period, and the lead-in to its first sample.
    start : State
        Before the lead-in.
    tolerance : float
        Largest deviation of the first steady cycle from the later ones [m].
    cycles : int, optional
        Of the start-up; by default as many as the tolerance requires, 1000 and 5e6 samples at most.
    present : float, optional
        Voltage before the first sample [V]; by default the one that holds the start.
    """
    task = _SteadyCycleTask(compensator, path, way, start, tolerance, present)
    return task.steady(cycles) or task.clamped(cycles)


@dataclass(frozen=True, eq=False)
class _SteadyCycleTask:
    compensator: Compensator
    path: ScanPath
    way: ScanPath | None
    start: State
    tolerance: float
    present: float | None = None

    @property
    def actuator(self) -> Actuator:
        return self.compensator.actuator

    def steady(self, cycles: int | None) -> Settled | None:
        """Settle by the steady state; return None if the limits clamp the steady cycle."""
        size = len(self.path)
        state = steady_state(self.actuator, self.path, self._begun(2).state)
        # In a cycle that repeats itself nothing limits the slew rate before the first sample.
        first = self.actuator.compensate(self.path.displacement, **timed(self.path), state=state, extrapolate=True)
        three = follow(self.compensator, self.path.repeated(3), state, self._nearest(float(first.voltage[0])))
        if three.clamped.any():
            return None
        # The middle cycle: at its ends the slope of the voltage is known from both sides, which a lag needs.
        voltage = three.voltage[size : 2 * size]
        repeats = float(np.abs(three.voltage[2 * size : 3 * size] - voltage).max())
        expected = self._play(voltage, state)
        count, error = self._needed(voltage, expected, cycles)
        command = self._begun(count)
        begun = self._leading_to(command.voltage[:-1], float(voltage[0]))
        if begun is None:
            return None
        command = replace(command, voltage=np.append(begun, voltage[0]))
        warnings = [*command.warnings, *self._not_settled(count, error)]
        if repeats > _REPEATS * float(np.ptp(voltage)):
            warnings.append(f"the steady cycle repeats itself to {repeats:.3g} V only")
        return Settled(
            self._start_up(command, 0, command.voltage.size - 1),
            self._cycle(voltage, expected[:-1]),
            count,
            error,
            state,
            int(command.clamped[:-1].sum()),
            tuple(warnings),
        )

    def clamped(self, cycles: int | None) -> Settled:
        """Settle by following the path until the clamped voltages repeat."""
        size = len(self.path)
        tries = [count for count in _CLAMPED if count == _CLAMPED[0] or count * size <= _MOST_CLAMPED]
        for count in tries if cycles is None else (cycles + 1,):
            command = self._begun(count)
            end = command.voltage.size - 1
            last = slice(end - size, end)
            if count > 1 and self._repeats(command.voltage[end - 2 * size : end]):
                break
        voltage = self._towards(command.voltage[last], float(command.voltage[last][0]))
        twice = self._simulated(np.concatenate([command.voltage[: end - size], voltage, voltage]))
        same = np.array_equal(voltage, command.voltage[last])
        expected = command.displacement[last] if same else twice[-2 * size : -size]
        error = float(np.abs(twice[-size:] - expected).max())
        miss = float(np.abs(expected - self.path.displacement).max())
        warnings = (
            f"CLAMPED: the steady cycle cannot be reached within the limits; each cycle misses the path by up to "
            f"{miss * 1e6:.4g} um",
            *command.warnings,
            *self._not_settled_clamped(count - 1, error),
        )
        return Settled(
            self._start_up(command, 0, end - size),
            self._cycle(voltage, expected),
            count - 1,
            error,
            command.state,
            int(command.clamped[:-1].sum()),
            warnings,
        )

    def _repeats(self, cycles: Array) -> bool:
        """Return whether the second of two cycles repeats the first."""
        first, second = np.split(cycles, 2)
        return bool(np.abs(second - first).max() <= _REPEATS * np.ptp(second))

    def _begun(self, cycles: int) -> Command:
        """Return the command for the lead-in, `cycles` cycles, and the sample that closes the last."""
        return follow(self.compensator, self._wanted(cycles), self.start, self.present)

    def _wanted(self, cycles: int) -> ScanPath:
        path = self.path.repeated(cycles)
        return path if self.way is None else self.way.then(path)

    def _needed(self, voltage: Array, expected: Array, cycles: int | None) -> tuple[int, float]:
        """Return the number of cycles before the steady voltages, and the deviation [m] of the first steady cycle."""
        most = max(1, min(_MOST_CYCLES, _MOST_SAMPLES // len(self.path))) if cycles is None else cycles
        before, state, count = None if self.way is None else self.way.last, self.start, 0
        sent = None
        if self.way is not None:
            command = follow(self.compensator, self.way, self.start, self.present)
            state, sent = command.state, float(command.voltage[-1])
        while True:
            if cycles is None or count == cycles:
                error = float(np.abs(self._play(voltage, state, sent) - expected).max())
                if error <= self.tolerance or count >= most:
                    return count, error
            cycle = self.path if before is None else before.then(self.path)
            command = follow(self.compensator, cycle, state, sent)
            before, state, sent, count = self.path.last, command.state, float(command.voltage[-1]), count + 1

    def _nearest(self, voltage: float) -> float:
        low, high = self.compensator.limits
        return min(max(voltage, low), high)

    @property
    def _step(self) -> float:
        """The largest change [V] in a sample."""
        slew = self.compensator.slew_rate
        return inf if slew is None else slew / self.path.sample_rate

    def _towards(self, voltage: Array, end: float) -> Array:
        """Return a voltage (n,) [V] whose last samples lead to the one after them, `end`, within the slew rate."""
        if self._step == inf:
            return voltage
        far = self._step * np.arange(voltage.size, 0, -1)
        # What keeps the slew rate keeps it between these two lines too.
        return np.clip(voltage, end - far, end + far)

    def _leading_to(self, begun: Array, first: float) -> Array | None:
        """Return a start-up (n,) [V] that leads to the `first` voltage of the cycle; None if it is too short."""
        led = self._towards(begun, first)
        present = self._nearest(self.actuator.voltage(self.start)) if self.present is None else self.present
        change = np.abs(np.diff(np.concatenate([[present], led, [first]])))
        rounding = _ROUNDING * (self.compensator.limits[1] - self.compensator.limits[0])
        return led if change.max() <= self._step + rounding else None

    def _play(self, voltage: Array, state: State, sent: float | None = None) -> Array:
        """Return the displacement (n + 1,) [m] along a cycle, from its first sample or from a voltage sent before."""
        closed = np.append(voltage, voltage[0]) if sent is None else np.concatenate([[sent], voltage, voltage[:1]])
        time = np.arange(closed.size) / self.path.sample_rate if self.actuator.needs_time else None
        motion = self.actuator.simulate(closed, time=time, state=state, extrapolate=True)
        return motion.displacement[closed.size - voltage.size - 1 :]

    def _simulated(self, voltage: Array) -> Array:
        """Return the displacement (n,) [m] from the start on."""
        time = np.arange(voltage.size) / self.path.sample_rate if self.actuator.needs_time else None
        return self.actuator.simulate(voltage, time=time, state=self.start, extrapolate=True).displacement

    def _not_settled(self, count: int, error: float) -> tuple[str, ...]:
        """Return the warning if the steady cycle begins too early."""
        if error <= self.tolerance:
            return ()
        warning, creep = self._deviation(count, error), self.actuator.creep
        if creep is None or not len(creep):
            return (f"{warning}; give a start-up of more cycles",)
        period = len(self.path) / self.path.sample_rate
        more = ceil(float(creep.time_constants.max()) / period * log(error / self.tolerance))
        warning, most = f"{warning}: creep takes {counted(more, 'cycle')} more, {more * period:.3g} s", self.most
        if count + more <= most:
            return (f"{warning}; give a start-up of {counted(count + more, 'cycle')}, or wait",)
        return (f"{warning}, but a start-up has {counted(most, 'cycle')} at most; play the table for that time first",)

    def _not_settled_clamped(self, count: int, error: float) -> tuple[str, ...]:
        """Return the warning for clamped voltages, of which nothing predicts how they settle."""
        if error <= self.tolerance:
            return ()
        return (
            f"{self._deviation(count, error)}; with clamped voltages the required number is not known, and by default "
            f"{_CLAMPED[-1] - 1} cycles and {_MOST_CLAMPED:g} samples are tried at most; try {2 * (count + 1)} cycles",
        )

    @property
    def most(self) -> int:
        """Most cycles of a start-up."""
        return _MOST_SAMPLES // len(self.path)

    def _deviation(self, count: int, error: float) -> str:
        return (
            f"NOT SETTLED: after {counted(count, 'cycle')} of start-up the first steady cycle deviates by up to "
            f"{error * 1e6:.3g} um, need {self.tolerance * 1e6:.3g} um"
        )

    def _start_up(self, command: Command, start: int, stop: int) -> StartUp:
        wanted = self._wanted_rows(command.voltage.size)
        return StartUp(
            command.voltage[start:stop], wanted[start:stop], command.displacement[start:stop], self.path.sample_rate
        )

    def _wanted_rows(self, size: int) -> Array:
        ahead = 0 if self.way is None else len(self.way)
        return self._wanted((size - 1 - ahead) // len(self.path)).displacement

    def _cycle(self, voltage: Array, expected: Array) -> StartUp:
        return StartUp(voltage, self.path.displacement, expected, self.path.sample_rate)


def follow(compensator: Compensator, path: ScanPath, state: State, present: float | None = None) -> Command:
    """Compute the voltages for a path from a state, with the path's own derivatives.

    `present`: voltage [V] before the first sample; by default the one that holds the state.
    """
    return compensator.trajectory(path.displacement, **timed(path), state=state, present=present)


def timed(path: ScanPath) -> dict[str, Any]:
    """Return time and derivatives of a path, as arguments of `compensate` and `trajectory`."""
    return {"time": path.time, "velocity": path.velocity, "acceleration": path.acceleration}
