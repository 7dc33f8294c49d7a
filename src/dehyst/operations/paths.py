"""A path: its zero, its limits, its temperature, and whether it can be reached."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from dehyst._errors import FileFormatError, ModelError
from dehyst._text import counted
from dehyst._types import Array
from dehyst._units import FACTORS
from dehyst._views.lines import ends, length
from dehyst.control import Compensator, PathPlan, VoltageLimits
from dehyst.control.limits import unit_hint
from dehyst.model import USELESS, Promise, Validity, apply, demand_thermal
from dehyst.operations.axes import AxesModel, Limits
from dehyst.operations.command import number
from dehyst.operations.files import PATH, Columns, clock_of, numbers_in
from dehyst.records import Table, table_of
from dehyst.records.formats.column import listed
from dehyst.records.record import Channel

ZERO = number("Zero of the path [um of the sensor]; default: the sensor's.")
# A path may be outside the reachable range by this part of it without a remark.
_ROUNDING = 1e-6
# Largest difference of the steps of time, as a part of their median.
_UNEVEN = 1e-3
# A path whose ends differ by more than this multiple of its largest step has a way back.
_CLOSED = 1.5
# A promise above this part of the stroke gets its reason; a path of less than this part may be in another unit.
_SMALL = 0.01


def bounds_remarks(limits: Limits, slew_rate: float | None, used: VoltageLimits, who: str) -> list[str]:
    """Return remarks if narrower limits [V] or a lower slew rate [V/s] than given are used, because of `who`."""
    remarks = []
    if limits is not None and limits != (used.low, used.high):
        remarks.append(f"limits: {ends(*limits, 'V')} was given, {used.words} is used, as {who}")
    if slew_rate is not None and used.slew_rate is not None and used.slew_rate < slew_rate:
        remarks.append(f"slew rate: {slew_rate:.6g} V/s was given, {used.slew_rate:.6g} V/s is used, as {who}")
    return remarks


def reason_of(promise: Promise | None, tested: Validity | None) -> list[str]:
    """Return why a model is not usable for a path, or what a promise above 1 % of the stroke comes from."""
    if promise is None or promise.largest <= _SMALL * promise.stroke:
        return []
    if promise.unusable:
        return [promise.unusable]
    cause = max(promise.parts, key=promise.parts.__getitem__)
    known = [each.sentence for each in promise.untested if (each.what == "temperature") is (cause == "temperature")]
    if cause == "model" and not known and tested:
        words = "The promise rests on RMS errors of {} on held-out parts, {} between models, {} more on fast branches."
        return [words.format(*map(length, (tested.rms, tested.disagreement, tested.growth)))]
    # The plan itself has remarks on the start and on missed samples.
    return [] if cause in ("start", "missed") else known[:1]


def fault_of(plan: PathPlan) -> str:
    """Return why a path is not followed well: it is missed, promised no better than 5 % of the stroke, or not homed."""
    promise = plan.promise
    if plan.failure or promise is None:
        return plan.failure or ("" if plan.certified else "the state before the path is not known")
    return promise.sentence if promise.largest > 0.01 * USELESS * promise.stroke else ""


def temperature_of(known: AxesModel, columns: Columns, table: Table) -> Array | None:
    """Return the temperature (n,) [degC] in a table: the named or the only temperature column; None if there is none.

    If the model does not depend on temperature, a column that was not requested is left out, with a remark.
    """
    own = tuple(column.name for column in table.columns if column.role == "temperature")
    if columns.temperature is not None:
        demand_thermal(*(actuator.thermal for actuator in known.actuators))
    elif not own:
        return None
    tested = [actuator.identification.validity for actuator in known.actuators]
    if not any(actuator.thermal for actuator in known.actuators) and not any(own.temperatures for own in tested if own):
        words = f"temperature: {listed(own)} of the file is not used, as the model does not depend on temperature"
        known.run.remarks.append(words)
        return None
    if columns.temperature is None and len(own) > 1:
        words = f"{table.source}: {listed(own)} are temperatures"
        raise FileFormatError(words, argument="columns", hint=f"select one by temperature={own[0]}")
    values = numbers_in(table, "temperature", table.column("temperature", columns.temperature or own[0]))
    if fault := Channel("temperature", "degC", "temperature", "", values).fault:
        raise FileFormatError(f"{table.source}: temperature: {fault}")
    return values


def read_path(
    known: AxesModel, path: Path, columns: Columns, zero: float | None = None
) -> tuple[Array, Array | None, dict[str, Array]]:
    """Return the wanted displacement (n, axes) [m] in a file from the sensor's zero, its temperature [degC], its time.

    `zero`: of the path [um of the sensor]. For one axis the only column of lengths needs no name.
    """
    columns.demand(PATH, "on a path", axes=known.several)
    table = table_of(path, columns)
    lengths = [column.name for column in table.columns if column.parts[1] in FACTORS["displacement"]]
    if not known.several and not columns.displacement and len(lengths) == 1 and not table.fitting("displacement"):
        columns = replace(columns, displacement=lengths[0])
    wanted = known.values(table, "displacement", columns)
    return wanted + 1e-6 * zero if zero else wanted, temperature_of(known, columns, table), clock_of(table, columns)


def reach_remarks(
    known: AxesModel, wanted: Array, limits: Sequence[Limits], zero: float | None, temperature: Array | None
) -> Iterator[list[str]]:
    """Yield for each axis a remark on a path (n, axes) [m] outside of its reach, or in another unit; what to try.

    `temperature`: of the path (n,) [degC]; default: not known, the reference counts. The range is that which is reached
    at all temperatures. Raise `ModelError` if the path is more than a stroke outside, because then its zero, unit or
    model is wrong.
    """
    targets = apply(known.stage.decoupling, wanted)
    for actuator, allowed, target in zip(known.actuators, limits, targets.T, strict=True):
        (axis,) = Compensator(actuator, allowed)._axes
        gain, offset = axis.scaling(temperature if actuator.thermal else None, target.size)
        lows, highs = (offset + gain * end for end in axis.reach)
        values = np.max(lows), np.min(highs), target.min(), target.max()
        low, high, least, most = (1e6 * float(value) for value in values)
        margin, fits = _ROUNDING * 1e-6 * (high - low), most - least <= high - low
        if hints := unit_hint("um", (low, high), 1e6 * target - (0.0 if zero is None else least)):
            yield [*hints]
            continue
        if np.all((lows - margin <= target) & (target <= highs + margin)):
            yield []
            continue
        advice = "choose another --zero" if fits else "choose a smaller path"
        if fits and zero is None:
            advice = f"--zero {0.5 * (low + high - least - most):.4g} puts it into the middle"
        if most - least < _SMALL * (high - low):
            advice = f"check the unit, as it moves by less than a hundredth of the reach, or {advice}"
        reached = f"the model reaches {ends(low, high, 'um')}, from the sensor's zero in its records"
        if axis.strays((target - offset) / gain):
            hint = f"check the numbers and their unit, or {advice}"
            raise ModelError(f"got {ends(least, most, 'um')}, {reached}", argument="displacement", hint=hint)
        yield [f"the path covers {ends(least, most, 'um')}, with {axis.bounds.words} {reached}; {advice}"]


def closed_path(wanted: Array) -> Array:
    """Return a path (n, axes) [m] with a way back to its first sample, unless it is closed."""
    steps, gap = np.abs(np.diff(wanted, axis=0)).max(axis=0), wanted[0] - wanted[-1]
    if (np.abs(gap) <= _CLOSED * steps).all():
        return wanted
    # The way back is a cosine with the largest slope of the path.
    count = int(np.ceil(0.5 * np.pi * (np.abs(gap) / np.maximum(steps, 1e-15)).max())) + 1
    way = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, count) / count)
    return np.vstack([wanted, wanted[-1] + way[:, None] * gap])


def even_rate(path: Path, clock: Mapping[str, Array]) -> float:
    """Return the rate [Hz] of the time in a file; raise `FileFormatError` if there is none, or it rises unevenly."""
    if not clock:
        got = f"no time of each sample in {path}"
        raise FileFormatError(argument="columns", got=got, need="one", hint="give --columns rate=HZ")
    time = clock["time_s"]
    if time.size < 2:
        raise FileFormatError(f"{path}: got {counted(time.size, 'sample')}, need at least two")
    steps = np.diff(time)
    if not (steps > 0).all() or float(np.ptp(steps)) > _UNEVEN * float(np.median(steps)):
        raise FileFormatError(f"{path}: the times do not rise evenly; write it with dehyst excite, or resample it")
    return (time.size - 1) / float(np.ptp(time))
