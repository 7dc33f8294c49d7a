"""`follow`: a path on an instrument: once, repeated, learnt, or with a sensor in the loop."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dehyst._errors import ModelError, RecordError, RigError
from dehyst._io import made_folder, write_atomically
from dehyst._types import Array
from dehyst._views.html import escape
from dehyst.calibration import TrackedPath
from dehyst.calibration.plan import even_rate
from dehyst.control import Compensator, Feedback, PathPlan, Repetition, StageCompensator, VoltageLimits, plan_path
from dehyst.control.stage_compensator import axes_of
from dehyst.instruments import HIGHEST_RATE, AbstractRig, Samples, open_rig, played_rate
from dehyst.instruments.base import StepFunction
from dehyst.model import slew_rate_of_records
from dehyst.operations.axes import AxesModel, Limit, Slew, limits_of, slews_of
from dehyst.operations.declaration import Folder, Input, operation
from dehyst.operations.files import AS_FOUND, PATH, Columns, clock_of, write_table
from dehyst.operations.paths import PathSlew, Zero, bounds_remarks, reach_remarks, temperature_of, zero_of_path
from dehyst.operations.run import Result, Run, files
from dehyst.records import Recording, beyond_noise, demand_disk_space, largest, percent, table_of
from dehyst.report.html import document, words
from dehyst.report.sections import followed as followed_sections
from dehyst.waveforms import Excitation

# Part by which a rate may differ without a remark.
_RATES = 0.01
# Most repetitions that learn by default; they end when none of the last ones lowered the RMS error by this share.
_MOST, _LAST, _LOWER = 20, 3, 0.03
# A path whose ends differ by more than this multiple of its largest step has a way back.
_CLOSED = 1.5


@operation()
def follow(
    run: Run,
    rig: str,
    *,
    model: Input,
    path: Input,
    output: Folder = Path("dehyst-follow"),
    repeat: int | None = None,
    learn: bool = False,
    feedback: bool = False,
    limits: tuple[Limit, ...] = (),
    slew_rate: tuple[Slew, ...] = (),
    zero: Zero | None = None,
    columns: Columns = AS_FOUND,
) -> Result:
    """Follow a path on RIG after a homing, measure the error, and compare it with the promise.

    RIG: as of dehyst calibrate. The voltage ends at the safe one; Ctrl-C brings it there too. The status is 1 if a
    voltage of the path was clamped, or the error exceeds the promise.

    Parameters
    ----------
    model
        The model (JSON) of one axis or several.
    path
        A file with times and a displacement, or the path of dehyst scan. A column temperature_C counts if the model
        depends on temperature.
    output
        Folder for the record (record.csv with the wanted displacement; a file an axis of several), its picture
        (report.html), and what was learnt (voltages.csv, one cycle to play again and again).
    repeat
        How often the path is followed, with a way back if it is not closed; default: once, with --learn until
        the error no longer falls.
    learn
        Correct each repetition by the error of the one before. It is measured in the second of two cycles.
    feedback
        Correct each sample by the reading before, of one axis, at 200 Hz at most: this computer sends each voltage.
    limits
        Range of the voltage [V]; default: that of the model and the device.
    slew_rate
        Largest slew rate [V/s]; default: the device's, or the whole range in 0.1 s.
    zero
        Zero of the path, as of dehyst compensate.
    columns
        Columns of the path.
    """
    if learn and feedback:
        raise ModelError(argument="learn", got="it with feedback", need="one of them")
    if repeat is not None and repeat < 1:
        raise RecordError(argument="repeat", got=repeat, need="1 or more")
    known = AxesModel.read(run, model)
    known.demand(columns, PATH, "on a path")
    if feedback and known.stage is not None:
        raise ModelError(argument="feedback", got="a model of several axes", need="one axis", hint="try --learn")
    wanted, warmth, rate = _path_of(run, known, path, columns)
    if feedback and rate > HIGHEST_RATE * (1 + _RATES):
        hint = "give a slower path, or --learn"
        raise RecordError(argument="path", got=f"{rate:.6g} Hz", need="200 Hz at most with feedback", hint=hint)
    allowed, slews = limits_of(known.axes, limits), slews_of(known.axes, slew_rate)
    asked: tuple[Any, Any] = allowed, [None if one is None else one.number for one in slews]
    axes = None if known.stage is None else known.axes
    bound, steepest = asked if axes else (asked[0][0], asked[1][0])
    with open_rig(rig, axes, limits=bound, slew_rate=steepest) as instrument:
        wanted, bounds = _placed(run, known, instrument, wanted, allowed, slews, zero, warmth)
        played = min(rate, HIGHEST_RATE) if feedback else played_rate(instrument.rigs[0], rate)
        if abs(played / rate - 1) > _RATES:
            run.note(f"the path has {rate:.6g} Hz, and is played at {played:.6g} Hz, as {instrument.name} can")
        size = len(wanted)
        if learn or (repeat or 1) > 1:
            wanted = _closed(wanted)
        if learn and instrument.longest is not None and 2 * len(wanted) > instrument.longest:
            run.note(f"{instrument.name} takes {instrument.longest} samples at once, and waits between such pieces")
        if isinstance(warmth, np.ndarray):
            warmth = np.concatenate([warmth, np.full(len(wanted) - size, warmth[-1])])
        demand_disk_space(made_folder(output), 2 * len(wanted) * len(axes or "1") * (repeat or _MOST), 4)
        task = _Task(run, instrument, known, bounds, played, wanted, size, warmth)
        task.follow(output, 1 if learn else repeat or 1, repeat or _MOST if learn else 0, feedback=feedback)
    return _result(task, output)


def _path_of(run: Run, known: AxesModel, path: Path, columns: Columns) -> tuple[Array, float | Array | None, float]:
    """Return the wanted displacements (n, axes) [m], the temperature [degC] and the rate [Hz] of a path."""
    known.demand(columns, PATH, "on a path")
    table = table_of(path, columns)
    wanted, clock = known.values(table, "displacement", columns), clock_of(table, columns)
    if not clock:
        raise RecordError(argument="path", got="no times", need="a time of each sample", hint="--columns rate=HERTZ")
    warmth = temperature_of(known, None, columns, table, len(wanted), remark=run.note)
    return wanted, warmth, even_rate(path, clock["time_s"])


def _placed(
    run: Run,
    known: AxesModel,
    rig: AbstractRig,
    wanted: Array,
    allowed: Sequence[tuple[float, float] | None],
    slews: Sequence[Slew | None],
    zero: Zero | None,
    warmth: float | Array | None,
) -> tuple[Array, list[VoltageLimits]]:
    """Return the path (n, axes) [m] from the sensor's zero, and the limits of each axis; note what is narrower."""
    if len(rig.axes) != len(known.axes):
        names = ", ".join(rig.axes)
        raise RigError(f"{rig.name}: has the axes {names}, the model {', '.join(known.axes)}; give its model")
    zeros = np.array(
        [
            zero_of_path(actuator, (part.limits.low, part.limits.high), zero)
            for part, actuator in zip(rig.rigs, known.actuators, strict=True)
        ]
    )
    wanted = wanted + (known.moved(zeros[None])[0] if zero is not None and zero.name else zeros)
    targets, bounds, remarks = known.targets(wanted).T, [], []
    for part, actuator, target, limit, slew in zip(rig.rigs, known.actuators, targets, allowed, slews, strict=True):
        low, high = actuator.voltage_range
        # Refused in micrometres here; the library's refusal would be in metres.
        reach_remarks(actuator, target, (low, high), zero, warmth)
        used = VoltageLimits(max(part.limits.low, low), min(part.limits.high, high), part.slew_rate)
        bounds.append(used)
        remarks.append(bounds_remarks(limit, slew, used, "device and model allow no more"))
        speed = PathSlew(used.slew_rate, "option", slew_rate_of_records(actuator))
        remarks[-1] += [speed.words] if slew is not None or speed.times > 1 else []
        remarks[-1] += reach_remarks(actuator, target, (used.low, used.high), zero, warmth)
    for sentence in known.prefixed(remarks):
        run.note(sentence)
    return wanted, bounds


