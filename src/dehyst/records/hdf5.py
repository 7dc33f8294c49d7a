"""A record as HDF5: three datasets in SI units, and beside them its name, its meta and a hash of its samples."""

from __future__ import annotations

import hashlib
import importlib
import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import FileFormatError, MissingExtraError
from dehyst._text import counted
from dehyst.records.formats.file_content import MOST, Allowance
from dehyst.records.formats.hdf5_nodes import own_samples

SUFFIXES = (".h5", ".hdf5")
DATASETS = {"time_s": "s", "voltage_V": "V", "displacement_m": "m"}
# Attribute of the file that holds name and meta as JSON; a file without it is somebody else's.
_MARK = "dehyst"

Columns = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]


class Stored(NamedTuple):
    """What a file tells beside its samples: name, meta, how many samples, and their hash."""

    name: str
    meta: dict[str, Any]
    samples: int
    sha256: str


def library(extra: str = "bench", purpose: str = "Writing .h5 files") -> Any:
    """The package h5py, or MissingExtraError."""
    try:
        return importlib.import_module("h5py")
    except ImportError as error:
        raise MissingExtraError.of("h5py", extra, purpose) from error


def digest(columns: Columns) -> str:
    """SHA-256 of time, voltage and displacement (n,), one after the other, as little-endian doubles."""
    found = hashlib.sha256()
    for column in columns:
        found.update(np.ascontiguousarray(column, dtype="<f8").tobytes())
    return found.hexdigest()


def pack(columns: Columns, name: str, meta: Mapping[str, Any], where: object) -> bytes:
    """The file's bytes.

    Parameters
    ----------
    columns : three (n,) arrays
        Time [s], voltage [V], displacement [m]; n may be 0.
    name, meta
        Told in JSON.
    where : object
        What a message calls the file.

    Raises
    ------
    FileFormatError
        If name or meta cannot be told in JSON.
    MissingExtraError
        If h5py is not installed.
    """
    h5py = library()
    text = in_json({"name": name, "meta": dict(meta)}, where)
    buffer = io.BytesIO()
    # A long meta is more than an attribute of the oldest version holds.
    with h5py.File(buffer, "w", libver=("v108", "v110")) as file:
        for (dataset, unit), column in zip(DATASETS.items(), columns, strict=True):
            file.create_dataset(dataset, data=np.ascontiguousarray(column, dtype="<f8")).attrs["unit"] = unit
        file.attrs[_MARK] = text
        file.attrs["sha256"] = digest(columns)
    return buffer.getvalue()


def in_json(data: Mapping[str, Any], where: object) -> str:
    """One line of ASCII; raises FileFormatError for NaN, inf and what JSON does not know."""
    try:
        return json.dumps(dict(data), allow_nan=False)
    except (TypeError, ValueError, RecursionError) as error:
        raise FileFormatError(
            f"{where}: meta cannot be told in JSON ({error}); use text, finite numbers, booleans, None, lists and dicts"
        ) from error


def decode(path: Path, least: int = 0, content: bytes | None = None, most: int = MOST) -> Stored | None:
    """What a file tells of its record; None if there is none, or one that `pack` did not make.

    Parameters
    ----------
    path : path
    least : int
        Samples that it must hold.
    content : bytes, optional
        The file's, if it was read already.
    most : int
        Memory that its samples may take [bytes], or as much as the file has.

    Raises
    ------
    FileFormatError
        If it is damaged, its samples are not those it was made of or lie elsewhere, or they are fewer than `least`.
    """
    if content is None and (path.suffix.lower() not in SUFFIXES or not path.is_file() or not path.stat().st_size):
        return None
    size = path.stat().st_size if content is None else len(content)
    allowance = Allowance(path, max(most, size))
    h5py = library("files", f"Reading {path.suffix} files")
    try:
        with h5py.File(path if content is None else io.BytesIO(content), "r") as file:
            if _MARK not in file.attrs or not all(dataset in file for dataset in DATASETS):
                return None
            name, meta = _marked(file.attrs[_MARK])
            time, voltage, displacement = (own_samples(file, h5py, dataset, allowance) for dataset in DATASETS)
            stored = Stored(name, meta, int(time.size), str(file.attrs["sha256"]))
    except (OSError, FileFormatError):
        raise
    # A damaged file makes h5py raise errors of any kind.
    except Exception as error:
        raise FileFormatError(
            f"{path}: this record of dehyst is damaged ({type(error).__name__}: {error}); take the file from a copy"
        ) from error
    found = digest((time, voltage, displacement))
    if found != stored.sha256:
        raise FileFormatError(
            f"{path}: its samples are not those that were written (sha256 {found[:12]}..., need "
            f"{stored.sha256[:12]}...): damaged or edited; take the file from a copy"
        )
    if stored.samples < least:
        raise FileFormatError(
            f"{path}: holds {counted(stored.samples, 'sample')} of a record that ended early "
            f"({stored.meta.get('ended_because', 'no reason is known')}), need {least} at least; record it again"
        )
    return stored


def _marked(mark: Any) -> tuple[str, dict[str, Any]]:
    """Name and meta as `pack` wrote them; raises ValueError if they are of other types, RecursionError if too deep."""
    content = json.loads(mark)
    name, meta = (content.get("name"), content.get("meta")) if isinstance(content, dict) else (None, None)
    if not isinstance(name, str) or not isinstance(meta, dict):
        raise ValueError(f"need name as text and meta as an object, got {str(mark)[:60]!r}")
    return name, meta
