"""Binary files: NPZ, HDF5, Parquet and TDMS to columns; declared sizes are checked before the data are read."""

from __future__ import annotations

import importlib
import io
import zipfile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import FileFormatError, MissingExtraError
from dehyst.records.formats import hdf5_nodes
from dehyst.records.formats.columns import Column, shortened
from dehyst.records.formats.file_content import Allowance

# Longest text of a unit [bytes].
_LONGEST_UNIT = 256


def library(module: str, purpose: str, extra: str = "files") -> Any:
    """Return a module of an optional package; raise MissingExtraError if it is not installed."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MissingExtraError.of(module.split(".", maxsplit=1)[0], extra, purpose) from error


def read_npz(data: bytes, allowance: Allowance) -> list[Column]:
    """Read arrays of an NPZ archive; objects are never opened, because that would run code."""
    columns: list[Column] = []
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = [member for member in archive.infolist() if member.filename.endswith(".npy")]
        for member in members:
            columns += _member(archive, member, allowance)
    return columns


def _member(archive: zipfile.ZipFile, member: zipfile.ZipInfo, allowance: Allowance) -> list[Column]:
    name = member.filename.removesuffix(".npy")
    what = f"array '{shortened(name)}'"
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise FileFormatError(
            f"{allowance.path}: {what} is packed in a way that NumPy never uses; save it with numpy.savez"
        )
    with archive.open(member) as stream:
        version = np.lib.format.read_magic(stream)
        read_header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
        if version not in read_header:
            raise FileFormatError(f"{allowance.path}: {what} has names in its type, need numbers; save plain arrays")
        shape, _, dtype = read_header[version](stream)
        if dtype.hasobject:
            raise FileFormatError(
                f"{allowance.path}: not a readable .npz file: {what} holds Python objects, which are not opened; save "
                "arrays of numbers"
            )
        count = product(shape)
        if dtype.kind not in "fiu" or not shape or count < 2 or count != max(shape):
            return []
        allowance.take(count, what)
        if count * dtype.itemsize > member.file_size:
            raise FileFormatError(
                f"{allowance.path}: {what} declares {count} numbers, but has only {member.file_size} bytes; the "
                "file is cut off or damaged, take a copy"
            )
    with archive.open(member) as stream:
        return vectors(name, np.lib.format.read_array(stream, allow_pickle=False))


def product(shape: tuple[int, ...]) -> int:
    """Return the number of elements, however large; negative if a size is."""
    count = 1
    for size in shape:
        count *= int(size)
    return -1 if any(size < 0 for size in shape) else count


def vectors(name: str, array: Any, unit: str = "") -> list[Column]:
    """Return a column for an array of real numbers that is 1-D, or 2-D with one row or column, as in MATLAB."""
    array = np.asarray(array)
    if array.dtype.kind not in "fiu" or array.size < 2 or array.size != max(array.shape):
        return []
    with np.errstate(all="ignore"):
        return [Column(name, array.ravel().astype(np.float64, copy=False), unit)]


def read_hdf5(data: bytes, allowance: Allowance) -> list[Column]:
    """Read datasets of an HDF5 file, in any group; those with samples in another file have a fault."""
    h5py = library("h5py", f"Reading {allowance.path.suffix} files")
    columns: list[Column] = []
    with h5py.File(io.BytesIO(data), "r") as file:
        for name, dataset, fault in hdf5_nodes.nodes(file, h5py, allowance):
            if name.startswith("#"):
                continue
            if fault:
                columns.append(Column(name, np.empty(0), fault=fault, foreign=True))
            elif hdf5_nodes.is_vector(dataset) and dataset.size > 1:
                columns += vectors(name, hdf5_nodes.samples(dataset, name, allowance), _unit(dataset))
    return columns


def _unit(dataset: Any) -> str:
    """Return the unit that an attribute states; attributes that are no short text are ignored."""
    for name in ("unit", "units"):
        if name in dataset.attrs:
            attribute = dataset.attrs.get_id(name)
            kind, size = attribute.dtype.kind, attribute.dtype.itemsize
            if attribute.shape in ((), (1,)) and kind in "OSU" and size <= _LONGEST_UNIT:
                unit = dataset.attrs[name]
                unit = unit[0] if isinstance(unit, np.ndarray) else unit
                return str(unit.decode() if isinstance(unit, bytes) else unit)[:_LONGEST_UNIT].strip()
    return ""


def read_parquet(data: bytes, allowance: Allowance) -> list[Column]:
    """Read columns of whole and real numbers of a Parquet file."""
    pyarrow = library("pyarrow", "Reading Parquet files")
    file = library("pyarrow.parquet", "Reading Parquet files").ParquetFile(io.BytesIO(data), pre_buffer=False)
    is_number = pyarrow.types.is_integer, pyarrow.types.is_floating
    wanted = [field.name for field in file.schema_arrow if any(holds(field.type) for holds in is_number)]
    for name in wanted:
        allowance.take(file.metadata.num_rows, f"column '{shortened(name)}'")
    table = file.read(columns=wanted, use_threads=False)
    return [
        column
        for name, values in zip(table.column_names, table.columns, strict=True)
        for column in vectors(name, np.concatenate([arrow_numbers(chunk) for chunk in values.chunks] or [np.empty(0)]))
    ]


def arrow_numbers(chunk: Any) -> NDArray[np.float64]:
    """Return the numbers of an Arrow array, NaN for missing ones; its own conversion to NumPy would import pandas."""
    valid, values = chunk.buffers()
    rows = slice(chunk.offset, chunk.offset + len(chunk))
    with np.errstate(all="ignore"):
        numbers = np.frombuffer(values, dtype=chunk.type.to_pandas_dtype())[rows].astype(np.float64)
    if chunk.null_count:
        bits = np.unpackbits(np.frombuffer(valid, dtype=np.uint8), bitorder="little")
        numbers[bits[rows] == 0] = np.nan
    return numbers


def read_tdms(data: bytes, allowance: Allowance) -> list[Column]:
    """Read channels of a TDMS file; the time of a waveform follows from its properties."""
    reader = library("nptdms", "Reading TDMS files").TdmsFile
    for group in reader.read_metadata(io.BytesIO(data)).groups():
        for channel in group.channels():
            allowance.take(len(channel), f"channel '{shortened(channel.name)}'")
    columns: list[Column] = []
    increments: set[tuple[int, float]] = set()
    for group in reader.read(io.BytesIO(data)).groups():
        for channel in group.channels():
            unit = str(channel.properties.get("unit_string", ""))[:_LONGEST_UNIT].strip()
            columns += vectors(f"{group.name}/{channel.name}", channel[:], unit)
            increments.add((len(channel), float(channel.properties.get("wf_increment", 0.0))))
    # A waveform has no time channel: its sampling is a property, the same for every channel of a run.
    timed = any(column.parts[0].lower() in ("time", "t") for column in columns)
    if not timed and len(increments) == 1 and (run := increments.pop())[1] > 0:
        allowance.take(run[0], "the time of its waveforms")
        with np.errstate(all="ignore"):
            columns.append(Column("time", np.arange(float(run[0])) * run[1], "s"))
    return columns
