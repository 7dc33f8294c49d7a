"""`dehyst identify --axes`: a stage of records of several axes; and what a single axis leaves to another voltage."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dehyst.cli.axes.inputs import read
from dehyst.cli.common import command_line, echo_files, refuse_overwriting, refuse_replacing
from dehyst.cli.output.terminal import echo, echo_json, note, progress_line
from dehyst.cli.record_files import table_of, time_of_table

if TYPE_CHECKING:
    from dehyst.model import Fit

_VOLTS = ("V", "mV", "kV")


def identify_axes(
    records: tuple[Path, ...],
    validate: tuple[Path, ...],
    axes: str,
    outputs: tuple[Path | None, Path | None],
    settings: dict[str, Any],
    columns: dict[str, Any],
    as_json: bool,
) -> None:
    """Identify a stage, write and print it, and exit."""
    from dehyst.stages import identify_stage

    output, report = outputs
    refuse_overwriting([*records, *validate], output, report)
    progress = progress_line()
    progress("reading")
    training, held_out = read(records, axes, columns), read(validate, axes, columns)
    try:
        fit = identify_stage(training, validate=held_out, progress=progress, **settings)
    except KeyboardInterrupt:
        progress("")
        note("Ctrl-C: several axes have no model before all are identified; nothing was written")
        raise
    refuse_replacing(output, report)
    if output is not None and fit.stage is not None:
        fit.stage.with_provenance(axes=training[0].meta["axes"]).save(output)
    if report is not None:
        from dehyst.stages import write_stage_report

        progress("drawing the report")
        write_stage_report(report, fit, [*training, *held_out], command=command_line())
    progress("")
    if as_json:
        echo_json(fit.as_dict())
    else:
        for line in fit.summary().split("\n"):
            echo(line)
        echo_files(Stage=output if fit.stage is not None else None, Report=report)
    sys.exit(0 if fit.good else 1)


def neighbour_remarks(fit: Fit, records: tuple[Path, ...], columns: dict[str, Any]) -> list[str]:
    """Return warnings of other voltages in the files of records that the residual of a single axis follows."""
    from dehyst.stages.neighbours import followed

    remarks = []
    for path, trace, error in zip(records, fit.traces, fit.errors, strict=False):
        if path.is_fifo() or columns["sample_rate"] is not None:
            continue
        table = table_of(path, columns)
        chosen = table.find("voltage", columns["voltage"])[0].name
        others = {c.name: c.data for c in table.columns if c.name != chosen and not c.fault and c.parts[1] in _VOLTS}
        if others:
            time = time_of_table(table, table.columns[0].data.size, columns).get("time_s")
            remarks += [] if time is None else [one.sentence for one in followed(trace, time, others, error.stroke)]
    return remarks
