"""The bytes of a file, read once, and the limits of their size and of the memory for its numbers."""

from __future__ import annotations

import codecs
import importlib
import stat
from math import inf, nan
from numbers import Real
from pathlib import Path
from typing import Any, NamedTuple

from dehyst._errors import FileFormatError, MissingExtraError

# Default limit of the bytes of a file and of its numbers: 20 million samples.
MOST = 500_000_000
# Bytes by which an encoding is recognised.
_HEAD = 4096
# Bytes of a double.
_DOUBLE = 8
_MAGIC = {
    b"\x89HDF\r\n\x1a\n": ".h5",
    b"PK\x03\x04": ".npz",
    b"\x93NUMPY": ".npy",
    b"PAR1": ".parquet",
    b"TDSm": ".tdms",
    b"MATLAB ": ".mat",
}
_RAISE = "allow more bytes if you trust the file"


class Content(NamedTuple):
    """A file as read, and how its columns are to be read.

    `suffix`: of the format of its bytes. `most`: memory that its numbers may take [bytes]. `decimal`: the decimal sign
    that the user states. `with_meta`: whether to read the name and meta that `write_hdf5` writes.
    """

    path: Path
    data: bytes
    suffix: str
    most: int
    decimal: str | None = None
    with_meta: bool = False


class Allowance:
    """The memory that the numbers of a file may take; sizes that its headers declare are checked first.

    `path`: name of the file in messages. `most`: limit for all numbers together [bytes]. `decimal`: the decimal sign of
    its text, if the user states it.
    """

    def __init__(self, path: Path, most: int, decimal: str | None = None) -> None:
        self.path, self.most, self.left, self.decimal = path, most, most, decimal

    def take(self, numbers: int, what: str) -> None:
        """Reserve memory for a count of numbers; raise FileFormatError if it does not suffice."""
        self.check(numbers * _DOUBLE, what)
        self.left -= numbers * _DOUBLE

    def check(self, size: int, what: str) -> None:
        """Refuse a size [bytes] that is negative or exceeds the remaining memory."""
        if size < 0:
            raise FileFormatError(f"{self.path}: {what} declares a negative size; the file is damaged, take a copy")
        if size > self.left:
            raise FileFormatError(
                f"{self.path}: {what} declares {_in_words(size)}, more than the {_in_words(self.left)} left of the "
                f"{_in_words(self.most)} that a file may take",
                hint=_RAISE,
                change=("max_bytes",),
            )


def content_of(path: Path, most: int) -> Content:
    """Read a regular file, a named pipe or a process substitution; once, and never more than `most` bytes.

    Raises
    ------
    FileFormatError
        A folder, a device, a socket; an empty file; more than `most` bytes.
    OSError
        The file cannot be opened.
    """
    kind = path.stat().st_mode
    if stat.S_ISDIR(kind):
        raise FileFormatError(f"{path}: this is a folder; give one of the files in it")
    if not (stat.S_ISREG(kind) or stat.S_ISFIFO(kind)):
        word = "a socket" if stat.S_ISSOCK(kind) else "a device"
        raise FileFormatError(f"{path}: this is {word}, need a file or a pipe; save its data to a file first")
    size = path.stat().st_size
    _refuse_large(path, size, most)
    with path.open("rb") as stream:
        data = stream.read(most + 1)
    _refuse_large(path, len(data), most)
    if not data:
        raise FileFormatError(f"{path}: the file is empty; export the measurement again")
    return Content(path, data, path.suffix.lower() if stat.S_ISREG(kind) else _suffix(path, data), most)


def as_utf8(data: bytes) -> bytes:
    """Return text in UTF-16, which Windows programs write as "Unicode text", in UTF-8; other bytes as they are."""
    head = data[:_HEAD]
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        encoding = "utf-16"
    elif b"\0" in head:
        # Latin letters and digits leave every second byte 0.
        zeros = [part.count(0) / max(len(part), 1) for part in (head[::2], head[1::2])]
        encoding = next(
            (name for name, share in zip(("utf-16-be", "utf-16-le"), zeros, strict=True) if share > 0.8), ""
        )
        if not encoding or min(zeros) > 0:
            return data
    else:
        return data
    try:
        return data.decode(encoding).encode()
    except UnicodeError:
        return data


def bytes_allowed(value: object) -> int:
    """Return a limit in whole bytes; raise FileFormatError for anything but a positive number."""
    number = float(value) if isinstance(value, Real) and not isinstance(value, bool) else nan
    if not 1 <= number < inf:
        raise FileFormatError(
            argument="max_bytes", got=repr(value), need="a number of bytes above 0", hint=f"try {MOST}"
        )
    return int(number)


def library(module: str, purpose: str, extra: str = "files") -> Any:
    """Return a module of an optional package; raise MissingExtraError if it is not installed."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MissingExtraError.of(module.split(".", maxsplit=1)[0], extra, purpose) from error


def _refuse_large(path: Path, size: int, most: int) -> None:
    if size > most:
        raise FileFormatError(
            f"{path}: the file has {'at least ' if size == most + 1 else ''}{_in_words(size)}, more than the "
            f"{_in_words(most)} that are allowed",
            hint=f"{_RAISE}, or shorten it",
            change=("max_bytes",),
        )


def _suffix(path: Path, data: bytes) -> str:
    """Return the suffix of a pipe's name or, as it rarely has one, that of its first bytes; by default text."""
    guess = next((suffix for magic, suffix in _MAGIC.items() if data.startswith(magic)), ".csv")
    return path.suffix.lower() or guess


def _in_words(size: int) -> str:
    return f"{size / 1e6:.4g} MB" if size >= 1_000_000 else f"{size} bytes"
