"""The formats that are read: by a file's suffix, the function that makes columns of its bytes, and what that needs."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from dehyst.records.formats.columns import TEXT, Column
from dehyst.records.formats.containers import is_hdf5, read_hdf5, read_mat, read_npz, read_parquet, read_tdms
from dehyst.records.formats.file_content import Allowance, Content
from dehyst.records.formats.text_table import read_text

_NAMES = {".parquet": "Parquet", ".tdms": "TDMS"}


class Format(NamedTuple):
    """How a kind of file is read.

    Attributes
    ----------
    load : callable
        Bytes and what they may take -> columns.
    library : str
        The module that does it, of a package that need not be installed; empty if none is needed.
    apart : bool
        Whether a library in C does it, which a damaged file may crash or stop: then in a process apart.
    """

    load: Callable[[bytes, Allowance], list[Column]]
    library: str = ""
    apart: bool = False


LOADERS: dict[str, Format] = {
    **dict.fromkeys(TEXT, Format(read_text)),
    ".mat": Format(read_mat, "scipy.io", apart=True),
    ".h5": Format(read_hdf5, "h5py", apart=True),
    ".hdf5": Format(read_hdf5, "h5py", apart=True),
    ".parquet": Format(read_parquet, "pyarrow.parquet", apart=True),
    ".tdms": Format(read_tdms, "nptdms", apart=True),
    ".npz": Format(read_npz),
}


def package(content: Content) -> tuple[str, str]:
    """The module that reads a file, and for what it is needed; MAT files of version 7.3 are HDF5."""
    module = "h5py" if content.suffix == ".mat" and is_hdf5(content.data) else LOADERS[content.suffix].library
    return module, f"Reading {_NAMES.get(content.suffix, content.suffix)} files"