def _closed(wanted: Array) -> Array:
    """Return a path (n, axes) [m] with a way back to its first sample, unless it is closed."""
    steps, gap = np.abs(np.diff(wanted, axis=0)).max(axis=0), wanted[0] - wanted[-1]
    if (np.abs(gap) <= _CLOSED * steps).all():
        return wanted
    # A cosine as steep as the path is.
    count = int(np.ceil(0.5 * np.pi * (np.abs(gap) / np.maximum(steps, 1e-15)).max())) + 1
    way = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, count) / count)
    return np.vstack([wanted, wanted[-1] + way[:, None] * gap])


@dataclass(eq=False)
class _Task:
    """A cycle `wanted` (n, axes) [m] on a rig, whose first `size` samples are the path, within `bounds`, at `rate`.

    `tracked`: what was measured of each repetition; `best`: of the best that was learnt, else of the last. `clamped`:
    number of samples. `learnt`: voltages (n, axes) [V] of the best cycle, or None. `noise`: of each sensor [m].
    """

    run: Run
    rig: AbstractRig
    known: AxesModel
    bounds: list[VoltageLimits]
    rate: float
    wanted: Array
    size: int
    warmth: Any

    def __post_init__(self) -> None:
        self.files: list[Recording] = []
        self.tracked: list[TrackedPath] = []
        self.promises: list[Any] = []
        self.noise: list[float] = []
        self.clamped = 0
        self.learnt: Array | None = None
        self.watcher: Any = None

    def follow(self, folder: Path, times: int, lessons: int, *, feedback: bool) -> None:
        """Home, follow the path some `times` and learn in `lessons`; all samples are in files of the folder."""
        # Read before anything moves: a rig without a measurement is refused here.
        present = [one.limits.nearest(one.read().voltage) for one in self.rig.rigs]
        wanted = np.tile(self.wanted, (times, 1))
        plan = self._plan(wanted, present)
        self.promises = list(plan.promise) if self.known.stage else [plan.promise]
        for line in self.known.prefixed([] if one is None else one.lines for one in self.promises):
            self.run.say(line)
        about, others = {"rig": self.rig.identity, "excitation": "path"}, (*self.rig.others, "wanted_um")
        with ExitStack() as stack:
            for name, axis in zip(self.known.axes, self.rig.axes, strict=True):
                path = folder / f"record{name and f'-{name}'}.csv"
                if self.run.force:
                    path.unlink(missing_ok=True)
                self.files.append(stack.enter_context(Recording(path, about={**about, "axis": axis}, others=others)))
            stack.enter_context(self.rig.safely())
            self.watcher = stack.enter_context(self.run.watch())
            if feedback:
                reached = self._feed_back(plan, wanted, present)
            else:
                self.clamped, reached = int(plan.clamped.sum()), self._play(*self._even(plan), len(wanted))
            self.tracked = [self._tracked(cycle) for cycle in np.split(reached, times)]
            self.best = self.tracked[-1]
            if lessons:
                self._learn(plan.state, lessons)
            self.rig.retreat()

    def _plan(self, wanted: Array, present: list[float]) -> PathPlan:
        """Return the plan of a path (n, axes) [m] with a homing."""
        time, one = np.arange(len(wanted)) / self.rate, self.known.stage is None
        warmth = np.resize(self.warmth, len(wanted)) if isinstance(self.warmth, np.ndarray) else self.warmth
        given: dict[str, Any] = {"time": time, "temperature": warmth, "home": True, "on_time": True}
        loop = self._compensator(None)
        return plan_path(loop, wanted[:, 0] if one else wanted, present=present[0] if one else present, **given)

    def _compensator(self, states: Any, *, preview: bool = False) -> Compensator | StageCompensator:
        """Return a compensator within the bounds that begins in these states, at the temperature of the path.

        `preview`: of a single axis, whether it compensates lag and resonance.
        """
        limits, slews = [(one.low, one.high) for one in self.bounds], [one.slew_rate for one in self.bounds]
        loop: Compensator | StageCompensator
        if self.known.stage is None:
            (actuator,) = self.known.actuators
            ahead = preview and (actuator.delay > 0 or actuator.dynamics is not None)
            given: dict[str, Any] = {"period": 1 / self.rate, "state": states, "preview": ahead, "warns": False}
            loop = Compensator(actuator, limits[0], slews[0], **given)
        else:
            loop = StageCompensator(self.known.stage, limits, slews, period=1 / self.rate, states=states)
        for part in axes_of(loop) if self.warmth is not None else ():
            if part.actuator.thermal is not None:
                gain, offset = part.actuator.thermal.scale(float(np.mean(self.warmth)), 1)
                part.scale(float(np.ravel(gain)[0]), float(np.ravel(offset)[0]))
        return loop

    def _even(self, plan: PathPlan) -> tuple[Array, Array]:
        """Return the voltages [V] and wanted displacements [m] (n, axes) of a plan, a sample a period."""
        times = plan.time if plan.time is not None else np.zeros(1)
        # Rows of the homing are farther apart, and the last row is a sample.
        at = times[-1] - np.arange(round((times[-1] - times[0]) * self.rate), -1, -1) / self.rate
        columns = (np.reshape(values, (times.size, -1)).T for values in (plan.voltage, plan.displacement))
        volts, wanted = (np.column_stack([np.interp(at, times, column) for column in every]) for every in columns)
        return volts, wanted

    def _play(self, voltage: Array, wanted: Array, size: int, step: StepFunction | None = None) -> Array:
        """Play voltages (n, axes) [V], record them with what is wanted [m], return what the last `size` reached."""
        count, rows, strokes = 0, self.rig.rows(len(voltage)), [one.stroke for one in self.known.actuators]
        shown = np.concatenate([np.full(len(voltage) - size, np.nan), wanted[len(wanted) - size :, 0]])

        def listen(samples: Samples) -> None:
            nonlocal count
            at = rows[count : count + samples.time.size]
            count += samples.time.size
            for j, file in enumerate(self.files):
                one = samples.axis(j)
                file.add(one._replace(others={**one.others, "wanted_um": 1e6 * wanted[at, j]}))
            self.watcher.samples(samples.axis(0), shown[at], strokes[0])

        excitation = Excitation("path", voltage if self.known.stage else voltage[:, 0], self.rate)
        self.watcher.step("path", excitation.duration)
        record = self.rig.play(excitation, listen, step=step)
        self.noise = [record.axis(j).noise for j in range(len(self.files))]
        reached = np.empty(voltage.shape)
        reached[rows] = record.displacement.reshape(rows.size, -1)
        return reached[len(voltage) - size :]

    def _feed_back(self, plan: PathPlan, wanted: Array, present: list[float]) -> Array:
        """Home, and follow the path with feedback; return what was reached."""
        lead = self._plan(np.repeat(wanted[:1], 2, axis=0), present)
        self._play(*self._even(lead), 0)
        loop = self._compensator(lead.state)
        corrected, ahead = Feedback(loop), iter(wanted[:, 0].tolist())  # type: ignore[arg-type]
        volts = np.reshape(plan.voltage[-len(wanted) :], wanted.shape)
        reached = self._play(volts, wanted, len(wanted), lambda measured: corrected.step(next(ahead), measured))
        self.clamped = _clamps(loop)
        return reached

    def _learn(self, states: Any, most: int) -> None:
        """Repeat the path from these states until the error no longer falls; keep the voltages of the best cycle."""
        loop, size = self._compensator(states, preview=True), len(self.wanted)
        repetition = Repetition(loop, self.wanted if self.known.stage else self.wanted[:, 0])
        errors: list[float] = []
        for number in range(1, most + 1):
            # The second cycle follows one like itself, as all later ones do.
            pair = [np.reshape(repetition.next(), self.wanted.shape) for _ in range(2)]
            reached = self._play(np.concatenate(pair), np.tile(self.wanted, (2, 1)), size)
            self.tracked.append(self._tracked(reached))
            self.run.say(f"Repetition {number}: {_errors(self.tracked[-1], self.known)}")
            errors.append(_rms(self.tracked[-1]))
            if errors[-1] == min(errors):
                self.learnt, self.best = pair[1], self.tracked[-1]
            repetition.learn(reached if self.known.stage else reached[:, 0])
            falls = len(errors) <= _LAST or min(errors[-_LAST:]) < (1 - _LOWER) * min(errors[:-_LAST])
            if not (repetition.believed and falls):
                break
        self.clamped += _clamps(loop)
        if not repetition.errors or not repetition.believed:
            stray = f"read more than {1e6 * repetition.bound:.3g} um from the model"
            self.run.note(f"nothing was learnt: voltages were clamped, or the sensor {stray}; try dehyst update")

    def _tracked(self, reached: Array) -> TrackedPath:
        """Return the path of a cycle without its way back, with what was reached (n, axes) [m]."""
        wanted, got = self.wanted[: self.size], reached[: self.size]
        time, strokes = np.arange(self.size) / self.rate, np.array([one.stroke for one in self.known.actuators])
        if self.known.stage is None:
            return TrackedPath(time, wanted[:, 0], got[:, 0], float(strokes[0]))
        return TrackedPath(time, wanted, got, strokes, self.known.axes)


