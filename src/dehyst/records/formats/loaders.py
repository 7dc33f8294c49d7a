"""The readable formats, and the reading of a file within a bound of its size."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, BinaryIO

from dehyst._errors import DehystError, FileFormatError, MissingExtraError
from dehyst.records.formats import containers, vendor_files
from dehyst.records.formats.columns import TEXT, Column
from dehyst.records.formats.file_content import Allowance, Content
from dehyst.records.formats.text_table import read_text

Loader = Callable[[Any, Allowance], list[Column]]
# Bytes by which a text is recognised: the longest header of a GCS array.
_HEAD = 50_000


def _read_text(stream: BinaryIO, allowance: Allowance) -> list[Column]:
    """Read a text file in the format that its first bytes show."""
    mark = containers.LINE.encode()
    stream.seek(0)
    head = stream.read(_HEAD)
    stream.seek(0)
    if vendor_files.is_labview(head):
        return vendor_files.read_labview(stream.read(), allowance)
    if vendor_files.is_gcs(head):
        return vendor_files.read_gcs(stream.read(), allowance)
    # Each line of a record of dehyst ends: one that does not was cut off while it was written.
    columns = read_text(stream, allowance, whole_lines=head.startswith(mark))
    stated = head[len(mark) : containers.LONGEST].split(b"\n")[0] if head.startswith(mark) else b""
    return containers.restored(columns, stated.decode(errors="replace"))


# The function of the bytes of a file, of the stream of a text, and the allowance that returns its columns, by suffix.
LOADERS: dict[str, Loader] = {
    **dict.fromkeys((*TEXT, ".lvm", ".asc"), _read_text),
    ".xlsx": vendor_files.read_xlsx,
    ".mat": containers.read_mat,
    ".h5": containers.read_hdf5,
    ".hdf5": containers.read_hdf5,
    ".parquet": containers.read_parquet,
    ".tdms": containers.read_tdms,
    ".npy": containers.read_npy,
    ".npz": containers.read_npz,
}


def load(content: Content) -> list[Column]:
    """Read a file's columns; raise FileFormatError, with the file's name before each message.

    Raise `MissingExtraError` if the library is not installed.
    """
    allowance = Allowance(content.most, content.path.stem, content.decimal)
    try:
        with warnings.catch_warnings():
            # Of a library on styles of a sheet and the like, which are no matter of the columns.
            warnings.simplefilter("ignore")
            read = LOADERS[content.suffix]
            return read(content.stream if read is _read_text else content.data, allowance)
    except FileFormatError as error:
        raise type(error)(**vars(error) | {"message": f"{content.path}: {error.message}"}) from error
    except DehystError:
        raise
    except ImportError as error:
        package = (error.name or "").partition(".")[0]
        raise MissingExtraError.of(package, "files", f"Reading {content.suffix} files") from error
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
