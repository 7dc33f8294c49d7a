"""Reading of measurements in every format, and writing of CSV, NPZ and HDF5."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import FileFormatError
from dehyst._io import PathLike, named, packed, reading_errors, write_atomically
from dehyst._types import Array
from dehyst._units import FACTORS, per_metre
from dehyst._validation import demand
from dehyst.records import hdf5
from dehyst.records.formats.columns import TEXT, Selected, Table, listed
from dehyst.records.formats.containers import MEMBER, line_of, stated
from dehyst.records.formats.file_content import MOST, bytes_allowed, content_of
from dehyst.records.formats.reader_process import LOADERS, load
from dehyst.records.formats.table_layout import SIGNS
from dehyst.records.record import Record
from dehyst.records.tables import AxisColumns, Choice, ColumnsError, axis_columns, chosen, joined, renamed

_ADVICE = dict.fromkeys((".xls", ".ods", ".opj", ".opju"), "; save it as CSV or .xlsx")
_MEASURED = ("voltage", "displacement")
# Kinds of files whose numbers are text.
_WITH_SIGNS = (*TEXT, ".lvm", ".asc", ".xlsx")


def read(
    path: PathLike,
    *,
    time: str | None = None,
    voltage: str | None = None,
    displacement: str | None = None,
    sample_rate: float | None = None,
    voltage_scale: str | None = None,
    displacement_scale: str | None = None,
    columns: str | None = None,
    join: PathLike | None = None,
    decimal: str | None = None,
    name: str | None = None,
    units: str | None = None,
    axes: str | None = None,
    max_bytes: float = MOST,
) -> Record:
    """Read a record from a file whose kind follows from its suffix.

    Parameters
    ----------
    path : path
        .csv .tsv .txt .dat .asc .lvm .xlsx .mat .h5 .hdf5 .parquet .tdms .npz or .npy. A named pipe is read once;
        without a suffix its first bytes determine the format.
    time, voltage, displacement : str, optional
        Columns, as "NAME" or "NAME:UNIT"; a "?" at the end marks a guess, which the record keeps in
        ``meta["guesses"]``.
    sample_rate : float, optional
        Samples a second [Hz], for a file without a time column.
    voltage_scale : str, optional
        What one volt of the voltage's column means, as "100 V/V" for an amplifier's monitor.
    displacement_scale : str, optional
        What one volt of the displacement's column means, as "10 um/V" for a sensor.
    columns : str, optional
        Names and units of all columns in their order, as "time:s,voltage:V,displacement:um"; "-" leaves one out.
    join : path, optional
        A second file of the same measurement. Its columns are aligned on time, or on the sample if one of the files
        has no time.
    decimal : str, optional
        "," or ".": the decimal sign of a text file whose numbers do not show it; the other sign groups digits.
    name : str, optional
        The record's name; by default the one that `write_hdf5` wrote, else the file's, without suffix.
    units : str, optional
        Unit of the displacement where the file states none: "m", "mm", "um", "nm" or "pm". The record is in metres.
    axes : str, optional
        For a record of several axes, instead of `voltage` and `displacement`: the columns of each axis, as
        "vx_V:x_um vy_V:y_um". An axis has the name of its displacement, without the unit, or the one given:
        "x=vx_V:x_um".
    max_bytes : float
        Largest size of the file, and of its numbers in memory; a header that declares more is refused before the data
        are read.

    Raises
    ------
    FileFormatError
        An argument is of another kind, the file or a column cannot be read, both a time column and a sample rate are
        given, the file states another unit than `units`, or `axes` does not name two columns for each of two axes.
    RecordError
        The columns make no record.
    MissingExtraError
        The library for this kind of file is not installed.
    """
    path = named(path)
    counted = sample_rate is None or (isinstance(sample_rate, Real) and not isinstance(sample_rate, bool))
    demand(counted, "sample_rate", sample_rate, "a number of samples a second [Hz]", error=FileFormatError)
    several = () if axes is None else axis_columns(axes)
    if several and (voltage or displacement or units):
        raise FileFormatError(
            "got it with voltage, displacement or units", argument="axes", hint="columns and units are those in axes"
        )
    table, stored = _load(path, max_bytes, decimal, with_meta=True)
    first = several[0].displacement if several else displacement
    choice = Choice(time, voltage, first, voltage_scale, displacement_scale, sample_rate)
    table = named_and_joined(table, choice, columns, join, decimal=decimal, max_bytes=max_bytes)
    if units is not None:
        choice = choice._replace(displacement=_in_units(table, displacement, units))
    record = record_of(table, choice, name or (stored.name if stored else path.stem), several)
    if stored is None:
        return record
    added = {name: record.meta[name] for name in ("scales", "guesses", "remarks") if name in record.meta}
    return replace(record, meta={**stored.meta, **added})


def record_of(table: Table, choice: Choice, name: str, axes: Sequence[AxisColumns] = ()) -> Record:
    """Return the record in a table, see `read`; of several axes if there are `axes`."""
    if axes:
        return _record_of_axes(table, choice, name, axes)
    timed = ("time",) if choice.sample_rate is None else ()
    found = chosen(table, choice, (*timed, *_MEASURED))
    voltage, displacement = (found[quantity].values for quantity in _MEASURED)
    time = found["time"].values if timed else time_of(table, len(voltage), choice.time, choice.sample_rate)
    return Record(time, voltage, displacement, name, _meta(table, found, choice.sample_rate))


def _record_of_axes(table: Table, choice: Choice, name: str, axes: Sequence[AxisColumns]) -> Record:
    records = []
    for one in axes:
        own = choice._replace(voltage=one.voltage, displacement=one.displacement)
        try:
            records.append(record_of(table, own, f"{name} ({one.name})"))
        except ColumnsError as error:
            # Options for one voltage and one displacement do not help here.
            raise FileFormatError(
                f"{error.reason.split(' Select ')[0].rstrip('.')}. Axis {one.name} needs its columns by the names in "
                "the file, with units; where the file has none, name all columns in their order, as "
                '"time:s,vx_V,vy_V,x_um,y_um"',
                change=("columns",),
            ) from error
    guesses = {
        quantity if quantity == "time" else f"{quantity} of {one.name}": words
        for one, record in zip(axes, records, strict=True)
        for quantity, words in record.meta.get("guesses", {}).items()
    }
    meta = {"source": table.source, "sha256": table.sha256, "axes": [one.text for one in axes]}
    return Record(
        records[0].time,
        np.column_stack([record.voltage for record in records]),
        np.column_stack([record.displacement for record in records]),
        name,
        {**meta, **({"guesses": guesses} if guesses else {})},
        axes=tuple(one.name for one in axes),
    )


def named_and_joined(
    table: Table,
    choice: Choice,
    columns: str | None,
    join: PathLike | None,
    *,
    decimal: str | None = None,
    max_bytes: float = MOST,
) -> Table:
    """Return a table with the names in `columns`, and joined to the file `join`, see `read`."""
    if columns is not None:
        table = renamed(table, columns)
    if join is None:
        return table
    path = named(join, "join")
    own = decimal if path.suffix.lower() in _WITH_SIGNS else None
    return joined(table, read_table(path, decimal=own, max_bytes=max_bytes), choice)


def _meta(table: Table, found: Mapping[str, Selected], sample_rate: float | None) -> dict[str, Any]:
    """Return the origin of a record: file, hash, columns, and the scales and guesses if there are any."""
    scales = {quantity: one.scale.words for quantity, one in found.items() if one.scale is not None}
    words = "".join(f", {quantity} {scale}" for quantity, scale in scales.items())
    columns = {quantity: found[quantity].column.name for quantity in _MEASURED}
    columns["time"] = found["time"].column.name if sample_rate is None else f"index / {sample_rate:.9g} Hz"
    guesses = {quantity: one.guess for quantity, one in found.items() if one.guess}
    added = {"scales": scales, "guesses": guesses, "remarks": list(table.remarks)}
    origin = {"source": f"{table.source}{words}", "sha256": table.sha256, "columns": columns}
    return origin | {name: value for name, value in added.items() if value}


def _in_units(table: Table, wanted: str | None, units: str) -> str:
    """Return "NAME:UNIT" for the column of the displacement; raise if the file states another unit."""
    per_metre(units, error=FileFormatError)
    found, known = table.select("displacement", wanted), FACTORS["displacement"]
    if found.unit in known and known[found.unit] != known[units]:
        raise FileFormatError(
            f"{table.source}: got the unit '{units}', but the column '{found.column.name}' is in {found.unit}; leave "
            "units out"
        )
    return f"{found.column.name}:{units}"


def time_of(table: Table, samples: int, wanted: str | None, sample_rate: float | None) -> Array:
    """Return the time [s] of each sample: the table's column, or the index over the sample rate [Hz]."""
    if sample_rate is None:
        return table.column("time", wanted)
    known = table.select("time") if wanted is None and table.has("time") else None
    if wanted is not None or (known and known.usable):
        raise FileFormatError(
            f"{table.source}: got a sample rate and the time column '{known.column.name if known else wanted}'",
            hint="leave one of them out",
            change=("sample_rate",),
        )
    if not 0 < sample_rate < float("inf"):
        raise FileFormatError(f"{table.source}: sample_rate is {sample_rate} Hz; give a number above 0")
    return np.arange(samples) / sample_rate


