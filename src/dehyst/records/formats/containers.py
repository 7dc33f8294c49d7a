"""Columns of binary files: NumPy, HDF5, Parquet, TDMS and MATLAB; what record files of dehyst state about theirs."""

from __future__ import annotations

import io
import json
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import FileFormatError
from dehyst._io import demand_version
from dehyst._units import COUNTS, quantity_of, symbol_of
from dehyst.records.formats.columns import Column, listed, shortened
from dehyst.records.formats.file_content import Allowance

# Name of the array of an NPZ, and the beginning of the first line of a text, in which a record file states in JSON
# "guesses" by quantity and the columns of "others".
MEMBER = "dehyst-record"
LINE = f"# {MEMBER}: "
# Why complex numbers cannot be used.
COMPLEX = "holds complex numbers; export their real part, or their magnitude, as a column of its own"
# Longest text of it [bytes].
LONGEST = 4096


def restored(columns: Sequence[Column], text: str) -> list[Column]:
    """Return the columns of a record file with the properties that the file states; other text is ignored."""
    try:
        stated = json.loads(text) if text else {}
    except (ValueError, RecursionError):
        stated = {}
    if isinstance(stated, dict):
        demand_version(stated, "this record of dehyst")
    guesses, others = (stated.get("guesses"), stated.get("others")) if isinstance(stated, dict) else (None, None)
    words = {k: v for k, v in guesses.items() if isinstance(v, str) and v} if isinstance(guesses, dict) else {}
    kept = others if isinstance(others, list) else []
    return [
        replace(one, guessed=words.get(one.parts[0], one.guessed), kept=one.kept or one.name in kept) for one in columns
    ]


def vectors(name: str, array: Any, unit: str = "") -> list[Column]:
    """Return a column for an array of numbers that is 1-D, or 2-D with one row or column, as in MATLAB.

    Complex numbers have a fault.
    """
    array = np.asarray(array)
    if array.dtype.kind not in "fiuc" or array.size < 2 or array.size != max(array.shape):
        return []
    if array.dtype.kind == "c":
        return [Column(name, np.empty(0), unit, fault=COMPLEX)]
    with np.errstate(all="ignore"):
        return [Column(name, array.ravel().astype(np.float64, copy=False), unit)]


def product(shape: tuple[int, ...]) -> int:
    """Return the number of elements, however large; negative if a size is."""
    count = int(np.prod(shape, dtype=object)) if shape else 1
    return -1 if any(size < 0 for size in shape) else count


# Rows or columns of one array that are taken for series of samples.
_MOST_SERIES = 32


class _Array(NamedTuple):
    """An array in the NPY format that is not yet read: its header, and how to open it."""

    open: Callable[[], IO[bytes]]
    name: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]

    @property
    def kind(self) -> str:
        """What it may hold: "series" of samples, a "table" of several, "text", or "" for anything else."""
        count = product(self.shape)
        if self.dtype.kind == "U" and not self.shape and self.dtype.itemsize <= 4 * LONGEST:
            return "text"
        if self.dtype.names is None and self.dtype.kind not in "fiuc":
            return ""
        if len(self.shape) == 2 and self.dtype.names is None:
            few, many = sorted(self.shape)
            if 1 < few <= _MOST_SERIES and many >= 2 * few:
                return "table"
        return "series" if self.shape and count > 1 and count == max(self.shape) else ""

    def read(self, allowance: Allowance) -> Any:
        """Read it after a check of its declared size, as numbers and as it is stored."""
        count, what = product(self.shape), f"array '{shortened(self.name)}'"
        allowance.check(count * self.dtype.itemsize, what)
        allowance.take(count * len(self.dtype.names or "1"), what)
        with self.open() as stream:
            return np.lib.format.read_array(stream, allow_pickle=False)

    def series(self, allowance: Allowance, prefix: str = "") -> list[Column]:
        """Return the columns of an array in one dimension: itself, or its fields."""
        values = self.read(allowance)
        if self.dtype.names is None:
            return vectors(self.name, values)
        return [column for field in self.dtype.names for column in vectors(f"{prefix}{field}", values[field])]

    def rows(self, allowance: Allowance) -> list[Column]:
        """Return the rows of a table without names, or its columns if these are longer."""
        table = self.read(allowance)
        rows, kind = (table, "rows") if self.shape[0] < self.shape[1] else (table.T, "columns")
        unnamed = (
            f"its one array has shape {self.shape} and no names; name its {len(rows)} {kind}, or save three arrays "
            "with the names time_s, voltage_V and displacement_um by numpy.savez"
        )
        with np.errstate(all="ignore"):
            columns = [column for k, row in enumerate(rows, 1) for column in vectors(str(k), row)]
        return [replace(column, unnamed=unnamed) for column in columns]


