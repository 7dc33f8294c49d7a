"""Record files of dehyst in HDF5: every bit of the samples, name and meta."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import FileFormatError, library
from dehyst._io import demand_version, to_json
from dehyst._text import counted
from dehyst.records.formats.columns import Column
from dehyst.records.formats.containers import hdf5_nodes, is_vector, samples_of
from dehyst.records.formats.file_content import MOST, Allowance

SUFFIXES = (".h5", ".hdf5")
# The datasets of every record; those of further channels follow.
DATASETS = ("time_s", "voltage_V", "displacement_m")
# Attribute of the file with name, meta and further datasets as JSON; a file without it is another program's.
_MARK = "dehyst"


class Stored(NamedTuple):
    """Name, meta, further datasets, number of samples and their hash, as stored in a file."""

    name: str
    meta: dict[str, Any]
    others: list[str]
    samples: int
    sha256: str


def writer() -> Any:
    """Return the package h5py; raise MissingExtraError if it is not installed."""
    return library("h5py", "Writing .h5 files", "bench")


def sha256_of(columns: Iterable[NDArray[np.float64]]) -> str:
    """Return the SHA-256 of columns, first time, voltage and displacement (n,), one by one as little-endian doubles."""
    digest = hashlib.sha256()
    for column in columns:
        digest.update(np.ascontiguousarray(column, dtype="<f8").tobytes())
    return digest.hexdigest()


def pack(columns: Mapping[str, NDArray[np.float64]], name: str, meta: Mapping[str, Any], where: object) -> bytes:
    """Return the bytes of a file: `DATASETS` and further columns (n,), n may be 0; name and meta as JSON.

    `where`: name of the file in messages. Raise `FileFormatError` if name or meta cannot be written as JSON. Raise
    `MissingExtraError` if h5py is not installed.
    """
    h5py = writer()
    others = [column for column in columns if column not in DATASETS]
    head = {"name": name, "meta": dict(meta), **({"others": others} if others else {})}
    text = to_json(head, f"{where}: meta")
    buffer = io.BytesIO()
    # A long meta does not fit into an attribute of the oldest version.
    with h5py.File(buffer, "w", libver=("v108", "v110")) as file:
        for column, values in columns.items():
            dataset = file.create_dataset(column, data=np.ascontiguousarray(values, dtype="<f8"))
            dataset.attrs["unit"] = Column(column, values).parts[1]
        file.attrs[_MARK] = text
        file.attrs["sha256"] = sha256_of(columns.values())
    return buffer.getvalue()


def decode(content: bytes, least: int = 0, most: int = MOST) -> Stored | None:
    """Return the stored record in the bytes of a file; None if `pack` did not write it.

    `most`: memory that its samples may take [bytes]; the size of the file if that is larger. Raise `FileFormatError` if
    it is damaged, its samples do not have the stored hash or lie in another file, or are fewer than `least`.
    """
    import h5py

    allowance = Allowance(max(most, len(content)))
    try:
        with h5py.File(io.BytesIO(content), "r") as file:
            if _MARK not in file.attrs or not all(dataset in file for dataset in DATASETS):
                return None
            stated = json.loads(file.attrs[_MARK])
            demand_version(stated, "this record of dehyst")
            name, meta, others = stated["name"], stated["meta"], list(map(str, stated.get("others", [])))
            if not isinstance(name, str) or not isinstance(meta, dict):
                raise ValueError(f"need name as text and meta as an object, got {str(stated)[:60]}")
            datasets = {node.name: node for node in hdf5_nodes(file)}
            columns = [_own_samples(datasets.get(one), one, allowance) for one in (*DATASETS, *others)]
            stored = Stored(name, meta, others, int(columns[0].size), str(file.attrs["sha256"]))
    except (OSError, FileFormatError):
        raise
    # A damaged file makes h5py raise errors of any kind.
    except Exception as error:
        raise FileFormatError(
            f"this record of dehyst is damaged ({type(error).__name__}: {error}); take the file from a copy"
        ) from error
    sha256 = sha256_of(columns)
    if sha256 != stored.sha256:
        raise FileFormatError(
            f"its samples are not those that were written (sha256 {sha256[:12]}..., need {stored.sha256[:12]}...): "
            "damaged or edited; take the file from a copy"
        )
    if stored.samples < least:
        raise FileFormatError(
            f"holds {counted(stored.samples, 'sample')} of a record that ended early "
            f"({meta.get('ended_because', 'the reason is unknown')}), need {least} at least; record it again"
        )
    return stored


def _own_samples(node: Any, name: str, allowance: Allowance) -> NDArray[np.float64]:
    """Read a dataset that must contain its own samples."""
    fault = "is a link or a group, need numbers in the file itself; take it from a copy" if node is None else node.fault
    if not fault and not is_vector(node.dataset):
        fault = f"has shape {node.dataset.shape} and type {node.dataset.dtype}, need numbers in a row"
    if fault:
        raise FileFormatError(f"dataset '{name}' {fault}")
    return np.asarray(samples_of(node.dataset, name, allowance), dtype=np.float64)
