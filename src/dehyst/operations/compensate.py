"""`compensate`: the voltages that follow a path, or the wave table of a scan."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dehyst._errors import FileFormatError, ModelError, RecordError, of_part
from dehyst._io import write_atomically
from dehyst._text import counted, escape
from dehyst._types import Array
from dehyst.control import PathPlan, PossibleStart, VoltageLimits, plan_path, wave_table
from dehyst.control.planning.ways import MOST_ROWS, present_voltage
from dehyst.model import Actuator, voltages_of
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
from dehyst.operations.files import COLUMNS, Columns, scan_declared, write_table
from dehyst.operations.paths import (
    ZERO,
    reach_remarks,
    read_path,
    reason_of,
    temperature_column,
)
from dehyst.operations.run import Result, Run, files
from dehyst.operations.start import START, Start
from dehyst.operations.waves import refuse_cycles
from dehyst.records import read_table
from dehyst.waveforms import Scan, ScanPath
from dehyst.waveforms.scans import scan_of

# How the library begins a remark on a path that is missed by more than its promise.
_CLAMPED = "CLAMPED"
# Part of the reachable range by which a row of a scan's file may differ from the scan.
_WRITTEN = 1e-9
_PRESENT = AxisNumber("[AXIS=]V")


class _Request(NamedTuple):
    """The request for the actuator of an axis; `start` is None if it is unknown, `present` [V] if it is not given."""

    actuator: Actuator
    limits: Limits
    slew: float | None
    start: PossibleStart | None
    present: float | None

    @property
    def stands(self) -> bool:
        """Whether its start or its present voltage is given."""
        return self.start is not None or self.present is not None

    @property
    def place(self) -> Limits:
        """Range of the voltage [V] before the path: the limits, or the present voltage."""
        return self.limits if self.present is None else (self.present, self.present)


def _of_scan(given: Values) -> str:
    scans = not of_one_axis(given) and scan_declared(given["trajectory"]) is not None
    return "" if scans else "without the path of a dehyst scan, for a model of one axis"


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
    table: Path | None = option("Write the steady cycle of a scan here (CSV).", OUTPUT, _of_scan),
    cycles: int = integer("Steady cycles in the output.", beside("table"), default=1),
    start_up: int | None = integer("Cycles before these; default: as needed.", beside("table")),
    plot: Path | None = option("Draw path, voltage and promise here (HTML).", PAGE),
    columns: Columns = COLUMNS,
) -> Result:
    """Compute the voltage with which the actuator follows a TRAJECTORY, within limits; the output adds voltage_V.

    Jumps and homings keep to the speed of the model's records. Column phase: 0 homing, 1 way or start-up, 2 path. The
    status is 1 if the model is not usable, the path is missed by more than the promise, or a homing leaves the start
    open; with --table also if a voltage is clamped or the cycle is not settled.
    """
    if start is not None and home:
        raise ModelError(argument="start", got="it with --home, which determines the state", hint="leave one out")
    known = AxesModel.read(run, model)
    slews, kept = known.slews(slew_rate)
    axes, remarks = _requests(known, limits, slews, start, present, columns)
    place = 1e-6 * (zero or 0.0)
    if zero is not None:
        remarks.append(f"the path is counted from {zero:.6g} um of the sensor, and written in um of the sensor")
    task = _Task(run, known, axes, zero, remarks, kept, plot)
    how: dict[str, Any] = {"home": home, "home_within": home_within}
    if table is None:
        wanted, warmth, clock = read_path(known, trajectory, columns, remark=remarks.append)
        try:
            return task.follow(wanted + place, clock, output, on_time=on_time, temperature=warmth, **how)
        except ModelError as error:
            if error.change or error.argument not in ("", "displacement"):
                raise
            raise of_part(error, trajectory.name) from error
    made, period = _declared_scan(trajectory, columns, place)
    refuse_cycles(made, cycles)
    return task.tabulate(period, cycles, (output, table), cycles=start_up, **how)


def _requests(
    known: AxesModel,
    limits: AxisLimits,
    slews: Sequence[float | None],
    start: Start | None,
    present: AxisNumbers,
    columns: Columns,
) -> tuple[list[_Request], list[str]]:
    """Return the request for each axis, and remarks on the start."""
    bounds = limits_of(known.axes, limits)
    begins, remarks = starts.starts_of(known, start, bounds, columns)
    volts, axes = of_axes(known.axes, present, "present"), []
    for actuator, allowed, slew, begin, given in zip(known.actuators, bounds, slews, begins, volts, strict=True):
        # Beside the given voltage of another axis, that of an unknown start is the default.
        assumed = given is not None or (begin is None and present)
        now = present_voltage(VoltageLimits(*(allowed or voltages_of(actuator))), given) if assumed else None
        stands = begin if begin is None or now is None else begin.standing_at(actuator, now)
        axes.append(_Request(actuator, allowed, slew, stands, now))
    return axes, remarks


def _declared_scan(path: Path, columns: Columns, zero: float) -> tuple[Scan, ScanPath]:
    """Return the scan in the first line of a path file, and its period along the wanted axis relative to a zero [m].

    Raise `FileFormatError` if no scan can be made from that line, or the rows of the path are not the scan's.
    """
    columns.demand(("displacement", "decimal"), "on the path of a scan")
    hint, declared = "write it again with dehyst scan", scan_declared(path) or {}
    options = {name: value for name, value in declared.items() if name not in ("kind", "cycles", "sample_rate")}
    try:
        made, cycles = scan_of(declared["kind"], options, declared["sample_rate"]), declared["cycles"]
    except (KeyError, TypeError, ValueError) as error:
        fault = f"nothing known for {error}" if isinstance(error, KeyError) else f"{error}"
        raise FileFormatError(f"{path}: no scan by its first line: {fault}", hint=hint) from error
    names = {f"{axis}_um": axis for axis in made.axes} if len(made.axes) > 1 else {"displacement_um": "x"}
    wanted = columns.displacement or "displacement_um"
    if wanted not in names:
        raise FileFormatError(argument="displacement", got=wanted, need=f"one of {', '.join(names)}")
    axis = names[wanted]
    table, period = read_table(path, columns), made.path(axis)
    rows = period.repeated(cycles)
    written = next(column.data for column in table.columns if names.get(column.name) == axis)
    span = float(np.abs(rows.displacement).max())
    if written.size != len(rows) or np.abs(1e-6 * written - rows.displacement).max() > _WRITTEN * span:
        raise FileFormatError(f"{path}: its rows are not those of the scan in its first line", hint=hint)
    return made, replace(period, displacement=period.displacement + zero)


@dataclass(frozen=True, eq=False)
class _Task:
    """A path for the axes of a model: what was asked for, remarks, lines on slew rates, and where it is drawn."""

    run: Run
    known: AxesModel
    axes: Sequence[_Request]
    zero: float | None
    remarks: list[str]
    kept: list[str]
    plot: Path | None

    def follow(self, wanted: Array, time: Mapping[str, Array], output: Path, **how: Any) -> Result:
        """Compute and write the voltages of a path (n, axes) [m]."""
        known, axes = self.known, self.axes
        pairs = zip(axes, known.targets(wanted).T, strict=True)
        urgent = known.prefixed(
            reach_remarks(each.actuator, target, each.limits, self.zero, how["temperature"]) for each, target in pairs
        )
        limits, slews = [each.limits for each in axes], [each.slew for each in axes]
        how |= {"start": [each.start for each in axes], "present": [each.present for each in axes]}
        plans = known.planned(plan_path, wanted, limits, slews, time=time.get("time_s"), **how)
        self.run.progress(f"writing {plans[0].voltage.size} rows")
        write_table(output, _written(known, plans, time))
        return self.result(plans, len(plans[0].voltage), output, urgent)

    def tabulate(self, path: ScanPath, repeats: int, outputs: tuple[Path, Path], **how: Any) -> Result:
        """Write the wave table of a scan with its start-up, and its homing unless a start or --no-home is given."""
        (request,) = self.axes
        urgent = reach_remarks(request.actuator, path.displacement, request.limits, self.zero)
        self.run.progress("homing, and the steady cycle")
        how |= {"limits": request.limits, "slew_rate": request.slew, "present": request.present}
        try:
            table = wave_table(request.actuator, path, start=request.start, **how)
        except RecordError as error:
            if error.argument == "cycles":
                error.argument = "start_up"
            raise
        rows, rate, cycle, plan = table.rows(repeats), table.sample_rate, table.cycle, table.plan
        if plan is None or rows > MOST_ROWS:
            got, need = f"{rows} rows at {rate:g} Hz", f"at most {MOST_ROWS:g} rows"
            hint = "try a lower sample rate, fewer cycles or start-up, or the start where the actuator stands"
            raise RecordError(argument="output", got=got, need=need, hint=hint)
        played = table.played(repeats)
        self.run.progress(f"writing {rows} rows")
        write_table(outputs[0], {"time_s": played.time, "phase": played.phase, **_path_columns(played)})
        write_table(outputs[1], {"time_s": cycle.time, **_path_columns(cycle)})
        line = (
            f"the steady table after {counted(table.cycles, 'cycle')} of start-up, to {table.error * 1e6:.3g} um; "
            f"{counted(len(cycle), 'sample')} a cycle: {outputs[1]}"
        )
        found = self.result([replace(plan, warnings=table.warnings)], rows, outputs[0], urgent, line)
        fields = {
            **found.fields,
            "sample_rate_Hz": rate,
            "frequency_Hz": rate / len(cycle),
            "start_up_cycles": table.cycles,
            "cycle_samples": len(cycle),
            "error_um": table.error * 1e6,
            "settled": table.settled,
            "table": str(outputs[1]),
        }
        return replace(found, fields=fields, good=found.good and table.settled and not plan.clamped.any())

    def result(self, plans: Sequence[PathPlan], samples: int, output: Path, urgent: list[str], *added: str) -> Result:
        """Return what to expect of the plans of all axes, and to do, with `added` lines; a file has `samples` rows."""
        known, each = self.known, [*zip(self.axes, plans, strict=True)]
        urgent += known.prefixed(
            starts.before_path(request.actuator, plan, request.place, request.slew, stands=request.stands)
            for request, plan in each
        )
        said = known.prefixed(plan.warnings for plan in plans)
        reasons = known.prefixed(reason_of(plan.promise) for plan in plans)
        urgent += [sentence for sentence in said if _CLAMPED in sentence]
        others = [*self.remarks, *(sentence for sentence in said if sentence not in {*urgent, *reasons})]
        fields = {
            "samples": samples,
            "clamped": known.by_axis(int(plan.clamped[plan.first :].sum()) for plan in plans),
            "missed_um": known.by_axis(float(plan.missed) * 1e6 for plan in plans),
            "lowest_V": known.by_axis(float(plan.voltage.min()) for plan in plans),
            "highest_V": known.by_axis(float(plan.voltage.max()) for plan in plans),
            "limits_V": known.by_axis(list(request.limits or voltages_of(request.actuator)) for request in self.axes),
            "slew_V_per_s": known.by_axis(request.slew for request in self.axes),
            **known.merged([starts.path_start_fields(plan) for plan in plans]),
            "promise": known.by_axis(plan.promise and plan.promise.as_dict() for plan in plans),
            "warnings": [*urgent, *reasons, *others],
            "state": known.by_axis(plan.state.as_dict() for plan in plans),
            "output": str(output),
        }
        if self.plot is not None:
            self.run.progress("drawing the path")
            _draw(self.plot, known.axes, plans, command=self.run.command)
        spans = (f"{plan.voltage.min():.6g} to {plan.voltage.max():.6g} V" for plan in plans)
        begins = (starts.begin_words(request.actuator, plan, request.place) for request, plan in each)
        words = known.prefixed([f"{span} {begin}"] for span, begin in zip(spans, begins, strict=True))
        lines = [
            *known.prefixed([plan.promise.sentence] if plan.promise else [] for plan in plans),
            *reasons,
            *known.prefixed(map(starts.open_start, plans)),
            f"{counted(samples, 'sample')}, {', '.join(words)}: {output}",
            *files(Picture=self.plot),
            *self.kept,
            *added,
        ]
        usable = not any(plan.promise is not None and plan.promise.unusable for plan in plans)
        good = usable and all(plan.followed and plan.certified for plan in plans)
        more = [*lines, *others[1:]] if others[1:] else ()
        return Result(fields, lines, more, [*urgent, *others[:1]], good)


def _written(known: AxesModel, plans: Sequence[PathPlan], time: Mapping[str, Array]) -> dict[str, Array]:
    """Return the columns of wanted displacement, voltage and expected displacement of each axis."""
    each = [*zip(known.axes, plans, strict=True)]
    columns = {known.name("displacement", axis): plan.displacement * 1e6 for axis, plan in each}
    columns |= {known.name("voltage", axis): plan.voltage for axis, plan in each}
    columns |= {known.name("displacement", axis, "expected"): plan.expected * 1e6 for axis, plan in each}
    return {**starts.clock_columns(plans[0], time), **columns, **temperature_column(plans[0])}


def _path_columns(part: Any) -> dict[str, Array]:
    return {"displacement_um": part.displacement * 1e6, "voltage_V": part.voltage, "expected_um": part.expected * 1e6}


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