def read_table(path: PathLike, *, decimal: str | None = None, max_bytes: float = MOST) -> Table:
    """Read all numeric columns of a file whose kind follows from its suffix; raise as `read` does.

    `path` is the file's. `decimal` is the decimal sign of its text, "," or ".". `max_bytes` bounds the file and its
    numbers.
    """
    return _load(named(path), max_bytes, decimal, with_meta=False)[0]


def _load(path: Path, max_bytes: float, decimal: str | None, with_meta: bool) -> tuple[Table, hdf5.Stored | None]:
    """Read a file once; return its columns and, if `with_meta` and dehyst wrote the file, name and meta."""
    demand(decimal in (None, *SIGNS), "decimal", decimal, "one of '.' and ','", error=FileFormatError)
    with reading_errors(path, path.suffix):
        if path.suffix.lower() not in LOADERS and not path.is_fifo() and not path.is_dir():
            raise FileFormatError(
                f"{path}: unknown kind of file '{path.suffix}'; dehyst reads "
                f"{' '.join(LOADERS)}{_ADVICE.get(path.suffix.lower(), '')}"
            )
        content = content_of(path, bytes_allowed(max_bytes))._replace(decimal=decimal, with_meta=with_meta)
    if decimal is not None and content.suffix not in _WITH_SIGNS:
        raise FileFormatError(
            f"{path}: decimal: got '{decimal}', but {content.suffix} files hold no text; leave it out"
        )
    columns, stored = load(content)
    if not columns:
        raise FileFormatError(f"{path}: no numeric columns found; store time, voltage and displacement as 1-D arrays")
    return Table(path.name, hashlib.sha256(content.data).hexdigest(), tuple(columns)), stored


