"""Repetition: the error of each cycle of a repeated path corrects the next cycle, ahead of the compensator."""

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
from dehyst.model import Actuator, State, mechanical_response

# Part of the error that one cycle corrects.
_GAIN = 0.6
# The displacement follows a harmonic if its error in a band is less than this share of the wanted motion; the band
# extends down to this part of the harmonic. A band with less than this share of the energy shows nothing.
_FOLLOWS, _BAND, _KNOWN = 0.5, 0.7, 1e-7
# First step at other harmonics: this share of the whole error, over the gain of an unknown resonance in a cycle.
_STEP = 0.15
# A response is wrong if it misses the step and this share of the harmonic; factors of the gain if wrong, if right.
_WRONG, _SLOWER, _FASTER = 0.1, 0.25, 2.0
# Longest gap between readings, as a share of the cycle.
_GAP = 0.05
# The correction ends at this multiple of the resonance; harmonics of the error count above this multiple of
# the noise.
_RESONANCE, _ABOVE_NOISE = 1.2, 3.0
# A step is taken back if the RMS error exceeds this multiple of the least one and this share of the first one. The
# whole correction is taken back if the best cycle, played again, is no better than the first.
_WORSE_THAN_BEST, _NEAR_FIRST = 1.2, 0.3
# A change of the RMS error is significant above this part of it and this number of standard errors of the noise.
_CHANGE, _ERRORS = 0.02, 3.0
# Part of a cycle over which a new correction is blended in.
_BLEND = 0.125


class _Cycle(NamedTuple):
    """A cycle that was sent: states before it, arrays (n, axes), and RMS error."""

    states: tuple[State, ...]
    aim: Array
    correction: Array
    voltage: Array
    clamped: bool
    measured: Array = np.zeros((0, 0))
    rms: float = np.inf


