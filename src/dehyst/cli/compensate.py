"""`dehyst compensate`: a voltage that makes an actuator follow a file or a named scan, or a scan's wave table."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dehyst._text import counted
from dehyst.cli.common import (
    PATH,
    before_and_after,
    came_from,
    columns_options,
    conclude,
    force_option,
    json_option,
    late_words,
    read_model,
    refuse_overwriting,
    refuse_replacing,
    start_option,
    start_within,
    state_dict,
    time_of_table,
)
from dehyst.cli.option_words import in_options, said_in_options
from dehyst.cli.scans import NAMES, named_scan, scan_options
from dehyst.cli.terminal import note, progress_line

if TYPE_CHECKING:
    from dehyst.control import WaveTable
    from dehyst.model import Actuator
    from dehyst.waveforms import Scan

_OF_SCANS = ("axis", "cycles", "cycle", *NAMES)
# A file of more is of no use to anyone, and is 300 MB.
_MOST_ROWS = 5_000_000
_OF_TABLES = ("homing", "present", "approach", "start_up", "tolerance")


@click.command()
@click.argument("model", type=PATH)
@click.argument("trajectory", type=PATH, required=False)
@click.option("-o", "--output", type=PATH, required=True, help="Write time, displacement and voltage here (CSV).")
@click.option(
    "--limits", type=(float, float), metavar="LOW HIGH", help="Voltages allowed.  [default: those of the records]"
)
@click.option("--slew", type=float, metavar="V/S", help="Largest slew rate.")
@scan_options
@click.option("--axis", type=click.Choice(["x", "y"]), help="Of the scan, which MODEL moves.  [default: x]")
@click.option("--cycles", type=int, metavar="N", help="Of the scan.  [default: 1]")
@click.option(
    "--cycle",
    type=PATH,
    metavar="TABLE",
    help="Write the scan's steady cycle here (CSV); the output then has a "
    "phase: 0 homing, 1 start-up, 2 steady cycles. Status 1 if clipped, not settled, or the homing is not certified.",
)
@click.option("--homing", is_flag=True, help="With --cycle: begin with the shortest homing, not at --start.")
@click.option("--present", type=float, metavar="V", help="With --homing: voltage now.  [default: 0]")
@click.option(
    "--approach", type=float, metavar="S", help="With --cycle: time to its first sample.  [default: shortest]"
)
@click.option(
    "--start-up", type=int, metavar="N", help="With --cycle: cycles before the steady ones.  [default: by --tolerance]"
)
@click.option(
    "--tolerance", type=float, metavar="UM", help="With --cycle: what is left to settle.  [default: 1e-4 of the stroke]"
)
@force_option
@start_option
@columns_options
@json_option
def compensate(
    model: Path,
    trajectory: Path | None,
    output: Path,
    limits: tuple[float, float] | None,
    slew: float | None,
    scan: str | None,
    start: str,
    as_json: bool,
    **options: Any,
) -> None:
    """Voltage that makes the actuator follow a TRAJECTORY or a --scan; adds voltage_V, within limits."""
    from dehyst._errors import ModelError

    if (trajectory is None) == (scan is None):
        raise ModelError(f"compensate: got {'neither' if scan is None else 'both'} of TRAJECTORY and --scan, need one")
    _refuse_idle(scan, options)
    table = options.pop("cycle")
    refuse_overwriting([model] if trajectory is None else [model, trajectory], output, table)
    actuator = read_model(model)
    if scan is None:
        _follow(actuator, _of_file(trajectory, options), output, limits, slew, start, as_json)
    axis, cycles = options["axis"] or "x", 1 if options["cycles"] is None else options["cycles"]
    with said_in_options():
        found = named_scan(scan or "", options["sample_rate"], options)
        if table is None:
            _follow(actuator, _of_scan(found, axis, cycles), output, limits, slew, start, as_json, found.warnings)
        _tabulate(actuator, found, axis, cycles, (output, table), limits, slew, start, as_json, options)


def _refuse_idle(scan: str | None, options: dict[str, Any]) -> None:
    """An option that would do nothing is a mistake."""
    from dehyst._errors import ModelError

    def first(names: tuple[str, ...]) -> str | None:
        given = [name for name in names if options[name] is not None and options[name] is not False]
        return f"--{given[0].replace('_', '-')}" if given else None

    if scan is None:
        if (idle := first((*_OF_SCANS, *_OF_TABLES))) is not None:
            raise ModelError(f"{idle}: got it with a TRAJECTORY, need --scan for it; leave one out")
        return
    if (idle := first(("displacement", "voltage", "time"))) is not None:
        raise ModelError(f"{idle}: got it with --scan, which has no columns; leave it out")
    if options["cycle"] is None and (idle := first(_OF_TABLES)) is not None:
        raise ModelError(f"{idle}: got it without --cycle; give --cycle TABLE.csv, where the steady cycle shall go")
    if options["present"] is not None and not options["homing"]:
        raise ModelError("--present: got it without --homing; give both, or --start")
    given = click.get_current_context().get_parameter_source("start")
    if options["homing"] and given is click.core.ParameterSource.COMMANDLINE:
        raise ModelError("--start: got it with --homing, after which the state is known; leave one out")


def _of_file(trajectory: Path | None, options: dict[str, Any]) -> tuple[Any, dict[str, Any], dict[str, Any]]:
    """Wanted displacement [m], its time column if there is one, and its derivatives: none."""
    from dehyst.records import read_table

    table = read_table(trajectory or "", max_bytes=options["max_bytes"])
    wanted = table.column("displacement", options["displacement"])
    return wanted, time_of_table(table, wanted.size, options), {}


def _of_scan(scan: Scan, axis: str, cycles: int) -> tuple[Any, dict[str, Any], dict[str, Any]]:
    """Wanted displacement [m], its time and its derivatives."""
    _refuse_cycles(scan, cycles)
    path = scan.path(axis)
    if cycles != 1 or path.periodic:
        path = path.repeated(cycles)
    return path.displacement, {"time_s": path.time}, {"velocity": path.velocity, "acceleration": path.acceleration}


def _follow(
    actuator: Actuator,
    path: tuple[Any, dict[str, Any], dict[str, Any]],
    output: Path,
    limits: tuple[float, float] | None,
    slew: float | None,
    start: str,
    as_json: bool,
    warnings: tuple[str, ...] = (),
) -> None:
    """Write the voltage of a path, and end."""
    from dehyst.control import Compensator
    from dehyst.control.reachable import state_at
    from dehyst.records import write_columns

    wanted, time, derivatives = path
    _refuse_astray(actuator, wanted, limits)
    begin = start_within(actuator, start, limits)
    # The way to the first sample is to be ramped slowly, as is said below.
    first = state_at(actuator, begin, float(wanted[0])) if wanted.size and actuator.model.moves_on else begin
    command = Compensator(actuator, limits, slew).trajectory(
        wanted, time=time.get("time_s"), **derivatives, state=first
    )
    tell = progress_line()
    tell(f"writing {wanted.size} rows")
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
    tell("")
    low, high = float(command.voltage.min()), float(command.voltage.max())
    said = [*warnings, *command.warnings, *before_and_after(actuator, float(command.voltage[0]), start, begin, slew)]
    result = {
        "samples": wanted.size,
        "clamped": int(command.clamped.sum()),
        "lowest_V": low,
        "highest_V": high,
        "warnings": said,
        "state": state_dict(command.state),
        "output": str(output),
    }
    line = f"{counted(wanted.size, 'sample')}, {low:.6g} to {high:.6g} V {came_from(actuator, start, begin)}: {output}"
    conclude(as_json, result, line, said)
    sys.exit(0 if command.followed else 1)


def _tabulate(
    actuator: Actuator,
    scan: Scan,
    axis: str,
    cycles: int,
    outputs: tuple[Path, Path],
    limits: tuple[float, float] | None,
    slew: float | None,
    start: str,
    as_json: bool,
    options: dict[str, Any],
) -> None:
    """Write the wave table of a scan and what comes before it, and end."""
    from dehyst._errors import RecordError
    from dehyst.control import wave_table
    from dehyst.records import write_columns

    _refuse_cycles(scan, cycles)
    tolerance, tell = options["tolerance"], progress_line()
    if tolerance is not None and not tolerance > 0:
        raise RecordError(f"--tolerance: got {tolerance:g}, need a length above 0 in um")
    tell("homing, and the steady cycle")
    try:
        table = wave_table(
            actuator,
            scan,
            axis=axis,
            limits=limits,
            slew_rate=slew,
            state=None if options["homing"] else start_within(actuator, start, limits),
            present=options["present"],
            approach=options["approach"],
            cycles=options["start_up"],
            tolerance=None if tolerance is None else tolerance * 1e-6,
        )
    finally:
        tell("")
    _tell_long(table, cycles)
    tell(f"writing {table.rows(cycles)} rows")
    played, cycle = table.played(cycles), table.cycle
    refuse_replacing(*outputs)
    write_columns(outputs[0], {"time_s": played.time, "phase": played.phase, **_columns(played)})
    write_columns(outputs[1], {"time_s": cycle.time, **_columns(cycle)})
    tell("")
    said = [*map(in_options, table.warnings), *_before(actuator, table, start, limits, slew)]
    low, high = float(played.voltage.min()), float(played.voltage.max())
    result = {
        "samples": played.voltage.size,
        "sample_rate_Hz": table.sample_rate,
        "frequency_Hz": 1 / scan.period,
        "homing_samples": table.homing_rows.size,
        "homing_s": _homing_seconds(table),
        "start_up_samples": len(table.start_up),
        "start_up_cycles": table.cycles,
        "cycle_samples": len(cycle),
        "error_um": table.error * 1e6,
        "unknown_um": table.unknown * 1e6,
        "certified": table.certified,
        "settled": table.settled,
        "clamped": table.clamped,
        "lowest_V": low,
        "highest_V": high,
        "warnings": said,
        "state": state_dict(table.state),
        "output": str(outputs[0]),
        "table": str(outputs[1]),
    }
    cycles_of = f"{table.cycles} cycle{'s' * (table.cycles != 1)} of start-up, to {table.error * 1e6:.3g} um"
    line = (
        f"{counted(played.voltage.size, 'sample')}, {low:.6g} to {high:.6g} V, the steady table after {cycles_of}: "
        f"{outputs[0]}; {counted(len(cycle), 'sample')} a cycle: {outputs[1]}"
    )
    conclude(as_json, result, line, said)
    sys.exit(0 if table.settled and table.certified and not table.clamped else 1)


def _refuse_astray(actuator: Actuator, wanted: Any, limits: tuple[float, float] | None) -> None:
    """A path more than one stroke outside of what can be reached is meant for another unit, or for another model."""
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


def _columns(part: Any) -> dict[str, Any]:
    return {"displacement_um": part.displacement * 1e6, "voltage_V": part.voltage, "expected_um": part.expected * 1e6}


def _before(
    actuator: Actuator, table: WaveTable, start: str, limits: tuple[float, float] | None, slew: float | None
) -> list[str]:
    """What the file cannot hold."""
    if table.homing is not None:
        return late_words(actuator)
    begin = start_within(actuator, start, limits)
    return before_and_after(actuator, float(table.start_up.voltage[0]), start, begin, slew)


def _homing_seconds(table: WaveTable) -> float:
    return 0.0 if table.homing is None else table.homing.duration


def _refuse_cycles(scan: Scan, cycles: int) -> None:
    from dehyst._errors import RecordError

    if cycles < 0:
        raise RecordError(f"--cycles: got {cycles}, need a whole number, 0 or more")
    if scan.samples > _MOST_ROWS:
        raise RecordError(
            f"--scan: got {scan.samples} rows a period at {scan.rate:g} Hz, need {_MOST_ROWS:g} at most; try a lower "
            "--sample-rate, or a scan of fewer lines"
        )
    if cycles * scan.samples > _MOST_ROWS:
        raise RecordError(
            f"--cycles: got {cycles}, {cycles * scan.samples:.4g} rows, need {_MOST_ROWS // scan.samples} at most "
            f"({_MOST_ROWS:g} rows); repeat one cycle instead"
        )


def _tell_long(table: WaveTable, cycles: int) -> None:
    """Say how long what is written takes; raises RecordError if that is more than a file should hold."""
    from dehyst._errors import RecordError

    rows, rate = table.rows(cycles), table.sample_rate
    parts = (
        (_homing_seconds(table), "homing"),
        (len(table.start_up) / rate, "start-up"),
        (cycles * len(table.cycle) / rate, "cycles"),
    )
    said = ", ".join(f"{seconds:.4g} s of {name}" for seconds, name in parts if seconds)
    if rows > _MOST_ROWS:
        raise RecordError(
            f"--output: got {said}, {rows} rows at {rate:g} Hz, need {_MOST_ROWS:g} rows at most; try a lower "
            "--sample-rate, fewer --cycles or --start-up, or no --homing and --start where the actuator stands"
        )
    note(f"{said}: {rows} rows")
    homing = table.homing
    if homing is not None and table.homing_rows.size < homing.duration * rate - 0.5:
        note(
            f"the homing has {table.homing_rows.size} rows, {1 / homing.sample_rate:.3g} s or more apart: play it "
            "by its time column, straight from row to row"
        )
