"""The start-up of a scan, from a state into the steady cycle: its voltages, and its number of cycles."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, log

import numpy as np

from dehyst._errors import RecordError
from dehyst._text import counted
from dehyst._types import Array
from dehyst.control.compensator import Compensator
from dehyst.control.lead_in import follow
from dehyst.control.steady_state import steady_state
from dehyst.control.trajectory import Command
from dehyst.model import Actuator, State
from dehyst.waveforms import ScanPath
from dehyst.waveforms.scan import whole

# Most difference of two steady cycles, as a share of the voltage range.
_REPEATS = 1e-9
_MOST_CYCLES, _MOST_SAMPLES = 1000, 5_000_000
# With clamped voltages: numbers of cycles to try, and most samples, as clamping is slow.
_CLAMPED, _MOST_CLAMPED = (3, 6, 12, 24, 48), 100_000


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
    """A start-up and the steady cycle after it, as in `dehyst.control.wave_table.WaveTable`."""

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
            f"cycles: got {count}, {count * len(path):.4g} samples of start-up, need {most} at most "
            f"({_MOST_SAMPLES:g} samples); try fewer, or a lower sample rate"
        )
    return count


def settle(
    compensator: Compensator,
    path: ScanPath,
    way: ScanPath | None,
    start: State,
    tolerance: float,
    cycles: int | None = None,
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
    """
    task = _SteadyCycleTask(compensator, path, way, start, tolerance)
    return task.steady(cycles) or task.clamped(cycles)


@dataclass(frozen=True, eq=False)
class _SteadyCycleTask:
    compensator: Compensator
    path: ScanPath
    way: ScanPath | None
    start: State
    tolerance: float

    @property
    def actuator(self) -> Actuator:
        return self.compensator.actuator

    def steady(self, cycles: int | None) -> Settled | None:
        """Settle by the steady state; return None if the limits clamp the steady cycle."""
        size = len(self.path)
        state = steady_state(self.actuator, self.path, self._begun(2).state)
        three = follow(self.compensator, self.path.repeated(3), state)
        if three.clamped.any():
            return None
        # The middle cycle: at its ends the slope of the voltage is known from both sides, which a lag needs.
        voltage = three.voltage[size : 2 * size]
        repeats = float(np.abs(three.voltage[2 * size : 3 * size] - voltage).max())
        expected = self._play(voltage, state)
        count, error = self._needed(voltage, expected, cycles)
        command = self._begun(count)
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
        voltage, expected = command.voltage[last], command.displacement[last]
        once_more = self._simulated(np.append(command.voltage[:-1], voltage))[-size:]
        error = float(np.abs(once_more - expected).max())
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
        return follow(self.compensator, self._wanted(cycles), self.start)

    def _wanted(self, cycles: int) -> ScanPath:
        path = self.path.repeated(cycles)
        return path if self.way is None else self.way.then(path)

    def _needed(self, voltage: Array, expected: Array, cycles: int | None) -> tuple[int, float]:
        """Return the number of cycles before the steady voltages, and the deviation [m] of the first steady cycle."""
        most = max(1, min(_MOST_CYCLES, _MOST_SAMPLES // len(self.path))) if cycles is None else cycles
        before, state, count = None if self.way is None else self.way.last, self.start, 0
        sent = None
        if self.way is not None:
            command = follow(self.compensator, self.way, self.start)
            state, sent = command.state, float(command.voltage[-1])
        while True:
            if cycles is None or count == cycles:
                error = float(np.abs(self._play(voltage, state, sent) - expected).max())
                if error <= self.tolerance or count >= most:
                    return count, error
            cycle = self.path if before is None else before.then(self.path)
            command = follow(self.compensator, cycle, state)
            before, state, sent, count = self.path.last, command.state, float(command.voltage[-1]), count + 1

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
            return (f"{warning}; give more cycles=",)
        period = len(self.path) / self.path.sample_rate
        more = ceil(float(creep.time_constants.max()) / period * log(error / self.tolerance))
        warning, most = f"{warning}: creep takes {counted(more, 'cycle')} more, {more * period:.3g} s", self.most
        if count + more <= most:
            return (f"{warning}; give cycles={count + more}, or wait",)
        return (f"{warning}, but a start-up has {counted(most, 'cycle')} at most; play the table for that time first",)

    def _not_settled_clamped(self, count: int, error: float) -> tuple[str, ...]:
        """Return the warning for clamped voltages, of which nothing predicts how they settle."""
        if error <= self.tolerance:
            return ()
        return (
            f"{self._deviation(count, error)}; with clamped voltages the required number is not known, and by default "
            f"{_CLAMPED[-1] - 1} cycles and {_MOST_CLAMPED:g} samples are tried at most; try cycles={2 * (count + 1)}",
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
