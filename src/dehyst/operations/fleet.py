"""`fleet`: many records identified at once."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from dehyst.fleet import identify_fleet
from dehyst.operations.command import CONTINUED, argument, command, option, output
from dehyst.operations.files import COLUMNS, RECORD, Columns
from dehyst.operations.run import Result, Run, demand_outputs
from dehyst.records import read


@command("fleet")
def fleet(
    run: Run,
    records: tuple[Path, ...] = argument(nargs=-1),
    output: Path = output("Write this table (.parquet), or continue it; --force begins a new one.", CONTINUED),
    scheduler: str | None = option("Dask scheduler, as tcp://host:8786; default: a process for each processor."),
    columns: Columns = COLUMNS,
) -> Result:
    """Identify each of RECORDS, a folder or files, and write one table with one row per record.

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
