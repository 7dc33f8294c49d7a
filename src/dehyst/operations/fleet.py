"""`fleet`: many records identified at once."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from dehyst.fleet import identify_fleet
from dehyst.operations.command import CONTINUED, INPUT, command, option, output
from dehyst.operations.files import RECORD, Columns, columns_option
from dehyst.operations.run import Result, Run, demand_outputs
from dehyst.records import read


@command("fleet")
@click.argument("records", type=INPUT, nargs=-1, required=True)
@output("Write the table here (.parquet), or continue it; with --force all rows are computed again.", CONTINUED)
@option("--scheduler", help="Address of a Dask scheduler, as tcp://host:8786; default: a process for each processor.")
@columns_option
def fleet(run: Run, records: tuple[Path, ...], output: Path, scheduler: str | None, columns: Columns) -> Result:
    """Identify each of RECORDS, a folder or files, and write one table with one row a record.

    A file from which no model is identified is a row too, with the reason. The same command continues a run that was
    stopped: records whose names are in the table keep their rows.
    """
    columns.demand(RECORD, "on a fleet")
    demand_outputs(records, [output], force=True)
    given = records[0] if len(records) == 1 else records
    reading = partial(read, columns=columns)
    found = identify_fleet(given, output, scheduler=scheduler, read=reading, again=run.force, progress=run.progress)
    there = found.records - found.computed
    lines = [
        f"{found.records} records: {found.computed} computed now, {there} in the table before; {found.refused} of all "
        "without a usable model",
        f"table: {found.path}",
    ]
    fields = {**found._asdict(), "path": str(found.path)}
    return Result(fields, lines, good=found.refused < found.records)