def _header(opened: Callable[[], IO[bytes]], size: int, name: str, allowance: Allowance) -> _Array:
    """Read the header of an array of `size` bytes.

    Raise `FileFormatError` if it holds Python objects, or may hold series and declares more than it has or is allowed.
    """
    what = f"array '{shortened(name)}'"
    with opened() as stream:
        version = np.lib.format.read_magic(stream)
        read_header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
        if version not in read_header:
            raise FileFormatError(f"{what} has names in its type, need numbers; save plain arrays")
        shape, _, dtype = read_header[version](stream)
    if dtype.hasobject:
        # Objects are never opened, because that would run code.
        raise FileFormatError(f"{what} holds Python objects, which are not opened; save arrays of numbers")
    array, count = _Array(opened, name, shape, dtype), product(shape)
    if array.kind == "series":
        allowance.check(8 * count, what)
    if array.kind and count * dtype.itemsize > size:
        raise FileFormatError(
            f"{what} declares {count} numbers, but has only {size} bytes; the file is cut off or damaged, take a copy"
        )
    return array


def read_npz(data: bytes, allowance: Allowance) -> list[Column]:
    """Read arrays of an NPZ archive."""
    arrays = []
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        for member in archive.infolist():
            if not member.filename.endswith(".npy"):
                continue
            name = member.filename.removesuffix(".npy")
            if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                raise FileFormatError(
                    f"array '{shortened(name)}' is packed in a way that NumPy never uses; save it with numpy.savez"
                )
            arrays.append(_header(partial(archive.open, member), member.file_size, name, allowance))
        tables = [array for array in arrays if array.kind == "table"]
        columns = [
            column for array in arrays if array.kind == "series" for column in array.series(allowance, f"{array.name}/")
        ]
        if not columns and len(tables) == 1:
            columns = tables[0].rows(allowance)
        texts = [str(array.read(allowance)) for array in arrays if (array.name, array.kind) == (MEMBER, "text")]
    return restored(columns, "".join(texts))


def read_npy(data: bytes, allowance: Allowance) -> list[Column]:
    """Read one array of NumPy: the fields of a structured one by their names, else its rows or columns."""
    array = _header(partial(io.BytesIO, data), len(data), allowance.stem, allowance)
    if array.kind == "table":
        return array.rows(allowance)
    if array.kind == "series":
        return array.series(allowance)
    raise FileFormatError(
        f"no numeric columns found in an array of the shape {array.shape}, need 2 to {_MOST_SERIES} series, each with "
        "twice as many samples at least; save one array for each series by numpy.savez, with the names time_s, "
        "voltage_V and displacement_um"
    )


# A file of measurements has fewer levels of groups and fewer names.
_DEEPEST, _MOST_NAMES = 64, 100_000
# Longest text of a unit [bytes].
_LONGEST_UNIT = 256
_OWN_SAMPLES = "copy its samples into the file, for instance with h5repack or h5copy"


class Node(NamedTuple):
    """A dataset of HDF5 by its full name, or the reason why it cannot be a column of a record."""

    name: str
    dataset: Any
    fault: str


