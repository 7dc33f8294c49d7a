"""HDF5: datasets that contain their own samples, links out of a file, and the record files of dehyst."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import FileFormatError
from dehyst._io import to_json
from dehyst._text import counted
from dehyst.records.formats.file_content import MOST, Allowance, library

# A file of measurements has fewer levels of groups and fewer names.
_DEEPEST, _MOST_NAMES = 64, 100_000
_ADVICE = "copy its samples into the file, for instance with h5repack or h5copy"


class Node(NamedTuple):
    """A dataset by its full name, or the reason why it cannot be a column of a record."""

    name: str
    dataset: Any
    fault: str


def nodes(file: Any, h5py: Any, allowance: Allowance) -> Iterator[Node]:
    """Yield the datasets of all groups that hard links lead to, each once.

    Soft links are ignored, because their targets are found under their own names; external links are yielded with
    their fault and never followed.

    Raise `FileFormatError` for groups too deep, or too many names: a damaged file.
    """
    seen = {_place(file, h5py)}
    left, count = [("", file["/"], iter(file))], 0
    while left:
        prefix, group, keys = left[-1]
        if (key := next(keys, None)) is None:
            left.pop()
            continue
        name, count = prefix + key, count + 1
        if count > _MOST_NAMES or len(left) > _DEEPEST:
            raise FileFormatError(
                f"{allowance.path}: more than {_MOST_NAMES} names, or groups more than {_DEEPEST} deep; keep the "
                "record's columns only"
            )
        link = group.get(key, getlink=True)
        if isinstance(link, h5py.ExternalLink):
            yield Node(name, None, f"is an external link to '{link.filename}', which is not followed; {_ADVICE}")
        elif isinstance(link, h5py.HardLink) and (place := _place(item := group[key], h5py)) not in seen:
            seen.add(place)
            if isinstance(item, h5py.Dataset):
                yield Node(name, item, foreign(item))
            elif isinstance(item, h5py.Group):
                left.append((f"{name}/", item, iter(item)))


def foreign(dataset: Any) -> str:
    """Return why a dataset does not contain its own samples; empty if it does."""
    if dataset.is_virtual:
        return f"is a virtual dataset, made of others, which are not read; {_ADVICE}"
    if dataset.external:
        return f"has external storage in '{dataset.external[0][0]}', which is not read; {_ADVICE}"
    return ""


def own_samples(file: Any, h5py: Any, name: str, allowance: Allowance) -> NDArray[np.float64]:
    """Read a dataset of the root by its name.

    Raise `FileFormatError` if it is a link, does not contain its own samples, has no numbers, or more than allowed.
    """
    link, where = file.get(name, getlink=True), f"{allowance.path}: dataset '{name}'"
    if not isinstance(link, h5py.HardLink):
        raise FileFormatError(f"{where} is a link to another place, which is not followed; {_ADVICE}")
    dataset = file[name]
    if not isinstance(dataset, h5py.Dataset):
        raise FileFormatError(f"{where} is a group, need numbers; take the file from a copy")
    if fault := foreign(dataset):
        raise FileFormatError(f"{where} {fault}")
    if not is_vector(dataset):
        raise FileFormatError(f"{where} has shape {dataset.shape} and type {dataset.dtype}, need numbers in a row")
    return np.asarray(samples(dataset, name, allowance), dtype=np.float64)


def is_vector(dataset: Any) -> bool:
    """Return whether a dataset declares real numbers in one dimension, or in one row or column."""
    shape = dataset.shape
    return shape is not None and len(shape) > 0 and dataset.dtype.kind in "fiu" and dataset.size == max(shape)


def samples(dataset: Any, name: str, allowance: Allowance) -> NDArray[Any]:
    """Read a dataset after a check of its declared size and of its chunk size."""
    allowance.take(int(dataset.size), f"dataset '{name}'")
    if dataset.chunks:
        chunk = int(np.prod([int(size) for size in dataset.chunks], dtype=object)) * dataset.dtype.itemsize
        # A whole chunk is in memory, packed and unpacked, however few of its samples exist.
        allowance.check(chunk, f"a chunk of dataset '{name}'")
    return np.asarray(dataset[()])


def _place(item: Any, h5py: Any) -> tuple[int, int]:
    """Return the identity of an object of the file, whatever its names."""
    info = h5py.h5o.get_info(item.id)
    return int(info.fileno), int(info.addr)


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
