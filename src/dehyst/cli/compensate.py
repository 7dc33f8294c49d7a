"""`dehyst compensate`: the voltage that makes an actuator follow a file or a named scan, or a scan's wave table."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dehyst._text import counted
from dehyst.cli.common import (
    PATH,
    columns_options,
    conclude,
    force_option,
    json_option,
    limits_option,
    read_model,
    refuse_overwriting,
    refuse_replacing,
    slew_option,
    time_of_table,
)
from dehyst.cli.scans import NAMES, errors_in_options, named_scan, scan_options
from dehyst.cli.start import Request, file_warnings, start_option, start_within, start_words, state_dict
from dehyst.cli.terminal import progress_line
from dehyst.cli.wave_table import refuse_cycles, tabulate

if TYPE_CHECKING:
    from dehyst.model import Actuator
    from dehyst.waveforms import Scan

_OF_SCANS = ("axis", "cycles", "cycle", *NAMES)
_OF_TABLES = ("homing", "present", "approach", "start_up", "tolerance")


@click.command()
@click.argument("model", type=PATH)
@click.argument("trajectory", type=PATH, required=False)
@click.option("-o", "--output", type=PATH, required=True, help="Write time, displacement and voltage here (CSV).")
@limits_option()
@slew_option
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
@click.option("--homing", is_flag=True, help="With --cycle: begin with the shortest homing, not at --start.")
@click.option("--present", type=float, metavar="V", help="With --homing: present voltage.  [default: 0]")
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
@force_option
@start_option
@columns_options
@json_option
def compensate(
    model: Path,
    trajectory: Path | None,
    output: Path,
    scan: str | None,
    **options: Any,
) -> None:
    """Compute the voltage that makes the actuator follow a TRAJECTORY or a --scan; adds voltage_V, within limits."""
    from dehyst._errors import ModelError

    if (trajectory is None) == (scan is None):
        raise ModelError(f"compensate: got {'neither' if scan is None else 'both'} of TRAJECTORY and --scan, need one")
    _refuse_unused(scan, options)
    table = options.pop("cycle")
    refuse_overwriting([model] if trajectory is None else [model, trajectory], output, table)
    given = {name: options.pop(name) for name in ("limits", "slew", "start", "as_json")}
    request = Request(read_model(model), **given)
    if scan is None:
        _follow(request, _of_file(trajectory, options), output)
    axis, cycles = options["axis"] or "x", 1 if options["cycles"] is None else options["cycles"]
    with errors_in_options():
        path = named_scan(scan or "", options["sample_rate"], options)
        if table is None:
            _follow(request, _of_scan(path, axis, cycles), output, path.warnings)
        tabulate(request, path, axis, cycles, (output, table), options)


def _refuse_unused(scan: str | None, options: dict[str, Any]) -> None:
    """Refuse an option that would have no effect."""
    from dehyst._errors import ModelError

    def first(names: tuple[str, ...]) -> str | None:
        given = [name for name in names if options[name] is not None and options[name] is not False]
        return f"--{given[0].replace('_', '-')}" if given else None

    if scan is None:
        if (unused := first((*_OF_SCANS, *_OF_TABLES))) is not None:
            raise ModelError(f"{unused}: got it with a TRAJECTORY, need --scan for it; leave one out")
        return
    if (unused := first(("displacement", "voltage", "time"))) is not None:
        raise ModelError(f"{unused}: got it with --scan, which has no columns; leave it out")
    if options["cycle"] is None and (unused := first(_OF_TABLES)) is not None:
        raise ModelError(f"{unused}: got it without --cycle; give --cycle TABLE.csv, the file for the steady cycle")
    if options["present"] is not None and not options["homing"]:
        raise ModelError("--present: got it without --homing; give both, or --start")
    given = click.get_current_context().get_parameter_source("start")
    if options["homing"] and given is click.core.ParameterSource.COMMANDLINE:
        raise ModelError("--start: got it with --homing, which determines the state; leave one out")


def _of_file(trajectory: Path | None, options: dict[str, Any]) -> tuple[Any, dict[str, Any], dict[str, Any]]:
    """Return the wanted displacement [m], its time column if there is one, and no derivatives."""
    from dehyst.records import read_table

    table = read_table(trajectory or "", max_bytes=options["max_bytes"])
    wanted = table.column("displacement", options["displacement"])
    return wanted, time_of_table(table, wanted.size, options), {}


def _of_scan(scan: Scan, axis: str, cycles: int) -> tuple[Any, dict[str, Any], dict[str, Any]]:
    """Return the wanted displacement [m], its time and its derivatives."""
    refuse_cycles(scan, cycles)
    path = scan.path(axis)
    if cycles != 1 or path.periodic:
        path = path.repeated(cycles)
    return path.displacement, {"time_s": path.time}, {"velocity": path.velocity, "acceleration": path.acceleration}


def _follow(
    request: Request, path: tuple[Any, dict[str, Any], dict[str, Any]], output: Path, warnings: tuple[str, ...] = ()
) -> None:
    """Write the voltage of a path, and exit."""
    from dehyst.control import Compensator
    from dehyst.control.reachable import state_at
    from dehyst.records import write_columns

    wanted, time, derivatives = path
    actuator, limits, slew, start, _ = request
    _refuse_astray(actuator, wanted, limits)
    begin = start_within(actuator, start, limits)
    # The user ramps slowly to the first sample, see `file_warnings`.
    first = state_at(actuator, begin, float(wanted[0])) if wanted.size and actuator.model.moves_on else begin
    command = Compensator(actuator, limits, slew).trajectory(
        wanted, time=time.get("time_s"), **derivatives, state=first
    )
    progress = progress_line()
    progress(f"writing {wanted.size} rows")
    refuse_replacing(output)
    write_columns(
        output,
        {
            **time,
            "displacement_um": wanted * 1e6,
            "voltage_V": command.voltage,
            "expected_um": command.displacement * 1e6,
        },
    )
    progress("")
    low, high = float(command.voltage.min()), float(command.voltage.max())
    remarks = [*warnings, *command.warnings, *file_warnings(actuator, float(command.voltage[0]), start, begin, slew)]
    result = {
        "samples": wanted.size,
        "clamped": int(command.clamped.sum()),
        "lowest_V": low,
        "highest_V": high,
        "warnings": remarks,
        "state": state_dict(command.state),
        "output": str(output),
    }
    line = (
        f"{counted(wanted.size, 'sample')}, {low:.6g} to {high:.6g} V {start_words(actuator, start, begin)}: {output}"
    )
    conclude(request.as_json, result, line, remarks)
    sys.exit(0 if command.followed else 1)


def _refuse_astray(actuator: Actuator, wanted: Any, limits: tuple[float, float] | None) -> None:
    """Refuse a path more than one stroke outside the reachable range: its unit or its model is another one."""
    from dehyst._errors import ModelError
    from dehyst.control import Compensator

    compensator = Compensator(actuator, limits)
    if compensator.strays(wanted):
        low, high = compensator.reach
        raise ModelError(
            f"displacement: got {1e6 * wanted.min():.6g} to {1e6 * wanted.max():.6g} um, the model reaches "
            f"{1e6 * low:.4g} to {1e6 * high:.4g} um, from the sensor's zero in its records; check the numbers and "
            "their unit"
        )
