"""`compensate`: the voltages that follow a path, or the wave table of a scan."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from dehyst._errors import FileFormatError, ModelError, RecordError, of_part
from dehyst._text import counted
from dehyst._types import Array
from dehyst.control import PathPlan, PossibleStart, VoltageLimits, plan_path, wave_table
from dehyst.control.planning.homing import present_voltage
from dehyst.control.planning.path import MOST_ROWS
from dehyst.model import Actuator, unusable, voltages_of
from dehyst.operations import start as starts
from dehyst.operations.axes import AxesModel, Limit, Present, Slew, is_stage, limits_of, numbers_of, slews_of
from dehyst.operations.declaration import Input, Only, Output, Values, beside, operation
from dehyst.operations.files import AS_FOUND, PATH, TEXT_KEYS, Columns, clock_of, scan_declared, write_table
from dehyst.operations.paths import (
    PathSlew,
    Zero,
    coverage_remarks,
    reach_remarks,
    temperature_column,
    temperature_of,
    zero_of_path,
)
from dehyst.operations.run import Result, Run
from dehyst.operations.start import Limits, Start
from dehyst.operations.waves import refuse_cycles
from dehyst.records import read_table, table_of
from dehyst.waveforms import Scan, ScanPath
from dehyst.waveforms.scans import scan_of

# Part of the reachable range by which a row of a scan's file may differ from the scan.
_WRITTEN = 1e-9


@dataclass(frozen=True, eq=False)
class _AxisRequest:
    """The request for the actuator of an axis; `start` is None if it is unknown."""

    actuator: Actuator
    limits: Limits
    slew: PathSlew
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

    @property
    def allowed(self) -> tuple[float, float]:
        """The effective limits [V]."""
        return self.limits or voltages_of(self.actuator)


def _is_scan(given: Values) -> bool:
    return not is_stage(given["model"]) and scan_declared(given["trajectory"]) is not None


_of_scan = Only(_is_scan, "without the path of a dehyst scan, for a model of one axis")
_of_table = beside("table")
_homes = Only(lambda given: given.get("start") is None and given.get("home") is not False, "without a homing")
_without_table = Only(lambda given: "table" not in given, "with --table, which is at the reference temperature")


@operation(plan_path, rare=("cycles", "on_time", "start_up"))
def compensate(
    run: Run,
    model: Input,
    trajectory: Input,
    *,
    output: Output,
    limits: tuple[Limit, ...] = (),
    slew_rate: tuple[Slew, ...] = (),
    zero: Zero | None = None,
    start: Start | None = None,
    home: bool | None = None,
    home_within: Annotated[float | None, _homes] = None,
    present: tuple[Present, ...] = (),
    on_time: bool | None = None,
    temperature: Annotated[float | None, _without_table] = None,
    table: Annotated[Output | None, _of_scan] = None,
    cycles: Annotated[int, _of_table] = 1,
    start_up: Annotated[int | None, _of_table] = None,
    columns: Columns = AS_FOUND,
) -> Result:
    """Compute the voltage with which the actuator follows a TRAJECTORY, within limits; the output adds voltage_V.

    Without --start the state before the path is unknown: a homing comes first if the start matters, and the error due
    to the start is reported. The status is 1 if the model is not usable, if clamped voltages miss the path by more than
    the promise, or if the error due to the start after --home exceeds the model's error; with --table if a voltage was
    clamped, the cycle is not settled, or the homing is not certified.

    Parameters
    ----------
    trajectory
        A file with a displacement, or the path of dehyst scan.
    output
        Write time, displacement and voltage here (CSV).
    limits
        Allowed voltages [V], of all axes or of one; default: the voltages of the records.
    slew_rate
        Largest slew rate [V/s]; none or default: the path's own speed. Jumps and homings keep to the speed of the
        model's records.
    zero
        Zero of the path: bottom or mean of the reachable range; first: the actuator's start; or a number [um]; default:
        the sensor's zero.
    start
        State before the first sample: turned at the top or bottom of the identified range; relaxed at 0 V; homed, as
        after 'dehyst excite homing --model' without other options; as at the end of FILE (a record, or the voltages
        played before); or as at the beginning of a RECORD; default: unknown.
    home
        Put the shortest homing before the path; the output then has a column phase: 0 homing, 1 the way to the first
        sample, 2 the path. Default: if --start is left out and the error due to the start exceeds the model's error.
    home_within
        Longest duration of the homing [s]; default: as long as the model's error asks for.
    present
        Present voltage [V], of all axes or of one: the output begins there; default: the voltage of --start, else 0 or
        the nearest limit, where a homing begins.
    on_time
        Let the voltage lead the path by the delay of the model; default: if the model's --lag-of is actuator.
    temperature
        Temperature [degC], for a model that depends on it; default: a column temperature_C, or else the
        model's reference.
    table
        Write the steady cycle of a scan here (CSV), a wave table; the output then has a column phase: 0 homing, 1
        start-up, 2 steady cycles.
    cycles
        Steady cycles in the output.
    start_up
        Cycles before the steady ones; default: from the tolerance.
    """
    if start is not None and home:
        raise ModelError(argument="start", got="it with --home, which determines the state", hint="leave one out")
    known = AxesModel.read(run, model)
    axes, remarks = _axes_of(known, limits, slew_rate, start, present, columns)
    places = np.array([zero_of_path(one.actuator, one.limits, zero, one.start, one.present) for one in axes])
    places = known.moved(places[None])[0] if zero is not None and zero.name else places
    if zero is not None:
        words = "the path is counted from {:.6g} um of the sensor, and written in um of the sensor"
        remarks += known.prefixed([words.format(place * 1e6)] for place in places.tolist())
    declared = None if known.stage is not None else scan_declared(trajectory)
    how = {"home": home, "home_within": home_within, "on_time": on_time}
    if declared is None:
        read = table_of(trajectory, columns)
        known.demand(columns, PATH, "on a path")
        wanted = known.values(read, "displacement", columns) + places
        warmth = temperature_of(known, temperature, columns, read, len(wanted), remark=remarks.append)
        clock = clock_of(read, columns)
        try:
            return _follow(run, known, axes, wanted, clock, {}, warmth, output, zero, how, remarks)
        except ModelError as error:
            if error.change or error.argument not in ("", "displacement"):
                raise
            raise of_part(error, trajectory.name) from error
    made, axis, period = _declared_scan(trajectory, declared, columns, float(places[0]))
    if len(made.axes) > 1 and not columns.displacement:
        others = " and ".join(one for one in made.axes if one != axis)
        remarks.append(
            f"the scan has the axes {', '.join(made.axes)}, the model one: {axis} is followed, {others} is not; "
            f"--columns displacement={others.split()[0]}_um takes another"
        )
    if table is None:
        path = period.repeated(declared["cycles"])
        rates = {"velocity": path.velocity, "acceleration": path.acceleration}
        moved, time = path.displacement[:, None], {"time_s": path.time}
        warmth = temperature_of(known, temperature, columns, remark=remarks.append)
        return _follow(run, known, axes, moved, time, rates, warmth, output, zero, how, [*remarks, *made.warnings])
    remarks += reach_remarks(axes[0].actuator, period.displacement, axes[0].limits, zero)
    refuse_cycles(made, cycles)
    how = {"home": home, "home_within": home_within, "cycles": start_up}
    return _tabulate(run, known, axes[0], period, cycles, (output, table), how, remarks)


def _axes_of(
    known: AxesModel,
    limits: Sequence[Limit],
    slew_rate: Sequence[Slew],
    start: Start | None,
    present: Sequence[Present],
    columns: Columns,
) -> tuple[list[_AxisRequest], list[str]]:
    """Return the request for each axis, and remarks on the start."""
    bounds, slews = limits_of(known.axes, limits), slews_of(known.axes, slew_rate)
    begins, remarks = starts.starts_of(known, start, bounds, columns)
    volts, axes = numbers_of(known.axes, present, "present"), []
    for actuator, allowed, slew, begin, given in zip(known.actuators, bounds, slews, begins, volts, strict=True):
        # Beside the given voltage of another axis, that of an unknown start is the default.
        assumed = given is not None or (begin is None and present)
        now = present_voltage(VoltageLimits(*(allowed or voltages_of(actuator))), given) if assumed else None
        stands = begin if begin is None or now is None else begin.standing_at(actuator, now)
        axes.append(_AxisRequest(actuator, allowed, PathSlew.chosen(actuator, slew), stands, now))
    remarks += known.prefixed(coverage_remarks(one.actuator, one.limits) for one in axes)
    return axes, remarks


def _declared_scan(
    path: Path, declared: Mapping[str, Any], columns: Columns, zero: float
) -> tuple[Scan, str, ScanPath]:
    """Return the scan in the first line of a path file, the wanted axis, and its period relative to a zero [m].

    Raise `FileFormatError` if no scan can be made from that line, or the rows of the path are not the scan's.
    """
    columns.demand(("displacement", *TEXT_KEYS), "on the path of a scan")
    hint = "remove that line to follow the rows"
    options = {name: value for name, value in declared.items() if name not in ("kind", "cycles", "sample_rate")}
    try:
        made, cycles = scan_of(declared["kind"], options, declared["sample_rate"]), declared["cycles"]
    except (KeyError, TypeError, ValueError) as error:
        fault = f"nothing known for {error}" if isinstance(error, KeyError) else f"{error}"
        raise FileFormatError(f"{path}: no scan by its first line: {fault}", hint=hint) from error
    names = {"displacement_um": "x", **{f"{axis}_um": axis for axis in made.axes}}
    wanted = columns.displacement or next(iter(names))
    if wanted not in names:
        raise FileFormatError(argument="displacement", got=wanted, need=f"one of {', '.join(names)}")
    axis = names[wanted]
    table, period = read_table(path, columns), made.path(axis)
    rows = period.repeated(cycles)
    written = next(column.data for column in table.columns if names.get(column.name) == axis)
    span = float(np.abs(rows.displacement).max())
    if written.size != len(rows) or np.abs(1e-6 * written - rows.displacement).max() > _WRITTEN * span:
        raise FileFormatError(f"{path}: its rows are not those of the scan in its first line", hint=hint)
    return made, axis, replace(period, displacement=period.displacement + zero)


def _follow(
    run: Run,
    known: AxesModel,
    axes: Sequence[_AxisRequest],
    wanted: Array,
    time: Mapping[str, Array],
    rates: Mapping[str, Array],
    warmth: float | Array | None,
    output: Path,
    zero: Zero | None,
    how: Mapping[str, Any],
    remarks: list[str],
) -> Result:
    """Compute and write the voltages of a path (n, axes) [m]."""
    when = time.get("time_s")
    slews = [one.slew for one in axes]
    targets = known.targets(wanted).T
    pairs = zip(axes, targets, strict=True)
    remarks += known.prefixed(reach_remarks(one.actuator, target, one.limits, zero, warmth) for one, target in pairs)
    paths = known.planned(
        plan_path,
        wanted,
        [one.limits for one in axes],
        [slew.bound for slew in slews],
        {"time": when, **rates, "temperature": warmth, **how},
        start=[one.start for one in axes],
        present=[one.present for one in axes],
    )
    run.progress(f"writing {paths[0].voltage.size} rows")
    write_table(output, _written(known, paths, time))
    return _told(known, axes, paths, len(paths[0].voltage), output, how["home"], remarks)


def _told(
    known: AxesModel,
    axes: Sequence[_AxisRequest],
    paths: Sequence[PathPlan],
    samples: int,
    output: Path,
    home: bool | None,
    remarks: list[str],
) -> Result:
    """Return what is printed of the plans of all axes, in a file of `samples` rows."""
    slews = [request.slew for request in axes]
    each = list(zip(axes, slews, paths, strict=True))
    remarks += known.prefixed(
        starts.path_warnings(request.actuator, path, request.place, slew.bound, stands=request.stands)
        for request, slew, path in each
    )
    clamped = [int(path.clamped.sum()) for path in paths]
    misses = [float(path.missed) for path in paths]
    spans = [(float(path.voltage.min()), float(path.voltage.max())) for path in paths]
    fields = {
        "samples": samples,
        "clamped": known.by_axis(clamped),
        "missed_um": known.by_axis(miss * 1e6 for miss in misses),
        "lowest_V": known.by_axis(low for low, _ in spans),
        "highest_V": known.by_axis(high for _, high in spans),
        "limits_V": known.by_axis(list(request.allowed) for request in axes),
        **known.merged([slew.fields() for slew in slews]),
        **known.merged([starts.path_start_fields(path) for path in paths]),
        "promise": known.by_axis(None if path.promise is None else path.promise.as_dict() for path in paths),
        "warnings": remarks,
        "state": known.by_axis(path.state.as_dict() for path in paths),
        "output": str(output),
    }
    words = []
    for (request, slew, path), (low, high), count, miss in zip(each, spans, clamped, misses, strict=True):
        begin = path.start.within(request.actuator, request.place)
        before = (
            starts.start_words(request.actuator, path.start, begin) if path.homing is None else starts.homed_words(path)
        )
        missed = ""
        if count and not path.followed:
            missed = slew.missed_words(request.allowed, path.voltage[path.first :], miss)
        words.append([f"{low:.6g} to {high:.6g} V {before}{missed}"])
    lines = [
        f"{counted(samples, 'sample')}, {', '.join(known.prefixed(words))}: {output}",
        *known.prefixed([slew.words] for slew in slews),
        *known.prefixed(
            starts.error_lines(path.start.name, path.left_open, homed=path.homing is not None) for path in paths
        ),
        *known.prefixed([] if path.promise is None else [path.promise.sentence] for path in paths),
    ]
    certified = all(path.certified for path in paths)
    usable = not any(unusable(request.actuator, path.promise) for request, path in zip(axes, paths, strict=True))
    good = usable and all(path.followed for path in paths) and (certified or not home)
    return Result(fields, lines, warnings=remarks, good=good)


def _written(known: AxesModel, paths: Sequence[PathPlan], time: Mapping[str, Array]) -> dict[str, Array]:
    """Return the columns of wanted displacement, voltage and expected displacement of each axis."""
    wanted, volts, expected = (
        np.column_stack([getattr(path, name) for path in paths]) for name in ("displacement", "voltage", "expected")
    )
    columns = known.columns("displacement", wanted * 1e6) | known.columns("voltage", volts)
    columns |= known.columns("displacement", expected * 1e6, "expected")
    return {**starts.clock_columns(paths[0], time), **columns, **temperature_column(paths[0])}


def _tabulate(
    run: Run,
    known: AxesModel,
    request: _AxisRequest,
    path: ScanPath,
    cycles: int,
    outputs: tuple[Path, Path],
    how: Mapping[str, Any],
    remarks: list[str],
) -> Result:
    """Write the wave table of a scan with its start-up, and with its homing unless a start or --no-home is given."""
    run.progress("homing, and the steady cycle")
    options = {"limits": request.limits, "slew_rate": request.slew.bound, "present": request.present, **how}
    try:
        table = wave_table(request.actuator, path, start=request.start, **options)
    except RecordError as error:
        if error.argument == "cycles":
            error.argument = "start_up"
        raise
    rows, rate, cycle, plan = table.rows(cycles), table.sample_rate, table.cycle, table.plan
    if plan is None or rows > MOST_ROWS:
        raise RecordError(
            argument="output",
            got=f"{rows} rows at {rate:g} Hz",
            need=f"at most {MOST_ROWS:g} rows",
            hint="try a lower sample rate, fewer cycles or start-up, or the start where the actuator stands",
        )
    played = table.played(cycles)
    run.note(f"{plan.seconds or 0.0:.4g} s before the scan, {table.cycles + cycles} cycles: {rows} rows")
    run.progress(f"writing {rows} rows")
    write_table(outputs[0], {"time_s": played.time, "phase": played.phase, **_path_columns(played)})
    write_table(outputs[1], {"time_s": cycle.time, **_path_columns(cycle)})
    told = _told(known, [request], [replace(plan, warnings=table.warnings)], rows, outputs[0], True, remarks)
    fields = {
        **told.fields,
        "sample_rate_Hz": rate,
        "frequency_Hz": rate / len(cycle),
        "start_up_cycles": table.cycles,
        "cycle_samples": len(cycle),
        "error_um": table.error * 1e6,
        "settled": table.settled,
        "table": str(outputs[1]),
    }
    line = (
        f"the steady table after {counted(table.cycles, 'cycle')} of start-up, to {table.error * 1e6:.3g} um; "
        f"{counted(len(cycle), 'sample')} a cycle: {outputs[1]}"
    )
    lines = [told.lines[0], line, *told.lines[1:]]
    return replace(told, fields=fields, lines=lines, good=told.good and table.settled and not plan.clamped.any())


def _path_columns(part: Any) -> dict[str, Array]:
    return {"displacement_um": part.displacement * 1e6, "voltage_V": part.voltage, "expected_um": part.expected * 1e6}
