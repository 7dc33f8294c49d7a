"""Reading of measurements in every format of `loaders`, and writing of CSV, NPZ and HDF5."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import FileFormatError
from dehyst._io.archives import packed
from dehyst._io.drafts import PathLike, write_atomically
from dehyst._io.marks import marked
from dehyst._io.reading import named, reading_errors
from dehyst._types import Array
from dehyst._units import per_metre
from dehyst._validation import demand
from dehyst.records import hdf5
from dehyst.records.column_choice import Choice, chosen
from dehyst.records.column_names import renamed
from dehyst.records.formats.columns import TEXT, UNITS, Table, listed
from dehyst.records.formats.file_content import MOST, bytes_allowed, content_of
from dehyst.records.formats.loaders import LOADERS
from dehyst.records.formats.reader_process import load
from dehyst.records.formats.units import scale_of
from dehyst.records.joined_tables import joined
from dehyst.records.record import Record

_ADVICE = dict.fromkeys((".xls", ".ods", ".opj", ".opju"), "; save it as CSV or .xlsx")
_MEASURED = ("voltage", "displacement")


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
    name: str | None = None,
    units: str | None = None,
    max_bytes: float = MOST,
) -> Record:
    """Read a record from a file whose kind follows from its suffix.

    Parameters
    ----------
    path : path
        .csv .tsv .txt .dat .asc .lvm .xlsx .mat .h5 .hdf5 .parquet .tdms or .npz. A named pipe is read once; without a
        suffix its first bytes determine the format.
    time, voltage, displacement : str, optional
        Columns, see `Table.column`.
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
    name : str, optional
        The record's name; by default the one that `write_hdf5` wrote, else the file's, without suffix.
    units : str, optional
        Unit of the displacement where the file states none: "m", "mm", "um", "nm" or "pm". The record is in metres.
    max_bytes : float
        Largest size of the file, and of its numbers in memory; a header that declares more is refused before the data
        are read.

    Raises
    ------
    FileFormatError
        An argument is of another kind, the file or a column cannot be read, both a time column and a sample rate are
        given, or the file states another unit than `units`.
    RecordError
        The columns make no record.
    MissingExtraError
        The library for this kind of file is not installed.
    """
    path = named(path)
    counted = sample_rate is None or (isinstance(sample_rate, Real) and not isinstance(sample_rate, bool))
    demand(counted, "sample_rate", sample_rate, "a number of samples a second [Hz]", error=FileFormatError)
    table, stored = _load(path, max_bytes, with_meta=True)
    table = named_and_joined(table, columns, join, time, sample_rate, max_bytes)
    displacement = displacement if units is None else _in_units(table, displacement, units)
    choice = Choice(time, voltage, displacement, voltage_scale, displacement_scale)
    record = record_of(table, choice, sample_rate, name or (stored.name if stored else path.stem))
    return _with_stored_meta(record, stored) if stored else record


def record_of(table: Table, choice: Choice, sample_rate: float | None, name: str) -> Record:
    """Return the record in a table, see `read`."""
    timed = ("time",) if sample_rate is None else ()
    found = chosen(table, choice, (*timed, "voltage", "displacement"))
    if sample_rate is not None:
        found["time"] = time_of(table, len(found["voltage"]), choice.time, sample_rate)
    meta = _meta(table, choice, sample_rate)
    return Record(found["time"], found["voltage"], found["displacement"], name, meta)


def _with_stored_meta(record: Record, stored: hdf5.Stored) -> Record:
    """Return a record with the meta that its file stores, and the scales that were given now."""
    scales = {"scales": record.meta["scales"]} if "scales" in record.meta else {}
    return replace(record, meta={**stored.meta, **scales})


def named_and_joined(
    table: Table,
    columns: str | None,
    join: PathLike | None,
    time: str | None,
    sample_rate: float | None,
    max_bytes: float = MOST,
) -> Table:
    """Return a table with the names in `columns`, and joined to the file `join`, see `read`."""
    if columns is not None:
        table = renamed(table, columns)
    return (
        table
        if join is None
        else joined(table, read_table(named(join, "join"), max_bytes=max_bytes), time, sample_rate)
    )


def _meta(table: Table, choice: Choice, sample_rate: float | None) -> dict[str, Any]:
    """Return the origin of a record: file, hash, columns, and the scales if there are any."""
    names = {quantity: table.find(quantity, getattr(choice, quantity))[0].name for quantity in _MEASURED}
    clock = table.find("time", choice.time)[0].name if sample_rate is None else f"index / {sample_rate:.9g} Hz"
    scales = {q: scale_of(q, text).words for q in _MEASURED if (text := choice.scale(q)) is not None}
    words = "".join(f", {quantity} {scale}" for quantity, scale in scales.items())
    meta: dict[str, Any] = {"source": f"{table.source}{words}", "sha256": table.sha256}
    meta["columns"] = {**names, "time": clock}
    return {**meta, "scales": scales} if scales else meta


def _in_units(table: Table, wanted: str | None, units: str) -> str:
    """Return "NAME:UNIT" for the column of the displacement; raise if the file states another unit."""
    per_metre(units, error=FileFormatError)
    column, stated = table.find("displacement", wanted)
    known = UNITS["displacement"]
    if stated in known and known[stated] != known[units]:
        raise FileFormatError(
            f"{table.source}: got the unit '{units}', but the column '{column.name}' is in {stated}; leave units out"
        )
    return f"{column.name}:{units}"


def time_of(table: Table, samples: int, wanted: str | None, sample_rate: float | None) -> Array:
    """Return the time [s] of each sample: the table's column, or the index over the sample rate [Hz]."""
    if sample_rate is None:
        return table.column("time", wanted)
    if wanted is not None or (table.has("time") and table.find("time")[1] in UNITS["time"]):
        column = wanted or table.find("time")[0].name
        raise FileFormatError(f"{table.source}: got sample_rate= and the time column '{column}'; leave one of them out")
    if not 0 < sample_rate < float("inf"):
        raise FileFormatError(f"{table.source}: sample_rate is {sample_rate} Hz; give a number above 0")
    return np.arange(samples) / sample_rate


