"""`compensate`: the voltages that follow a path, or the wave table of a period."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import dehyst._validation as check
from dehyst._errors import ModelError, RecordError, of_part
from dehyst._io import write_atomically
from dehyst._text import counted, escape
from dehyst._types import Array
from dehyst.calibration.plan import even_rate
from dehyst.control import PathPlan, PossibleStart, plan_path, wave_table
from dehyst.model import USELESS, Actuator, voltages_of
from dehyst.operations import start as starts
from dehyst.operations.axes import (
    AxesModel,
    AxisLimits,
    AxisNumber,
    AxisNumbers,
    Limits,
    limits_of,
    limits_option,
    of_axes,
    of_one_axis,
    slew_option,
)
from dehyst.operations.command import (
    OUTPUT,
    PAGE,
    Values,
    argument,
    beside,
    command,
    integer,
    number,
    option,
    output,
    switch,
)
from dehyst.operations.files import COLUMNS, GAIN, Columns, write_table
from dehyst.operations.paths import (
    ZERO,
    reach_remarks,
    read_path,
    reason_of,
    temperature_column,
)
from dehyst.operations.run import Result, Run, files
from dehyst.operations.start import START, Start
from dehyst.waveforms import ScanPath

# How the library begins a remark on a path that is missed by more than its promise.
_CLAMPED = "CLAMPED"
# Part of its range by which a period may end elsewhere than it begins.
_CLOSED = 1e-9
_PRESENT = AxisNumber("[AXIS=]V")


def _homes(given: Values) -> str:
    return "" if given.get("start") is None and given.get("home") is not False else "without a homing"


@command("compensate", details=True)
def compensate(
    run: Run,
    model: Path = argument(),
    trajectory: Path = argument(),
    output: Path = output("Write the voltage here (CSV)."),
    limits: AxisLimits = limits_option("Allowed voltages [V]; default: of the records."),
    slew_rate: AxisNumbers = slew_option("Largest slew rate [V/s]; default: the model's, or none."),
    zero: float | None = ZERO,
    start: Start | None = option("State before the path; default: unknown.", START),
    home: bool | None = switch("--home/--no-home", "Home before; default: if the start matters."),
    home_within: float | None = number("Longest duration of homing and way [s].", _homes),
    present: AxisNumbers = option("Present voltage [V]; default: of --start, or 0.", _PRESENT, multiple=True),
    on_time: bool | None = switch("--on-time/--late", "Lead by the delay; default: if the actuator lags."),
    table: Path | None = option("Write the steady cycle of a periodic path here (CSV).", OUTPUT, of_one_axis),
    start_up: int | None = integer("Cycles before the steady one; default: as needed.", beside("table")),
    gain: float | None = GAIN,
    plot: Path | None = option("Draw path, voltage and promise here (HTML).", PAGE),
    columns: Columns = COLUMNS,
) -> Result:
    """Compute the voltage with which the actuator follows a TRAJECTORY, within limits; the output adds voltage_V.

    Jumps and homings keep to the speed of the model's records. Column phase: 0 homing, 1 way, 2 path. The
    status is 1 if the path is missed by more than the promise, or this exceeds 5 % of the stroke; with --table also if
    a voltage is clamped or the cycle is not settled.
    """
    if start is not None and home:
        raise ModelError(argument="start", got="it with --home, which determines the state", hint="leave one out")
    known, place = AxesModel.read(run, model), 1e-6 * (zero or 0.0)
    bounds, (slews, kept) = limits_of(known.axes, limits), known.slews(slew_rate)
    begins, remarks = starts.starts_of(known, start, bounds, columns)
    if zero is not None:
        remarks.append(f"the path is counted from {zero:.6g} um of the sensor, and written in um of the sensor")
    volts = of_axes(known.axes, present, "present")
    begins = [
        begin and (begin if now is None else begin.standing_at(actuator, now))
        for actuator, begin, now in zip(known.actuators, begins, volts, strict=True)
    ]
    task = _Task(run, known, bounds, slews, begins, volts, {"home": home, "home_within": home_within}, zero, gain)
    wanted, warmth, clock = read_path(known, trajectory, columns, remark=remarks.append)
    with _named(trajectory):
        if table is None:
            made = task.follow(wanted + place if place else wanted, clock, warmth, on_time, output)
        else:
            period = _period_of(trajectory, wanted[:, 0] + place, clock, warmth)
            made = task.tabulate(period, start_up, output, table)
    if plot is not None:
        run.progress("drawing the path")
        _draw(plot, known.axes, made.plans, command=run.command)
    return task.result(made, remarks, output, [*files(Picture=plot), *kept])


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Add the name of the path's file to an error of its displacements."""
    try:
        yield
    except ModelError as error:
        if error.change or error.argument not in ("", "displacement"):
            raise
        raise of_part(error, path.name) from error


