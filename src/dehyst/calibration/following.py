"""Following a path on a rig: once, repeated, learnt, or with a sensor in the loop."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from dehyst._types import Array
from dehyst.calibration.session import Player, ProgressListener, slower
from dehyst.calibration.tracking import TrackedPath
from dehyst.control import Clamps, Compensator, Feedback, PathPlan, Repetition, VoltageLimits, plan_path
from dehyst.instruments import AbstractRig, StepFunction
from dehyst.model import Actuator, Stage, stroke_of
from dehyst.records import beyond_noise
from dehyst.waveforms import Excitation

# Learning ends when this number of repetitions did not lower the RMS error by this part.
_LAST, _LEAST_DECREASE = 3, 0.03


def _clamps_of(plan: PathPlan, bounds: Sequence[VoltageLimits]) -> Clamps:
    """Return the clamped samples of a path by kind."""
    clamped, volts = plan.clamped[plan.first :], plan.voltage[plan.first :]
    low, high = np.transpose([(bound.low, bound.high) for bound in bounds])
    limited = int(np.sum(clamped & ((volts <= low) | (volts >= high))))
    return Clamps(limited, int(clamped.sum()) - limited)


def _apart(path: TrackedPath, most: float) -> Array:
    """Return the error (n,) [m] without its mean and a constant delay of up to `most` seconds, early or late."""
    error = path.error - path.error.mean()
    speed = np.gradient(path.wanted, path.time) if most and path.time.size > 1 else np.zeros(error.size)
    speed -= speed.mean()
    delay = -float(speed @ error) / max(float(speed @ speed), 1e-300)
    return np.asarray(error + float(np.clip(delay, -most, most)) * speed)


@dataclass(eq=False)
class FollowedPath:
    """A path `wanted` (n, axes) [m] at a `rate` [Hz] on a `rig` by a `model`, within `bounds` of each axis.

    Its first `size` samples are compared; the other samples lead back. `temperature` [degC] of the path, (n,) or a
    number. `listener` receives the progress, `say` a line on each repetition; `judge` may refuse the plan before
    anything moves. `follow` sets: `tracked`, the measured path of each repetition, and `best`, the best learnt path, or
    else the last path; `promises` of each axis or None; `noise` [m] of each sensor; `clamps`, the number of samples of
    the path by kind; `late` [s], the longest delay of a sample; `learnt`, the voltages (n, axes) [V] of the best cycle,
    or None; `believed`, whether the sensor is believed; `remarks`, sentences.
    """

    rig: AbstractRig
    model: Actuator | Stage
    bounds: Sequence[VoltageLimits]
    rate: float
    wanted: Array
    size: int
    temperature: Any = None
    listener: ProgressListener = field(default_factory=ProgressListener)
    say: Callable[[str], object] = lambda _: None
    judge: Callable[[PathPlan], object] = lambda _: None

    def __post_init__(self) -> None:
        self._several = isinstance(self.model, Stage)
        self._actuators = self.model.actuators if isinstance(self.model, Stage) else (self.model,)
        self._axes = self.model.axes if isinstance(self.model, Stage) else ()
        self._strokes = np.array([*map(stroke_of, self._actuators)])
        self.promises: list[Any] = []
        self.tracked: list[TrackedPath] = []
        self.noise: list[float] = []
        self.remarks: list[str] = []
        self.clamps, self.late, self.believed = Clamps(0, 0), 0.0, True
        self.learnt: Array | None = None

    @property
    def promised(self) -> list[Array | None]:
        """Error (n,) [m] of each axis without the mean and delay that its promise excludes; None without a promise."""
        pairs = zip(self.promises, self.best.each, strict=True)
        return [None if promise is None else _apart(path, promise.delay) for promise, path in pairs]

    @property
    def kept(self) -> list[bool | None]:
        """Whether the promise of each axis is kept, without the mean and delay that it excludes, and the noise."""
        return [
            None if error is None else promise.missed_by(*beyond_noise(error, noise)) <= 1
            for promise, error, noise in zip(self.promises, self.promised, self.noise, strict=True)
        ]

    @property
    def cause(self) -> str:
        """The likely cause of an error above the promise, and what to try, in words."""
        if self.clamps.slewed:
            return "the slew rate kept the voltage from the path: give a slower path"
        if self.clamps.limited:
            return "the limits kept the voltage from the path: give a path within their reach"
        late = f"this computer was late by up to {1e3 * self.late:.3g} ms: give fewer samples a second"
        return late if self.late > 1 / self.rate else "the stage may have changed: dehyst check shows how"

    def follow(self, path: Path, *, repeat: int = 1, lessons: int = 0, feedback: bool = False) -> None:
        """Home, follow the path `repeat` times, then learn it `lessons` times; the file `path` has all samples.

        `feedback`: correct each sample of a single axis by the reading before. Raise `RigError` if the rig fails. Then,
        and at the end, the voltage is brought to the safe value.
        """
        # Read before anything moves: a rig without a sensor is refused here.
        present = [axis.limits.nearest(axis.read().voltage) for axis in self.rig.rigs]
        wanted = np.tile(self.wanted, (repeat, 1))
        plan = self._plan(wanted, present)
        self.clamps = _clamps_of(plan, self.bounds)
        self.promises = list(plan.promise) if self._several else [plan.promise]
        self.judge(plan)
        about = {"rig": self.rig.identity, "excitation": "path"}
        with ExitStack() as stack:
            player = stack.enter_context(Player(self.rig, path, about, self.listener, states_wanted=True))
            stack.enter_context(self.rig.safely())
            if feedback:
                reached = self._feed_back(player, plan, wanted, present)
            else:
                reached = self._play(player, *self._even(plan), len(wanted))
            self.tracked = [self._tracked(cycle) for cycle in np.split(reached, repeat)]
            self.best = self.tracked[-1]
            if lessons:
                self._learn(player, plan.state, lessons)
            self.rig.retreat()

    def _plan(self, wanted: Array, present: list[float]) -> PathPlan:
        """Return the plan of a path (n, axes) [m] with a homing."""
        time, warmth = np.arange(len(wanted)) / self.rate, self.temperature
        given: dict[str, Any] = {
            "time": time,
            "temperature": np.resize(warmth, len(wanted)) if isinstance(warmth, np.ndarray) else warmth,
            "present": present if self._several else present[0],
        }
        rows = wanted if self._several else wanted[:, 0]
        return plan_path(self._compensator(None), rows, home=True, on_time=True, **given)

    def _compensator(self, states: Any) -> Compensator:
        """Return a compensator within the bounds at the temperature of the path; from given `states` it looks ahead."""
        limits, slews = [(bound.low, bound.high) for bound in self.bounds], [bound.slew_rate for bound in self.bounds]
        single = None if isinstance(self.model, Stage) else self.model
        ahead = states is not None and single is not None and (single.delay > 0 or single.dynamics is not None)
        given: dict[str, Any] = {"period": 1 / self.rate, "state": states, "preview": ahead, "warns": single is None}
        loop = Compensator(self.model, limits, slews, **given)
        if self.temperature is not None and any(actuator.thermal for actuator in loop.stage.actuators):
            loop.scale(temperature=float(np.mean(self.temperature)))
        return loop

    def _even(self, plan: PathPlan) -> tuple[Array, Array]:
        """Return the voltages [V] and wanted displacements [m] (n, axes) of a plan, a sample a period."""
        times = plan.time if plan.time is not None else np.zeros(1)
        # Rows of the homing are farther apart, and the last row is a sample.
        at = times[-1] - np.arange(round((times[-1] - times[0]) * self.rate), -1, -1) / self.rate
        columns = (np.reshape(values, (times.size, -1)).T for values in (plan.voltage, plan.displacement))
        volts, wanted = (np.column_stack([np.interp(at, times, column) for column in every]) for every in columns)
        return volts, wanted

    def _play(
        self, player: Player, voltage: Array, wanted: Array, size: int, step: StepFunction | None = None
    ) -> Array:
        """Play voltages (n, axes) [V], record them with the wanted path [m]; return the last `size` displacements."""
        excitation = Excitation("path", voltage if self._several else voltage[:, 0], self.rate)
        self.listener.step("path", excitation.duration)
        record = player.play(excitation, wanted, step=step)
        # In a short or coarse record the estimate contains more than the noise.
        noise = [record.axis(j).noise for j in range(len(self.rig.axes))]
        self.noise = [*map(min, self.noise or noise, noise)]
        self.remarks += () if self.remarks else slower(record, excitation)
        rows, reached = self.rig.rows(len(voltage)), np.empty(voltage.shape)
        late = np.diff(record.time - rows / self.rate)[-size - 1 :] if size else np.zeros(1)
        self.late = max(self.late, float(late.max(initial=0.0)))
        reached[rows] = record.displacement.reshape(rows.size, -1)
        return reached[len(voltage) - size :]

    def _feed_back(self, player: Player, plan: PathPlan, wanted: Array, present: list[float]) -> Array:
        """Home, and follow the path with feedback; return what was reached."""
        homed = self._plan(np.repeat(wanted[:1], 2, axis=0), present)
        rest, where = self._even(homed)
        self._play(player, rest, where, 0)
        loop = self._compensator(homed.state)
        # The loop looks ahead: the stage rests at the first sample meanwhile, and a sample longer.
        ahead = loop.samples_ahead
        volts = np.vstack([np.repeat(rest[-1:], ahead + 1, axis=0), plan.voltage[-len(wanted) :].reshape(wanted.shape)])
        due = np.vstack([np.repeat(wanted[:1], ahead + 1, axis=0), wanted])
        corrected, inputs = Feedback(loop), iter([*due[ahead:, 0], *np.repeat(wanted[-1, 0], ahead)])

        slewed = 0

        def step(measured: float | None) -> float:
            # The lag behind a slewed voltage is no error of the model; corrected, it would wind the integral up.
            nonlocal slewed
            before, slewed = slewed, loop.clamps.slewed
            return corrected.step(next(inputs), measured if slewed == before else None)

        reached = self._play(player, volts, due, len(wanted), step)
        self.clamps = loop.clamps
        return reached

    def _learn(self, player: Player, states: Any, most: int) -> None:
        """Repeat the path from these states until the error no longer falls; keep the voltages of the best cycle."""
        loop, size = self._compensator(states), len(self.wanted)
        repetition = Repetition(loop, self.wanted if self._several else self.wanted[:, 0])
        errors: list[float] = []
        for number in range(1, most + 1):
            # The second cycle follows an equal cycle, as all later cycles do.
            pair = [np.reshape(repetition.next(), self.wanted.shape) for _ in range(2)]
            reached = self._play(player, np.concatenate(pair), np.tile(self.wanted, (2, 1)), size)
            tracked = self._tracked(reached)
            self.tracked.append(tracked)
            self.say(f"Repetition {number}: {tracked.words}")
            errors.append(max(path.rms_percent for path in tracked.each))
            if errors[-1] == min(errors):
                self.learnt, self.best = pair[1], tracked
            repetition.learn(reached if self._several else reached[:, 0])
            falls = len(errors) <= _LAST or min(errors[-_LAST:]) < (1 - _LEAST_DECREASE) * min(errors[:-_LAST])
            if not (repetition.believed and falls):
                break
        self.clamps = Clamps(*np.sum([self.clamps, *np.reshape(loop.clamps, (-1, 2))], axis=0).tolist())
        self.believed = repetition.believed
        stray = f"the sensor read more than {1e6 * repetition.bound:.3g} um from the model"
        if not repetition.errors:
            self.learnt = None
            self.remarks.append(f"nothing was learnt: voltages were clamped, or {stray}; try dehyst update")
        elif not self.believed:
            self.remarks.append(f"{stray} in repetition {number}: the repetitions before it count; check the sensor")

    def _tracked(self, reached: Array) -> TrackedPath:
        """Return the path of a cycle without its way back, with what was reached (n, axes) [m]."""
        wanted, got, time = self.wanted[: self.size], reached[: self.size], np.arange(self.size) / self.rate
        if self._several:
            return TrackedPath(time, wanted, got, self._strokes, self._axes)
        return TrackedPath(time, wanted[:, 0], got[:, 0], float(self._strokes[0]))
