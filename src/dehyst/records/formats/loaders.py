"""The readable formats: for each suffix the function that reads columns from bytes, and the library it needs."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from dehyst.records.formats.columns import TEXT, Column
from dehyst.records.formats.containers import read_hdf5, read_npz, read_parquet, read_tdms
from dehyst.records.formats.file_content import Allowance, Content
from dehyst.records.formats.gcs_file import is_gcs, read_gcs
from dehyst.records.formats.labview_file import is_labview, read_labview
from dehyst.records.formats.mat_file import is_hdf5, read_mat
from dehyst.records.formats.spreadsheet import read_xlsx
from dehyst.records.formats.text_table import read_text

_NAMES = {".parquet": "Parquet", ".tdms": "TDMS"}


class Format(NamedTuple):
    """A readable format.

    `load`: function of the bytes and their allowance that returns columns. `library`: module of an optional package
    that it needs; empty without one. `isolated`: whether it runs in a separate process, because a damaged file may
    crash or stop its C library.
    """

    load: Callable[[bytes, Allowance], list[Column]]
    library: str = ""
    isolated: bool = False


def _read_text(data: bytes, allowance: Allowance) -> list[Column]:
    """Read a text file in the format that its first bytes show."""
    if is_labview(data):
        return read_labview(data, allowance)
    return read_gcs(data, allowance) if is_gcs(data) else read_text(data, allowance)


LOADERS: dict[str, Format] = {
    **dict.fromkeys((*TEXT, ".lvm", ".asc"), Format(_read_text)),
    ".xlsx": Format(read_xlsx, "openpyxl", isolated=True),
    ".mat": Format(read_mat, "scipy.io", isolated=True),
    ".h5": Format(read_hdf5, "h5py", isolated=True),
    ".hdf5": Format(read_hdf5, "h5py", isolated=True),
    ".parquet": Format(read_parquet, "pyarrow.parquet", isolated=True),
    ".tdms": Format(read_tdms, "nptdms", isolated=True),
    ".npz": Format(read_npz),
}


def package(content: Content) -> tuple[str, str]:
    """Return the module that reads a file, and its purpose; MAT files of version 7.3 are HDF5."""
    module = "h5py" if content.suffix == ".mat" and is_hdf5(content.data) else LOADERS[content.suffix].library
    return module, f"Reading {_NAMES.get(content.suffix, content.suffix)} files"
