"""`follow`: a path on an instrument: once, repeated, learnt, or with a sensor in the loop."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import Any

import click
import numpy as np

from dehyst._errors import ModelError, RigError
from dehyst._io import made_folder, write_atomically
from dehyst._text import escape
from dehyst._types import Array
from dehyst._views.lines import percent
from dehyst.calibration.following import FollowedPath
from dehyst.control import PathPlan, VoltageLimits
from dehyst.instruments import HIGHEST_RATE, AbstractRig, open_rig, played_rate
from dehyst.model import stroke_of, voltages_of
from dehyst.operations.axes import AxesModel, Limits, OfAxes, limits_option, slew_option
from dehyst.operations.bench import Steps
from dehyst.operations.command import FOLDER, INPUT, argument, command, flag, option, output
from dehyst.operations.files import COLUMNS, Columns, write_table
from dehyst.operations.paths import ZERO, bounds_remarks, closed_path, even_rate, fault_of, read_path
from dehyst.operations.run import Result, Run, files
from dehyst.records import largest, rms
from dehyst.report.html import document, words
from dehyst.report.sections import followed as followed_sections

# Part by which a rate may differ without a remark, and part of a sample that is rounding.
_RATES = 0.01
# Largest number of learning repetitions by default.
_MOST = 20


@command("follow")
def follow(
    run: Run,
    rig: str = argument(None),
    model: Path = option("The model (JSON) of one axis or several.", INPUT, required=True),
    path: Path = option("A file with times and a displacement, or the path of dehyst scan.", INPUT, required=True),
    output: Path = output("Folder for record, report, and the learnt voltages.", FOLDER, default="dehyst-follow"),
    repeat: int | None = option("Cycles; default: 1, with --learn until the error converges.", click.IntRange(1)),
    learn: bool = flag("Correct each repetition by the error of the one before."),
    feedback: bool = flag("Correct each sample by the reading before; one axis, at most 200 Hz, without --learn."),
    limits: OfAxes = limits_option("Range of the voltage [V]; default: that of the model and the device."),
    slew_rate: OfAxes = slew_option("Largest slew rate [V/s]; default: that of the model, else the device's."),
    zero: float | None = ZERO,
    columns: Columns = COLUMNS,
) -> Result:
    """Follow a path on RIG after a homing, measure the error, and compare it with the promise.

    RIG: as in dehyst calibrate. At the end, also by Ctrl-C, the voltage goes to its safe value. Without --force, a path
    is refused before anything moves if the voltages miss it, or if its promise exceeds 5 % of the stroke and neither
    --learn nor --feedback is given. The status is 1 if a voltage of the path was clamped, the error exceeds the
    promise, or the sensor is not believed.
    """
    if learn and feedback:
        raise ModelError(argument="learn, feedback", got="both", need="one of them")
    known = AxesModel.read(run, model)
    if feedback and known.several:
        raise ModelError(argument="feedback", got="a model of several axes", need="one axis", hint="try --learn")
    wanted, warmth, clock = read_path(known, path, columns, zero)
    rate = even_rate(path, clock)
    allowed, slews = known.of("limits", limits), known.slews(slew_rate)
    axes = known.axes if known.several else None
    asked: Any = [each if axes else each[0] for each in (allowed, slews)]
    with open_rig(rig, axes, limits=asked[0], slew_rate=asked[1]) as instrument:
        bounds = _bounds(run, known, instrument, allowed, slews)
        played = min(rate, HIGHEST_RATE) if feedback else played_rate(instrument, rate)
        if abs(played / rate - 1) > _RATES:
            run.note(f"played at {played:.6g} Hz, as {instrument.name} allows, in place of {rate:.6g} Hz")
            wanted = _resampled(wanted, played / rate)
            warmth = None if warmth is None else _resampled(warmth, played / rate)
        size = len(wanted)
        if learn or (repeat or 1) > 1:
            wanted = closed_path(wanted)
        if warmth is not None:
            warmth = np.concatenate([warmth, np.full(len(wanted) - size, warmth[-1])])
        record = made_folder(output) / "record.csv"
        if run.force:
            record.unlink(missing_ok=True)
        judge = partial(_demand_fit, known, fault_of=attrgetter("failure") if learn or feedback else fault_of)
        with Steps(run) as watcher:
            followed = FollowedPath(
                instrument, known.model, bounds, played, wanted, size, warmth, watcher, run.say, judge
            )
            lessons = repeat or _MOST if learn else 0
            followed.follow(record, repeat=1 if learn else repeat or 1, lessons=lessons, feedback=feedback)
    run.remarks += followed.remarks
    return _result(known, followed, record, output)


def _demand_fit(known: AxesModel, plan: PathPlan, fault_of: Callable[[PathPlan], str]) -> None:
    """Print the promise of a plan; refuse a plan with a fault, unless `--force` is given."""
    parts = plan.each or (plan,)
    for line in known.prefixed(part.promise.lines() if part.promise else () for part in parts):
        known.run.say(line)
    words = "; ".join(known.prefixed([fault] if (fault := fault_of(part)) else [] for part in parts))
    if words and not known.run.force:
        hint = "nothing was moved; dehyst compensate says which path fits; --force follows this one"
        raise ModelError(words.removesuffix("."), argument="path", hint=hint)


def _resampled(values: Array, ratio: float) -> Array:
    """Return values (n,) or (n, axes) at `ratio` times their sample rate."""
    at, rows = np.arange(0, (len(values) - 1) * ratio + _RATES) / ratio, np.arange(len(values))
    return np.apply_along_axis(lambda column: np.interp(at, rows, column), 0, values)


def _bounds(
    run: Run, known: AxesModel, rig: AbstractRig, allowed: Sequence[Limits], slews: Sequence[float | None]
) -> list[VoltageLimits]:
    """Return the limits of each axis; note limits that are narrower than given."""
    if len(rig.axes) != len(known.axes):
        names = ", ".join(rig.axes)
        raise RigError(f"{rig.name}: has the axes {names}, the model {', '.join(known.axes)}; give the rig's model")
    bounds, remarks = [], []
    for part, actuator, limit, slew in zip(rig.rigs, known.actuators, allowed, slews, strict=True):
        low, high = voltages_of(actuator)
        used = VoltageLimits(max(part.limits.low, low), min(part.limits.high, high), part.slew_rate)
        bounds.append(used)
        remarks.append(bounds_remarks(limit, slew, used, "device and model allow no more"))
    for sentence in known.prefixed(remarks):
        run.note(sentence)
    return bounds


def _result(known: AxesModel, followed: FollowedPath, record: Path, folder: Path) -> Result:
    """Write picture and voltages; return errors, whether they keep the promise, and the files."""
    rig, best, report = followed.rig, followed.best, folder / "report.html"
    head = _head(known, followed)
    parts: list[Any] = [f"<h1>A path on {escape(rig.name)}</h1>", f"<p>{words(head)}</p>"]
    shown = {"first cycle": followed.tracked[0]}
    if best is not followed.tracked[0]:
        shown["best repetition" if followed.learnt is not None else "last cycle"] = best
    for j, axis in enumerate(best.axes or ("",)):
        each = {name: tracked.each[j] for name, tracked in shown.items()}
        parts += [axis and f"<h2>Axis {escape(axis)}</h2>", *followed_sections(each)]
    write_atomically(report, document("A path on a rig", parts))
    voltages = None
    if followed.learnt is not None:
        voltages, time = folder / "voltages.csv", np.arange(len(followed.wanted)) / followed.rate
        columns = known.columns("displacement", 1e6 * followed.wanted.T) | known.columns("voltage", followed.learnt.T)
        write_table(voltages, {"time_s": time, **columns})
    fields = {
        "rig": rig.identity,
        "limits_V": known.by_axis([bound.low, bound.high] for bound in followed.bounds),
        "slew_V_per_s": known.by_axis(bound.slew_rate for bound in followed.bounds),
        "promise": known.by_axis(None if promise is None else promise.as_dict() for promise in followed.promises),
        "kept": known.by_axis(followed.kept),
        "noise_m": known.by_axis(followed.noise),
        **best.as_dict(),
        "repetitions": [tracked.as_dict() for tracked in followed.tracked],
        "clamped": sum(followed.clamps),
    }
    lines = [head, *files(Record=record, Voltages=voltages, Report=report)]
    good = not any(followed.clamps) and followed.believed and False not in followed.kept
    return Result(fields, lines, good=good)


def _head(known: AxesModel, followed: FollowedPath) -> str:
    """Return the result in words: errors, noise of the sensor, clamped samples, and a promise that is not kept."""
    strokes = [stroke_of(actuator) for actuator in known.actuators]
    noise = ", ".join(map(percent, followed.noise, strokes))
    head = f"Followed: {followed.best.words} of the stroke"
    judged = [
        f"{percent(largest(error), stroke, promise.largest)} and {percent(rms(error), stroke, promise.rms)} RMS"
        for error, promise, stroke in zip(followed.promised, followed.promises, strokes, strict=True)
        if error is not None and promise is not None
    ]
    late = " and a delay" * any(promise is not None and promise.delay > 0 for promise in followed.promises)
    if judged:
        head += f"; without an offset{late}, which the promise leaves out, {', '.join(judged)}"
    head += f"; the sensor's noise is {noise} RMS"
    if any(followed.clamps):
        head += f"; {followed.clamps.limited} samples were clamped at a limit, {followed.clamps.slewed} slewed"
    if False in followed.kept:
        head += f"; this is more than was promised, and {followed.cause}"
    return head
