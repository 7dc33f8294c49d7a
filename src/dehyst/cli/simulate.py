"""`dehyst simulate`: the displacement that a voltage causes."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dehyst._text import counted
from dehyst.cli.axes.inputs import axes_option, is_stage
from dehyst.cli.axes.simulate import simulate_axes
from dehyst.cli.common import (
    PATH,
    conclude,
    force_option,
    json_option,
    read_model,
    refuse_overwriting,
    refuse_replacing,
    write_output,
)
from dehyst.cli.played_voltage import PlayedVoltage
from dehyst.cli.record_files import column_of, columns_options, table_of, time_of_table
from dehyst.cli.start import (
    given_start,
    home_option,
    lagging,
    outside_warnings,
    start_option,
    start_words,
)

if TYPE_CHECKING:
    from dehyst.control import PossibleStart
    from dehyst.model import Actuator


@click.command()
@click.argument("model", type=PATH)
@click.argument("voltage_file", metavar="VOLTAGE", type=PATH)
@click.option("-o", "--output", type=PATH, required=True, help="Write time, voltage and displacement here (CSV).")
@click.option("--lag", is_flag=True, help="Delay the displacement by the delay found at identification.")
@axes_option("those of the records")
@force_option
@start_option
@home_option("Put the shortest homing before the voltages, from 0 V.  [default: no-home]")
@columns_options
@json_option
def simulate(
    model: Path,
    voltage_file: Path,
    output: Path,
    lag: bool,
    axes: str | None,
    start: str | Path | None,
    home: bool | None,
    as_json: bool,
    **columns: Any,
) -> None:
    """Compute the displacement that a VOLTAGE file causes; adds displacement_um.

    Without --start the state before the first sample is unknown: the displacement is that from the middle of the
    possible states, and lowest_um and highest_um bound it. The status is 1 if a voltage lies outside the model's
    limits by more than a tenth of their range, or if --home leaves more than the model's error.
    """
    from dehyst._errors import ModelError

    if is_stage(model):
        if lag or start is not None or home:
            raise ModelError("--lag, --start, --home: got one with a stage, which does not take it; leave it out")
        simulate_axes(model, voltage_file, output, axes, columns, as_json)
    if home and start is not None:
        raise ModelError("--start: got it with --home, which determines the state; leave one out")
    refuse_overwriting([model, voltage_file, *([start] if isinstance(start, Path) else [])], output)
    actuator = read_model(model)
    table = table_of(voltage_file, columns)
    voltage = column_of(table, "voltage", columns)
    time = time_of_table(table, voltage.size, columns)
    given, remarks = (None, []) if start is None else given_start(actuator, start, None, columns["max_bytes"])
    run = _homed(actuator, voltage, time) if home else _from_start(actuator, voltage, time, given)
    written = {"displacement_um": run.expected}
    if run.error is not None and run.homed is None:
        written |= {"lowest_um": run.error.lowest, "highest_um": run.error.highest}
    if lag:
        written = {name: lagging(values, actuator, run.clock) for name, values in written.items()}
    refuse_replacing(output)
    micro = {name: values * 1e6 for name, values in written.items()}
    write_output(output, {**run.clock, "voltage_V": run.voltage, **micro})
    outside, far, warnings = outside_warnings(actuator, voltage)
    warnings += [*remarks, *run.warnings]
    if actuator.delay and not lag:
        warnings.append(
            f"the measured displacement lagged by {actuator.delay * 1e3:.4g} ms, which is left out here; add --lag"
        )
    result = {
        "samples": run.voltage.size,
        "outside": outside,
        "far_outside": far,
        **run.start_dict(),
        "warnings": warnings,
        "state": run.state.as_dict(),
        "output": str(output),
    }
    lines = [f"{counted(run.voltage.size, 'sample')} {run.words}: {output}", *run.error_lines()]
    conclude(as_json, result, lines, warnings)
    sys.exit(1 if far or not run.certified else 0)


def _from_start(actuator: Actuator, voltage: Any, time: dict[str, Any], given: PossibleStart | None) -> PlayedVoltage:
    """Simulate from the start that was given, or from the middle of the possible ones."""
    from dehyst.control import PossibleStart, StartError

    first = float(voltage[0]) if voltage.size else 0.0
    start = PossibleStart.unknown(actuator, first) if given is None else given
    when = time.get("time_s")
    motion = actuator.simulate(voltage, time=when if actuator.needs_time else None, state=start.state, extrapolate=True)
    return PlayedVoltage(
        clock=time,
        voltage=voltage,
        displacement=motion.displacement,
        expected=motion.displacement,
        state=motion.state,
        start=start,
        words=start_words(actuator, start, start.state),
        error=None if start.known else StartError.along(actuator, start.states, voltage, time=when),
    )


def _homed(actuator: Actuator, voltage: Any, time: dict[str, Any]) -> PlayedVoltage:
    """Simulate a homing, and the voltages after it."""
    from dehyst.control import Compensator, home_before_voltage

    compensator = Compensator(actuator, actuator.voltage_range)
    return PlayedVoltage.after_homing(home_before_voltage(compensator, voltage, time=time.get("time_s")))