def write_record(path: PathLike, record: Record) -> None:
    """Write a `record` at full precision: as CSV, or as a NumPy archive, which is read faster.

    CSV has the columns time_s, voltage_V and displacement_um, a `path` that ends in .npz the arrays time_s, voltage_V
    and displacement_m; of several axes they are called vx_V, x_um and so on. What was guessed when it was read
    (``record.meta["guesses"]``) is kept, in a comment above the table or in an array beside the others. An existing
    file is replaced. The new file is a measurement, not an output: no command replaces it without --force.

    Raises
    ------
    FileFormatError
        It is no record, the suffix is not one of text or .npz, or the file cannot be written.
    """
    if not isinstance(record, Record):
        raise FileFormatError(
            argument="record", got=type(record).__name__, need="a Record", hint="give the path first, then the record"
        )
    of_axes = {
        f"{'voltage' if one.role == 'drive' else 'displacement'} of {one.axis}": one.name for one in record.channels
    }
    known = record.meta.get("guesses")
    guesses = stated({of_axes.get(k, k): v for k, v in known.items()} if isinstance(known, Mapping) else known)
    if Path(path).suffix.lower() == ".npz":
        kept = {MEMBER: np.array(guesses)} if guesses else {}
        write_atomically(path, packed({**record.columns("m"), **kept}))
        return
    lines = _lines(path, record.columns())
    write_atomically(path, "\n".join([*line_of(guesses), *lines, ""]))


