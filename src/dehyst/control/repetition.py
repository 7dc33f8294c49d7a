"""Repetition: a path that is repeated learns from its own error, cycle by cycle, around the compensator."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._native import judge
from dehyst._types import Array
from dehyst._validation import FARTHEST, plain
from dehyst.control.compensator import Compensator
from dehyst.control.limits import SensorFault, sensor_bound, warn_of_sensor
from dehyst.control.planning.wave_table import Cycle, WaveTable
from dehyst.control.stage_compensator import StageCompensator, axes_of
from dehyst.model import State, mechanical_response

# Share of the error that a cycle takes away; above the tenth harmonic less after the error rose, and more as it falls.
_GAIN, _SAFE, _SLOWER, _FASTER = 0.6, 10, 0.25, 2.0
# Longest gap between readings, and the part in which a new correction comes, as a share of the cycle.
_GAP, _BLEND = 0.05, 0.125
# The correction ends at this multiple of the resonance; harmonics count that are more than so many times noise.
_RESONANCE, _ABOVE_NOISE = 1.5, 3.0
# The best cycle returns after one with so many times the first error, or so many times the least.
_WORSE, _FAR_WORSE = 1.1, 3.0
# Cycles in which a resonance is looked for, qualities and frequencies tried; share of error to explain, of b unknown.
_CYCLES, _QUALITIES, _FREQUENCIES, _EXPLAINED, _KNOWN = 8, (3.0, 10.0, 30.0, 100.0), 100, 0.8, 0.1
# What the hysteresis leaves falls with this power of the harmonic; so much of it differs between cycles.
_FALLS, _VARIES = 1.5, 0.1


class _Cycle(NamedTuple):
    """A cycle as it was sent: states before it, arrays (n, axes), and its RMS error."""

    states: tuple[State, ...]
    aim: Array
    correction: Array
    voltage: Array
    clamped: bool
    measured: Array = np.zeros((0, 0))
    rms: float = np.inf


class Repetition:
    """A path that is repeated: each cycle corrects the wanted displacement by the error of the cycle before.

    Hysteresis and creep are the compensator's; what is left of the error is learnt::

        repetition = dehyst.Repetition(compensator, path)
        for _ in range(10):
            repetition.learn(rig.play(repetition.next()))

    The first cycle teaches only if it rings: the second follows one like itself. A resonance that the model does not
    have is found in the first cycles; the correction ends just above it. Harmonics are learnt as far as they are more
    than noise. A cycle counts if its readings are complete, no voltage was clamped, and the sensor is believed. After
    one that is worse than the first, the best cycle returns.

    Parameters
    ----------
    compensator : Compensator or StageCompensator
        With a period. It is stepped by this repetition, and by nobody else.
    path : (n,) or (n, axes) array_like
        Wanted displacement [`units` of the compensator] of one cycle, a sample a period.
    bound : float, optional
        Largest correction, and the farthest that a reading may be from the model [as `path`]: one beyond counts as
        missing. Default: a twentieth of the compensator's reach, of the smallest axis.

    Attributes
    ----------
    compensator, path, bound
        As given, the path (n, axes).
    correction : (n, axes) array
        What the next cycle adds to the path.
    errors : list of float
        RMS error of each complete cycle [as `path`]; the first may still settle.
    fault : SensorFault
        Why the sensor is not believed; `SensorFault.NONE` if it is.

    Raise `ModelError` if the compensator has no period, the path does not fit, or the bound is not up to a quarter of
    the reach.
    """

    def __init__(
        self, compensator: Compensator | StageCompensator, path: ArrayLike, *, bound: float | None = None
    ) -> None:
        if not isinstance(compensator, Compensator | StageCompensator):
            raise ModelError(argument="compensator", got=type(compensator).__name__, need="a compensator")
        self._loops = axes_of(compensator)
        if compensator.period is None:
            raise ModelError("a repetition needs the time between steps", hint="give the period [s]")
        self.compensator, self.path = compensator, self._samples(path, "path")
        if len(self.path) < 2 or not (np.abs(self.path) <= FARTHEST).all():
            raise ModelError(argument="path", got=f"{len(self.path)} samples", need="two or more finite numbers")
        reaches = ((loop.reach, loop.actuator.stroke * loop._per_metre) for loop in self._loops)
        self.bound = min(sensor_bound(*reach, bound) for reach in reaches)
        self.reset()

    def __repr__(self) -> str:
        state = "believed" if self.believed else self.fault.name
        error = f", RMS error {self.errors[-1]:.3g}" if self.errors else ""
        return f"<Repetition of {len(self.path)} samples, sensor {state}{error}>"

    @property
    def believed(self) -> bool:
        """Whether the sensor is believed; once it is not, only `reset` trusts it again."""
        return self.fault == SensorFault.NONE

    def reset(self) -> None:
        """Believe the sensor again, and begin without a correction."""
        self.correction = self._before = np.zeros(self.path.shape)
        self.errors: list[float] = []
        self.fault = SensorFault.NONE
        self._cycle: _Cycle | None = None
        self._best: _Cycle | None = None
        # Cycles sent, and gain; cycles in which a resonance is looked for, and what was found for each axis.
        self._sent, self._gain = 0, _GAIN
        self._cycles: list[_Cycle] = []
        self._found: list[tuple[Any, float] | None] = [None] * len(self._loops)

    def next(self) -> Array:
        """Return the voltages (n,) or (n, axes) [V] of the next cycle; they count as sent. Warn `ClampWarning`."""
        states, clamps = tuple(loop.state for loop in self._loops), [loop.clamps for loop in self._loops]
        # What changes comes within a part of the cycle, so that nothing jumps.
        new = 0.5 - 0.5 * np.cos(np.pi * np.clip(np.arange(len(self.path)) / (_BLEND * len(self.path)), 0, 1))[:, None]
        aim = self.path + self._before + new * (self.correction - self._before)
        if isinstance(self.compensator, Compensator):
            # The next cycle begins with this correction.
            after = np.resize((self.path + self.correction)[:, 0], self.compensator.samples_ahead)
            voltage = self.compensator.run(np.concatenate([aim[:, 0], after])[after.size :])[:, None]
        else:
            voltage = self.compensator.run(aim)
        self._before, self._sent = self.correction, self._sent + 1
        clamped = clamps != [loop.clamps for loop in self._loops]
        self._cycle = _Cycle(states, aim, self.correction, voltage, clamped)
        return voltage[:, 0] if isinstance(self.compensator, Compensator) else voltage

    def learn(self, measured: ArrayLike) -> bool:
        """Learn from the displacements (n,) or (n, axes) that the voltages of `next` led to; return whether it did.

        NaN is no reading; up to a twentieth of a cycle may lie between two of them, as of a slow sensor.
        Raise `ModelError` if the shape is not the path's, or no cycle was sent since the last call. Warn
        `SensorWarning` once, when the sensor is not believed any more.
        """
        read = self._samples(measured, "measured")
        if read.shape != self.path.shape:
            raise ModelError(argument="measured", got=f"the shape {read.shape}", need=f"{self.path.shape}")
        if self._cycle is None:
            raise ModelError("no cycle was sent since the last one that was learnt", hint="call next() first")
        cycle, self._cycle = self._cycle, None
        if not self.believed or cycle.clamped:
            return False
        pairs = zip(np.array(cycle.aim.T, order="C"), np.array(read.T, order="C"), strict=True)
        faults = [judge(aim, column, self.bound) for aim, column in pairs]
        if any(faults):
            self.fault, self._best = SensorFault(max(faults)), None
            self.correction = np.zeros(self.path.shape)
            warn_of_sensor(self.fault, self.bound / self._loops[0]._per_metre)
            return False
        read = np.where(np.abs(read - cycle.aim) <= self.bound, read, np.nan)
        gaps = [_longest_gap(np.isfinite(column)) for column in read.T]
        if max(gaps) > _GAP * len(read):
            return False
        error = np.column_stack([_filled(column) for column in (self.path - read).T])
        cycle = cycle._replace(measured=self.path - error, rms=float(np.sqrt(np.mean(error**2))))
        self.errors.append(cycle.rms)
        return self._improve(cycle, error, max(gaps))

    def table(self) -> WaveTable | tuple[WaveTable, ...]:
        """Return the best cycle as a wave table to play, one for each axis of a stage.

        It has no start-up: it follows cycles of this repetition. Raise `ModelError` if no cycle has been learnt from.
        """
        if self._best is None:
            raise ModelError("nothing was learnt: no cycle was complete", hint="call next() and learn() first")
        best, rate = self._best, 1 / (self.compensator.period or 1.0)
        tables = []
        for j, loop in enumerate(self._loops):
            wanted, measured = self.path[:, j] / loop._per_metre, best.measured[:, j] / loop._per_metre
            cycle, error = Cycle(best.voltage[:, j], wanted, measured, rate), float(np.abs(wanted - measured).max())
            tables.append(WaveTable(cycle, error=error, tolerance=error, state=best.states[j]))
        return tables[0] if isinstance(self.compensator, Compensator) else tuple(tables)

    def _samples(self, values: ArrayLike, what: str) -> Array:
        """Return samples (n, axes) that may be NaN."""
        found = np.asarray(plain(values, what))
        if found.dtype.kind not in "fiu":
            raise ModelError(argument=what, got=f"{found.dtype} values", need="real numbers")
        table = found.astype(np.float64).reshape(len(found), -1) if found.ndim == 1 else found.astype(np.float64)
        if table.ndim != 2 or table.shape[1] != len(self._loops):
            raise ModelError(argument=what, got=f"the shape {found.shape}", need=f"{len(self._loops)} columns")
        return table

    def _improve(self, cycle: _Cycle, error: Array, gap: int) -> bool:
        """Judge a cycle by its error, and correct the next one; return whether it does."""
        if looks := len(self._cycles) < _CYCLES:
            self._cycles.append(cycle)
        by = np.column_stack([self._learnable(cycle, error[:, j], gap, j, looks) for j in range(len(self._loops))])
        if self._sent < 2 and not any(self._found):
            return False
        if self._best is None or cycle.rms < self._best.rms:
            self._best = cycle
        if cycle.rms > min(_WORSE * max(self._best.rms, *self.errors[:2]), _FAR_WORSE * self._best.rms):
            self.correction, self._best, self._cycles = self._best.correction, None, []
            self._gain *= _SLOWER
            return False
        self._gain = min(_FASTER * self._gain, _GAIN)
        self.correction = np.clip(cycle.correction + by, -self.bound, self.bound)
        return bool(by.any())

    def _learnable(self, cycle: _Cycle, error: Array, gap: int, j: int, looks: bool) -> Array:
        """Return what the error (n,) of axis j adds to the correction: as far as it is no noise and no decay."""
        actuator, samples = self._loops[j].actuator, len(error)
        harmonic, seconds = np.arange(samples // 2 + 1), samples * (self.compensator.period or 1.0)
        moves = mechanical_response(actuator.dynamics, actuator.delay, harmonic / seconds)
        made = moves if self._loops[j]._previews else np.ones(harmonic.size)
        wanted, left = np.fft.rfft(self.path[:, j]), np.fft.rfft(error)
        pushed = np.fft.rfft([each.aim[:, j] for each in [*self._cycles, cycle]]) / made
        read = np.fft.rfft([each.measured[:, j] for each in [*self._cycles, cycle]])
        # The median of a Rayleigh distribution, of harmonics that hold noise alone.
        floor = (
            np.median(np.abs(left[samples // 4 :])) / np.sqrt(np.log(2)) + np.finfo(float).eps * samples * self.bound
        )
        rest = np.abs(wanted - read)[:, 1].max() / np.maximum(harmonic, 0.1) ** _FALLS
        if looks:
            self._found[j] = _resonance(pushed[:-1], read[:-1], rest, floor) or self._found[j]
        if known := self._found[j]:
            inverse, top = known
            begun = _begun(pushed[-1] - inverse * read[-1], 1 / np.hypot(rest, floor * np.abs(inverse)), harmonic)
            begun[0] = 0
        else:
            inverse, begun, ring = 1 / moves, 0 * left, actuator.dynamics
            top = np.inf if ring is None else ring.frequency * seconds
        more = inverse * left - begun + pushed[-1] - (wanted + np.fft.rfft(cycle.correction[:, j])) / made
        heard = np.clip(1 - (_ABOVE_NOISE * floor * np.abs(inverse) / np.maximum(np.abs(more), 1e-300)) ** 2, 0, 1)
        limit = max(min(_RESONANCE * top, samples / 2, samples / (4.0 * max(gap, 1))), 1.0)
        weight = np.where(harmonic < _SAFE, _GAIN, self._gain) * heard * np.clip(3 - 2 * harmonic / limit, 0, 1)
        return np.fft.irfft(more * made * weight, samples)


def _begun(spectra: Any, weight: Array, s: Any) -> Any:
    """Return the part c + i d s of spectra (..., n) that is what a cycle begins with, by weighted least squares."""
    w = weight**2
    c = (w * spectra.real).sum(axis=-1, keepdims=True) / w.sum(axis=-1, keepdims=True)
    d = (w * s * spectra.imag).sum(axis=-1, keepdims=True) / (w * s * s).sum(axis=-1, keepdims=True)
    return c + 1j * d * s


def _resonance(pushed: Any, read: Any, rest: Array, floor: float) -> tuple[Any, float] | None:
    """Return one over the response of a resonance between spectra (cycles, n), and its harmonic; None if none shows.

    pushed = (1 + i a s - b s^2) read + c + i d s + rest, of which c and d begin each cycle; by maximum likelihood.
    """
    count, size = read.shape
    used = np.flatnonzero(np.sqrt(np.mean(np.abs(read[:, 1:]) ** 2, axis=0)) > _ABOVE_NOISE * floor) + 1
    if used.size < _CYCLES:
        return None
    s, w = np.arange(size) / size, used / size
    # The mean of the cycles, and the differences between them, in which little is left of the hysteresis.
    y, u = (np.concatenate([x.mean(axis=0)[None], np.diff(x, axis=0)])[:, used] for x in (read, pushed))
    rests = np.outer([1.0, *[_VARIES] * (count - 1)], rest[used])
    noises = floor * np.array([count**-0.5, *[2**0.5] * (count - 1)])[:, None]
    columns = np.stack([1j * w * y, -(w**2) * y, u - y])

    def squares(a: float, b: float) -> tuple[Array, float, float]:
        """Return weighted products of the columns, what is left of their squares, and the negative log likelihood."""
        weight = 1 / np.hypot(rests, noises * np.abs(1 + 1j * a * w - b * w**2))
        x = (weight * (columns - _begun(columns, weight, w))).reshape(3, -1)
        table, of = (x.conj() @ x.T).real, np.array([-a, -b, 1.0])
        return table, of @ table @ of, of @ table @ of - 2 * np.log(weight).sum()

    tries = [(1 / (q * r), 1 / r**2) for r in np.geomspace(3, size / 2, _FREQUENCIES) / size for q in _QUALITIES]
    best = min(tries, key=lambda each: squares(*each)[2])
    table, left, cost = squares(*best)
    for _ in range(6):
        a, b = np.linalg.solve(table[:2, :2], table[:2, 2])
        new = max(a, np.sqrt(max(b, 0.0)) / _QUALITIES[-1]), b
        if b <= 0 or squares(*new)[2] >= cost:
            break
        best, (table, left, cost) = new, squares(*new)
    a, b = best
    variance = max(left / (2 * y.size), 1.0) * np.linalg.inv(table[:2, :2])[1, 1]
    if left > (1 - _EXPLAINED) * table[2, 2] or variance > (_KNOWN * b) ** 2:
        return None
    return 1 + 1j * a * s - b * s**2, float(size / np.sqrt(b))


def _longest_gap(there: Array) -> int:
    """Return the most samples without a reading in a row, around the end too; all of them if there is no reading."""
    at = np.flatnonzero(there)
    return len(there) if not at.size else int(np.diff(np.append(at, at[0] + len(there))).max()) - 1


def _filled(error: Array) -> Array:
    """Return a periodic error (n,) with its gaps filled along straight lines."""
    at = np.flatnonzero(np.isfinite(error))
    return np.asarray(np.interp(np.arange(error.size), at, error[at], period=error.size))
