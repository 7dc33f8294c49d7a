"""A path that is followed on a rig, again and again, with a model that may adapt to what the sensor measures."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError, RecordError
from dehyst._io import PathLike
from dehyst._native import EMPTY
from dehyst._types import Array
from dehyst._validation import number, vector
from dehyst._version import __version__
from dehyst.adaptation import FEWEST, AdaptiveCompensator, Drift
from dehyst.calibration.session import NullProgress, ProgressListener
from dehyst.calibration.tracking import SeenTemperature, TrackedPath
from dehyst.control import ClampWarning, Compensator, HomedPath, plan_path
from dehyst.instruments import AbstractRig, Samples, played_rate
from dehyst.model import Actuator, State, promised
from dehyst.records import Column, Record, Recording, demand_disk_space, largest, rms
from dehyst.trust import Judgement, judge_planned
from dehyst.waveforms import Excitation, wanted_path

# A step from the end of a path to its beginning that is larger than this many steps of the path needs a way back.
_CLOSED = 2.0
# Repetitions from which a growth of the error is known, and how much of the fastest is promised: it is not steady.
_REMEMBERED, _GROWTH = 3, 2.0
# Further columns of a recording: the wanted displacement, in the homing the model's; the repetition, in the homing 0.
WANTED, REPETITION = "wanted_m", "repetition_1"


@dataclass(frozen=True, eq=False)
class Repetition:
    """One repetition of a path.

    `record`: as recorded, with the way back to the beginning, if there is one. `wanted` (n,): displacement [m] of each
    of its samples. `path`: the path and its errors. `clamped`: number of samples whose voltage was changed to keep
    limits and slew rate. `drift`: changes of the model so far; None without adaptation. `used`: whether new weights are
    used after this repetition. `reason`: why not. `promised`: the error to expect, as judged before it was played.
    """

    record: Record
    wanted: Array
    path: TrackedPath
    clamped: int
    promised: Judgement
    drift: Drift | None = None
    used: bool = False
    reason: str = ""


class PathRun:
    """A path on a rig of one axis: a homing, then repetitions, each played as a whole by `AbstractRig.play`.

    The weights of the model adapt between two repetitions, see `AdaptiveCompensator`. Voltages stay within the limits
    of the rig and of the model, and within the slew rate of the rig. A path that does not end where it begins gets a
    way back. Nothing is sent before `play`.

    Parameters
    ----------
    rig : AbstractRig
    actuator : Actuator
        The model; the resonance of a mass is not compensated. If it depends on temperature, a repetition is planned at
        the one that the rig recorded last, with its drift; the weights adapt at the reference.
    displacement : (n,) array_like
        The path [m].
    sample_rate : float
        Of the path [Hz]; the rig plays at the nearest rate that it has.
    temperature : (n,) array_like, optional
        Temperature of the path [degC], where the rig measures none; default: not known, the reference of the
        model is taken.
    adapt : bool, optional
        Whether to adapt the model.
    memory, zero_drifts
        As in `AdaptiveCompensator`.

    Attributes
    ----------
    rate : float
        Rate [Hz] at which the rig plays.
    stroke : float
        `Actuator.stroke` [m], the reference of percentages.

    Raises
    ------
    RigError, RecordError, ModelError
        If the rig has several axes, its limits exclude those of the model, the path has fewer than 24 samples, does not
        move or lies far outside of the model's reach, or adaptation does not support the model.
    """

    def __init__(
        self,
        rig: AbstractRig,
        actuator: Actuator,
        displacement: ArrayLike,
        sample_rate: float,
        *,
        temperature: ArrayLike | None = None,
        adapt: bool = False,
        memory: float = 10.0,
        zero_drifts: bool = True,
    ) -> None:
        self._rig, self._path, self._adapt = rig, vector(displacement, "displacement"), bool(adapt)
        self._wanted = _closed(self._path)
        if not 0 < number(sample_rate, "sample_rate") < np.inf:
            raise ModelError(argument="sample_rate", got=sample_rate, need="a positive number of hertz")
        self.rate = played_rate(rig, sample_rate)
        (low, high), period = actuator.voltage_range, 1 / self.rate
        limits = max(low, rig.limits.low), min(high, rig.limits.high)
        self.stroke = actuator.stroke
        self._thermal = actuator.thermal
        at_reference = actuator if self._thermal is None else replace(actuator, thermal=None)
        self._planner = Compensator(at_reference, limits, rig.slew_rate, period=period, warns=False)
        if sentence := self._planner.strays(self._path):
            raise ModelError(sentence)
        if self._wanted.size < FEWEST:
            raise RecordError(argument="path", got=f"{self._wanted.size} samples", need=f"{FEWEST} at least")
        # Of the path, and as the rig measured it last; the kelvins by which this may be wrong; and the displacement [m]
        # that the sensor showed last, relative to the model's.
        self._given = None if temperature is None else vector(temperature, "temperature")
        self._seen: SeenTemperature | None = None
        self._unsure = 0.0
        self._off: float | None = None
        # RMS and largest error [m] of the last repetitions.
        self._errors: list[tuple[float, float]] = []
        self._recording: Recording | None = None
        self._options: dict[str, Any] = {"period": period, "warns": False, "memory": memory, "zero_drifts": zero_drifts}
        self._loop = self._begun(actuator.state)

    @property
    def actuator(self) -> Actuator:
        """The model in use."""
        found = self._loop.actuator
        return found if self._thermal is None else replace(found, thermal=self._thermal)

    @property
    def limits(self) -> tuple[float, float]:
        """Lowest and highest voltage [V] that is sent."""
        return self._planner.limits

    @property
    def measures_temperature(self) -> bool:
        """Whether one further channel of the rig is a temperature, as in `Record.temperature`."""
        return [Column(name, EMPTY).role for name in self._rig.others].count("temperature") == 1

    def judged(self) -> Judgement:
        """Judge the error of the next repetition: before the homing by the model, then by what the rig measured too."""
        path = self._planned
        known = self._given is not None if not self.measures_temperature else self._thermal is not None
        warmth = self._temperature(0.0) if known else None
        times = None if path.time is None else path.time[path.first :]
        found, untested = promised(self.actuator, path.voltage[path.first :], times, warmth)
        path = replace(path, promise=found)
        if self._off is not None:
            path = replace(path, expected=np.append(path.expected[: path.first], self._reachable()))
        judged = judge_planned(self.actuator, path, drift=self._unsure, seen=self._off, measured=self._next_errors())
        return judged if found else replace(judged, untested=untested)

    def _next_errors(self) -> tuple[float, float]:
        """Return RMS and largest error [m] of the next repetition if they go on to grow as they did lately."""
        if not self._errors:
            return 0.0, 0.0
        errors = np.array(self._errors)
        grown = errors[-1] + _GROWTH * np.diff(errors, axis=0).max(axis=0, initial=0.0)
        return float(grown[0]), float(grown[1])

    def _reachable(self) -> Array:
        """Return the path (n,) [m] as far as the present model reaches it at the temperature to expect."""
        warmth, targets = self._temperature(0.0), self._wanted
        if self._thermal is not None:
            targets = self._thermal.at_reference(targets, warmth)
        reached = np.clip(targets, *self._loop.reach)
        return reached if self._thermal is None else self._thermal.warmed(reached, warmth)

    @cached_property
    def _planned(self) -> HomedPath:
        """The homing, from 0 V or the nearest limit, and the first repetition as the model expects them."""
        return plan_path(self._planner, self._wanted, home=True)

    def recording(self, path: PathLike, repetitions: int) -> Recording:
        """Begin the recording of a homing and `repetitions` at `path` (.h5), for `play`.

        Its columns "wanted_m" and "repetition_1" hold the wanted displacement and the number of the repetition; in the
        homing, what the model expects and 0. Raise `FileFormatError` as `Recording`, or if the disk has no room for it.
        """
        one = self._rig
        meta = {"identity": one.identity, "axis": one.axis, "program": __version__}
        recording = Recording(path, meta=meta, others=(*one.others, WANTED, REPETITION))
        try:
            demand_disk_space(recording.path.parent, repetitions * self._wanted.size, len(recording.columns))
        except BaseException:
            recording.discard()
            raise
        return recording

    def play(
        self,
        repetitions: int,
        watcher: ProgressListener | None = None,
        judged: Callable[[Judgement], object] | None = None,
        recording: Recording | None = None,
    ) -> Iterator[Repetition]:
        """Home, and yield each of the `repetitions` as it ends; the voltage ends at the safe one, after any error too.

        `watcher` receives the progress, `judged` the errors to expect on a repetition before it is played. With a
        `recording` of this run, each sample is on the disk before the next ones are requested; the caller ends it.
        Raise `RigError` if the instrument or its sensor fails, `FileFormatError` if a sample cannot be written.
        """
        listener, self._recording = watcher or NullProgress(), recording
        with self._rig.safely():
            end, pause = self._home(listener), 0.0
            for number in range(1, repetitions + 1):
                judgement = self.judged()
                if judged is not None:
                    judged(judgement)
                repetition, pause = self._repeat(number, end, pause, judgement, listener)
                end = float(repetition.record.time[-1])
                yield repetition
            self._rig.retreat()

    def _home(self, listener: ProgressListener) -> float:
        """Play the shortest homing and the way to the path, and begin the loop there; return the device's time [s]."""
        bounds = self._planner.bounds
        present = bounds.nearest(self._rig.read().voltage)
        way = plan_path(self._planner, self._path[:1], home=True, present=present)
        times = way.time if way.time is not None else np.zeros(1)
        count = round((times[-1] - times[0]) * self.rate)
        at = times[-1] - np.arange(max(count, 1), -1, -1) / self.rate
        expected = np.interp(at - self.actuator.delay, times, way.expected)
        record = self._play(0, np.interp(at, times, way.voltage), expected, listener)
        moved = self._observed(record, self._temperature(0.0)[:1])
        if self._seen:
            self._unsure = abs(self._seen.drift) * self._wanted.size / self.rate
        # Before the way to the path the state of the actuator is not known.
        rows = self._rig.rows(at.size)
        late = at[rows] >= times[np.flatnonzero(way.phase)[0]] if len(times) > 1 else np.ones(1, dtype=bool)
        self._off = float((moved - expected[rows])[late].mean()) if late.any() else None
        self._loop = self._begun(way.state)
        return float(record.time[-1])

    def _begun(self, state: State) -> AdaptiveCompensator:
        one = self._planner
        loop = AdaptiveCompensator(one.actuator, one.limits, one.slew_rate, state=state, **self._options)
        loop.learning = self._adapt
        return loop

    def _repeat(
        self, number: int, end: float, expected: float, judgement: Judgement, listener: ProgressListener
    ) -> tuple[Repetition, float]:
        """Play a repetition; return it, and the pause [s] since the `end` of the wave before, by the device's time.

        `expected`: this pause as a guess, the one before: what a device needs between two waves, it needs again.
        """
        loop, wanted, size = self._loop, self._wanted, self._wanted.size
        at = np.arange(size) / self.rate
        ahead = np.interp(at + loop.actuator.delay, at, wanted, period=size / self.rate)
        warmth = self._temperature(expected)
        if self._thermal is not None:
            ahead = self._thermal.at_reference(ahead, warmth)
        with warnings.catch_warnings():
            # They are counted.
            warnings.simplefilter("ignore", ClampWarning)
            voltage = loop.plan(ahead, expected)
        record = self._play(number, voltage, wanted, listener)
        rows = self._rig.rows(size)
        measured = np.full(size, np.nan)
        measured[rows] = self._observed(record, warmth[rows])
        pause = max(0.0, float(record.time[0]) - end - 1 / self.rate)
        loop.learn(ahead, voltage, measured, pause)
        along = rows < self._path.size
        path = TrackedPath(record.time[along], wanted[rows[along]], record.displacement[along], self.stroke)
        if not self._errors and judgement.bounds is not None:
            # A first error that is more than was promised has grown too.
            self._errors = [judgement.bounds]
        self._errors = [*self._errors[-_REMEMBERED:], (rms(path.error), largest(path.error))]
        clamped = loop.clamped(voltage)
        followed = ~clamped[rows[along]]
        self._off = float(path.error[followed].mean()) if followed.any() else self._off
        repetition = Repetition(record, wanted[rows], path, int(clamped.sum()), judgement)
        if self._loop.learning:
            last = loop.log[-1]
            repetition = replace(repetition, drift=loop.drift, used=last.used, reason=last.reason)
        return repetition, pause

    def _temperature(self, pause: float) -> Array:
        """Return the temperature (n,) [degC] to expect in a repetition that begins after a `pause` [s]."""
        size = self._wanted.size
        if self._seen is not None:
            return self._seen.after(pause + np.arange(1, size + 1) / self.rate)
        if self._given is not None and not self.measures_temperature:
            return np.pad(self._given, (0, size - self._given.size), "edge")
        return np.full(size, 0.0 if self._thermal is None else self._thermal.reference)

    def _observed(self, record: Record, expected: Array) -> Array:
        """Take over the temperature of a record, if it has one; return its displacement (n,) [m] at the reference.

        `expected`: the temperatures (n,), or one, for which the record was planned [degC].
        """
        if self._thermal is None:
            return record.displacement
        if record.temperature is not None:
            self._unsure = float(np.abs(record.temperature - expected).max())
            self._seen, expected = SeenTemperature.of(record), record.temperature
        return self._thermal.at_reference(record.displacement, np.broadcast_to(expected, len(record)))

    def _play(self, number: int, voltage: Array, wanted: Array, listener: ProgressListener) -> Record:
        """Play repetition `number` and return its record; 0 is the homing, of which the listener gets no `wanted`."""
        name, count = f"repetition {number}" if number else "homing", 0
        excitation = Excitation(name, voltage, self.rate)
        rows = self._rig.rows(len(excitation))
        listener.step(name, excitation.duration)

        def listen(samples: Samples) -> None:
            nonlocal count
            part = wanted[rows[count : count + samples.time.size]]
            count += samples.time.size
            if self._recording is not None:
                added = {WANTED: part, REPETITION: np.full(part.size, float(number))}
                self._recording.add(samples._replace(others={**samples.others, **added}))
            listener.samples(samples, part if number else None, self.stroke)

        return self._rig.play(excitation, listen)


def _closed(path: Array) -> Array:
    """Return a path (n,) [m] with a way back to its beginning, no faster than the path, if it does not end there."""
    steps = np.abs(np.diff(path))
    fastest, back = float(steps.max(initial=0.0)), float(path[0] - path[-1]) if path.size else 0.0
    if not fastest:
        raise RecordError(argument="path", got="no motion", need="a displacement that changes")
    if abs(back) <= _CLOSED * fastest:
        return path
    leg = int(np.ceil(0.5 * np.pi * abs(back) / fastest)) + 1
    return np.concatenate([path, wanted_path(1.0, (float(path[-1]), float(path[0])), leg=leg)[1:-1]])
