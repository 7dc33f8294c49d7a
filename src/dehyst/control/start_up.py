"""From a start into the steady cycle: its voltages, and how many cycles pass before they may be played."""

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

# Of the voltages of a cycle: by so much it may differ from the next.
_REPEATS = 1e-9
_MOST_CYCLES, _MOST_SAMPLES = 1000, 5_000_000
# Where voltages are clamped: cycles until they repeat themselves, and samples, for clamping is slow.
_CLAMPED, _MOST_CLAMPED = (3, 6, 12, 24, 48), 100_000


@dataclass(frozen=True, eq=False)
class StartUp:
    """A voltage to play (n,) [V], the displacement wanted with it and the one to expect (n,) [m]."""

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
    """Return `cycles` as cycles that a start-up may have; raises RecordError."""
    found, most = whole(cycles, "cycles", 0), _MOST_SAMPLES // len(path)
    if found > most:
        raise RecordError(
            f"cycles: got {found}, {found * len(path):.4g} samples of start-up, need {most} at most "
            f"({_MOST_SAMPLES:g} samples); try fewer, or a lower sample rate"
        )
    return found


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
        One period, and what leads to its first sample.
    start : State
        Before the way.
    tolerance : float
        How far the first steady cycle may come off the later ones [m].
    cycles : int, optional
        In the start-up; by default as many as the tolerance needs, 1000 and 5e6 samples at most.
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
        """By the steady state; None if the limits do not let the steady cycle through."""
        size = len(self.path)
        state = steady_state(self.actuator, self.path, self._begun(2).state)
        three = follow(self.compensator, self.path.repeated(3), state)
        if three.clamped.any():
            return None
        # The middle one: at its ends a lagging amplifier knows the slope of the voltage from both sides.
        voltage = three.voltage[size : 2 * size]
        repeats = float(np.abs(three.voltage[2 * size : 3 * size] - voltage).max())
        expected = self._play(voltage, state)
        taken, error = self._taken(voltage, expected, cycles)
        command = self._begun(taken)
        said = [*command.warnings, *self._late(taken, error)]
        if repeats > _REPEATS * float(np.ptp(voltage)):
            said.append(f"the steady cycle repeats itself to {repeats:.3g} V only")
        return Settled(
            self._stretch(command, 0, command.voltage.size - 1),
            self._cycle(voltage, expected[:-1]),
            taken,
            error,
            state,
            int(command.clamped[:-1].sum()),
            tuple(said),
        )

    def clamped(self, cycles: int | None) -> Settled:
        """By going on until the clamped voltages repeat themselves."""
        size = len(self.path)
        tried = [taken for taken in _CLAMPED if taken == _CLAMPED[0] or taken * size <= _MOST_CLAMPED]
        for taken in tried if cycles is None else (cycles + 1,):
            command = self._begun(taken)
            end = command.voltage.size - 1
            last = slice(end - size, end)
            if taken > 1 and self._repeats(command.voltage[end - 2 * size : end]):
                break
        voltage, expected = command.voltage[last], command.displacement[last]
        once_more = self._simulated(np.append(command.voltage[:-1], voltage))[-size:]
        error = float(np.abs(once_more - expected).max())
        miss = float(np.abs(expected - self.path.displacement).max())
        said = (
            f"CLAMPED: the steady cycle cannot be reached within the limits; each misses the path by up to "
            f"{miss * 1e6:.4g} um",
            *command.warnings,
            *self._late_clamped(taken - 1, error),
        )
        return Settled(
            self._stretch(command, 0, end - size),
            self._cycle(voltage, expected),
            taken - 1,
            error,
            command.state,
            int(command.clamped[:-1].sum()),
            said,
        )

    def _repeats(self, two: Array) -> bool:
        """Whether the second of two cycles is the first again."""
        first, second = np.split(two, 2)
        return bool(np.abs(second - first).max() <= _REPEATS * np.ptp(second))

    def _begun(self, cycles: int) -> Command:
        """The way to the first sample, so many cycles, and the sample that closes the last."""
        return follow(self.compensator, self._wanted(cycles), self.start)

    def _wanted(self, cycles: int) -> ScanPath:
        path = self.path.repeated(cycles)
        return path if self.way is None else self.way.then(path)

    def _taken(self, voltage: Array, expected: Array, cycles: int | None) -> tuple[int, float]:
        """Cycles until the steady voltages may be played, and how far the first of these comes off [m]."""
        most = max(1, min(_MOST_CYCLES, _MOST_SAMPLES // len(self.path))) if cycles is None else cycles
        before, state, taken = None if self.way is None else self.way.last, self.start, 0
        held = None
        if self.way is not None:
            command = follow(self.compensator, self.way, self.start)
            state, held = command.state, float(command.voltage[-1])
        while True:
            if cycles is None or taken == cycles:
                error = float(np.abs(self._play(voltage, state, held) - expected).max())
                if error <= self.tolerance or taken >= most:
                    return taken, error
            once = self.path if before is None else before.then(self.path)
            command = follow(self.compensator, once, state)
            before, state, held, taken = self.path.last, command.state, float(command.voltage[-1]), taken + 1

    def _play(self, voltage: Array, state: State, held: float | None = None) -> Array:
        """Displacement (n + 1,) [m] along a cycle of the voltage, from its first sample or from the one before."""
        closed = np.append(voltage, voltage[0]) if held is None else np.concatenate([[held], voltage, voltage[:1]])
        time = np.arange(closed.size) / self.path.sample_rate if self.actuator.needs_time else None
        motion = self.actuator.simulate(closed, time=time, state=state, extrapolate=True)
        return motion.displacement[closed.size - voltage.size - 1 :]

    def _simulated(self, voltage: Array) -> Array:
        """Displacement (n,) [m] from the start on."""
        time = np.arange(voltage.size) / self.path.sample_rate if self.actuator.needs_time else None
        return self.actuator.simulate(voltage, time=time, state=self.start, extrapolate=True).displacement

    def _late(self, taken: int, error: float) -> tuple[str, ...]:
        """What is to be said if the steady cycle comes too early."""
        if error <= self.tolerance:
            return ()
        said, creep = self._off(taken, error), self.actuator.creep
        if creep is None or not len(creep):
            return (f"{said}; give more cycles=",)
        period = len(self.path) / self.path.sample_rate
        more = ceil(float(creep.time_constants.max()) / period * log(error / self.tolerance))
        said, most = f"{said}: creep takes {counted(more, 'cycle')} more, {more * period:.3g} s", self.most
        if taken + more <= most:
            return (f"{said}; give cycles={taken + more}, or wait",)
        return (f"{said}, but a start-up has {counted(most, 'cycle')} at most; play the table for so long and wait",)

    def _late_clamped(self, taken: int, error: float) -> tuple[str, ...]:
        """The same where voltages are clamped: nothing tells how they settle but going on."""
        if error <= self.tolerance:
            return ()
        return (
            f"{self._off(taken, error)}; where the voltage is clipped, how many would do is not known, and by itself "
            f"it tries {_CLAMPED[-1] - 1} at most and {_MOST_CLAMPED:g} samples; give cycles={2 * (taken + 1)} to see",
        )

    @property
    def most(self) -> int:
        """Cycles that a start-up may have."""
        return _MOST_SAMPLES // len(self.path)

    def _off(self, taken: int, error: float) -> str:
        return (
            f"NOT SETTLED: after {counted(taken, 'cycle')} of start-up the first steady cycle comes off by up to "
            f"{error * 1e6:.3g} um, not {self.tolerance * 1e6:.3g} um"
        )

    def _stretch(self, command: Command, start: int, stop: int) -> StartUp:
        wanted = self._wanted_rows(command.voltage.size)
        return StartUp(
            command.voltage[start:stop], wanted[start:stop], command.displacement[start:stop], self.path.sample_rate
        )

    def _wanted_rows(self, size: int) -> Array:
        ahead = 0 if self.way is None else len(self.way)
        return self._wanted((size - 1 - ahead) // len(self.path)).displacement

    def _cycle(self, voltage: Array, expected: Array) -> StartUp:
        return StartUp(voltage, self.path.displacement, expected, self.path.sample_rate)
