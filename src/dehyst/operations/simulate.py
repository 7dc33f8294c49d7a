"""`simulate`: the displacement that a voltage causes."""

from __future__ import annotations

from pathlib import Path

from dehyst._text import counted
from dehyst.control import outside_identified, plan_voltage
from dehyst.model import voltages_of
from dehyst.operations.axes import AxesModel
from dehyst.operations.command import argument, command, output
from dehyst.operations.files import COLUMNS, VOLTAGE, Columns, clock_of, write_table
from dehyst.operations.paths import temperature_of
from dehyst.operations.run import Result, Run
from dehyst.operations.start import START, begin_words, open_start, start_fields, starts_of
from dehyst.records import table_of

_LATE = "the measured displacement lagged by {:.4g} ms; the output does not have this lag"


@command("simulate")
def simulate(
    run: Run,
    model: Path = argument(),
    voltage: Path = argument(),
    output: Path = output("Write time, voltage and displacement here (CSV)."),
    start: Path | None = START,
    columns: Columns = COLUMNS,
) -> Result:
    """Compute the displacement that the voltage in a VOLTAGE file causes; the output adds expected_um.

    Without --start the state before the first sample is unknown: the displacement starts from the middle of the
    possible states. The status is 1 if a voltage lies outside the model's limits by more than a tenth of their range.
    """
    known = AxesModel.read(run, model)
    columns.demand(VOLTAGE, "on a voltage", axes=known.several)
    table = table_of(voltage, columns)
    given, time = known.values(table, "voltage", columns), clock_of(table, columns)
    begins = starts_of(known, start, [None] * len(known.axes), columns, rests=False)
    ranges = [voltages_of(actuator) for actuator in known.actuators]
    when = {"time": time.get("time_s"), "temperature": temperature_of(known, columns, table)}
    plan = known.planned(plan_voltage, given, ranges, [None] * len(ranges), **when, start=begins)
    each = plan.each or (plan,)
    write_table(output, time | known.table(each, wanted=False))
    outsides = [outside_identified(*pair, refuse=False) for pair in zip(known.actuators, given.T, strict=True)]
    known.remark(outside.warnings for outside in outsides)
    known.remark(path.warnings for path in each)
    known.remark([_LATE.format(1e3 * axis.delay)] if axis.delay else [] for axis in known.actuators)
    known.remark(map(open_start, each))
    fields = {
        "samples": len(given),
        "outside": known.by_axis(outside.count for outside in outsides),
        "far_outside": known.by_axis(outside.far for outside in outsides),
        "start": known.by_axis(map(start_fields, each)),
        "state": known.by_axis(path.state.as_dict() for path in each),
    }
    words = known.prefixed([begin_words(path)] for path in each)
    line = f"{counted(len(given), 'sample')} {', '.join(words)}: {output}"
    return Result(fields, [line], good=not any(outside.far for outside in outsides))
