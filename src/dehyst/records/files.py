"""Reading of measurements in every format, and writing of CSV and NPZ."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from numbers import Real
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import FileFormatError
from dehyst._io import PathLike, packed, path_of, reading_errors, write_atomically
from dehyst._types import Array
from dehyst._units import FACTORS, per_metre
from dehyst._validation import demand
from dehyst.records.formats.columns import TEXT, Selected, Table, listed
from dehyst.records.formats.containers import LINE, MEMBER
from dehyst.records.formats.file_content import MOST, content_of
from dehyst.records.formats.loaders import LOADERS, load
from dehyst.records.formats.notation import SIGNS
from dehyst.records.record import Record, further_channels
from dehyst.records.tables import (
    AxisColumns,
    Choice,
    ColumnsError,
    axis_columns,
    chosen,
    error_of_axis,
    joined,
    renamed,
)

_ADVICE = dict.fromkeys((".xls", ".ods", ".opj", ".opju"), "; save it as CSV or .xlsx")
_MEASURED = ("voltage", "displacement")
_SCALES = ("voltage_scale", "displacement_scale")
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
    """Read a record from a file; its suffix determines the format.

    Temperatures and loads in further columns, as temperature_C or "Force [mN]", become the record's `others`;
    unsuitable columns are left out with a remark.

    Parameters
    ----------
    path : path
        .csv .tsv .txt .dat .asc .lvm .xlsx .mat .h5 .hdf5 .parquet .tdms .npz or .npy. A named pipe is read once;
        without a suffix its first bytes determine the format.
    time, voltage, displacement : str, optional
        Columns, as "NAME" or "NAME:UNIT"; a "?" at the end marks a guess, which the record keeps in
        ``meta["guesses"]``.
    sample_rate : float, optional
        Samples per second [Hz], for a file without a time column.
    voltage_scale, displacement_scale : str, optional
        Scale of the column: "100 V/V" for an amplifier's monitor, "10 um/V" for a sensor.
    columns : str, optional
        Names and units of all columns in their order, as "time:s,voltage:V,displacement:um,temperature:C"; "-" leaves
        one out. Further columns with a unit, as "humidity:%", are kept in the record's `others`.
    join : path, optional
        A second file of the same measurement. Its columns are aligned on time, or on the sample if one of the files
        has no time.
    decimal : str, optional
        "," or ".": the decimal sign of a text file whose numbers do not show it; the other sign groups digits.
    name : str, optional
        Name of the record; by default the file's name without suffix.
    units : str, optional
        Unit of the displacement where the file states none: "m", "mm", "um", "nm" or "pm". The record is in metres.
    axes : str, optional
        For a record of several axes, instead of `voltage` and `displacement`: the columns of each axis, as
        "x=vx_V:x_um, y=vy_V:y_um". A column is "NAME", "NAME:UNIT" or, with its scale, "NAME*100" or "NAME*10um/V".
        Without "x=" an axis is named after its displacement, without the unit; without blanks in names, blanks may
        replace the commas.
    max_bytes : float
        Largest size of the file, and of its numbers in memory; a header that declares more is refused before the data
        are read.

    Raises
    ------
    FileFormatError
        If an argument has a wrong type, the file or a column cannot be read, both a time column and a sample rate are
        given, the file states another unit than `units`, or `axes` does not name two columns for each of at least two
        axes.
    RecordError
        If the columns do not form a record.
    MissingExtraError
        If the library for this kind of file is not installed.
    """
    path = path_of(path)
    counted = sample_rate is None or (isinstance(sample_rate, Real) and not isinstance(sample_rate, bool))
    demand(counted, "sample_rate", sample_rate, "a number of samples a second [Hz]", error=FileFormatError)
    several = () if axes is None else axis_columns(axes)
    if several and (voltage or displacement or units):
        hint = "columns and units are those in axes"
        raise FileFormatError("got it with voltage, displacement or units", argument="axes", hint=hint)
    table = read_table(path, decimal=decimal, max_bytes=max_bytes)
    first = several[0].displacement if several else displacement
    choice = Choice(time, voltage, first, voltage_scale, displacement_scale, sample_rate)
    table = named_and_joined(table, choice, columns, join, decimal=decimal, max_bytes=max_bytes)
    if units is not None:
        per_metre(units, error=FileFormatError)
        found, known = table.select("displacement", displacement), FACTORS["displacement"]
        if found.unit in known and known[found.unit] != known[units]:
            words = f"got the unit '{units}', but the column '{found.column.name}' is in {found.unit}; leave units out"
            raise FileFormatError(f"{table.source}: {words}")
        choice = choice._replace(displacement=f"{found.column.name}:{units}")
    return record_of(table, choice, name or path.stem, several)


def record_of(table: Table, choice: Choice, name: str, axes: Sequence[AxisColumns] = ()) -> Record:
    """Return the record in a table, see `read`; of several axes if there are `axes`."""
    timed = ("time",) if choice.sample_rate is None else ()
    own = [one.choice(choice) for one in axes]
    parts: list[dict[str, Selected]] = []
    for k, selected in enumerate(own or [choice]):
        try:
            parts.append(chosen(table, selected, (*timed, *_MEASURED)))
        except ColumnsError as error:
            if not axes:
                raise
            # Options for one voltage and one displacement do not help here.
            raise error_of_axis(table, axes[k].name, error.problems, "VOLTAGE:DISPLACEMENT") from error
    voltages, displacements = ([part[quantity].values for part in parts] for quantity in _MEASURED)
    samples, found = len(voltages[0]), parts[0]
    time = found["time"].values if timed else time_of(table, samples, choice.time, choice.sample_rate)
    used = [one.column for part in parts for one in part.values()]
    others, remarks = further_channels(table, used, len(time))
    used_as = {
        quantity if quantity == "time" or not axes else f"{quantity} of {axes[k].name}": one
        for k, part in enumerate(parts)
        for quantity, one in part.items()
    }
    words = {name: one.guess for name, one in used_as.items()}
    words |= {channel.name: column.guessed for channel, column in others}
    scales = {name: one.scale.words for name, one in used_as.items() if one.scale is not None}
    columns = {quantity: found[quantity].column.name for quantity in _MEASURED}
    columns["time"] = found["time"].column.name if timed else f"index / {choice.sample_rate:.9g} Hz"
    columns |= {channel.name: column.name for channel, column in others}
    source = f"{table.source}{''.join(f', {quantity} {scale}' for quantity, scale in scales.items())}"
    texts = [
        one._replace(**{name: getattr(known, name) for name in _SCALES}).text
        for one, known in zip(axes, own, strict=True)
    ]
    origin = {"axes": texts} if axes else {"columns": columns}
    guesses = {quantity: guess for quantity, guess in words.items() if guess}
    added = {"scales": scales, "guesses": guesses, "remarks": [*table.remarks, *remarks]}
    meta = {"source": source, "sha256": table.sha256, **origin, **{key: value for key, value in added.items() if value}}
    channels = tuple(channel for channel, _ in others)
    if not axes:
        return Record(time, voltages[0], displacements[0], name, meta, others=channels)
    # Each axis is checked by itself.
    records = [
        Record(time, v, y, f"{name} ({one.name})") for one, v, y in zip(axes, voltages, displacements, strict=True)
    ]
    voltage, displacement = (np.column_stack([getattr(one, column) for one in records]) for column in _MEASURED)
    return Record(time, voltage, displacement, name, meta, axes=tuple(one.name for one in axes), others=channels)


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
    path = path_of(join, "join")
    own = decimal if path.suffix.lower() in _WITH_SIGNS else None
    return joined(table, read_table(path, decimal=own, max_bytes=max_bytes), choice)


def time_of(table: Table, samples: int, wanted: str | None, sample_rate: float | None) -> Array:
    """Return the time [s] of each sample: the table's column, or the index over the sample rate [Hz]."""
    if sample_rate is None:
        return table.column("time", wanted)
    known = table.select("time") if wanted is None and table.fitting("time") == 1 else None
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
    """Read all numeric columns of the file at `path`; its suffix determines the format. Errors as in `read`.

    `decimal`: decimal sign of a text file, "," or ".". `max_bytes`: largest size of the file, and of its numbers in
    memory.
    """
    path = path_of(path)
    demand(decimal in (None, *SIGNS), "decimal", decimal, "one of '.' and ','", error=FileFormatError)
    with reading_errors(path, path.suffix):
        if path.suffix.lower() not in LOADERS and path.exists() and not path.is_fifo() and not path.is_dir():
            raise FileFormatError(
                f"{path}: unknown kind of file '{path.suffix}'; dehyst reads "
                f"{' '.join(LOADERS)}{_ADVICE.get(path.suffix.lower(), '')}"
            )
        content = content_of(path, max_bytes)._replace(decimal=decimal)
    if decimal is not None and content.suffix not in _WITH_SIGNS:
        raise FileFormatError(
            f"{path}: decimal: got '{decimal}', but {content.suffix} files hold no text; leave it out"
        )
    columns = load(content)
    if not columns:
        raise FileFormatError(f"{path}: no numeric columns found; store time, voltage and displacement as 1-D arrays")
    return Table(path.name, hashlib.sha256(content.data).hexdigest(), tuple(columns))