class Repetition:
    """A path that is repeated: each cycle corrects the wanted displacement by the error of the cycle before.

    The compensator removes hysteresis and creep; the repetition learns the error that remains::

        repetition = dehyst.Repetition(compensator, path)
        for _ in range(10):
            repetition.learn(rig.play(repetition.next()))

    A harmonic of the error is learnt as far as it exceeds the noise. The path and records of several speeds show up to
    which harmonic the displacement follows. Above, the model may lack a resonance: the first step is so small that no
    resonance can grow much in a cycle. If the displacement changes as predicted, the next step is larger, else the step
    is taken back. An identified resonance is part of the prediction; the correction ends just above it.

    A cycle counts if its readings are complete, no voltage was clamped, and the sensor is believed. If a
    cycle has an RMS error of more than 1.2 times the least, the best cycle is played again.

    Parameters
    ----------
    compensator : Compensator
        A compensator with a period, which only this repetition steps. Without `preview`, identified delay and resonance
        are learnt too.
    path : (n,) or (n, axes) array_like
        Wanted displacement [`units` of the compensator] of one cycle, a sample a period; after its last sample comes
        its first.
    bound : float, optional
        Largest correction, and largest distance of a reading from the model [as `path`]: a reading farther away counts
        as missing. Default: a twentieth of the smallest reach of the axes.

    Attributes
    ----------
    compensator, bound
        As given.
    path : (n, axes) array
    correction : (n, axes) array
        What the next cycle adds to the path.
    errors : list of float
        RMS error of each complete cycle [as `path`].
    fault : SensorFault
        Why the sensor is not believed; `SensorFault.NONE` if it is.

    Raises
    ------
    ModelError
        If the compensator has no period, the path does not fit, or the bound is not within 0 and a quarter of the
        reach.
    """

    def __init__(self, compensator: Compensator, path: ArrayLike, *, bound: float | None = None) -> None:
        if not isinstance(compensator, Compensator):
            raise ModelError(argument="compensator", got=type(compensator).__name__, need="a Compensator")
        if compensator.period is None:
            raise ModelError("a repetition needs the time between steps", hint="give the period [s]")
        self.compensator, self._unit, self._single = compensator, compensator._per_metre, compensator._single
        self.path = self._samples(path, "path")
        if len(self.path) < 2 or not (np.abs(self.path) <= FARTHEST).all():
            raise ModelError(argument="path", got=f"{len(self.path)} samples", need="two or more finite numbers")
        self.bound = min(sensor_bound(self._unit * axis.width, bound) for axis in compensator._axes)
        self.reset()

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
        # The best cycle; after a step is taken back, it is played and measured again, then the path without correction.
        self._best: _Cycle | None = None
        self._returned = 0
        # Aim, displacement and step of the last cycle by harmonics, and the gain of each.
        self._last: tuple[Any, Any, Any] | None = None
        harmonic, axes = np.arange(len(self.path) // 2 + 1)[:, None], self.compensator.stage.actuators
        self._gains = np.full((len(harmonic), len(axes)), _GAIN)
        seconds = len(self.path) * (self.compensator.period or 1.0)
        self._known = np.array([actuator.dynamics is not None for actuator in axes])
        self._tested = seconds * np.array([_tested_to(actuator) for actuator in axes])
        # The harmonic at which the correction ends.
        rings = [_RESONANCE * seconds * part.dynamics.frequency for part in axes if part.dynamics is not None]
        self._highest = min([0.5 * len(self.path), *rings])
        # The response of the axes to the wanted displacement, and the gain of an unknown resonance within a cycle.
        moves = [mechanical_response(part.dynamics, part.delay, harmonic[:, 0] / seconds) for part in axes]
        previews = [axis.previews for axis in self.compensator._axes]
        self._moves = np.where(previews, 1.0, np.column_stack(moves))
        self._swing = 1 + 0.5 * np.pi * harmonic * ~self._known

    def next(self) -> Array:
        """Return the voltages (n,) or (n, axes) [V] of the next cycle; they count as sent.

        Warn `ClampWarning` as `Compensator.run`.
        """
        states, clamps = tuple(axis.state for axis in self.compensator._axes), self.compensator.clamps
        # The change of the correction is spread over a part of the cycle, so that nothing jumps.
        new = 0.5 - 0.5 * np.cos(np.pi * np.clip(np.arange(len(self.path)) / (_BLEND * len(self.path)), 0, 1))[:, None]
        aim = self.path + self._before + new * (self.correction - self._before)
        # The samples ahead belong to the next cycle, which has this correction.
        ahead, following = self.compensator.samples_ahead, self.path + self.correction
        wanted = np.concatenate([aim, np.resize(following, (ahead, aim.shape[1]))])[ahead:]
        voltage = self.compensator.run(wanted[:, 0] if self._single else wanted)
        self._before = self.correction
        self._cycle = _Cycle(
            states, aim, self.correction, voltage.reshape(aim.shape), clamps != self.compensator.clamps
        )
        return voltage

    def learn(self, measured: ArrayLike) -> bool:
        """Learn from the displacements (n,) or (n, axes) that the voltages of `next` caused; return whether it learnt.

        NaN: no reading. A slow sensor may leave up to a twentieth of a cycle between two readings.

        Raises
        ------
        ModelError
            If the shape is not the path's, or no cycle was sent since the last call.

        Warns
        -----
        SensorWarning
            Once, when the sensor is not believed any more.
        """
        read = self._samples(measured, "measured")
        if read.shape != self.path.shape:
            raise ModelError(argument="measured", got=f"the shape {read.shape}", need=f"{self.path.shape}")
        if self._cycle is None:
            raise ModelError("no cycle was sent since the last one that was learnt", hint="call next() first")
        cycle, self._cycle = self._cycle, None
        if not self.believed or cycle.clamped:
            return False
        columns = [np.ascontiguousarray(values) for values in (*cycle.aim.T, *read.T)]
        axes = read.shape[1]
        faults = [judge(columns[j], columns[axes + j], self.bound) for j in range(axes)]
        if any(faults):
            self.fault, self._best = SensorFault(max(faults)), None
            self.correction = np.zeros(self.path.shape)
            warn_of_sensor(self.fault, self.bound / self._unit)
            return False
        read = np.where(np.abs(read - cycle.aim) <= self.bound, read, np.nan)
        there, at = np.isfinite(read), np.arange(len(read))
        gaps = [_longest_gap(column) for column in there.T]
        if max(gaps) > _GAP * len(read):
            return False
        # Gaps are filled along straight lines.
        left = [(column[known], at[known]) for column, known in zip((self.path - read).T, there.T, strict=True)]
        error = np.column_stack([np.interp(at, when, values, period=len(at)) for values, when in left])
        cycle = cycle._replace(measured=self.path - error, rms=float(np.sqrt(np.mean(error**2))))
        self.errors.append(cycle.rms)
        return self._improve(cycle, error, max(gaps))

    def table(self) -> WaveTable | tuple[WaveTable, ...]:
        """Return the best cycle as a wave table to play, one for each axis of a stage.

        Its start-up is empty: it follows cycles of this repetition, or a wave table of the same path. Raise
        `ModelError` if no cycle has been complete.
        """
        if self._best is None:
            raise ModelError("nothing was learnt: no cycle was complete", hint="call next() and learn() first")
        best, rate = self._best, 1 / (self.compensator.period or 1.0)
        tables = []
        for j in range(self.path.shape[1]):
            wanted, measured = self.path[:, j] / self._unit, best.measured[:, j] / self._unit
            cycle, error = Cycle(best.voltage[:, j], wanted, measured, rate), float(np.abs(wanted - measured).max())
            tables.append(WaveTable(cycle, error=error, tolerance=error, state=best.states[j]))
        return tables[0] if self._single else tuple(tables)

    def _samples(self, values: ArrayLike, what: str) -> Array:
        """Return samples (n, axes) that may be NaN."""
        found, count = np.asarray(plain(values, what)), len(self.compensator.stage.axes)
        table = found[:, np.newaxis] if found.ndim == 1 else found
        if found.dtype.kind not in "fiu" or table.ndim != 2 or table.shape[1] != count:
            got = f"{found.dtype} values of the shape {found.shape}"
            raise ModelError(argument=what, got=got, need=f"real numbers, {count} columns")
        return table.astype(np.float64)

    def _improve(self, cycle: _Cycle, error: Array, gap: int) -> bool:
        """Judge a cycle by its error, and correct the next one; return whether a step was learnt."""
        spectrum = np.fft.rfft(error, axis=0)
        size = np.abs(spectrum)
        # The upper harmonics are noise alone; their amplitudes have a Rayleigh distribution with this median.
        floor = np.median(size[len(size) // 2 :], axis=0) / np.sqrt(np.log(2))
        noise = _ERRORS * float(floor.max()) / len(error) / np.sqrt(2)
        best = self._best
        near = (_NEAR_FIRST, 1.0, 1.0)[self._returned] * self.errors[0]
        if best is not None and self._returned < 2 and cycle.rms > max(_WORSE_THAN_BEST * best.rms + noise, near):
            # A resonance may have been excited after the best cycle; a cycle without a correction excites none.
            self._returned += 1
            self.correction = best.correction if self._returned == 1 else np.zeros(self.path.shape)
            self._last = None
            self._gains *= _SLOWER
            return False
        if best is None or self._returned or cycle.rms < best.rms - max(_CHANGE * cycle.rms, noise):
            self._best, self._returned = cycle, 0
        step = self._step(cycle, spectrum, floor, gap)
        by = np.fft.irfft(step, len(error), axis=0)
        self.correction = np.clip(cycle.correction + by, -self.bound, self.bound)
        return bool(by.any())

    def _step(self, cycle: _Cycle, spectrum: Any, floor: Array, gap: int) -> Any:
        """Return the change of the correction by harmonics (k, axes), from the error's `spectrum` and noise `floor`."""
        aim, moved = np.fft.rfft(cycle.aim, axis=0), np.fft.rfft(cycle.measured, axis=0)
        size, harmonic = np.abs(spectrum), np.arange(len(spectrum))[:, None]
        follows = harmonic <= self._follows_to(aim, moved)
        wrong = np.zeros(size.shape, dtype=bool)
        if self._last is None:
            most = _STEP * np.linalg.norm(size, axis=0) / self._swing
            self._gains = np.minimum(self._gains, most / np.maximum(size, np.finfo(float).tiny))
        else:
            before, was, last = self._last
            push, tried = self._moves * (aim - before), np.abs(last) > 0
            off = np.abs(moved - was - push) - _ABOVE_NOISE * floor
            wrong = tried & ~follows & (off > np.maximum(np.abs(push), _WRONG * size))
            right = tried & (off < np.abs(push)) & (self._known | (size <= np.abs(spectrum + moved - was)))
            self._gains = np.where(wrong, _SLOWER, np.where(right, _FASTER, 1.0)) * self._gains
        self._gains = np.where(follows, _GAIN, np.minimum(self._gains, _GAIN))
        weight = np.clip(1 - (_ABOVE_NOISE * floor / np.maximum(size, np.finfo(float).tiny)) ** 2, 0, 1)
        limit = max(min(self._highest, len(self.path) / (4.0 * max(gap, 1))), 1.0)
        step = spectrum * weight * self._gains * np.clip(3 - 2 * harmonic / limit, 0, 1)
        step = np.where(step != 0, step / self._moves, 0)
        if self._last is not None:
            step = np.where(wrong, -self._last[2], step)
        self._last = aim, moved, np.where(wrong, 0, step)
        return step

    def _follows_to(self, aim: Any, moved: Any) -> Array:
        """Return the highest harmonic (axes,) up to which the displacement follows the aim."""
        harmonic = np.arange(len(aim))
        wanted, below = self._moves * np.fft.rfft(self.path, axis=0), np.floor(_BAND * harmonic).astype(np.intp)
        sums = [np.cumsum(np.abs(part) ** 2, axis=0) for part in (moved - self._moves * aim, wanted)]
        missed, there = (total - total[below] for total in sums)
        known = there > _KNOWN * sums[1][-1]
        failed = np.cumsum(known & (missed > _FOLLOWS**2 * there), axis=0) > 0
        follows = (known | (harmonic[:, None] <= self._tested)) & ~failed
        return np.asarray(np.where(follows, harmonic[:, None], 0).max(axis=0))


def _tested_to(actuator: Actuator) -> float:
    """Return half of the lowest frequency [Hz] of a resonance that the records of an `actuator` do not exclude.

    A resonance at f0 enlarges a motion at f by a share of (f / f0)^2. The model has the same gain for slow and fast
    branches, so the largest error of the records contains this difference.
    """
    tested = actuator.identification.validity
    if tested is None or actuator.dynamics is not None:
        return 0.0
    paces = tested.rates, np.divide(tested.speeds, tested.span)
    faster = 0.5 * np.sqrt(min(fast**2 - slow**2 for slow, fast in paces))
    # An error below 1e-4 of the stroke is not visible in records.
    share = max(tested.largest / tested.stroke, 1e-4)
    return float(0.5 * min(faster / np.sqrt(2 * share), 1 / (np.pi * max(tested.lag_error, 1e-9))))


def _longest_gap(there: Array) -> int:
    """Return the length of the longest gap between readings, also across the end; without a reading, all samples."""
    at = np.flatnonzero(there)
    return len(there) if not at.size else int(np.diff(np.append(at, at[0] + len(there))).max()) - 1
