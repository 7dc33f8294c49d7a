"""Records of stages from files, and the columns of each axis."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from dehyst._errors import FileFormatError
from dehyst._io.drafts import PathLike
from dehyst._io.reading import named
from dehyst.records import read_table
from dehyst.records.column_choice import Choice, ColumnsError
from dehyst.records.files import named_and_joined, record_of
from dehyst.records.formats.columns import Table
from dehyst.records.formats.file_content import MOST
from dehyst.stages.record import StageRecord, axis_names

_EXAMPLE = '"vx_V:x_um vy_V:y_um"'
_OPTIONS = {"time", "sample_rate", "voltage_scale", "displacement_scale", "columns", "join", "name", "max_bytes"}


class AxisColumns(NamedTuple):
    """The `name` of an axis, and the columns of its voltage and its displacement."""

    name: str
    voltage: str
    displacement: str


def axis_columns(axes: str) -> tuple[AxisColumns, ...]:
    """Return the columns in `axes`, as "vx_V:x_um vy_V:y_um", or with names of the axes, as "x=vx_V:x_um".

    An axis is called as the column of its displacement is, without the unit. Raise `FileFormatError` if there are fewer
    than two axes, an entry has no two columns, or two axes or columns have one name.
    """
    entries = [_entry(text) for text in axes.replace(",", " ").split()] if isinstance(axes, str) else []
    used = [column for one in entries for column in one[1:]]
    if twice := sorted({column for column in used if used.count(column) > 1}):
        raise FileFormatError(f"axes: got '{twice[0]}' twice, need columns of its own for each axis, as {_EXAMPLE}")
    if len(entries) < 2:
        raise FileFormatError(f"axes: got {axes!r}, need voltage and displacement of two axes at least, as {_EXAMPLE}")
    axis_names([one.name for one in entries], len(entries), "axes", FileFormatError)
    return tuple(entries)


def _entry(text: str) -> AxisColumns:
    name, _, columns = text.rpartition("=")
    parts = columns.split(":")
    if len(parts) != 2 or not all(parts):
        raise FileFormatError(f"axes: got '{text}', need the columns of a voltage and a displacement, as {_EXAMPLE}")
    word = parts[1].rsplit("/", 1)[-1]
    return AxisColumns(name or (word.rsplit("_", 1)[0] if "_" in word else word), *parts)


def read_stage(path: PathLike, axes: str, **options: Any) -> StageRecord:
    """Read a record of several axes from one file.

    Parameters
    ----------
    path : path
        As in `dehyst.read`.
    axes : str
        Columns of voltage and displacement of each axis, as "vx_V:x_um vy_V:y_um vz_V:z_um"; "x=vx_V:x_um" names the
        axis too.
    **options
        As in `dehyst.read`, for all axes: time, sample_rate, voltage_scale, displacement_scale, columns, join, name,
        max_bytes.

    Raises
    ------
    FileFormatError, RecordError, MissingExtraError
        As `dehyst.read`, or if `axes` does not name two columns for each of two axes at least.
    """
    if unknown := sorted(set(options) - _OPTIONS):
        raise FileFormatError(f"{unknown[0]}: is no option of a record of several axes; {', '.join(sorted(_OPTIONS))}")
    path, found = named(path), axis_columns(axes)
    most = options.get("max_bytes", MOST)
    table = named_and_joined(
        read_table(path, max_bytes=most),
        options.get("columns"),
        options.get("join"),
        options.get("time"),
        options.get("sample_rate"),
        most,
    )
    return record_in(table, found, options.get("name") or path.stem, options)


def record_in(table: Table, axes: Sequence[AxisColumns], name: str, options: dict[str, Any]) -> StageRecord:
    """Return the record of several axes in a table, with the options of `read_stage`."""
    records = []
    for one in axes:
        choice = Choice(
            options.get("time"),
            one.voltage,
            one.displacement,
            options.get("voltage_scale"),
            options.get("displacement_scale"),
        )
        try:
            records.append(record_of(table, choice, options.get("sample_rate"), f"{name} ({one.name})"))
        except ColumnsError as error:
            raise FileFormatError(_advice(error, one)) from error
    meta = {
        "source": table.source,
        "sha256": table.sha256,
        "axes": [f"{a.name}={a.voltage}:{a.displacement}" for a in axes],
    }
    return StageRecord(
        records[0].time,
        np.column_stack([record.voltage for record in records]),
        np.column_stack([record.displacement for record in records]),
        tuple(one.name for one in axes),
        name,
        meta,
    )


def _advice(error: ColumnsError, axis: AxisColumns) -> str:
    """Return what to do about columns of an axis: options for one voltage and one displacement do not help here."""
    fault = error.reason.split(" Select ")[0].rstrip(".")
    return (
        f"{fault}. Axis {axis.name} needs its columns by the names in the file, with units; where the file has none, "
        'name all columns in their order, as columns="time:s,vx_V,vy_V,x_um,y_um"'
    )
