"""`dehyst compensate`: the voltage that makes an actuator follow a file or a named scan, or a scan's wave table."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dehyst._text import counted
from dehyst.cli.axes.compensate import compensate_axes
from dehyst.cli.axes.inputs import axes_option, axis_bounds_options, is_stage, refuse_axis_bounds
from dehyst.cli.common import (
    PATH,
    conclude,
    force_option,
    json_option,
    limits_option,
    read_model,
    refuse_overwriting,
    refuse_replacing,
    slew_option,
    write_output,
)
from dehyst.cli.output.terminal import progress_line
from dehyst.cli.played_voltage import WantedPath, path_columns, path_voltages
from dehyst.cli.record_files import COLUMNS, column_of, columns_options, table_of, time_of_table
from dehyst.cli.scans import NAMES, errors_in_options, named_scan, scan_options
from dehyst.cli.start import Request, given_start, home_option, start_option
from dehyst.cli.wave_table import refuse_cycles, tabulate
from dehyst.cli.zero import outside_reach, refuse_astray, scan_from_zero, zero_of_path, zero_option

if TYPE_CHECKING:
    from dehyst.model import Actuator
    from dehyst.waveforms import Scan

_OF_SCANS = ("axis", "cycles", "cycle", *NAMES)
_OF_FILES = tuple(name for name in COLUMNS if name not in ("sample_rate", "max_bytes"))
_OF_TABLES = ("approach", "start_up", "tolerance")
_HOME = (
    "Put the shortest homing before the path; the output then has a column phase: 0 homing, 1 the way to the first "
    "sample, 2 the path.  [default: if --start is left out and the start matters more than the model's error]"
)


@click.command()
@click.argument("model", type=PATH)
@click.argument("trajectory", type=PATH, required=False)
@click.option("-o", "--output", type=PATH, required=True, help="Write time, displacement and voltage here (CSV).")
@limits_option()
@slew_option
@axis_bounds_options
@scan_options
@click.option("--axis", type=click.Choice(["x", "y"]), help="Axis of the scan that MODEL moves.  [default: x]")
@click.option("--cycles", type=int, metavar="N", help="Cycles of the scan.  [default: 1]")
@click.option(
    "--cycle",
    type=PATH,
    metavar="TABLE",
    help="Write the scan's steady cycle here (CSV); the output then has a column "
    "phase: 0 homing, 1 start-up, 2 steady cycles. Status 1 if clipped, not settled, or the homing is not certified.",
)
@zero_option("From where the path is counted: bottom or mean of the reachable range, first: where the actuator starts.")
@home_option(_HOME)
@click.option("--present", type=float, metavar="V", help="Voltage before the homing.  [default: 0]")
@click.option(
    "--approach", type=float, metavar="S", help="With --cycle: time to its first sample.  [default: shortest]"
)
@click.option(
    "--start-up", type=int, metavar="N", help="With --cycle: cycles before the steady ones.  [default: by --tolerance]"
)
@click.option(
    "--tolerance",
    type=float,
    metavar="UM",
    help="With --cycle: error left by the start-up.  [default: 1e-4 of the stroke]",
)
@axes_option("those of the records")
@force_option
@start_option
@columns_options
@json_option
def compensate(
    model: Path,
    trajectory: Path | None,
    output: Path,
    scan: str | None,
    axes: str | None,
    **options: Any,
) -> None:
    """Compute the voltage that makes the actuator follow a TRAJECTORY or a --scan; adds voltage_V, within limits.

    Without --start the state before the path is unknown: a homing comes first where that matters, and what the start
    leaves open is reported. The status is 1 if a voltage was clamped, or --home leaves more than the model's error.
    """
    from dehyst._errors import ModelError

    if (trajectory is None) == (scan is None):
        raise ModelError(f"compensate: got {'neither' if scan is None else 'both'} of TRAJECTORY and --scan, need one")
    if is_stage(model):
        with errors_in_options():
            compensate_axes(model, trajectory, output, scan, axes, options)
    refuse_axis_bounds(options)
    _refuse_unused(scan, options)
    table = options.pop("cycle")
    inputs = [path for path in (model, trajectory, options["start"]) if isinstance(path, Path)]
    refuse_overwriting(inputs, output, table)
    zero = options.pop("zero")
    request, remarks = _request(read_model(model), options)
    place = zero_of_path(request, zero)
    if zero is not None:
        remarks.append(f"the path is counted from {place * 1e6:.6g} um of the sensor, and written in um of the sensor")
    if scan is None:
        wanted, time, derivatives = _of_file(trajectory, options)
        _follow(request, (wanted + place, time, derivatives), output, zero, tuple(remarks))
    options = scan_from_zero(options, place)
    axis, cycles = options["axis"] or "x", 1 if options["cycles"] is None else options["cycles"]
    with errors_in_options():
        path = named_scan(scan or "", options["sample_rate"], options)
        if table is None:
            _follow(request, _of_scan(path, axis, cycles), output, zero, (*remarks, *path.warnings))
        wanted = path.path(axis).displacement
        remarks += _reach_remarks(request, wanted, zero)
        tabulate(request, path, axis, cycles, (output, table), options, remarks)


def _request(actuator: Actuator, options: dict[str, Any]) -> tuple[Request, list[str]]:
    """Return what is asked for, and remarks on the start."""
    given = {name: options.pop(name) for name in ("limits", "slew", "start", "home", "present", "as_json")}
    remarks: list[str] = []
    if given["start"] is not None:
        given["start"], remarks = given_start(actuator, given["start"], given["limits"], options["max_bytes"])
    return Request(actuator, **given), remarks


def _refuse_unused(scan: str | None, options: dict[str, Any]) -> None:
    """Refuse an option that would have no effect."""
    from dehyst._errors import ModelError

    if options["start"] is not None and options["home"]:
        raise ModelError("--start: got it with --home, which determines the state; leave one out")
    if options["present"] is not None and (options["start"] is not None or options["home"] is False):
        other = "--start" if options["home"] is None else "--no-home"
        raise ModelError(f"--present: got it with {other}, without a homing; leave one out")

    def first(names: tuple[str, ...]) -> str | None:
        given = [name for name in names if options[name] is not None and options[name] is not False]
        return f"--{given[0].replace('_', '-')}" if given else None

    if scan is None:
        if (unused := first((*_OF_SCANS, *_OF_TABLES))) is not None:
            raise ModelError(f"{unused}: got it with a TRAJECTORY, need --scan for it; leave one out")
        return
    if (unused := first(_OF_FILES)) is not None:
        raise ModelError(f"{unused}: got it with --scan, which has no columns; leave it out")
    if options["cycle"] is None and (unused := first(_OF_TABLES)) is not None:
        raise ModelError(f"{unused}: got it without --cycle; give --cycle TABLE.csv, the file for the steady cycle")


def _reach_remarks(request: Request, wanted: Any, zero: str | float | None) -> list[str]:
    """Refuse a path far outside of the reachable range; return a remark if it lies outside at all."""
    refuse_astray(request.actuator, wanted, request.limits, zero)
    return outside_reach(request.actuator, wanted, request.limits, zero)


def _of_file(trajectory: Path | None, options: dict[str, Any]) -> WantedPath:
    """Return the wanted displacement [m], its time column if there is one, and no derivatives."""
    table = table_of(trajectory or Path(), options)
    wanted = column_of(table, "displacement", options)
    return wanted, time_of_table(table, wanted.size, options), {}


def _of_scan(scan: Scan, axis: str, cycles: int) -> WantedPath:
    """Return the wanted displacement [m], its time and its derivatives."""
    refuse_cycles(scan, cycles)
    path = scan.path(axis)
    if cycles != 1 or path.periodic:
        path = path.repeated(cycles)
    return path.displacement, {"time_s": path.time}, {"velocity": path.velocity, "acceleration": path.acceleration}


def _follow(
    request: Request,
    path: WantedPath,
    output: Path,
    zero: str | float | None,
    warnings: tuple[str, ...] = (),
) -> None:
    """Write the voltage of a path, and exit."""
    from dehyst.control import Compensator

    warnings = (*warnings, *_reach_remarks(request, path[0], zero))
    answer = path_voltages(request, Compensator(request.actuator, request.limits, request.slew), path)
    voltage = answer.voltage
    progress = progress_line()
    progress(f"writing {voltage.size} rows")
    refuse_replacing(output)
    write_output(output, {**answer.clock, **path_columns(answer)})
    progress("")
    low, high = float(voltage.min()), float(voltage.max())
    remarks = [*warnings, *answer.warnings]
    result = {
        "samples": voltage.size,
        "clamped": answer.clamped,
        "lowest_V": low,
        "highest_V": high,
        **answer.start_dict(),
        "warnings": remarks,
        "state": answer.state.as_dict(),
        "output": str(output),
    }
    lines = [f"{counted(voltage.size, 'sample')}, {low:.6g} to {high:.6g} V {answer.words}: {output}"]
    lines += answer.error_lines()
    conclude(request.as_json, result, lines, remarks)
    sys.exit(0 if answer.followed and (answer.certified or not request.home) else 1)