def read_table(path: PathLike, *, max_bytes: float = MOST) -> Table:
    """Read all numeric columns of a file whose kind follows from its suffix; raise as `read` does.

    `path` is the file's. `max_bytes` bounds the file and its numbers.
    """
    return _load(named(path), max_bytes, with_meta=False)[0]


def _load(path: Path, max_bytes: float, with_meta: bool) -> tuple[Table, hdf5.Stored | None]:
    """Read a file once; return its columns and, if `with_meta` and dehyst wrote the file, name and meta."""
    most = bytes_allowed(max_bytes)
    with reading_errors(path, path.suffix):
        if path.suffix.lower() not in LOADERS and not path.is_fifo() and not path.is_dir():
            raise FileFormatError(
                f"{path}: unknown kind of file '{path.suffix}'; dehyst reads "
                f"{' '.join(LOADERS)}{_ADVICE.get(path.suffix.lower(), '')}"
            )
        content = content_of(path, most)
    columns, stored = load(content, most, with_meta)
    if not columns:
        raise FileFormatError(f"{path}: no numeric columns found; store time, voltage and displacement as 1-D arrays")
    return Table(path.name, hashlib.sha256(content.data).hexdigest(), tuple(columns)), stored


def write_record(path: PathLike, record: Record) -> None:
    """Write a `record` at full precision: as CSV, or as a NumPy archive, which is read faster.

    CSV has the columns time_s, voltage_V and displacement_um, a `path` that ends in .npz the arrays time_s, voltage_V
    and displacement_m. An existing file is replaced. The new file is a measurement, not an output: no command replaces
    it without --force.

    Raises
    ------
    FileFormatError
        It is no record, the suffix is not one of text or .npz, or the file cannot be written.
    """
    if not isinstance(record, Record):
        raise FileFormatError(
            f"record: got {type(record).__name__}, need a Record; give the path first, then the record"
        )
    columns = {"time_s": record.time, "voltage_V": record.voltage}
    if Path(path).suffix.lower() == ".npz":
        write_atomically(path, packed({**columns, "displacement_m": record.displacement}))
        return
    write_atomically(path, "\n".join([*_lines(path, {**columns, "displacement_um": record.displacement * 1e6}), ""]))


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
    columns = record.time, record.voltage, record.displacement
    write_atomically(path, hdf5.pack(columns, record.name, record.meta, path))


def write_columns(path: PathLike, columns: Mapping[str, ArrayLike], *, digits: int | None = None) -> None:
    """Write named (n,) arrays as CSV, marked as an output of dehyst (`dehyst._io.marks`).

    `path` is the file's. `columns` maps names to arrays. `digits` are the significant digits of the numbers, by default
    as many as give the same numbers when read; rounding never widens the range of a column.

    Raises
    ------
    FileFormatError
        The suffix is not one of text, the columns differ in length, or the file cannot be written.
    """
    lines = _lines(path, columns, digits)
    if len(lines) > 1:
        first, *rest = re.split(r"([,\t])", lines[1], maxsplit=1)
        lines[1] = "".join([marked(first), *rest])
    write_atomically(path, "\n".join([*lines, ""]))


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
    """Return the texts of numbers, in full or with so many significant digits."""
    if digits is None or not values.size:
        return map(repr, values.tolist())
    known = np.isfinite(values)
    low, high = np.min(values, initial=np.inf, where=known), np.max(values, initial=-np.inf, where=known)

    def rounded(value: float) -> str:
        text = f"{value:.{digits}g}"
        # A voltage at a limit stays within it.
        return text if low <= float(text) <= high else repr(value)

    return map(rounded, values.tolist())