def write_hdf5(path: PathLike, record: Record) -> None:
    """Write a `record` as HDF5, atomically: `read` returns every bit of its samples, its name and its meta.

    The file holds the datasets time_s, voltage_V and displacement_m, as an attribute ``sha256`` the hash of the three,
    one after the other as little-endian doubles, and as an attribute ``dehyst`` name and meta in JSON. `path` ends in
    .h5 or .hdf5.

    Raises
    ------
    FileFormatError
        The suffix is not .h5 or .hdf5, the meta cannot be written as JSON, or the file cannot be written.
    MissingExtraError
        If h5py is not installed.
    """
    if Path(path).suffix.lower() not in hdf5.SUFFIXES:
        raise FileFormatError(f"{path}: HDF5 needs the suffix .h5 or .hdf5; rename it")
    if record.axes:
        raise FileFormatError(f"{path}: HDF5 takes a record of one axis; write each of record.by_axis()")
    columns = record.time, record.voltage, record.displacement
    write_atomically(path, hdf5.pack(columns, record.name, record.meta, path))


def write_columns(
    path: PathLike, columns: Mapping[str, ArrayLike], *, digits: int | None = None, head: Sequence[str] = ()
) -> None:
    """Write named (n,) arrays as CSV.

    `path` is the file's. `columns` maps names to arrays. `digits` are the significant digits of the numbers, by default
    as many as give the same numbers when read; rounding never widens the range of a column. `head`: comments, a line
    each, above the table.

    Raises
    ------
    FileFormatError
        The suffix is not one of text, the columns differ in length, or the file cannot be written.
    """
    write_atomically(path, "\n".join([*head, *_lines(path, columns, digits), ""]))


def _lines(path: PathLike, columns: Mapping[str, ArrayLike], digits: int | None = None) -> list[str]:
    """Return a table as lines of text, the header first."""
    if Path(path).suffix.lower() not in TEXT and (Path(path).is_file() or not Path(path).exists()):
        raise FileFormatError(f"{path}: dehyst writes text only; try the suffix .csv")
    if any(set(name) & set(',;\t\n"') for name in columns):
        raise FileFormatError(f"{path}: column names {listed(tuple(columns))} hold a separator or a quote; rename them")
    arrays = [np.asarray(values, dtype=np.float64) for values in columns.values()]
    if not arrays or any(array.ndim != 1 or array.shape != arrays[0].shape for array in arrays):
        shapes = ", ".join(f"{name} {array.shape}" for name, array in zip(columns, arrays, strict=True))
        raise FileFormatError(f"{path}: columns must be one-dimensional and of one length, got {shapes or 'none'}")
    delimiter = "\t" if Path(path).suffix.lower() == ".tsv" else ","
    rows = zip(*(_texts(array, digits) for array in arrays), strict=True)
    return [delimiter.join(columns), *map(delimiter.join, rows)]


def _texts(values: Array, digits: int | None) -> Iterator[str]:
    """Return the texts of numbers, in full or with `digits` significant digits."""
    if digits is None or not values.size:
        return map(repr, values.tolist())
    known = np.isfinite(values)
    low, high = np.min(values, initial=np.inf, where=known), np.max(values, initial=-np.inf, where=known)

    def rounded(value: float) -> str:
        text = f"{value:.{digits}g}"
        # A voltage at a limit stays within it.
        return text if low <= float(text) <= high else repr(value)

    return map(rounded, values.tolist())
