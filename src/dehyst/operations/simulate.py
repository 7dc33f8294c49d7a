"""`simulate`: the displacement that a voltage causes."""

from __future__ import annotations

from pathlib import Path

from dehyst._text import counted
from dehyst.control import outside_identified, plan_voltage
from dehyst.model import voltages_of
from dehyst.operations import start as starts
from dehyst.operations.axes import AxesModel
from dehyst.operations.command import argument, command, output
from dehyst.operations.files import COLUMNS, VOLTAGE, Columns, clock_of, write_table
from dehyst.operations.paths import temperature_of
from dehyst.operations.run import Result, Run
from dehyst.operations.start import START
from dehyst.records import table_of


@command("simulate")
def simulate(
    run: Run,
    model: Path = argument(),
    voltage: Path = argument(),
    output: Path = output("Write time, voltage and displacement here (CSV)."),
    start: str | Path | None = START,
    columns: Columns = COLUMNS,
) -> Result:
    """Compute the displacement that the voltage in a VOLTAGE file causes; the output adds expected_um.

    Without --start the state before the first sample is unknown: the displacement starts from the middle of the
    possible states. The status is 1 if a voltage lies outside the model's limits by more than a tenth of their range.
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
    clock = starts.clock_columns(paths[0], time)
    write_table(output, clock | known.table(paths, wanted=False))
    outsides = [outside_identified(*each, refuse=False) for each in zip(known.actuators, given.T, strict=True)]
    late = "the measured displacement lagged by {:.4g} ms; the output does not have this lag"
    warnings += known.prefixed(
        [*outside.warnings, *path.warnings, *([late.format(1e3 * delay)] if delay else [])]
        for outside, path, delay in zip(outsides, paths, [actuator.delay for actuator in known.actuators], strict=True)
    )
    far = any(outside.far for outside in outsides)
    fields = {
        "samples": len(given),
        "outside": known.by_axis(outside.count for outside in outsides),
        "far_outside": known.by_axis(outside.far for outside in outsides),
        "start": known.by_axis(map(starts.start_fields, paths)),
        "warnings": warnings,
        "state": known.by_axis(path.state.as_dict() for path in paths),
        "output": str(output),
    }
    pairs = zip(known.actuators, paths, strict=True)
    words = known.prefixed([starts.start_words(actuator, path.start, path.start.state)] for actuator, path in pairs)
    lines = [f"{counted(len(given), 'sample')} {', '.join(words)}: {output}"]
    return Result(fields, [*lines, *known.prefixed(map(starts.open_start, paths))], warnings=warnings, good=not far)
