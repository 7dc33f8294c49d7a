"""MAT files: the variables of MATLAB, and the fields of its structures, to columns."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from dehyst.records.formats.columns import Column, shortened
from dehyst.records.formats.containers import library, product, read_hdf5, vectors
from dehyst.records.formats.file_content import Allowance

_HDF5 = b"\x89HDF\r\n\x1a\n"
# Sizes of the header and of a tag of MAT files of version 5 [bytes], and the type of a compressed variable.
_MAT_HEAD, _MAT_TAG, _MAT_COMPRESSED = 128, 8, 15
_MAT_NUMBERS = {"double", "single", "logical", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))}
_CHUNK = 1 << 20
# Structures in structures.
_DEEPEST = 8


def read_mat(data: bytes, allowance: Allowance) -> list[Column]:
    """Read variables of a MAT file of any version; of structures the fields; cells and text are ignored."""
    if is_hdf5(data):
        return read_hdf5(data, allowance)
    scipy_io = library("scipy.io", "Reading .mat files")
    _refuse_inflated(data, allowance)
    wanted, structures = [], []
    for name, shape, kind in scipy_io.whosmat(io.BytesIO(data)):
        count = product(shape)
        if kind in _MAT_NUMBERS and shape and count > 1 and count == max(shape) and not name.startswith("__"):
            allowance.take(count, f"variable '{shortened(name)}'")
            wanted.append(name)
        elif kind == "struct" and count == 1:
            structures.append(name)
    if not wanted and not structures:
        return []
    variables = scipy_io.loadmat(
        io.BytesIO(data), variable_names=[*wanted, *structures], simplify_cells=bool(structures)
    )
    columns = [column for name in wanted for column in vectors(name, variables[name])]
    fields = [column for name in structures for column in _fields(name, variables[name], allowance)]
    return columns + [replace(column, foreign=bool(columns)) for column in fields]


def _fields(name: str, structure: Any, allowance: Allowance, depth: int = 1) -> list[Column]:
    """Return the arrays in a structure, and in the structures in it, as data/t."""
    columns: list[Column] = []
    for field, value in structure.items() if isinstance(structure, dict) and depth <= _DEEPEST else ():
        found = _fields(f"{name}/{field}", value, allowance, depth + 1)
        if not isinstance(value, dict) and (found := vectors(f"{name}/{field}", value)):
            allowance.take(found[0].data.size, f"field '{shortened(field)}'")
        columns += found
    return columns


def is_hdf5(data: bytes) -> bool:
    """Return whether a MAT file has version 7.3."""
    return data.startswith((b"MATLAB 7.3", _HDF5)) or data[512:520] == _HDF5


def _refuse_inflated(data: bytes, allowance: Allowance) -> None:
    """Unpack the compressed variables piece by piece, and check their size."""
    place, size = _MAT_HEAD, 0
    order = ">" if data[126:128] == b"MI" else "<"
    while place + _MAT_TAG <= len(data):
        kind, length = struct.unpack_from(f"{order}II", data, place)
        place += _MAT_TAG
        if kind == _MAT_COMPRESSED:
            for piece in _inflate(data[place : place + length]):
                size += piece
                allowance.check(size, "its compressed variables")
        place += length


def _inflate(packed: bytes) -> Iterator[int]:
    """Yield the number of bytes of each unpacked piece."""
    inflate = zlib.decompressobj()
    while packed and not inflate.eof:
        yield len(inflate.decompress(packed, _CHUNK))
        packed = inflate.unconsumed_tail
