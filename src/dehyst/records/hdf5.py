"""A record as HDF5: three datasets in SI units, with its name, its meta and a hash of its samples."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import FileFormatError
from dehyst._io.json_files import to_json
from dehyst._text import counted
from dehyst.records.formats.containers import library
from dehyst.records.formats.file_content import MOST, Allowance
from dehyst.records.formats.hdf5_nodes import own_samples

SUFFIXES = (".h5", ".hdf5")
DATASETS = {"time_s": "s", "voltage_V": "V", "displacement_m": "m"}
# Attribute of the file with name and meta as JSON; a file without it was written by another program.
_MARK = "dehyst"

Columns = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]


class Stored(NamedTuple):
    """Name, meta, number of samples and their hash, as stored in a file."""

    name: str
    meta: dict[str, Any]
    samples: int
    sha256: str


def demand_writer() -> Any:
    """Return the package h5py; raise MissingExtraError if it is not installed."""
    return library("h5py", "Writing .h5 files", "bench")


def sha256_of(columns: Columns) -> str:
    """Return the SHA-256 of time, voltage and displacement (n,), one after the other, as little-endian doubles."""
    digest = hashlib.sha256()
    for column in columns:
        digest.update(np.ascontiguousarray(column, dtype="<f8").tobytes())
    return digest.hexdigest()


def pack(columns: Columns, name: str, meta: Mapping[str, Any], where: object) -> bytes:
    """Return the bytes of the file.

    Raise `FileFormatError` if name or meta cannot be written as JSON. Raise `MissingExtraError` if h5py is not
    installed.

    `columns`: time [s], voltage [V], displacement [m]; n may be 0. `name`, `meta`: written as JSON. `where`: name of
    the file in messages.
    """
    h5py = demand_writer()
    text = to_json({"name": name, "meta": dict(meta)}, f"{where}: meta")
    buffer = io.BytesIO()
    # A long meta does not fit into an attribute of the oldest version.
    with h5py.File(buffer, "w", libver=("v108", "v110")) as file:
        for (dataset, unit), column in zip(DATASETS.items(), columns, strict=True):
            file.create_dataset(dataset, data=np.ascontiguousarray(column, dtype="<f8")).attrs["unit"] = unit
        file.attrs[_MARK] = text
        file.attrs["sha256"] = sha256_of(columns)
    return buffer.getvalue()


def decode(path: Path, least: int = 0, content: bytes | None = None, most: int = MOST) -> Stored | None:
    """Return what a file stores of its record; None without a file, or if `pack` did not make it.

    Raise `FileFormatError` if it is damaged, its samples do not have the stored hash or lie in another file, or are
    fewer than `least`.

    `least`: least number of samples. `content`: the bytes of the file, if they are read already. `most`: memory that
    its samples may take [bytes]; the size of the file if that is larger.
    """
    if content is None and (path.suffix.lower() not in SUFFIXES or not path.is_file() or not path.stat().st_size):
        return None
    size = path.stat().st_size if content is None else len(content)
    allowance = Allowance(path, max(most, size))
    h5py = library("h5py", f"Reading {path.suffix} files")
    try:
        with h5py.File(path if content is None else io.BytesIO(content), "r") as file:
            if _MARK not in file.attrs or not all(dataset in file for dataset in DATASETS):
                return None
            name, meta = _parse(file.attrs[_MARK])
            time, voltage, displacement = (own_samples(file, h5py, dataset, allowance) for dataset in DATASETS)
            stored = Stored(name, meta, int(time.size), str(file.attrs["sha256"]))
    except (OSError, FileFormatError):
        raise
    # A damaged file makes h5py raise errors of any kind.
    except Exception as error:
        raise FileFormatError(
            f"{path}: this record of dehyst is damaged ({type(error).__name__}: {error}); take the file from a copy"
        ) from error
    sha256 = sha256_of((time, voltage, displacement))
    if sha256 != stored.sha256:
        raise FileFormatError(
            f"{path}: its samples are not those that were written (sha256 {sha256[:12]}..., need "
            f"{stored.sha256[:12]}...): damaged or edited; take the file from a copy"
        )
    if stored.samples < least:
        raise FileFormatError(
            f"{path}: holds {counted(stored.samples, 'sample')} of a record that ended early "
            f"({stored.meta.get('ended_because', 'the reason is unknown')}), need {least} at least; record it again"
        )
    return stored


def _parse(mark: Any) -> tuple[str, dict[str, Any]]:
    """Return name and meta as `pack` wrote them; raise ValueError for other types, RecursionError if too deep."""
    content = json.loads(mark)
    name, meta = (content.get("name"), content.get("meta")) if isinstance(content, dict) else (None, None)
    if not isinstance(name, str) or not isinstance(meta, dict):
        raise ValueError(f"need name as text and meta as an object, got {str(mark)[:60]!r}")
    return name, meta
