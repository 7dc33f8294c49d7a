"""`dehyst simulate`: the displacement that a voltage causes."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dehyst._text import counted
from dehyst.cli.common import (
    PATH,
    conclude,
    force_option,
    json_option,
    refuse_overwriting,
    refuse_unused,
    write_output,
)
from dehyst.cli.models import AxesModel, axes_option, is_stage
from dehyst.cli.record_files import table_of, time_of_table, voltage_columns_options
from dehyst.cli.start import (
    StartFile,
    clock_columns,
    error_lines,
    given_starts,
    home_option,
    homed_words,
    lagging,
    left_open,
    path_start_dict,
    period_of,
    start_option,
    start_words,
)

if TYPE_CHECKING:
    from dehyst.control import HomedPath, PossibleStart


@click.command()
@click.argument("model", type=PATH)
@click.argument("voltage_file", metavar="VOLTAGE", type=PATH)
@click.option("-o", "--output", type=PATH, required=True, help="Write time, voltage and displacement here (CSV).")
@click.option("--lag", is_flag=True, help="Delay the displacement by the delay found at identification.")
@axes_option("those of the records")
@force_option
@start_option
@home_option("Put the shortest homing before the voltages, from 0 V.  [default: no-home]")
@voltage_columns_options
@json_option
def simulate(
    model: Path,
    voltage_file: Path,
    output: Path,
    lag: bool,
    axes: str | None,
    start: str | StartFile | None,
    home: bool | None,
    as_json: bool,
    **columns: Any,
) -> None:
    """Compute the displacement that a VOLTAGE file causes; adds expected_um.

    Without --start the state before the first sample is unknown: the displacement is that from the middle of the
    possible states, and lowest_um and highest_um bound it. The status is 1 if a voltage lies outside the model's
    limits by more than a tenth of their range, or if --home leaves more than the model's error.
    """
    import numpy as np

    from dehyst._errors import ModelError
    from dehyst.control.limits import outside_identified

    taken = ["axes", *(name for name in columns if name != "voltage")] if is_stage(model) else columns
    beside = "with a stage" if is_stage(model) else "with the model of one axis"
    refuse_unused(beside, "output", "force", "lag", "start", "home", *taken)
    if home and start is not None:
        raise ModelError(argument="start", got="it with --home, which determines the state", hint="leave one out")
    refuse_overwriting([model, voltage_file, *([start.path] if isinstance(start, StartFile) else [])], output)
    known = AxesModel.read(model)
    table = table_of(voltage_file, columns, several=isinstance(start, StartFile))
    voltage = known.values_in(table, "voltage", axes, columns)
    time = time_of_table(table, len(voltage), columns)
    starts, remarks = given_starts(known, start, [None] * len(known.axes), columns, axes, rests=False)
    runs = _runs(known, voltage, time, starts, home=bool(home))
    if lag and not any(one.delay for one in known.actuators):
        remarks.append("--lag: has no effect, because the model has no delay")
    clock = clock_columns(runs[0], time)
    volts = np.column_stack([run.voltage for run in runs])
    write_output(output, {**clock, **known.columns("voltage", volts), **_displacements(known, runs, clock, lag)})
    pairs = zip(known.actuators, voltage.T, strict=True)
    outsides = [outside_identified(*each, refuse=False) for each in pairs]
    late = [
        f"the measured displacement lagged by {one.delay * 1e3:.4g} ms, which is left out here; add --lag"
        for one in known.actuators
    ]
    own = [
        [*outside.warnings, *run.warnings, *([words] if one.delay and not lag else [])]
        for outside, run, one, words in zip(outsides, runs, known.actuators, late, strict=True)
    ]
    warnings = [*remarks, *known.prefixed(own)]
    far = any(outside.far for outside in outsides)
    result = {
        "samples": len(volts),
        "outside": known.by_axis(outside.count for outside in outsides),
        "far_outside": known.by_axis(outside.far for outside in outsides),
        **known.merged([path_start_dict(run) for run in runs]),
        "warnings": warnings,
        "state": known.by_axis(run.state.as_dict() for run in runs),
        "output": str(output),
    }
    begins = [
        homed_words(run) if run.homing is not None else start_words(one, run.start, run.start.state)
        for run, one in zip(runs, known.actuators, strict=True)
    ]
    words = ", ".join(known.prefixed([one] for one in begins))
    lines = [f"{counted(len(volts), 'sample')} {words}: {output}"]
    conclude(as_json, result, [*lines, *known.prefixed(error_lines(run) for run in runs)], warnings)
    sys.exit(1 if far or not all(run.certified for run in runs) else 0)


def _runs(
    known: AxesModel, voltage: Any, time: dict[str, Any], starts: list[PossibleStart | None], *, home: bool
) -> list[HomedPath]:
    """Return the motion of each axis by voltages (n, axes), perhaps with a homing before them."""
    from dehyst.control import Compensator, StageCompensator, plan_voltage

    when, ranges = time.get("time_s"), [one.voltage_range for one in known.actuators]
    if known.stage is None:
        compensator = Compensator(known.actuators[0], ranges[0])
        return [plan_voltage(compensator, voltage[:, 0], time=when, start=starts[0], home=home)]
    several = StageCompensator(known.stage, limits=ranges, period=period_of(time))
    return [*plan_voltage(several, voltage, time=when, start=starts, home=home)]


def _displacements(known: AxesModel, runs: list[HomedPath], clock: dict[str, Any], lag: bool) -> dict[str, Any]:
    """Return columns of the displacement [um] and, if a start is open, of its bounds."""
    import numpy as np

    def late(targets: Any) -> Any:
        pairs = zip(known.actuators, targets.T, strict=True)
        return np.column_stack([lagging(values, actuator, clock) for actuator, values in pairs])

    moved = np.column_stack([run.expected for run in runs])
    if lag:
        moved = known.moved(late(known.targets(moved)))
    written = known.columns("displacement", 1e6 * moved, "expected")
    if runs[0].homing is not None or all(left_open(run) is None for run in runs):
        return written
    low, high = (np.column_stack([getattr(run.error, end) for run in runs]) for end in ("lowest", "highest"))
    if lag:
        low, high = late(low), late(high)
    if known.stage is not None:
        # Each entry of the coupling takes the end that its sign asks for.
        up, down = np.maximum(known.stage.coupling, 0.0), np.minimum(known.stage.coupling, 0.0)
        low, high = low @ up.T + high @ down.T, high @ up.T + low @ down.T
    lowest = known.columns("displacement", 1e6 * low, "lowest")
    return {**written, **lowest, **known.columns("displacement", 1e6 * high, "highest")}
