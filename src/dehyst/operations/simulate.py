"""`simulate`: the displacement that a voltage causes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dehyst._errors import FileFormatError
from dehyst._text import counted
from dehyst._types import Array
from dehyst.control import PathPlan, outside_identified, plan_voltage
from dehyst.model import voltages_of
from dehyst.operations import start as starts
from dehyst.operations.axes import AxesModel
from dehyst.operations.command import argument, command, flag, option, output
from dehyst.operations.files import COLUMNS, VOLTAGE, Columns, clock_of, write_table
from dehyst.operations.paths import temperature_column, temperature_of
from dehyst.operations.run import Result, Run
from dehyst.operations.start import START, Start
from dehyst.records import table_of


@command("simulate")
def simulate(
    run: Run,
    model: Path = argument(),
    voltage: Path = argument(),
    output: Path = output("Write time, voltage and displacement here (CSV)."),
    lag: bool = flag("Delay the displacement by the delay found at identification."),
    start: Start | None = option("State before the first sample, as in compensate; default: unknown.", START),
    columns: Columns = COLUMNS,
) -> Result:
    """Compute the displacement that the voltage in a VOLTAGE file causes; the output adds expected_um.

    Without --start the state before the first sample is unknown: the displacement starts from the middle of the
    possible states, and lowest_um and highest_um bound it. The status is 1 if a voltage lies outside the model's limits
    by more than a tenth of their range.
    """
    known = AxesModel.read(run, model)
    known.demand(columns, VOLTAGE, "on a voltage")
    table = table_of(voltage, columns)
    given = known.values(table, "voltage", columns)
    time = clock_of(table, columns)
    begins, warnings = starts.starts_of(known, start, [None] * len(known.axes), columns, rests=False)
    warmth = temperature_of(known, columns, table, remark=warnings.append)
    ranges = [voltages_of(actuator) for actuator in known.actuators]
    known_path = {"time": time.get("time_s"), "temperature": warmth, "start": begins}
    paths = known.planned(plan_voltage, given, ranges, [None] * len(ranges), **known_path)
    if lag and not any(actuator.delay for actuator in known.actuators):
        warnings.append("--lag: has no effect, because the model has no delay")
    clock = starts.clock_columns(paths[0], time)
    volts = np.column_stack([path.voltage for path in paths])
    written = {**clock, **known.columns("voltage", volts), **_displacements(known, paths, clock, lag=lag)}
    write_table(output, written | temperature_column(paths[0]))
    outsides = [outside_identified(*each, refuse=False) for each in zip(known.actuators, given.T, strict=True)]
    late = "the measured displacement lagged by {:.4g} ms, which is left out here; add --lag"
    warnings += known.prefixed(
        [*outside.warnings, *path.warnings, *([late.format(1e3 * delay)] if delay and not lag else [])]
        for outside, path, delay in zip(outsides, paths, [actuator.delay for actuator in known.actuators], strict=True)
    )
    far = any(outside.far for outside in outsides)
    costs = [path.promise.parts.get("temperature", 0.0) if path.promise else 0.0 for path in paths]
    fields = {
        "samples": len(volts),
        "outside": known.by_axis(outside.count for outside in outsides),
        "far_outside": known.by_axis(outside.far for outside in outsides),
        **known.merged([starts.path_start_fields(path) for path in paths]),
        "temperature_cost_um": known.by_axis(1e6 * cost for cost in costs),
        "warnings": warnings,
        "state": known.by_axis(path.state.as_dict() for path in paths),
        "output": str(output),
    }
    pairs = zip(known.actuators, paths, strict=True)
    words = known.prefixed([starts.start_words(actuator, path.start, path.start.state)] for actuator, path in pairs)
    lines = [f"{counted(len(volts), 'sample')} {', '.join(words)}: {output}"]
    return Result(fields, [*lines, *known.prefixed(map(starts.open_start, paths))], warnings=warnings, good=not far)


def _displacements(
    known: AxesModel, paths: Sequence[PathPlan], clock: Mapping[str, Array], *, lag: bool
) -> dict[str, Any]:
    """Return columns of the displacement [um] and, if a start is uncertain, of its bounds."""

    def late(targets: Array) -> Array:
        """Return displacements as the sensors show them, with the actuators' delays."""
        if not lag:
            return targets
        if "time_s" not in clock:
            raise FileFormatError(
                argument="lag", need="the time of each sample", hint="give a time column", change=("sample_rate",)
            )
        when = clock["time_s"]
        pairs = zip(known.actuators, targets.T, strict=True)
        return np.column_stack([np.interp(when - actuator.delay, when, values) for actuator, values in pairs])

    moved = np.column_stack([path.expected for path in paths])
    if lag:
        moved = known.moved(late(known.targets(moved)))
    written = known.columns("displacement", 1e6 * moved, "expected")
    if all(path.left_open is None for path in paths):
        return written
    low, high = (late(np.column_stack([getattr(path.error, end) for path in paths])) for end in ("lowest", "highest"))
    if known.stage is not None:
        # Each entry of the coupling takes the end that its sign asks for.
        up, down = np.maximum(known.stage.coupling, 0.0), np.minimum(known.stage.coupling, 0.0)
        low, high = low @ up.T + high @ down.T, high @ up.T + low @ down.T
    lowest = known.columns("displacement", 1e6 * low, "lowest")
    return {**written, **lowest, **known.columns("displacement", 1e6 * high, "highest")}
