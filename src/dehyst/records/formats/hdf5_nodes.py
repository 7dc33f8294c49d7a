"""Datasets of an HDF5 file that contain their own samples; links out of the file are found before data are read."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import FileFormatError
from dehyst.records.formats.file_content import Allowance

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

    Raises
    ------
    FileFormatError
        Groups too deep, or too many names: a damaged file.
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

    Raises
    ------
    FileFormatError
        It is a link, does not contain its own samples, has no numbers, or more than allowed.
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
