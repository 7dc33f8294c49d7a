"""`compensate`: the voltages that follow a path, or the wave table of a period."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import dehyst._validation as check
from dehyst._errors import ModelError, RecordError
from dehyst._io import write_atomically
from dehyst._text import counted, escape
from dehyst._types import Array
from dehyst._views.lines import length, span_of
from dehyst.control import PathPlan, WaveTable, plan_path, wave_table
from dehyst.model import Actuator, voltages_of
from dehyst.operations import start as starts
from dehyst.operations.axes import AxesModel, Limits, OfAxes, axes_option, limits_option, of_one_axis, slew_option
from dehyst.operations.command import OUTPUT, PAGE, Values, argument, beside, command, number, option, output
from dehyst.operations.files import COLUMNS, GAIN, Columns, write_table
from dehyst.operations.paths import ZERO, even_rate, fault_of, reach_remarks, read_path, reason_of
from dehyst.operations.run import Result, Run, files
from dehyst.operations.start import START
from dehyst.waveforms import ScanPath

# Largest difference between the ends of a period, as a part of its range.
_CLOSED = 1e-9
# Number of the last cycles of a table in its picture.
_SHOWN = 3


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
    start: str | Path | None = START,
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
    allowed, volts, (slews, kept) = limits.of(known.axes), present.of(known.axes), known.slews(slew_rate)
    begins, remarks = starts.starts_of(known, start, allowed, columns, volts)
    wanted, warmth, clock = read_path(known, trajectory, columns, zero, remark=remarks.append)
    asked: dict[str, Any] = {"home": home, "home_within": home_within}
    found: WaveTable | None = None
    period = None if table is None else _period_of(trajectory, wanted[:, 0], clock, warmth)
    targets = known.targets(wanted if period is None else period.displacement[:, None]).T
    each = zip(known.actuators, targets, allowed, strict=True)
    urgent = known.prefixed(reach_remarks(*axis, zero, warmth) for axis in each)
    if period is None:
        asked |= {"start": begins, "present": volts, "time": clock.get("time_s"), "temperature": warmth}
        plans = known.planned(plan_path, wanted, allowed, slews, on_time=on_time, **asked)
        rows = {**starts.clock_columns(plans[0], clock), **known.table(plans)}
    else:
        run.progress("homing, and the steady cycle")
        asked |= {"limits": allowed[0], "slew_rate": slews[0], "start": begins[0], "present": volts[0]}
        found = wave_table(known.actuators[0], period, cycles=cycles, **asked)
        plans = [replace(found.plan, warnings=found.warnings)]
        # The table of the cycle follows, so that its first sample is not written twice.
        rows = {"time_s": found.plan.time, "phase": found.plan.phase, **known.table(plans)}
        rows = {name: values[:-1] for name, values in rows.items()}
    size = len(next(iter(rows.values())))
    run.progress(f"writing {size} rows")
    write_table(output, rows, gain)
    if found is not None and table is not None:
        write_table(table, {"time_s": found.cycle.time, **known.table([found.cycle])}, gain)
    if plot is not None:
        run.progress("drawing the path")
        words = f"After {plans[0].seconds or 0.0:.4g} s that lead to the path." if found is None else "The last cycles."
        shown = plans if found is None else [_last(plans[0], _SHOWN * len(found.cycle))]
        _draw(plot, words, known.axes, shown, command=run.command)
    axes = [*zip(known.actuators, plans, allowed, slews, volts, strict=True)]
    made: dict[str, Any] = {"samples": size, "output": str(output)}
    if found is not None:
        made |= {"table": str(table), "settled": found.settled, "error_um": found.error * 1e6}
        made |= {"start_up_cycles": found.cycles, "cycle_samples": len(found.cycle)}
        made |= {"sample_rate_Hz": found.sample_rate, "frequency_Hz": found.sample_rate / len(found.cycle)}
    return _answer(known, axes, urgent, remarks, made, [*files(Picture=plot), *kept], found)


def _answer(
    known: AxesModel,
    axes: Sequence[tuple[Any, ...]],
    urgent: list[str],
    remarks: Sequence[str],
    made: dict[str, Any],
    added: Sequence[str],
    found: WaveTable | None,
) -> Result:
    """Return the answer: the promise of each axis, what to do, where the files are, and `added` lines.

    `axes`: actuator, plan, limits, slew rate and present voltage of each. `made`: JSON values of the files. `found`:
    the table of a period, if one was asked for.
    """
    plans = [plan for _, plan, *_ in axes]
    urgent += known.prefixed(starts.before_path(*axis) for axis in axes)
    said = known.prefixed(plan.warnings for plan in plans)
    reasons = known.prefixed(reason_of(plan.promise) for plan in plans)
    urgent += known.prefixed([plan.failure] if plan.failure else [] for plan in plans)
    others = [*remarks, *(sentence for sentence in said if sentence not in {*urgent, *reasons})]
    fields = {**known.merged([_numbers(*axis[:4]) for axis in axes]), "warnings": [*urgent, *reasons, *others]}
    spans = (span_of(plan.voltage, "V") for plan in plans)
    words = known.prefixed(
        [f"{span} {starts.begin_words(actuator, plan, limits, now)}"]
        for span, (actuator, plan, limits, _, now) in zip(spans, axes, strict=True)
    )
    lines = [
        *known.prefixed([plan.promise.sentence] if plan.promise else [] for plan in plans),
        *reasons,
        *known.prefixed(map(starts.open_start, plans)),
        f"{counted(made['samples'], 'sample')}, {', '.join(words)}: {made['output']}",
        *added,
    ]
    good = not any(map(fault_of, plans))
    if found is not None:
        delay = plans[0].promise.delay if plans[0].promise else axes[0][0].delay
        late = f", without a lead for the delay of {1e3 * delay:.4g} ms" if delay else ""
        lines.append(
            f"the steady table after {counted(found.cycles, 'cycle')} of start-up, to {length(found.error)}; "
            f"{counted(len(found.cycle), 'sample')} a cycle{late}: {made['table']}"
        )
        good = good and found.settled and not found.plan.clamped.any()
    more = [*lines, *others[1:]] if others[1:] else ()
    return Result(fields | made, lines, more, [*urgent, *others[:1]], good)


def _period_of(path: Path, wanted: Array, clock: Mapping[str, Array], warmth: Array | None) -> ScanPath:
    """Return a path (n,) [m] that ends where it begins as one period, with the derivatives of its periodic spline.

    Raise `ModelError` or `RecordError` if it is not periodic, has no even times, or depends on temperature.
    """
    from scipy.interpolate import CubicSpline

    if warmth is not None:
        raise ModelError(argument="table", got="a path with temperatures", need="one without temperatures")
    if not clock:
        raise RecordError(argument="table", got="no times", need="a time of each sample", hint="give --columns rate=HZ")
    even_rate(path, clock["time_s"])
    wanted = check.vector(wanted, "displacement")
    if abs(wanted[-1] - wanted[0]) > _CLOSED * float(np.ptp(wanted)):
        got = f"{1e6 * wanted[0]:.6g} um at the first sample and {1e6 * wanted[-1]:.6g} um at the last"
        raise RecordError(argument="table", got=got, need="one period, which ends where it begins")
    rows = wanted.size - 1
    rate = rows / float(np.ptp(clock["time_s"]))
    at = np.arange(rows + 1) / rate
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
        "start": starts.start_fields(plan),
        "homing_samples": plan.first if homing else 0,
        "homing_s": 0.0 if homing is None else None if time is None else homing.played.duration,
        "certified": plan.certified if homing else None,
        "seconds": None if time is None else float(np.ptp(time)),
        "promise": plan.promise and plan.promise.as_dict(),
        "state": plan.state.as_dict(),
    }


def _last(plan: PathPlan, rows: int) -> PathPlan:
    """Return the last rows of the path of a plan, for a picture."""
    rows = min(rows, len(plan.phase) - plan.first)
    promise = plan.promise and replace(plan.promise, half=plan.promise.half[-rows:])
    columns = ("time", "phase", "voltage", "displacement", "expected", "clamped")
    return replace(plan, promise=promise, **{name: getattr(plan, name)[-rows:] for name in columns})


def _draw(path: Path, caption: str, axes: Sequence[str], plans: Sequence[PathPlan], *, command: str) -> None:
    """Write a self-contained HTML page with the plan of each axis."""
    from dehyst.report import pictures
    from dehyst.report.html import Charts, Part, document, reproduction, words

    def parts() -> Iterator[Part]:
        yield "<h1>A planned path</h1>"
        for axis, plan in zip(axes, plans, strict=True):
            yield axis and f"<h2>Axis {escape(axis)}</h2>"
            yield "" if plan.promise is None else f"<p>{words(plan.promise.sentence)}</p>"
            charts = [pictures.planned_path(plan), pictures.planned_voltage(plan)]
            charts += [] if plan.promise is None else [pictures.error_band(plan)]
            yield Charts("", caption, charts, wide=True)
        yield reproduction(command)

    write_atomically(path, document("A planned path", parts()))
