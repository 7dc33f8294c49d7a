"""Reading of measurements in every format, and writing of CSV and NPZ."""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from decimal import ROUND_CEILING, ROUND_FLOOR, Context
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import FileFormatError, MissingExtraError, RecordError
from dehyst._io import COMPUTED, PathLike, packed, path_of, reading, write_atomically
from dehyst._text import counted, escaped
from dehyst._types import Array
from dehyst._units import in_si
from dehyst.records.columns import Columns
from dehyst.records.events import record_of_periodic
from dehyst.records.formats.column import MOST, TEXT, Allowance, Column, listed
from dehyst.records.formats.containers import LINE, MEMBER
from dehyst.records.formats.loaders import LOADERS
from dehyst.records.record import Channel, Record, columns_of
from dehyst.records.tables import ColumnsError, Selected, Table, chosen, joined

_MEASURED = ("voltage", "displacement")
_SIGNS = {"point": ".", "comma": ","}
# Rows that are written at once.
_BLOCK = 1 << 14


def read(path: PathLike, columns: Columns | str | None = None, *, name: str | None = None) -> Record:
    """Read a record from a file; its suffix determines the format.

    Temperatures in further columns, as temperature_C, become the record's `others`; unsuitable ones are left out with
    a remark.

    Parameters
    ----------
    path : path
        .csv .tsv .txt .dat .asc .xlsx .mat .h5 .hdf5 .tdms .npz or .npy.
    columns : Columns or str, optional
        Columns, units, scales, and how the file is read, as "time=Time:ms, voltage=Ch1*100, displacement=Sensor:um";
        by default columns are found by their names, and nothing is guessed.
    name : str, optional
        Name of the record; by default the file's name without suffix.

    Raises
    ------
    FileFormatError
        If the file or a column cannot be read, or `columns` cannot be understood or contradict the file. A
        `ColumnsError` has a `proposal`, the text of columns that may be right.
    RecordError
        If the columns do not form a record.
    MissingExtraError
        If the library for this kind of file is not installed.
    """
    path, columns = path_of(path), Columns.of(columns)
    return record_of(table_of(path, columns), columns, name or path.stem)


def record_of(table: Table, columns: Columns, name: str) -> Record:
    """Return the record in a table, see `read` and `table_of`; of several axes if `columns` names some."""
    axes = columns.of_axes() if columns.axes else {"": columns}
    parts = {axis: selected(table, own, axis, ("time", *_MEASURED)) for axis, own in axes.items()}
    if columns.temperature is not None:
        known = table.select("temperature", columns.temperature)
        named = Column("temperature_C", known.values, kept=True, guessed=known.guess)
        rest = [column for column in table.columns if column is not known.column and column.role != "temperature"]
        table = replace(table, columns=(*rest, named))
    used = {
        f"{quantity} of {axis}" if axis and quantity != "time" else quantity: part
        for axis, own in parts.items()
        for quantity, part in own.items()
    }
    first = next(iter(parts.values()))
    time, drive, moved = (first[quantity] for quantity in ("time", *_MEASURED))
    others, left_out = _further_channels(table, [part.column for part in used.values()], len(time.values))
    meta = _origin(table, columns, used, others)
    if remarks := [*table.remarks, *left_out]:
        meta["remarks"] = remarks
    channels = tuple(channel for channel, _ in others)
    hold: Any = columns.hold or ("sample" if drive.column.timing == "sample" else "line")
    if columns.axes:
        if any(part.entry.scale is not None and part.entry.scale.kind for part in used.values()):
            need = "one voltage and one displacement; read each axis by itself"
            raise FileFormatError(argument="columns", got="a periodic signal with axes", need=need)
        records = [
            Record(time.values, part["voltage"].values, part["displacement"].values, f"{name} ({axis})")
            for axis, part in parts.items()
        ]
        voltage = np.column_stack([record.voltage for record in records])
        displacement = np.column_stack([record.displacement for record in records])
        return Record(time.values, voltage, displacement, name, meta, axes=tuple(axes), others=channels, hold=hold)
    scale = moved.entry.scale
    if scale is not None and scale.kind:
        period, unit = float(in_si(scale.factor, scale.unit)), moved.entry.unit or moved.column.parts[1] or "a.u."
        signals = time.values, drive.values, moved.values
        record = record_of_periodic(*signals, period, kind=scale.kind, name=name, unit=unit)
        return replace(record, meta={**meta, **record.meta}, others=(*channels, *record.others), hold=hold)
    measured = ~np.isnan(moved.values) if moved.column.timing == "events" else None
    return Record(time.values, drive.values, moved.values, name, meta, others=channels, hold=hold, measured=measured)