def _period_of(path: Path, wanted: Array, clock: Mapping[str, Array], warmth: Array | None) -> ScanPath:
    """Return a path (n,) [m] that ends where it begins as one period, with the derivatives of its periodic spline.

    Raise `ModelError` or `RecordError` if it is not periodic, has no even times, or depends on temperature.
    """
    from scipy.interpolate import CubicSpline

    if warmth is not None:
        raise ModelError(argument="table", got="a path with temperatures", need="one without: it is at the reference")
    if not clock:
        raise RecordError(argument="table", got="no times", need="a time of each sample", hint="--columns rate=HERTZ")
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


class _Made(NamedTuple):
    """The plan of each axis, the rows of the file, what is urgent, and further JSON values and lines."""

    plans: Sequence[PathPlan]
    rows: int
    urgent: list[str]
    fields: Mapping[str, Any] = {}
    lines: Sequence[str] = ()
    good: bool = True


@dataclass(frozen=True, eq=False)
class _Task:
    """What was asked for of each axis of a model: limits, slew rate, start, present voltage; `how` to home.

    `gain`: of the amplifier, whose inputs are written too.
    """

    run: Run
    known: AxesModel
    limits: Sequence[Limits]
    slews: Sequence[float | None]
    starts: Sequence[PossibleStart | None]
    present: Sequence[float | None]
    how: Mapping[str, Any]
    zero: float | None
    gain: float | None

    def follow(
        self, wanted: Array, time: Mapping[str, Array], warmth: Array | None, on_time: bool | None, output: Path
    ) -> _Made:
        """Compute and write the voltages of a path (n, axes) [m]."""
        known = self.known
        each = zip(known.actuators, known.targets(wanted).T, self.limits, strict=True)
        urgent = known.prefixed(reach_remarks(*axis, self.zero, warmth) for axis in each)
        path = {"time": time.get("time_s"), "temperature": warmth, "start": self.starts, "present": self.present}
        plans = known.planned(plan_path, wanted, self.limits, self.slews, on_time=on_time, **path, **self.how)
        self.run.progress(f"writing {plans[0].voltage.size} rows")
        clock = starts.clock_columns(plans[0], time)
        write_table(output, {**clock, **_columns(known, plans), **temperature_column(plans[0])}, self.gain)
        return _Made(plans, len(plans[0].voltage), urgent)

    def tabulate(self, path: ScanPath, cycles: int | None, output: Path, steady: Path) -> _Made:
        """Write the wave table of a period with its start-up, and its homing unless a start or --no-home is given."""
        actuator, limits = self.known.actuators[0], self.limits[0]
        urgent = reach_remarks(actuator, path.displacement, limits, self.zero)
        self.run.progress("homing, and the steady cycle")
        given = {"slew_rate": self.slews[0], "start": self.starts[0], "present": self.present[0], **self.how}
        try:
            table = wave_table(actuator, path, limits=limits, cycles=cycles, **given)
        except RecordError as error:
            if error.argument == "cycles":
                error.argument = "start_up"
            raise
        rate, cycle, plan = table.sample_rate, table.cycle, table.plan
        # The cycle follows at once, so that its first sample is not written twice.
        rows = plan.voltage.size - 1
        self.run.progress(f"writing {rows} rows")
        columns = {"time_s": plan.time, "phase": plan.phase, **_columns(self.known, [plan])}
        write_table(output, {name: values[:-1] for name, values in columns.items()}, self.gain)
        write_table(steady, {"time_s": cycle.time, **_columns(self.known, [cycle])}, self.gain)
        line = (
            f"the steady table after {counted(table.cycles, 'cycle')} of start-up, to {table.error * 1e6:.3g} um; "
            f"{counted(len(cycle), 'sample')} a cycle: {steady}"
        )
        fields = {
            "sample_rate_Hz": rate,
            "frequency_Hz": rate / len(cycle),
            "start_up_cycles": table.cycles,
            "cycle_samples": len(cycle),
            "error_um": table.error * 1e6,
            "settled": table.settled,
            "table": str(steady),
        }
        steadies = table.settled and not plan.clamped.any()
        return _Made([replace(plan, warnings=table.warnings)], rows, urgent, fields, [line], bool(steadies))

    def result(self, made: _Made, remarks: Sequence[str], output: Path, added: Sequence[str]) -> Result:
        """Return what to expect of the plans of all axes, and to do, with `added` lines."""
        known, plans = self.known, made.plans
        each = [*zip(known.actuators, plans, self.limits, self.slews, self.present, strict=True)]
        urgent = [*made.urgent, *known.prefixed(starts.before_path(*axis) for axis in each)]
        said = known.prefixed(plan.warnings for plan in plans)
        reasons = known.prefixed(reason_of(plan.promise) for plan in plans)
        urgent += [sentence for sentence in said if _CLAMPED in sentence]
        others = [*remarks, *(sentence for sentence in said if sentence not in {*urgent, *reasons})]
        fields = {
            "samples": made.rows,
            **known.merged([_numbers(*axis) for axis in each]),
            "warnings": [*urgent, *reasons, *others],
            "output": str(output),
            **made.fields,
        }
        spans = (f"{plan.voltage.min():.6g} to {plan.voltage.max():.6g} V" for plan in plans)
        begins = (starts.begin_words(actuator, plan, limits, now) for actuator, plan, limits, _, now in each)
        words = known.prefixed([f"{span} {begin}"] for span, begin in zip(spans, begins, strict=True))
        lines = [
            *known.prefixed([plan.promise.sentence] if plan.promise else [] for plan in plans),
            *reasons,
            *known.prefixed(map(starts.open_start, plans)),
            f"{counted(made.rows, 'sample')}, {', '.join(words)}: {output}",
            *added,
            *made.lines,
        ]
        good = made.good and all(map(_is_good, plans))
        more = [*lines, *others[1:]] if others[1:] else ()
        return Result(fields, lines, more, [*urgent, *others[:1]], good)