def hdf5_nodes(file: Any) -> Iterator[Node]:
    """Yield the datasets of all groups that hard links lead to, each once.

    Soft links are ignored, because their targets are found under their own names; external links are yielded with
    their fault and never followed. Raise `FileFormatError` for groups too deep, or too many names: a damaged file.
    """
    import h5py

    def place(item: Any) -> tuple[int, int]:
        info = h5py.h5o.get_info(item.id)
        return int(info.fileno), int(info.addr)

    seen = {place(file)}
    left, count = [("", file["/"], iter(file))], 0
    while left:
        prefix, group, keys = left[-1]
        if (key := next(keys, None)) is None:
            left.pop()
            continue
        name, count = prefix + key, count + 1
        if count > _MOST_NAMES or len(left) > _DEEPEST:
            raise FileFormatError(
                f"more than {_MOST_NAMES} names, or groups more than {_DEEPEST} deep; keep the record's columns only"
            )
        link = group.get(key, getlink=True)
        if isinstance(link, h5py.ExternalLink):
            fault = f"is an external link to '{link.filename}', which is not followed; {_OWN_SAMPLES}"
            yield Node(name, None, fault)
        elif isinstance(link, h5py.HardLink) and (where := place(item := group[key])) not in seen:
            seen.add(where)
            if isinstance(item, h5py.Group):
                left.append((f"{name}/", item, iter(item)))
            elif isinstance(item, h5py.Dataset):
                fault = ""
                if item.is_virtual:
                    fault = f"is a virtual dataset, made of others, which are not read; {_OWN_SAMPLES}"
                elif item.external:
                    fault = f"has external storage in '{item.external[0][0]}', which is not read; {_OWN_SAMPLES}"
                # MATLAB writes complex numbers as pairs.
                elif (item.dtype.kind == "c" or item.dtype.names == ("real", "imag")) and item.size == max(item.shape):
                    fault = COMPLEX
                yield Node(name, item, fault)


def is_vector(dataset: Any) -> bool:
    """Return whether a dataset declares real numbers in one dimension, or in one row or column."""
    shape = dataset.shape
    return shape is not None and len(shape) > 0 and dataset.dtype.kind in "fiu" and dataset.size == max(shape)


def samples_of(dataset: Any, name: str, allowance: Allowance) -> NDArray[Any]:
    """Read a dataset after a check of its declared size and of its chunk size."""
    allowance.take(int(dataset.size), f"dataset '{name}'")
    if dataset.chunks:
        # A whole chunk is in memory, packed and unpacked, however few of its samples exist.
        allowance.check(product(dataset.chunks) * dataset.dtype.itemsize, f"a chunk of dataset '{name}'")
    return np.asarray(dataset[()])


def read_hdf5(data: bytes, allowance: Allowance) -> list[Column]:
    """Read datasets of an HDF5 file, in any group; those with samples in another file have a fault."""
    import h5py

    columns: list[Column] = []
    with h5py.File(io.BytesIO(data), "r") as file:
        for name, dataset, fault in hdf5_nodes(file):
            if name.startswith("#"):
                continue
            if fault:
                columns.append(Column(name, np.empty(0), fault=fault, foreign=fault != COMPLEX))
            elif is_vector(dataset) and dataset.size > 1:
                (column,) = vectors(name, samples_of(dataset, name, allowance), _unit(dataset))
                if not symbol_of(column.parts[1]) and (unit := _unit(dataset.parent)):
                    # The unit of the group, unless the column has the name of another quantity.
                    named = column.quantities
                    column = replace(column, unit=unit) if not named or quantity_of(unit) in named else column
                columns.append(column)
    return columns


def _unit(item: Any) -> str:
    """Return the unit that an attribute states; attributes that are no short text are ignored."""
    for name in ("unit", "units"):
        if name in item.attrs:
            attribute = item.attrs.get_id(name)
            kind, size = attribute.dtype.kind, attribute.dtype.itemsize
            if attribute.shape in ((), (1,)) and kind in "OSU" and size <= _LONGEST_UNIT:
                unit = item.attrs[name]
                unit = unit[0] if isinstance(unit, np.ndarray) else unit
                return str(unit.decode() if isinstance(unit, bytes) else unit)[:_LONGEST_UNIT].strip()
    return ""


