"""The bytes of a file, and the limits of their size and of the memory for its numbers."""

from __future__ import annotations

import hashlib
import io
import stat
from pathlib import Path
from typing import NamedTuple

from dehyst._errors import FileFormatError

# Default limit of the bytes of a file and of its numbers: 20 million samples.
MOST = 500_000_000
# Bytes of a double.
_DOUBLE = 8


class Content(NamedTuple):
    """A file that is open, and how its columns are to be read.

    `stream`: its bytes, which can be read again; those of a pipe are in memory. `suffix`: of its format. `most`: memory
    that its numbers may take [bytes]. `decimal`: the decimal sign that the user states.
    """

    path: Path
    stream: io.BufferedIOBase
    suffix: str
    most: int
    decimal: str | None = None

    @property
    def data(self) -> bytes:
        """All bytes, never more than `most`."""
        self.stream.seek(0)
        return self.stream.read(self.most)

    @property
    def sha256(self) -> str:
        """The digest of the bytes, in hexadecimal digits."""
        self.stream.seek(0)
        return hashlib.file_digest(self.stream, "sha256").hexdigest()


class Allowance:
    """The memory that the numbers of a file may take, of which sizes that its headers declare are taken first.

    `most`: the memory [bytes]. `stem`: name of the file without its suffix. `decimal`: the decimal sign of its text, if
    the user states it.
    """

    def __init__(self, most: int, stem: str = "", decimal: str | None = None) -> None:
        self.most, self.left, self.stem, self.decimal = most, most, stem, decimal

    def take(self, numbers: int, what: str) -> None:
        """Reserve memory for a count of `numbers`; raise FileFormatError, with `what` has them, if it is too little."""
        self.check(numbers * _DOUBLE, what)
        self.left -= numbers * _DOUBLE

    def check(self, size: int, what: str) -> None:
        """Refuse a `size` [bytes] of `what` that is negative or exceeds the remaining memory."""
        if size < 0:
            raise FileFormatError(f"{what} declares a negative size; the file is damaged, take a copy")
        if size > self.left:
            raise FileFormatError(
                f"{what} has {_in_words(size)}, more than the {_in_words(self.left)} left of the "
                f"{_in_words(self.most)} that are allowed",
                hint="give a larger max_size=MB if you trust the file",
                change=("columns",),
            )


def content_of(path: Path, most: float) -> Content:
    """Open a regular file, or read a named pipe or a process substitution once; never more than `most` bytes.

    A pipe without a suffix holds text. Raise `FileFormatError` for a folder, a device, a socket, an empty file, more
    than `most` bytes. Raise `OSError` if the file cannot be opened.
    """
    allowed, state = int(most), path.stat()
    if stat.S_ISDIR(state.st_mode):
        raise FileFormatError(f"{path}: this is a folder; give one of the files in it")
    pipe = stat.S_ISFIFO(state.st_mode)
    if not (pipe or stat.S_ISREG(state.st_mode)):
        raise FileFormatError(f"{path}: this is a device, need a file or a pipe; save its data to a file first")
    size, stream = state.st_size, io.BytesIO()
    if not size:
        # A pipe, or a file of the system that states no size.
        with path.open("rb") as source:
            stream = io.BytesIO(source.read(allowed + 1))
        size = stream.getbuffer().nbytes
    Allowance(allowed).check(size, f"{path}: the file")
    if not size:
        raise FileFormatError(f"{path}: the file is empty; export the measurement again")
    opened = path.open("rb") if state.st_size else stream
    return Content(path, opened, path.suffix.lower() or (".csv" if pipe else ""), allowed)


def _in_words(size: int) -> str:
    return f"{size / 1e6:.4g} MB" if size >= 1_000_000 else f"{size} bytes"