def _is_good(plan: PathPlan) -> bool:
    """Return whether a path is followed, with a promise of at most 5 % of the stroke or, without one, a known start."""
    promise = plan.promise
    small = plan.certified if promise is None else promise.largest <= 0.01 * USELESS * promise.stroke
    return plan.followed and small


def _numbers(actuator: Actuator, plan: PathPlan, limits: Limits, slew: float | None, _: float | None) -> dict[str, Any]:
    """Return the plan of an axis as JSON values."""
    return {
        "clamped": int(plan.clamped[plan.first :].sum()),
        "missed_um": float(plan.missed) * 1e6,
        "lowest_V": float(plan.voltage.min()),
        "highest_V": float(plan.voltage.max()),
        "limits_V": list(limits or voltages_of(actuator)),
        "slew_V_per_s": slew,
        **starts.path_start_fields(plan),
        "promise": plan.promise and plan.promise.as_dict(),
        "state": plan.state.as_dict(),
    }


def _columns(known: AxesModel, parts: Sequence[Any]) -> dict[str, Array]:
    """Return the columns of wanted displacement, voltage and expected displacement of each axis."""
    wanted, volts, expected = (
        np.column_stack([getattr(part, name) for part in parts]) for name in ("displacement", "voltage", "expected")
    )
    columns = known.columns("displacement", 1e6 * wanted) | known.columns("voltage", volts)
    return columns | known.columns("displacement", 1e6 * expected, "expected")


def _draw(path: Path, axes: Sequence[str], plans: Sequence[PathPlan], *, command: str) -> None:
    """Write a self-contained HTML page with the plan of each axis."""
    from dehyst.report import pictures
    from dehyst.report.charts import Axis, Chart, Series
    from dehyst.report.html import Charts, Part, document, reproduction, words

    def voltage(plan: PathPlan) -> Chart:
        """Return the voltage along the path, without what comes before it, and its clamped samples."""
        volts, clamped = plan.voltage[plan.first :], plan.clamped[plan.first :]
        axis, x = Axis("sample"), np.arange(volts.size, dtype=np.float64)
        if plan.time is not None:
            axis, x = Axis("time", "s"), plan.time[plan.first :] - plan.time[plan.first]
        series = [Series("voltage", x, volts, "measured")]
        if clamped.any():
            series.append(Series("clamped", x[clamped], volts[clamped], "simulated", "points", width=3))
        return Chart("Voltage", axis, Axis("voltage", "V"), series)

    def parts() -> Iterator[Part]:
        yield "<h1>A planned path</h1>"
        for axis, plan in zip(axes, plans, strict=True):
            yield axis and f"<h2>Axis {escape(axis)}</h2>"
            yield "" if plan.promise is None else f"<p>{words(plan.promise.sentence)}</p>"
            charts = [pictures.planned_path(plan), voltage(plan)]
            charts += [] if plan.promise is None else [pictures.error_band(plan)]
            yield Charts("", f"After {plan.seconds or 0.0:.4g} s that lead to the path.", charts, wide=True)
        yield reproduction(command)

    write_atomically(path, document("A planned path", parts()))