def read_parquet(data: bytes, allowance: Allowance) -> list[Column]:
    """Read columns of numbers, dates and durations of a Parquet file, an index of pandas among them."""
    from pyarrow import parquet

    file = parquet.ParquetFile(io.BytesIO(data), pre_buffer=False)
    wanted = [field.name for field in file.schema_arrow if is_readable(field.type)]
    for name in wanted:
        allowance.take(file.metadata.num_rows, f"column '{shortened(name)}'")
    return arrow_columns(file.read(columns=wanted, use_threads=False))


def is_readable(kind: Any) -> bool:
    """Return whether an Arrow type holds real numbers, dates or durations."""
    from pyarrow import types

    return any(holds(kind) for holds in (types.is_integer, types.is_floating, types.is_timestamp, types.is_duration))


def arrow_columns(table: Any) -> list[Column]:
    """Return the columns of an Arrow table; dates and durations in seconds, an index without a name as the time."""
    columns: list[Column] = []
    for name, values in zip(table.column_names, table.columns, strict=True):
        resolution = getattr(values.type, "unit", "")
        numbers = [_arrow_numbers(chunk, bool(resolution)) for chunk in values.chunks] or [np.empty(0)]
        array = np.concatenate(numbers)
        if resolution:
            # Dates count from the first of them. Whole numbers are subtracted before they become doubles, which resolve
            # nanoseconds since 1970 to 0.2 us only.
            missing = array == _MISSING
            first = array[~missing][:1] if str(values.type).startswith("timestamp") else array[:0]
            with np.errstate(all="ignore"):
                array = (array - first if first.size else array) / COUNTS["s"][resolution]
            array[missing] = np.nan
        index = bool(resolution) and name.startswith("__index_level_")
        found = vectors("time" if index else name, array, "s" if resolution else "")
        columns += [replace(column, foreign=index) for column in found]
    return columns


# A date or a duration that is missing.
_MISSING = np.iinfo(np.int64).min


def _arrow_numbers(chunk: Any, ticks: bool) -> NDArray[Any]:
    """Return the numbers of an Arrow array, NaN for missing ones; its own conversion to NumPy would import pandas.

    `ticks`: whether it counts units of time, which stay whole numbers.
    """
    valid, values = chunk.buffers()
    rows = slice(chunk.offset, chunk.offset + len(chunk))
    kind = np.int64 if ticks else chunk.type.to_pandas_dtype()
    with np.errstate(all="ignore"):
        numbers = np.frombuffer(values, dtype=kind)[rows].astype(np.int64 if ticks else np.float64)
    if chunk.null_count:
        bits = np.unpackbits(np.frombuffer(valid, dtype=np.uint8), bitorder="little")
        numbers[bits[rows] == 0] = _MISSING if ticks else np.nan
    return numbers


def read_tdms(data: bytes, allowance: Allowance) -> list[Column]:
    """Read channels of a TDMS file; the time of a waveform follows from its properties.

    Raise FileFormatError if its channels have clocks of their own.
    """
    from nptdms import TdmsFile

    for group in TdmsFile.read_metadata(io.BytesIO(data)).groups():
        for channel in group.channels():
            allowance.take(len(channel), f"channel '{shortened(channel.name)}'")
    columns: list[Column] = []
    clocks: dict[str, tuple[int, float, float, str]] = {}
    for group in TdmsFile.read(io.BytesIO(data)).groups():
        for channel in group.channels():
            have = channel.properties
            unit = str(have.get("unit_string", ""))[:_LONGEST_UNIT].strip()
            times = float(have.get("wf_increment", 0.0)), float(have.get("wf_start_offset", 0.0))
            for column in vectors(f"{group.name}/{channel.name}", channel[:], unit):
                columns.append(column)
                clocks[column.name] = (len(channel), *times, str(have.get("wf_start_time", "")))
    # A waveform has no time channel: its sampling is a property, the same for every channel of a run.
    if any(column.parts[0].lower() in ("time", "t") for column in columns):
        return columns
    runs = set(clocks.values())
    if len(runs) > 1 and all(run[1] > 0 for run in runs):
        raise FileFormatError(
            f"the channels {listed(tuple(clocks))} have clocks of their own: number of samples, wf_increment, "
            "wf_start_offset or wf_start_time differ",
            hint="save each in a file of its own with its time, and join the second one",
            change=("join",),
        )
    if len(runs) == 1 and (run := runs.pop())[1] > 0:
        allowance.take(run[0], "the time of its waveforms")
        with np.errstate(all="ignore"):
            columns.append(Column("time", run[2] + np.arange(float(run[0])) * run[1], "s"))
    return columns


