"""The readable formats, and the reading of a file within a bound of its size."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from importlib.util import find_spec
from typing import NamedTuple

from dehyst._errors import DehystError, FileFormatError, MissingExtraError
from dehyst.records.formats import containers, vendor_files
from dehyst.records.formats.columns import TEXT, Column
from dehyst.records.formats.file_content import Allowance, Content
from dehyst.records.formats.text_table import as_utf8, read_text


class Format(NamedTuple):
    """A readable format: the function of bytes and their allowance that returns columns, and the library it needs.

    `library`: module of an optional package; empty without one. `name`: in messages, by default the suffix.
    """

    load: Callable[[bytes, Allowance], list[Column]]
    library: str = ""
    name: str = ""


def _read_text(data: bytes, allowance: Allowance) -> list[Column]:
    """Read a text file in the format that its first bytes show."""
    data, mark = as_utf8(data), containers.LINE.encode()
    if data.startswith(mark):
        # Each line of a record of dehyst ends: one that does not was cut off while it was written.
        data = data[: data.rfind(b"\n") + 1]
    if vendor_files.is_labview(data):
        return vendor_files.read_labview(data, allowance)
    columns = vendor_files.read_gcs(data, allowance) if vendor_files.is_gcs(data) else read_text(data, allowance)
    first = data[len(mark) : containers.LONGEST].splitlines()[:1] if data.startswith(mark) else []
    return containers.restored(columns, b"".join(first).decode(errors="replace"))


LOADERS = {
    **dict.fromkeys((*TEXT, ".lvm", ".asc"), Format(_read_text)),
    ".xlsx": Format(vendor_files.read_xlsx, "openpyxl"),
    ".mat": Format(containers.read_mat, "scipy.io"),
    ".h5": Format(containers.read_hdf5, "h5py"),
    ".hdf5": Format(containers.read_hdf5, "h5py"),
    ".parquet": Format(containers.read_parquet, "pyarrow.parquet", "Parquet"),
    ".tdms": Format(containers.read_tdms, "nptdms", "TDMS"),
    ".npy": Format(containers.read_npy),
    ".npz": Format(containers.read_npz),
}


def load(content: Content) -> list[Column]:
    """Read a file's columns; raise FileFormatError, with the file's name before each message.

    Raise `MissingExtraError` if the library is not installed.
    """
    if module := _library(content):
        package = module.split(".", maxsplit=1)[0]
        if sys.modules.get(module, ...) is None or find_spec(package) is None:
            name = LOADERS[content.suffix].name or content.suffix
            raise MissingExtraError.of(package, "files", f"Reading {name} files")
    try:
        allowance = Allowance(content.most, content.path.stem, content.decimal)
        with warnings.catch_warnings():
            # Of a library on styles of a sheet and the like, which are no matter of the columns.
            warnings.simplefilter("ignore")
            return LOADERS[content.suffix].load(content.data, allowance)
    except FileFormatError as error:
        raise type(error)(**vars(error) | {"message": f"{content.path}: {error.message}"}) from error
    except DehystError:
        raise
    except MemoryError as error:
        raise FileFormatError(
            f"{content.path}: reading it takes more memory than {content.most / 1e6:.4g} MB of numbers should",
            hint="the file is damaged, or give a larger max_size=MB",
            change=("columns",),
        ) from error
    except Exception as error:  # Every library has its own errors for broken content.
        raise FileFormatError(
            f"{content.path}: not a readable {content.suffix} file ({str(error)[:300] or type(error).__name__}); check "
            "that the suffix fits"
        ) from error


def _library(content: Content) -> str:
    """Return the module that reads a file; MAT files of version 7.3 are HDF5."""
    if content.suffix == ".mat" and containers.is_hdf5(content.data):
        return "h5py"
    return LOADERS[content.suffix].library
