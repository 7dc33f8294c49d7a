"""Columns of binary files: NumPy, MATLAB, HDF5 and TDMS; what record files of dehyst state about their columns.

A library reads each format. A small file may declare a large size: sizes are checked before samples are read.
"""

from __future__ import annotations

import io
import json
import re
import zipfile
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from math import prod
from typing import IO, Any, BinaryIO, NamedTuple

import numpy as np

from dehyst._errors import FileFormatError
from dehyst._io import demand_version
from dehyst._units import quantity_of, symbol_of
from dehyst.records.formats.column import Allowance, Column, listed, shortened

# Name of the array of an NPZ, and the beginning of the first line of a text, in which a record file states in JSON
# "guesses" and "timing" by quantity and the columns of "others"; and the longest such text [bytes].
MEMBER = "dehyst-record"
LINE = f"# {MEMBER}: "
LONGEST = 4096
# Why variables cannot be used.
_OBJECT = "holds a MATLAB object, which only MATLAB reads: save its fields as a struct or arrays"
_CELL = "holds a cell array; save the arrays in its cells as variables of their own"
_PYTHON = "holds Python objects, which are not opened, because that runs code; save arrays of numbers"
_ELSEWHERE = "has its samples in another place, which is not read; copy them into the file, with h5repack or h5copy"
# Most rows or columns of one array that count as series of samples.
_MOST_SERIES = 32
# Bytes in which the header of an array of NumPy states its type.
_HEADER = 4096


def restored(columns: Sequence[Column], text: str) -> list[Column]:
    """Return the columns of a record file with the properties that the file states; other text is ignored."""
    try:
        stated = dict(json.loads(text or "{}"))
        guesses, timing = (dict(stated.get(name, {})) for name in ("guesses", "timing"))
        others = list(stated.get("others", []))
    except (ValueError, TypeError, RecursionError):
        return [*columns]
    demand_version(stated, "this record of dehyst")
    return [
        replace(
            column,
            guessed=str(guesses.get(column.parts[0], column.guessed)),
            kept=column.kept or column.name in others,
            timing=str(timing.get(column.parts[0], "")),
        )
        for column in columns
    ]


class _Array(NamedTuple):
    """An array of a file, which HDF5 has not yet read: its name, its numbers, its unit, and why it cannot be used."""

    name: str
    values: Any
    unit: str = ""
    fault: str = ""

    @property
    def kind(self) -> str:
        """What it may hold: "series" of samples, a "table" of several, or "" for anything else."""
        shape, dtype = self.values.shape, self.values.dtype
        many = max(shape, default=0)
        if many > 1 and self.values.size == many and (dtype.names or dtype.kind in "fiu"):
            return "series"
        table = len(shape) == 2 and 1 < min(shape) <= _MOST_SERIES and many >= 2 * min(shape)
        return "table" if table and dtype.kind in "fiu" else ""

    def columns(self, allowance: Allowance, alone: bool = False) -> list[Column]:
        """Return the columns: rows or columns of a table, fields of a structure; `alone`: without its name."""
        if self.fault:
            return [Column(self.name, np.empty(0), fault=self.fault, group=_group(self.name))]
        if not self.kind:
            return []
        allowance.take(self.values.size * len(self.values.dtype.names or "1"), f"array '{shortened(self.name)}'")
        values, fields = _unpacked(self.values), {}
        if self.kind == "table":
            fields = {str(k): row for k, row in enumerate(values if values.shape[0] < values.shape[1] else values.T, 1)}
        elif values.dtype.names:
            fields = {name: values[name] for name in values.dtype.names}
        named = {key if alone else f"{self.name}/{key}": row for key, row in fields.items()} or {self.name: values}
        unnamed = alone and self.kind == "table"
        columns = []
        for name, field in named.items():
            # A structure may hold more than one number, or text, for each sample.
            if field.dtype.kind in "fiu" and field.size == max(field.shape):
                with np.errstate(all="ignore"):
                    data = np.ascontiguousarray(field.ravel(), dtype=np.float64)
                columns.append(Column(name, data, self.unit, unnamed=unnamed, group=_group(name)))
        return columns


def _group(name: str) -> str:
    return name[: name.rfind("/") + 1]


def _columns_of(arrays: Sequence[_Array], allowance: Allowance) -> list[Column]:
    """Return all series, and the tables as long as one of the series; without a series, all tables."""
    tables = [array for array in arrays if array.kind == "table" and not array.fault]
    alone = len(arrays) == 1
    columns = [column for array in arrays if array not in tables for column in array.columns(allowance, alone)]
    lengths = {column.data.size for column in columns} - {0}
    alone = len(tables) == 1 and not lengths
    fit = [table for table in tables if not lengths or max(table.values.shape) in lengths]
    # Columns without a name come first, because an error names the first column.
    columns = [column for table in fit for column in table.columns(allowance, alone)] + columns
    if columns and not (lengths or fit):
        raise FileFormatError(f"'{shortened(columns[0].name)}' {columns[0].fault}")
    return columns