def _origin(
    table: Table, columns: Columns, used: Mapping[str, Selected], others: Sequence[tuple[Channel, Column]]
) -> dict[str, Any]:
    """Return what `Record.meta` says of a file: its name, its columns, their scales and guesses."""
    given = {quantity: part.entry.scale for quantity, part in used.items() if part.entry.scale is not None}
    scales = {quantity: str(scale) if scale.unit else f"times {scale}" for quantity, scale in given.items()}
    found = {quantity: part.column.name for quantity, part in used.items()}
    found |= {channel.name: column.name for channel, column in others}
    if columns.rate is not None:
        found["time"] = f"index / {columns.rate:.9g} Hz"
    guesses = {quantity: part.guess for quantity, part in used.items()}
    guesses |= {channel.name: column.guessed for channel, column in others}
    planned = [name for name in table.names if name.endswith(COMPUTED) and columns.displacement is None]
    meta = {
        "source": ", ".join([table.source, *(f"{quantity} {words}" for quantity, words in scales.items())]),
        "sha256": table.sha256,
        "axes": [f"{axis}={text}" for axis, text in columns.axes.items()],
        "columns": {} if columns.axes else found,
        "scales": scales,
        "computed": planned,
        "guesses": {quantity: guess for quantity, guess in guesses.items() if guess},
    }
    return {key: value for key, value in meta.items() if value}


def _further_channels(
    table: Table, used: Sequence[Column], samples: int
) -> tuple[list[tuple[Channel, Column]], list[str]]:
    """Return the temperatures and kept columns in a table besides the `used` ones, and remarks on others."""
    found: dict[str, tuple[Channel, Column]] = {}
    remarks = []
    for column in table.columns:
        if any(column is other for other in used) or not (column.kept or column.role != "other"):
            continue
        words, size = column.fault, column.data.size
        if not words and size != samples:
            words = f"it has {counted(size, 'value')} for {counted(samples, 'sample')}"
        if not words:
            channel = Channel.of(column)
            words = "its name is that of another channel" if channel.name in found else channel.fault
        if not words:
            found[channel.name] = channel, column
        elif column.kept:
            raise RecordError(f"{table.source}: column '{escaped(column.name)}': {words}")
        else:
            remarks.append(f"Column '{escaped(column.name)}' is left out: {words}.")
    return list(found.values()), remarks


def selected(table: Table, columns: Columns, axis: str, quantities: Sequence[str]) -> dict[str, Selected]:
    """Return the columns of an axis, which is empty if there is only one."""
    try:
        return chosen(table, columns, quantities)
    except ColumnsError as error:
        if not axis:
            raise
        # A proposal for one voltage and one displacement does not help here.
        hint = f'the file holds {listed(table.names)}. Give the axis as "{axis}={":".join(quantities[-2:]).upper()}"'
        raise FileFormatError(f"axis {axis}: {error.problems[0].message}", hint=hint, change=("columns",)) from error


def table_of(path: PathLike, columns: Columns) -> Table:
    """Read the table of a file; apply the rate and join the second file that `columns` state."""
    path = path_of(path)
    table = read_table(path, columns)
    if columns.rate is not None and columns.time is not None:
        raise FileFormatError(argument="columns", got="a time and a rate", need="one of them")
    table = table if columns.rate is None else table.with_rate(columns.rate)
    if columns.join is None:
        return table
    second = path_of(columns.join)
    own = columns if second.suffix.lower() in TEXT else replace(columns, decimal=None)
    return joined(table, read_table(second, own), columns)


def read_table(path: PathLike, columns: Columns | None = None) -> Table:
    """Read all numeric columns of a file, by the decimal sign of `columns`; errors as in `read`."""
    path, columns = path_of(path), columns or Columns()
    suffix = path.suffix.lower()
    if suffix not in LOADERS and path.is_file():
        known = f"unknown kind of file '{path.suffix}'; save it as one that dehyst reads: {' '.join(LOADERS)}"
        raise FileFormatError(f"{path}: {known}")
    with reading(path, path.suffix, MOST) as stream:
        if columns.decimal is not None and suffix not in TEXT:
            got = f"{columns.decimal} for a {path.suffix} file, whose numbers are no text"
            raise FileFormatError(argument="decimal", got=got, need="none")
        digest = hashlib.file_digest(stream, "sha256").hexdigest()  # type: ignore[arg-type]
        stream.seek(0)
        try:
            with warnings.catch_warnings():
                # A library warns of styles of a sheet and the like, which do not matter for the columns.
                warnings.simplefilter("ignore")
                found = LOADERS[suffix](stream, Allowance(MOST, path.stem, _SIGNS.get(columns.decimal or "")))
        except FileFormatError as error:
            raise type(error)(**vars(error) | {"message": f"{path}: {error.message}"}) from error
        except ImportError as error:
            package = (error.name or "").partition(".")[0]
            raise MissingExtraError.of(package, "files", f"Reading {suffix} files") from error
    if not found:
        raise FileFormatError(f"{path}: no numeric columns found; store time, voltage and displacement as 1-D arrays")
    return Table(path.name, digest, tuple(found))


