"""`dehyst simulate` with a stage file: displacements of all axes."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dehyst._text import counted
from dehyst.cli.axes.inputs import OWN_START, columns_of, load, named
from dehyst.cli.common import conclude, refuse_overwriting, refuse_replacing, write_output
from dehyst.cli.record_files import table_of, time_of_table

if TYPE_CHECKING:
    from dehyst.stages import Stage


def simulate_axes(
    model: Path, voltage_file: Path, output: Path, axes: str | None, columns: dict[str, Any], as_json: bool
) -> None:
    """Write the displacements of all axes of a stage, and exit."""
    refuse_overwriting([model, voltage_file], output)
    stage = load(model)
    table = table_of(voltage_file, columns)
    voltage = columns_of(table, stage, axes, "voltage", columns)
    clock = time_of_table(table, len(voltage), columns)
    trace = stage.simulate(voltage, time=clock.get("time_s"), extrapolate=True)
    low, high = _limits(stage)
    outside = int(((voltage < low) | (voltage > high)).any(axis=1).sum())
    warnings = [f"{outside} samples lie outside of the identified voltages: extrapolated"] if outside else []
    refuse_replacing(output)
    write_output(output, {**clock, **named(stage, voltage, "voltage"), **named(stage, trace.displacement * 1e6)})
    lines = f"{counted(len(voltage), 'sample')} of {len(stage.axes)} axes, from {OWN_START}: {output}"
    result = {"samples": len(voltage), "axes": list(stage.axes), "outside": outside, "warnings": warnings}
    conclude(as_json, {**result, "output": str(output)}, lines, warnings)
    sys.exit(0)


def _limits(stage: Stage) -> tuple[Any, Any]:
    import numpy as np

    pairs = [one.limits or (-np.inf, np.inf) for one in stage.actuators]
    return np.array([low for low, _ in pairs]), np.array([high for _, high in pairs])
