"""Records and tables from files: the options that name, scale and join their columns."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dehyst.cli.common import PATH
from dehyst.records.formats.file_content import MOST

if TYPE_CHECKING:
    from dehyst.records import Record
    from dehyst.records.formats.columns import Table

# The arguments that `columns_options` adds.
COLUMNS = (
    *("displacement", "voltage", "time", "sample_rate", "voltage_scale", "displacement_scale", "columns", "join"),
    "max_bytes",
)
_TEXTS = {
    "--displacement": ("NAME", "Column of the displacement, e.g. displacement_um. [default: found by its name]"),
    "--voltage": ("NAME", "Column of the voltage, e.g. drive_V. [default: found by its name]"),
    "--time": ("NAME", "Column of the time, e.g. time_s. [default: found by its name]"),
    "--displacement-scale": ("SCALE", "Of a sensor's voltage, e.g. '10 um/V'."),
    "--voltage-scale": ("SCALE", "Of an amplifier's monitor, e.g. '100 V/V'."),
    "--columns": ("NAMES", "Of all columns in their order, e.g. time:s,voltage:V,-,displacement:um; - leaves one out."),
}


def columns_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options that name the columns of a file."""
    for flag, (metavar, text) in _TEXTS.items():
        command = click.option(flag, metavar=metavar, help=text)(command)
    text = "Second file of the same measurement, aligned on time or sample."
    command = click.option("--join", type=PATH, metavar="FILE", help=text)(command)
    command = size_option(command)
    return click.option("--sample-rate", type=float, metavar="HZ", help="Instead of a time column.")(command)


def size_option(command: Callable[..., None]) -> Callable[..., None]:
    """Add the option that admits large files; its value is in bytes."""
    return click.option(
        "--max-size",
        "max_bytes",
        type=float,
        metavar="MB",
        default=MOST / 1e6,
        show_default=f"{MOST / 1e6:g}",
        callback=lambda _context, _option, size: size * 1e6,
        help="Largest file to read, and most memory for its numbers.",
    )(command)


def read_records(paths: tuple[Path, ...], options: dict[str, Any]) -> list[Record]:
    """Read records from files, with the options of their columns."""
    from dehyst.records import read

    return [read(path, **{name: options[name] for name in COLUMNS}) for path in paths]


def table_of(path: Path, options: dict[str, Any]) -> Table:
    """Read the table of a file, with the options that name and join its columns."""
    from dehyst.records import read_table
    from dehyst.records.files import named_and_joined

    table, largest = read_table(path, max_bytes=options["max_bytes"]), options["max_bytes"]
    names, other = options["columns"], options["join"]
    return named_and_joined(table, names, other, options["time"], options["sample_rate"], largest)


def record_in(table: Table, name: str, options: dict[str, Any]) -> Record:
    """Return the record in a table, with the options that select and scale its columns."""
    from dehyst.records.column_choice import Choice
    from dehyst.records.files import record_of

    choice = Choice(**{quantity: options[quantity] for quantity in Choice._fields})
    return record_of(table, choice, options["sample_rate"], name)


def column_of(table: Table, quantity: str, options: dict[str, Any]) -> Any:
    """Return the voltage or the displacement of a table, with the options that select and scale it."""
    from dehyst.records.column_choice import Choice, chosen

    selected = {quantity: options[quantity], f"{quantity}_scale": options[f"{quantity}_scale"]}
    return chosen(table, Choice(**selected), (quantity,))[quantity]


def time_of_table(table: Table, size: int, columns: dict[str, Any]) -> dict[str, Any]:
    """Return the time column, if the file has one or a rate was given."""
    from dehyst.records.files import time_of

    if columns["time"] is None and columns["sample_rate"] is None and not table.has("time"):
        return {}
    return {"time_s": time_of(table, size, columns["time"], columns["sample_rate"])}


def path_of(trajectory: Path, wanted: str | None, max_bytes: float = MOST) -> tuple[Any, dict[str, Any]]:
    """Return the displacement of a trajectory file and, if it has one, its time column."""
    from dehyst._errors import FileFormatError
    from dehyst.records import read_table

    table = read_table(trajectory, max_bytes=max_bytes)
    try:
        path = table.column("displacement", wanted)
    except FileFormatError as error:
        # --displacement names the column of the records here.
        raise FileFormatError(str(error).replace("displacement=", "wanted=")) from error
    return path, time_of_table(table, path.size, {"time": None, "sample_rate": None})