def write_record(path: PathLike, record: Record) -> None:
    """Write a `record` to `path` at full precision: as CSV, or as a NumPy archive, which is read faster.

    CSV has the columns time_s, voltage_V and displacement_um, an .npz file the arrays time_s, voltage_V and
    displacement_m; with several axes the names are vx_V, x_um and so on. Further channels follow, as temperature_C.
    Guesses from reading (``record.meta["guesses"]``), a `hold` other than "line", and the names of channels other than
    temperatures are kept in a comment above the table or in an additional array; cells of the displacement are blank
    (NaN) where it is not measured. An existing file is replaced; commands replace a measurement with --force only.

    Raises
    ------
    FileFormatError
        If `record` is not a Record, the suffix is neither .npz nor one of a text file, or the file cannot be written.
    """
    if not isinstance(record, Record):
        need, hint = "a Record", "give the path first, then the record"
        raise FileFormatError(argument="record", got=type(record).__name__, need=need, hint=hint)
    names: dict[tuple[str, str], str] = {}
    for channel in record.channels:
        names["voltage" if channel.role == "drive" else channel.role, channel.axis] = channel.name
    guesses = {}
    for quantity, guess in dict(record.meta.get("guesses") or {}).items():
        role, _, axis = str(quantity).partition(" of ")
        guesses[names.get((role, axis), str(quantity))] = str(guess)
    timing = {} if record.measured is None else {"displacement": "events"}
    if record.hold == "sample":
        timing |= {channel.name: "sample" for channel in record.channels if channel.role == "drive"}
    others = [channel.column for channel in record.others if channel.role == "other"]
    stated = {"guesses": guesses, "timing": timing, "others": others}
    text = json.dumps({key: value for key, value in stated.items() if value}) if any(stated.values()) else ""
    if Path(path).suffix.lower() == ".npz":
        arrays = columns_of(record, "m") | ({MEMBER: np.array(text)} if text else {})
        write_atomically(path, packed(arrays))
    else:
        write_columns(path, columns_of(record), head=[LINE + text] if text else [])


def write_columns(
    path: PathLike, columns: Mapping[str, ArrayLike], *, digits: int | None = None, head: Sequence[str] = ()
) -> None:
    """Write named (n,) arrays as CSV.

    `columns` maps names to arrays. `digits` are the significant digits of the numbers, by default as many as give the
    same numbers when read; rounding never widens the range of a column. `head` has lines to write before the names.
    Raise `FileFormatError` if the suffix is not one of text, columns differ in length, or the file cannot be written.
    """
    write_atomically(path, _blocks(path, columns, digits, head))


def _blocks(path: PathLike, columns: Mapping[str, ArrayLike], digits: int | None, head: Sequence[str]) -> Iterator[str]:
    """Yield a table as blocks of text, the lines before it and its header first."""
    if Path(path).suffix.lower() not in TEXT and (Path(path).is_file() or not Path(path).exists()):
        raise FileFormatError(f"{path}: dehyst writes text only; try the suffix .csv")
    if any(set(name) & set(',;\t\n"') for name in columns):
        raise FileFormatError(f"{path}: column names {listed(tuple(columns))} hold a separator or a quote; rename them")
    arrays = [np.asarray(values, dtype=np.float64) for values in columns.values()]
    if not arrays or any(array.ndim != 1 or array.shape != arrays[0].shape for array in arrays):
        shapes = ", ".join(f"{name} {array.shape}" for name, array in zip(columns, arrays, strict=True))
        raise FileFormatError(f"{path}: columns must be one-dimensional and of one length, got {shapes or 'none'}")
    delimiter = "\t" if Path(path).suffix.lower() == ".tsv" else ","
    if digits is not None:
        arrays = [np.clip(array, *_ends(array, digits)) for array in arrays]
    yield "\n".join([*head, delimiter.join(columns), ""])
    line = delimiter.join(["%r" if digits is None else f"%.{digits}g"] * len(arrays)) + "\n"
    for i in range(0, arrays[0].size, _BLOCK):
        block = np.column_stack([array[i : i + _BLOCK] for array in arrays])
        # A number that is not known is a blank cell.
        yield (line * len(block) % tuple(block.ravel().tolist())).replace("nan", "")


def _ends(values: Array, digits: int) -> tuple[float, float]:
    """Return bounds for values (n,) so that rounding to `digits` moves none out of their range: limits are kept."""
    there = np.isfinite(values)
    lowest, highest = values.min(where=there, initial=inf), values.max(where=there, initial=-inf)
    ends = (lowest, ROUND_CEILING), (highest, ROUND_FLOOR)
    low, high = (float(Context(digits, rounding).create_decimal(float(end))) for end, rounding in ends)
    return (low, high) if low <= high else (-inf, inf)