def _npy(name: str, stream: IO[bytes]) -> _Array:
    """Return an array of NumPy; one of Python objects has a fault."""
    head = stream.read(_HEADER)
    if b"'|O'" in head:
        return _Array(name, np.empty(0), fault=_PYTHON)
    stream.seek(0)
    return _Array(name, np.lib.format.read_array(stream, allow_pickle=False))


def read_npy(stream: BinaryIO, allowance: Allowance) -> list[Column]:
    """Read one array of NumPy: the fields of a structured one by their names, else its rows or columns."""
    return _columns_of([_npy(allowance.stem, stream)], allowance)


def read_npz(stream: BinaryIO, allowance: Allowance) -> list[Column]:
    """Read arrays of an NPZ archive."""
    arrays = []
    with zipfile.ZipFile(stream) as archive:
        for member in archive.infolist():
            allowance.check(member.file_size, f"array '{shortened(member.filename)}'")
            if member.filename.endswith(".npy"):
                with archive.open(member) as unpacked:
                    arrays.append(_npy(member.filename.removesuffix(".npy"), unpacked))
    texts = [str(array.values) for array in arrays if array.name == MEMBER and array.values.dtype.kind == "U"]
    return restored(_columns_of(arrays, allowance), "".join(texts))


def read_hdf5(stream: BinaryIO, allowance: Allowance) -> list[Column]:
    """Read the datasets of all groups, each once; samples in another file are a fault. Links are left out."""
    import h5py

    arrays: list[_Array] = []

    def keep(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and item.shape is not None and not name.startswith("#"):
            arrays.extend(_dataset(name, item, allowance))

    with h5py.File(stream, "r") as file:
        file.visititems(keep)
        return _columns_of(arrays, allowance)


def _dataset(name: str, item: Any, allowance: Allowance) -> list[_Array]:
    """Return a dataset; none for text, an empty array of MATLAB, and a dimension of netCDF without coordinates."""
    matlab = _attribute(item, "MATLAB_class")
    # The numbers of these datasets are letters, a shape, or zeros.
    if matlab == [b"char"] or "MATLAB_empty" in item.attrs or "not a netCDF variable" in str(_attribute(item, "NAME")):
        return []
    fault = _ELSEWHERE if item.is_virtual or item.external else _CELL if matlab == [b"cell"] else ""
    fault = _OBJECT if "MATLAB_object_decode" in item.attrs else fault
    if item.chunks:
        # A chunk is read as a whole.
        allowance.check(prod(item.chunks) * item.dtype.itemsize, f"a chunk of dataset '{shortened(name)}'")
    # The unit of the group, unless the dataset has one, or the name of another quantity.
    unit, group = _unit(item), _unit(item.parent)
    column = Column(name.rsplit("/", 1)[-1], np.empty(0), unit)
    if group and not symbol_of(column.parts[1]) and (not column.quantities or quantity_of(group) in column.quantities):
        unit = group
    return [_Array(name, item, unit, fault)]


def _unpacked(array: Any) -> Any:
    """Return the numbers of an array, unpacked if it is a dataset as netCDF packs it; fill values become NaN."""
    values = np.asarray(array[()])
    keys = "scale_factor", "add_offset", "_FillValue", "missing_value"
    scale, offset, *fills = ([x for x in _attribute(array, key) if isinstance(x, int | float)][:1] for key in keys)
    if values.dtype.kind not in "fiu" or not any((scale, offset, *fills)):
        return values
    with np.errstate(all="ignore"):
        missing = np.isin(values, np.array([x for fill in fills for x in fill]).astype(values.dtype))
        return np.where(missing, np.nan, values * (scale[0] if scale else 1.0) + (offset[0] if offset else 0.0))


def _attribute(item: Any, name: str) -> list[Any]:
    """Return the values of an attribute of a dataset; none if it is absent."""
    attributes = getattr(item, "attrs", {})
    return np.ravel(attributes[name]).tolist() if name in attributes else []


def _unit(item: Any) -> str:
    """Return the unit that an attribute states; of "seconds since 1970-01-01", as netCDF has it, the first word."""
    texts = [x for x in (*_attribute(item, "unit"), *_attribute(item, "units")) if isinstance(x, str | bytes)]
    text = texts[0].decode(errors="replace") if texts and isinstance(texts[0], bytes) else str(*texts[:1])
    return text.partition(" since ")[0].strip()


_HDF5 = b"\x89HDF\r\n\x1a\n"


def read_mat(stream: BinaryIO, allowance: Allowance) -> list[Column]:
    """Read variables of a MAT file of any version, and fields of structures; text is ignored."""
    head = stream.read(520)
    stream.seek(0)
    if head.startswith((b"MATLAB 7.3", _HDF5)) or head.endswith(_HDF5):
        return read_hdf5(stream, allowance)
    import scipy.io

    # The types that SciPy states allow names of files only.
    source: Any = stream
    variables = scipy.io.loadmat(source, simplify_cells=True)
    named = [(name, value) for name, value in variables.items() if not name.startswith("__")]
    return _columns_of([array for name, value in named for array in _arrays(name, value)], allowance)


def _arrays(name: str, value: Any) -> list[_Array]:
    """Return the arrays in a variable, and in the structures in it, as data/t."""
    if isinstance(value, dict):
        return [array for key, field in value.items() for array in _arrays(f"{name}/{key}", field)]
    if not isinstance(value, np.ndarray):
        return []
    # SciPy returns arrays of classes of its own for the objects of MATLAB.
    fault = _OBJECT if type(value) is not np.ndarray else _CELL if value.dtype == object else ""
    return [_Array(name, value, fault=fault)]


# The start of a waveform, and the part by which the clocks of a computer and of a converter differ.
_START, _SAME_CLOCK = "wf_start_time", 1e-4
# Type and value of the start of a waveform in a TDMS file.
_STAMP = re.compile(_START.encode() + rb"(.{20})", re.DOTALL)


def read_tdms(stream: BinaryIO, allowance: Allowance) -> list[Column]:
    """Read channels of a TDMS file; the time of a waveform follows from its properties."""
    from nptdms import TdmsFile

    with TdmsFile.open(stream) as file:
        channels, arrays = _channels(file), []
        for name, channel in channels.items():
            allowance.check(len(channel) * np.dtype("f8").itemsize, f"channel '{shortened(name)}'")
            unit = str(channel.properties.get("unit_string", "")).strip()
            arrays.append(_Array(name, np.asarray(channel[:]), unit))
    columns = _columns_of(arrays, allowance)
    waves = {column.name: channels[column.name] for column in columns}
    # A waveform has no time channel: its sampling is a property, the same for every channel of a run.
    if any(column.parts[0].lower() in ("time", "t") for column in columns):
        return columns
    keys = {"wf_increment": 0.0, "wf_start_offset": 0.0, _START: ""}
    runs = {(len(wave), *(wave.properties.get(key, empty) for key, empty in keys.items())) for wave in waves.values()}
    if len(runs) > 1 and all(step > 0 for _, step, _, _ in runs):
        raise FileFormatError(
            f"the channels {listed(tuple(waves))} have clocks of their own: samples, {', '.join(keys)} differ",
            hint="save each in a file of its own with its time, and join the second one",
            change=("columns",),
        )
    count, step, start, _ = next(iter(runs)) if len(runs) == 1 else (0, 0.0, 0.0, "")
    if step > 0:
        allowance.take(count, "the time of its waveforms")
        stream.seek(0)
        guess = _guess_of_segments(stream.read(), waves, step)
        with np.errstate(all="ignore"):
            columns.append(Column("time", start + np.arange(float(count)) * step, "s", guessed=guess))
    return columns


def _channels(file: Any) -> dict[str, Any]:
    """Return the channels of a TDMS file by group and name."""
    return {f"{group.name}/{channel.name}": channel for group in file.groups() for channel in group.channels()}


def _guess_of_segments(data: bytes, waves: dict[str, Any], step: float) -> str:
    """Return what is assumed of waveforms in several pieces; raise if there is a pause between these."""
    from nptdms import TdmsFile

    stamps = [(match.start(), match[1]) for match in _STAMP.finditer(data)]
    changes = [data.rfind(b"TDSm", 0, place) for (_, before), (place, now) in pairwise(stamps) if now != before]
    if not changes:
        appended = any(wave.properties.get("wf_samples", len(wave)) != len(wave) for wave in waves.values())
        return "its pieces, of wf_samples each, follow one another without a pause" if appended else ""
    first, before = (_channels(TdmsFile.read_metadata(io.BytesIO(data[:end]))) for end in (changes[0], changes[-1]))
    for name in waves.keys() & first.keys():
        passed = (waves[name].properties[_START] - first[name].properties[_START]) / np.timedelta64(1, "s")
        pause = passed - len(before[name]) * step
        if abs(pause) > step / 2 + _SAME_CLOCK * passed:
            raise FileFormatError(
                f"was recorded in {len(changes) + 1} pieces: by {_START}, the last one begins {abs(pause):.6g} s "
                f"{'after' if pause > 0 else 'before'} the end of those before it",
                hint="save each piece in a file of its own, and give them as several records",
            )
    return ""