def write_record(path: PathLike, record: Record) -> None:
    """Write a `record` to `path` at full precision: as CSV, or as a NumPy archive, which is read faster.

    CSV has the columns time_s, voltage_V and displacement_um, an .npz file the arrays time_s, voltage_V and
    displacement_m; with several axes the names are vx_V, x_um and so on. Further channels follow, as temperature_C.
    Guesses from reading (``record.meta["guesses"]``), and the names of channels other than temperatures and loads, are
    kept in a comment above the table or in an additional array. An existing file is replaced. The new file is a
    measurement, not an output: no command replaces it without --force.

    Raises
    ------
    FileFormatError
        If `record` is not a Record, the suffix is neither .npz nor one of a text file, or the file cannot be written.
    """
    if not isinstance(record, Record):
        need, hint = "a Record", "give the path first, then the record"
        raise FileFormatError(argument="record", got=type(record).__name__, need=need, hint=hint)
    of_axes = {f"{'voltage' if one.role == 'drive' else one.role} of {one.axis}": one.name for one in record.channels}
    known = record.meta.get("guesses")
    known = known if isinstance(known, Mapping) else {}
    guesses = {of_axes.get(str(quantity), str(quantity)): str(guess) for quantity, guess in known.items()}
    stated = {"guesses": guesses, "others": [one.column for one in record.others if one.role == "other"]}
    text = json.dumps({key: value for key, value in stated.items() if value}) if any(stated.values()) else ""
    if Path(path).suffix.lower() == ".npz":
        write_atomically(path, packed({**record.columns("m"), **({MEMBER: np.array(text)} if text else {})}))
    else:
        write_atomically(path, "\n".join([*[LINE + text] * bool(text), *_lines(path, record.columns()), ""]))


def write_columns(
    path: PathLike, columns: Mapping[str, ArrayLike], *, digits: int | None = None, head: Sequence[str] = ()
) -> None:
    """Write named (n,) arrays as CSV.

    `path` is the file's. `columns` maps names to arrays. `digits` are the significant digits of the numbers, by default
    as many as give the same numbers when read; rounding never widens the range of a column. `head` has lines to
    write before the names. Raise `FileFormatError` if the suffix is not one of text, the columns differ in length, or
    the file cannot be written.
    """
    write_atomically(path, "\n".join([*head, *_lines(path, columns, digits), ""]))


def demand_text(path: PathLike) -> None:
    """Raise `FileFormatError` if the suffix of an output is not one of text."""
    if Path(path).suffix.lower() not in TEXT and (Path(path).is_file() or not Path(path).exists()):
        raise FileFormatError(f"{path}: dehyst writes text only; try the suffix .csv")


def _lines(path: PathLike, columns: Mapping[str, ArrayLike], digits: int | None = None) -> list[str]:
    """Return a table as lines of text, the header first."""
    demand_text(path)
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
