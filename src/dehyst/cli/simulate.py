"""`dehyst simulate`: the displacement that a voltage causes."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from dehyst.cli.common import (
    PATH,
    columns_options,
    conclude,
    force_option,
    json_option,
    read_model,
    refuse_overwriting,
    refuse_replacing,
    time_of_table,
)
from dehyst.cli.start import lagging, outside_warnings, start_option, start_state, start_words, state_dict


@click.command()
@click.argument("model", type=PATH)
@click.argument("voltage_file", metavar="VOLTAGE", type=PATH)
@click.option("-o", "--output", type=PATH, required=True, help="Write time, voltage and displacement here (CSV).")
@click.option("--lag", is_flag=True, help="Delay the displacement by the delay found at identification.")
@force_option
@start_option
@columns_options
@json_option
def simulate(
    model: Path, voltage_file: Path, output: Path, lag: bool, start: str, as_json: bool, **columns: Any
) -> None:
    """Compute the displacement that a VOLTAGE file causes; adds displacement_um.

    The status is 1 if a voltage lies outside the model's limits by more than a tenth of their range.
    """
    from dehyst.records import read_table, write_columns

    refuse_overwriting([model, voltage_file], output)
    actuator = read_model(model)
    table = read_table(voltage_file, max_bytes=columns["max_bytes"])
    voltage = table.column("voltage", columns["voltage"])
    time = time_of_table(table, voltage.size, columns)
    motion = actuator.simulate(
        voltage,
        time=time.get("time_s") if actuator.needs_time else None,
        state=start_state(actuator, start),
        extrapolate=True,
    )
    displacement = lagging(motion.displacement, actuator, time) if lag else motion.displacement
    refuse_replacing(output)
    write_columns(output, {**time, "voltage_V": voltage, "displacement_um": displacement * 1e6})
    outside, far, warnings = outside_warnings(actuator, voltage)
    if actuator.delay and not lag:
        warnings.append(
            f"the measured displacement lagged by {actuator.delay * 1e3:.4g} ms, which is left out here; add --lag"
        )
    result = {
        "samples": voltage.size,
        "outside": outside,
        "far_outside": far,
        "warnings": warnings,
        "state": state_dict(motion.state),
        "output": str(output),
    }
    conclude(as_json, result, f"{voltage.size} samples {start_words(actuator, start)}: {output}", warnings)
    sys.exit(1 if far else 0)