_HDF5 = b"\x89HDF\r\n\x1a\n"
# Sizes of the header and of a tag of MAT files of version 5 [bytes], and the type of a compressed variable.
_MAT_HEAD, _MAT_TAG, _MAT_COMPRESSED = 128, 8, 15
_MAT_NUMBERS = {"double", "single", "logical", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))}
_CHUNK = 1 << 20
# Structures in structures.
_DEEPEST_FIELD = 8


def is_hdf5(data: bytes) -> bool:
    """Return whether a MAT file has version 7.3."""
    return data.startswith((b"MATLAB 7.3", _HDF5)) or data[512:520] == _HDF5


def read_mat(data: bytes, allowance: Allowance) -> list[Column]:
    """Read variables of a MAT file of any version; of structures the fields; cells and text are ignored."""
    if is_hdf5(data):
        return read_hdf5(data, allowance)
    import scipy.io

    _refuse_inflated(data, allowance)
    wanted, structures = [], []
    stream: Any = io.BytesIO(data)
    for name, shape, kind in scipy.io.whosmat(stream):
        count = product(shape)
        if kind in _MAT_NUMBERS and shape and count > 1 and count == max(shape) and not name.startswith("__"):
            allowance.take(count, f"variable '{shortened(name)}'")
            wanted.append(name)
        elif kind == "struct" and count == 1:
            structures.append(name)
    if not wanted and not structures:
        return []
    names = [*wanted, *structures]
    variables = scipy.io.loadmat(stream, variable_names=names, simplify_cells=bool(structures))
    columns = [column for name in wanted for column in vectors(name, variables[name])]
    fields = [column for name in structures for column in _fields(name, variables[name], allowance)]
    return columns + [replace(column, foreign=bool(columns)) for column in fields]


def _fields(name: str, structure: Any, allowance: Allowance, depth: int = 1) -> list[Column]:
    """Return the arrays in a structure, and in the structures in it, as data/t."""
    columns: list[Column] = []
    for field, value in structure.items() if isinstance(structure, dict) and depth <= _DEEPEST_FIELD else ():
        found = _fields(f"{name}/{field}", value, allowance, depth + 1)
        if not isinstance(value, dict) and (found := vectors(f"{name}/{field}", value)):
            allowance.take(found[0].data.size, f"field '{shortened(field)}'")
        columns += found
    return columns


def _refuse_inflated(data: bytes, allowance: Allowance) -> None:
    """Unpack the compressed variables piece by piece, and check their size."""
    place, size = _MAT_HEAD, 0
    order = ">" if data[126:128] == b"MI" else "<"
    while place + _MAT_TAG <= len(data):
        kind, length = struct.unpack_from(f"{order}II", data, place)
        place += _MAT_TAG
        if kind == _MAT_COMPRESSED:
            inflate, packed = zlib.decompressobj(), data[place : place + length]
            while packed and not inflate.eof:
                size += len(inflate.decompress(packed, _CHUNK))
                packed = inflate.unconsumed_tail
                allowance.check(size, "its compressed variables")
        place += length
