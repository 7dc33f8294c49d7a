"""Names that a user gives to the columns of a file, in their order."""

from __future__ import annotations

from dataclasses import replace

from dehyst._errors import FileFormatError
from dehyst.records.formats.columns import Table, listed
from dehyst.records.formats.units import symbol_of


def renamed(table: Table, columns: str) -> Table:
    """Return a table with the names and units of a text as "time:s,voltage:V,-,displacement:um".

    An entry without a unit keeps that of the file; "-" and an empty entry leave a column out.

    Raises
    ------
    FileFormatError
        It is no text, there are more entries than columns, fewer, an unknown unit, a name twice, or no name.
    """
    if not isinstance(columns, str):
        raise FileFormatError(
            f"columns: got {columns!r}, need one text with commas, as 'time:s,voltage:V,displacement:um'"
        )
    entries = [entry.strip() for entry in columns.split(",")]
    if len(entries) != len(table.columns):
        raise FileFormatError(
            f"{table.source}: columns: got {len(entries)} names, but the file holds {len(table.columns)} columns: "
            f"{listed(table.names)}; give a name for each, and - for one that is to be left out"
        )
    named = []
    for entry, column in zip(entries, table.columns, strict=True):
        name, _, unit = (part.strip() for part in entry.partition(":"))
        if unit and not symbol_of(unit):
            raise FileFormatError(f"{table.source}: columns: got the unit '{unit}', which is unknown; try s, V or um")
        if name not in ("", "-"):
            named.append(replace(column, name=name, unit=symbol_of(unit) or column.parts[1], unnamed="", divided=False))
    names = [column.name for column in named]
    if len(set(names)) < len(names):
        raise FileFormatError(f"{table.source}: columns: got {listed(tuple(names))}; give each name once")
    if not named:
        raise FileFormatError(
            f"{table.source}: columns: got '{columns}', which leaves out all columns; name one at least, as time:s"
        )
    return replace(table, columns=tuple(named))
