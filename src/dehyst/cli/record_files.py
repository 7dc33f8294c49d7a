"""Records and tables from files: the options that name, scale and join their columns."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from dehyst.cli.common import PATH
from dehyst.records.formats.file_content import MOST

if TYPE_CHECKING:
    from dehyst.records import Record
    from dehyst.records.formats.columns import Table

_Read = TypeVar("_Read")
# The arguments that `columns_options` adds; those of tables with several axes, whose columns --axes names.
COLUMNS = (
    *("displacement", "voltage", "time", "sample_rate", "voltage_scale", "displacement_scale", "columns", "join"),
    "decimal",
    "max_bytes",
)
AXES_COLUMNS = tuple(name for name in COLUMNS if name not in ("voltage", "displacement"))
_TEXTS = {
    "--displacement": ("NAME", "Column of the displacement, e.g. displacement_um. [default: found by its name]"),
    "--voltage": ("NAME", "Column of the voltage, e.g. drive_V. [default: found by its name]"),
    "--time": ("NAME", "Column of the time, e.g. time_s. [default: found by its name]"),
    "--displacement-scale": ("SCALE", "Of a sensor's voltage, e.g. '10 um/V'."),
    "--voltage-scale": ("SCALE", "Of an amplifier's monitor, e.g. '100 V/V'."),
    "--columns": ("NAMES", "Of all columns in their order, e.g. time:s,voltage:V,-,displacement:um; - leaves one out."),
}


def columns_options(
    command: Callable[..., None], quantities: tuple[str, ...] = ("voltage", "displacement")
) -> Callable[..., None]:
    """Add the options that name the columns of a file, for the quantities that the command reads."""
    for flag, (metavar, text) in _TEXTS.items():
        if flag[2:].removesuffix("-scale") in (*quantities, "time", "columns"):
            command = click.option(flag, metavar=metavar, help=text)(command)
    text = "Second file of the same measurement, aligned on time or sample."
    command = click.option("--join", type=PATH, metavar="FILE", help=text)(command)
    command = size_option(decimal_option(command))
    return sample_rate_option(command)


def voltage_columns_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options of a file of which only the voltage is read."""
    return columns_options(command, ("voltage",))


def path_columns_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options of a file of which only the displacement is read."""
    return columns_options(command, ("displacement",))


class _Rate(click.types.FloatParamType):
    """A number of samples a second; its name in a proposed command is no number."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        from dehyst.records.tables import RATE

        if value == RATE:
            self.fail(f"replace {RATE} by the number of samples a second, as 1000", param, ctx)
        return super().convert(value, param, ctx)


def sample_rate_option(command: Callable[..., None]) -> Callable[..., None]:
    """Add the option that replaces a time column."""
    return click.option("--sample-rate", type=_Rate(), metavar="HZ", help="Instead of a time column.")(command)


def decimal_option(command: Callable[..., None]) -> Callable[..., None]:
    """Add the option that states the decimal sign of text files."""
    text = "Decimal sign of a text file whose numbers do not show it; the other sign groups digits."
    return click.option("--decimal", type=click.Choice([".", ","]), help=text)(command)


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


def read_records(
    paths: tuple[Path, ...], options: dict[str, Any], several: bool = False, axes: str | None = None
) -> list[Record]:
    """Read records from files, with the options of their columns, or with `axes` those of several axes.

    `several`: the command reads other files too.
    """
    from dehyst.records import read

    given = {name: options[name] for name in (COLUMNS if axes is None else AXES_COLUMNS) if name != "decimal"}
    given["axes"] = axes
    several = several or len(paths) > 1
    return [_with_sign(partial(read, path, **given), options["decimal"], several) for path in paths]


def _with_sign(reading: Callable[..., _Read], decimal: str | None, several: bool) -> _Read:
    """Read a file with the decimal sign that was given; one of several files may show another sign."""
    from dehyst._errors import FileFormatError

    try:
        return reading(decimal=decimal)
    except FileFormatError:
        if decimal is not None and several:
            with suppress(FileFormatError):
                return reading(decimal=None)
        raise


def table_of(path: Path, options: dict[str, Any], several: bool = False) -> Table:
    """Read the table of a file, with the options that name and join its columns; `several`: as in `read_records`."""
    from dehyst.records.files import named_and_joined
    from dehyst.records.tables import Choice

    # A command that reads voltages only has no option for the displacement.
    choice = Choice(**{name: options.get(name) for name in Choice._fields})
    given = {name: options[name] for name in ("columns", "join", "decimal", "max_bytes")}
    return named_and_joined(table_in(path, options, several), choice, **given)


def record_in(table: Table, name: str, options: dict[str, Any], axes: str | None = None) -> Record:
    """Return the record in a table, with the options that select and scale its columns, or with those of several axes.

    `axes`: as in `dehyst.read`.
    """
    from dehyst.records.files import record_of
    from dehyst.records.tables import Choice, axis_columns

    choice = Choice(**{quantity: options[quantity] for quantity in Choice._fields})
    return record_of(table, choice, name, () if axes is None else axis_columns(axes))


def column_of(table: Table, quantity: str, options: dict[str, Any]) -> Any:
    """Return the voltage or the displacement of a table, with the options that select and scale it."""
    from dehyst.records.tables import Choice, chosen

    selected = {quantity: options[quantity], f"{quantity}_scale": options[f"{quantity}_scale"]}
    return chosen(table, Choice(**selected), (quantity,))[quantity].values


def time_of_table(table: Table, size: int, columns: dict[str, Any]) -> dict[str, Any]:
    """Return the time column, if the file has one or a rate was given."""
    from dehyst.records.files import time_of

    if columns["time"] is None and columns["sample_rate"] is None and table.fitting("time") != 1:
        return {}
    return {"time_s": time_of(table, size, columns["time"], columns["sample_rate"])}


def table_in(path: Path, options: dict[str, Any], several: bool = True) -> Table:
    """Read the table of a file, with the options of text files; `several`: as in `read_records`."""
    from dehyst.records import read_table

    return _with_sign(partial(read_table, path, max_bytes=options["max_bytes"]), options["decimal"], several)


def path_of(trajectory: Path, wanted: str | None, options: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
    """Return the displacement of a trajectory file and, if it has one, its time column."""
    from dehyst._errors import FileFormatError

    table = table_in(trajectory, options)
    try:
        path = table.column("displacement", wanted)
    except FileFormatError as error:
        # --displacement names the column of the records here.
        change = ["wanted" if name == "displacement" else name for name in error.change]
        raise FileFormatError(error.message, hint=error.hint, change=change) from error
    return path, time_of_table(table, path.size, {"time": None, "sample_rate": None})