def _rms(tracked: TrackedPath) -> float:
    """Return the RMS error [%] of the worst axis."""
    return float(np.max(tracked.rms_percent))


def _clamps(loop: Compensator | StageCompensator) -> int:
    """Return the number of samples that were clamped or slewed."""
    return sum(one.clamps.limited + one.clamps.slewed for one in axes_of(loop))


def _errors(tracked: TrackedPath, known: AxesModel) -> str:
    """Return the errors of each axis in words."""
    each = [[f"largest error {one.largest_percent:.3f} %, RMS {one.rms_percent:.3f} %"] for one in tracked.each]
    return "; ".join(known.prefixed(each))


def _result(task: _Task, folder: Path) -> Result:
    """Write picture and voltages; return errors, whether they keep the promise, and the files."""
    known, best, report = task.known, task.best, folder / "report.html"
    # A promise is apart from a constant offset.
    apart = [largest(tracked.error - tracked.error.mean()) for tracked in best.each]
    kept = [
        None if promise is None else beyond_noise(error, noise) <= promise.largest
        for promise, error, noise in zip(task.promises, apart, task.noise, strict=True)
    ]
    head = _head(task, kept)
    parts: list[Any] = [f"<h1>A path on {escape(task.rig.name)}</h1>", f"<p>{words(head)}</p>"]
    shown = {"first cycle": task.tracked[0]}
    if best is not task.tracked[0]:
        number = task.tracked.index(best)
        shown[f"repetition {number}, the best" if task.learnt is not None else f"cycle {number + 1}, the last"] = best
    for j, axis in enumerate(best.axes or ("",)):
        followed = {name: tracked.each[j] for name, tracked in shown.items()}
        parts += [axis and f"<h2>Axis {escape(axis)}</h2>", *followed_sections(followed)]
    write_atomically(report, document("A path on a rig", parts))
    voltages = None
    if task.learnt is not None:
        voltages, time = folder / "voltages.csv", np.arange(len(task.wanted)) / task.rate
        columns = known.columns("displacement", 1e6 * task.wanted) | known.columns("voltage", task.learnt)
        write_table(voltages, {"time_s": time, **columns})
    fields = {
        "rig": task.rig.identity,
        "limits_V": known.by_axis([one.low, one.high] for one in task.bounds),
        "slew_V_per_s": known.by_axis(one.slew_rate for one in task.bounds),
        "promise": known.by_axis(None if one is None else one.as_dict() for one in task.promises),
        "kept": known.by_axis(kept),
        "noise_m": known.by_axis(task.noise),
        **best.as_dict(),
        "repetitions": [one.as_dict() for one in task.tracked],
        "clamped": task.clamped,
        "output": str(folder),
    }
    lines = [head, *(f"Record: {one.path}" for one in task.files), *files(Voltages=voltages, Report=report)]
    return Result(fields, lines, good=not task.clamped and False not in kept)


def _head(task: _Task, kept: Sequence[bool | None]) -> str:
    """Return the result in words: errors, noise of the sensor, clamped samples, and a promise that is not kept."""
    strokes = (actuator.stroke for actuator in task.known.actuators)
    noise = ", ".join(f"{percent(value, stroke):.3f}" for value, stroke in zip(task.noise, strokes, strict=True))
    head = f"Followed: {_errors(task.best, task.known)} of the stroke; the sensor's noise is {noise} % RMS"
    if task.clamped:
        head += f"; {task.clamped} samples were clamped at a limit or by the slew rate"
    if False in kept:
        head += "; that is more than was promised: dehyst check tells what has changed"
    return head
