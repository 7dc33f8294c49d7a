"""`compensate`: the voltages that follow a path, or the wave table of a period."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dehyst._errors import ModelError, RecordError
from dehyst._io import write_atomically
from dehyst._text import counted, escape
from dehyst._types import Array
from dehyst._views.lines import length, span_of
from dehyst.control import PathPlan, WaveTable, plan_path, wave_table
from dehyst.model import Actuator, voltages_of
from dehyst.operations.axes import AxesModel, Limits, OfAxes, axes_option, limits_option, of_one_axis, slew_option
from dehyst.operations.command import OUTPUT, PAGE, Values, argument, beside, command, number, option, output
from dehyst.operations.files import COLUMNS, GAIN, Columns, write_table
from dehyst.operations.paths import ZERO, even_rate, fault_of, reach_remarks, read_path, reason_of
from dehyst.operations.run import Result, Run, files
from dehyst.operations.start import START, before_path, begin_words, open_start, start_fields, starts_of
from dehyst.waveforms import ScanPath

# Largest difference between the ends of a period, as a part of its range.
_CLOSED = 1e-9


def _homes(given: Values) -> str:
    return "" if given.get("start") is None and given.get("home") is not False else "without a homing"


def _of_path(given: Values) -> str:
    return "with --table" if "table" in given else ""


@command("compensate", details=True)
def compensate(
    run: Run,
    model: Path = argument(),
    trajectory: Path = argument(),
    output: Path = output("Write the voltage here (CSV)."),
    limits: OfAxes = limits_option("Allowed voltages [V]; default: the records'."),
    slew_rate: OfAxes = slew_option("Largest slew rate [V/s]; default: the model's, or none."),
    zero: float | None = ZERO,
    start: Path | None = START,
    home: bool | None = option("Home first; default: if the start matters.", words="--home/--no-home", default=None),
    home_within: float | None = number("Longest homing, with the way to the path [s].", _homes),
    present: OfAxes = axes_option("Present voltage [V]; default: that of --start, or 0.", "[AXIS=]V"),
    on_time: bool | None = option(
        "Lead by the delay; default: if the actuator lags.", None, _of_path, words="--on-time/--late", default=None
    ),
    table: Path | None = option("Write the steady cycle of a periodic path here (CSV).", OUTPUT, of_one_axis),
    cycles: int | None = option(
        "Cycles before the steady one; default: as needed.", int, beside("table"), words="--start-up"
    ),
    gain: float | None = GAIN,
    plot: Path | None = option("Draw path, voltage and promise here (HTML).", PAGE),
    columns: Columns = COLUMNS,
) -> Result:
    """Compute the voltage with which the actuator follows a TRAJECTORY, within limits; the output adds voltage_V.

    Jumps and homings are not faster than the model's records. Column phase: 0 homing, 1 way to the path, 2 path. The
    status is 1 if the voltages miss the path by more than the model's error, the promise exceeds 5 % of the stroke, or
    with --table a voltage is clamped or the cycle is not settled.
    """
    if start is not None and home:
        got = f"{start} with --home, after which the state is known"
        raise ModelError(argument="start", got=got, need="one of them")
    known = AxesModel.read(run, model)
    if on_time is not None and not any(actuator.delay for actuator in known.actuators):
        raise ModelError("has no effect on a model without a delay", argument="on_time", hint="leave it out")
    allowed, volts, slews = known.of("limits", limits), known.of("present", present), known.slews(slew_rate)
    begins, found = starts_of(known, start, allowed, columns, volts), None
    wanted, warmth, clock = read_path(known, trajectory, columns, zero)
    known.remark(reach_remarks(known, wanted, allowed, zero, warmth))
    asked: dict[str, Any] = {"home": home, "home_within": home_within}
    if table is None:
        asked |= {"start": begins, "present": volts, "time": clock.get("time_s"), "temperature": warmth}
        plan = known.planned(plan_path, wanted, allowed, slews, on_time=on_time, **asked)
    else:
        run.progress("homing, and the steady cycle")
        period = _period(wanted[:, 0], even_rate(trajectory, clock), warmth)
        asked |= {"limits": allowed[0], "slew_rate": slews[0], "start": begins[0], "present": volts[0]}
        found = wave_table(known.actuators[0], period, cycles=cycles, **asked)
        plan = replace(found.plan, warnings=found.warnings)
    plans = plan.each or (plan,)
    run.progress(f"writing {plan.phase.size} rows")
    rows: dict[str, Any] = clock | known.table(plans)
    if found or plan.first:
        rows = {**({} if plan.time is None else {"time_s": plan.time}), "phase": plan.phase, **known.table(plans)}
    # The table of the cycle follows, so that its first sample is not written twice.
    write_table(output, {name: values[:-1] for name, values in rows.items()} if found else rows, gain)
    if found and table:
        write_table(table, {"time_s": found.cycle.time, **known.table([found.cycle])}, gain)
    if plot is not None:
        run.progress("drawing the path")
        write_atomically(plot, _page(known, plans))
    untested = _remark(known, plans, allowed, volts)
    size = plan.phase.size - bool(found)
    words = known.prefixed([f"{span_of(part.voltage, 'V')} {begin_words(part)}"] for part in plans)
    lines = [
        *known.prefixed([part.promise.sentence] if part.promise else [] for part in plans),
        f"{counted(size, 'sample')}, {', '.join(words)}: {output}",
        *files(Picture=plot),
    ]
    parts = zip(known.actuators, plans, allowed, slews, strict=True)
    fields = {"samples": size, "warnings": untested, **known.merged([_numbers(*part) for part in parts])}
    good = not any(map(fault_of, plans))
    if found:
        fields |= {"settled": found.settled, "error_um": found.error * 1e6, "start_up_cycles": found.cycles}
        fields |= {"cycle_samples": len(found.cycle), "sample_rate_Hz": found.sample_rate}
        fields["frequency_Hz"] = found.sample_rate / len(found.cycle)
        lines.append(f"{_table_words(found, known.actuators[0].delay)}: {table}")
        good = good and found.settled and not plan.clamped.any()
    return Result(fields, lines, [*lines, *untested] if untested else (), good=good)


def _remark(
    known: AxesModel, plans: Sequence[PathPlan], limits: Sequence[Limits], present: Sequence[float | None]
) -> list[str]:
    """Add remarks on a plan: what to do, and why a promise is large; return what else the records do not test."""
    promises = [plan.promise for plan in plans]
    said = known.prefixed(plan.warnings for plan in plans)
    reasons = known.prefixed(map(reason_of, promises, (own.identification.validity for own in known.actuators)))
    untested = known.prefixed([each.sentence for each in promise.untested] if promise else [] for promise in promises)
    known.remark(map(before_path, known.actuators, plans, limits, present))
    known.run.remarks += [*(sentence for sentence in said if sentence not in untested + reasons), *reasons]
    known.remark(map(open_start, plans))
    return [sentence for sentence in untested if sentence not in reasons]


def _table_words(found: WaveTable, delay: float) -> str:
    """Describe the steady cycle of an actuator with a `delay` [s], for which a table has no lead."""
    late = f", without a lead for the delay of {1e3 * delay:.4g} ms" if delay else ""
    cycles, samples = counted(found.cycles, "cycle"), counted(len(found.cycle), "sample")
    return f"the steady table after {cycles} of start-up, to {length(found.error)}; {samples} a cycle{late}"


def _period(wanted: Array, rate: float, warmth: Array | None) -> ScanPath:
    """Return a path (n,) [m] that ends where it begins as one period, with the derivatives of its periodic spline."""
    from scipy.interpolate import CubicSpline

    if warmth is not None:
        raise ModelError(argument="table", got="a path with temperatures", need="one without temperatures")
    if abs(wanted[-1] - wanted[0]) > _CLOSED * float(np.ptp(wanted)):
        got = f"{1e6 * wanted[0]:.6g} um at the first sample and {1e6 * wanted[-1]:.6g} um at the last"
        raise RecordError(argument="table", got=got, need="one period, which ends where it begins")
    at = np.arange(wanted.size) / rate
    spline = CubicSpline(at, np.append(wanted[:-1], wanted[0]), bc_type="periodic")
    return ScanPath(wanted[:-1], spline(at[:-1], 1), spline(at[:-1], 2), rate)


def _numbers(actuator: Actuator, plan: PathPlan, limits: Limits, slew: float | None) -> dict[str, Any]:
    """Return the plan of an axis as JSON values; the duration of a homing does not include the way."""
    homing, time = plan.homing, plan.time
    return {
        "clamped": int(plan.clamped[plan.first :].sum()),
        "missed_um": float(plan.missed) * 1e6,
        "lowest_V": float(plan.voltage.min()),
        "highest_V": float(plan.voltage.max()),
        "limits_V": list(limits or voltages_of(actuator)),
        "slew_V_per_s": slew,
        "start": start_fields(plan),
        "homing_samples": plan.first if homing else 0,
        "path_begins_s": plan.seconds,
        "homing_s": 0.0 if homing is None else None if time is None else homing.played.duration,
        "certified": plan.certified if homing else None,
        "seconds": None if time is None else float(np.ptp(time)),
        "promise": plan.promise and plan.promise.as_dict(),
        "state": plan.state.as_dict(),
    }


def _page(known: AxesModel, plans: Sequence[PathPlan]) -> str:
    """Return a self-contained HTML page with the plan of each axis."""
    from dehyst.report import pictures
    from dehyst.report.html import Charts, Part, document, reproduction, words

    def parts() -> Iterator[Part]:
        yield "<h1>A planned path</h1>"
        for axis, plan in zip(known.axes, plans, strict=True):
            yield axis and f"<h2>Axis {escape(axis)}</h2>"
            yield "" if plan.promise is None else f"<p>{words(plan.promise.sentence)}</p>"
            charts = [pictures.planned_path(plan), pictures.planned_voltage(plan)]
            charts += [] if plan.promise is None else [pictures.error_band(plan)]
            yield Charts("", f"After {plan.seconds or 0.0:.4g} s that lead to the path.", charts, wide=True)
        yield reproduction(known.run.command)

    return document("A planned path", parts())
