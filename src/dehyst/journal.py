"""A journal: samples appended to a CSV file, each lot on the disk before the next; what is left of one is read back."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import shutil
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from dehyst._errors import FileFormatError
from dehyst.files import PathLike, unwritten
from dehyst.hdf5 import DATASETS, Columns

# Behind the name of the file that is to be.
SUFFIX = ".part.csv"
_DAMAGED = ".part.damaged.csv"
_HEADER = ",".join(DATASETS)
# Bytes a sample: three numbers of 24 characters at most, each with a comma or a line's end, and three doubles.
_A_SAMPLE = 3 * 25 + 3 * 8
_MARGIN = 1_000_000


class Told(NamedTuple):
    """What a journal holds: name, meta and start as it was begun, samples, a last line cut off, unreadable lines."""

    name: str
    meta: dict[str, Any]
    started: str | None
    columns: Columns
    cut_off: str
    damaged: int

    @property
    def samples(self) -> int:
        """How many."""
        return int(self.columns[0].size)


class Journal:
    """A journal that this process holds, by a lock that ends with the process.

    Attributes
    ----------
    path : Path
    samples : int
        Whole lines on the disk, of those that were appended here.
    """

    def __init__(self, path: Path, descriptor: int) -> None:
        self.path, self.samples = path, 0
        self._descriptor: int | None = descriptor
        self._size = os.fstat(descriptor).st_size
        self._fault: FileFormatError | None = None

    @classmethod
    def begin(cls, target: Path, head: str) -> Self:
        """Begin the journal of a file that is to be, with one line of JSON at its head; raises FileFormatError."""
        path = target.with_name(target.name + SUFFIX)
        flags = os.O_CREAT | os.O_EXCL | os.O_RDWR | os.O_APPEND | getattr(os, "O_BINARY", 0)
        try:
            descriptor = os.open(path, flags, 0o666)
        except FileExistsError as error:
            raise FileFormatError(
                f"{path}: is there already: another process records to it, or was killed; salvage() makes a file of "
                "what it left"
            ) from error
        except FileNotFoundError as error:
            raise FileFormatError(f"{path}: the folder {path.parent} does not exist; create it first") from error
        except OSError as error:
            raise unwritten(path, error) from error
        journal = cls(path, descriptor)
        try:
            _lock(descriptor)
            journal._write(f"# {head}\n{_HEADER}\n".encode())
            _settle_folder(path.parent)
        except (FileFormatError, OSError) as error:
            journal.remove()
            raise (error if isinstance(error, FileFormatError) else unwritten(path, error)) from error
        journal.samples = 0
        return journal

    @classmethod
    def found(cls, path: Path) -> Self | None:
        """A journal that was left behind; None if another process still holds it."""
        try:
            descriptor = os.open(path, os.O_RDWR | getattr(os, "O_BINARY", 0))
        except OSError as error:
            raise unwritten(path, error) from error
        journal = cls(path, descriptor)
        try:
            _lock(descriptor)
        except BlockingIOError:
            journal.close()
            return None
        return journal

    @property
    def there(self) -> bool:
        """Whether the file can still be found by its name."""
        try:
            now, then = self.path.stat(), self._identity
        except OSError:
            return False
        return (now.st_dev, now.st_ino) == then

    def append(self, columns: Columns) -> None:
        """Append samples; they are on the disk when this returns.

        Raises
        ------
        FileFormatError
            If not all of them are: whole lines stay. No more can be appended then, there would be a gap.
        """
        if self._fault is not None:
            raise self._fault
        rows = zip(*(map(repr, column.tolist()) for column in columns), strict=True)
        self._write("".join(f"{','.join(row)}\n" for row in rows).encode())

    def read(self) -> Told:
        """What the file holds, line by line."""
        *lines, cut_off = self.path.read_bytes().decode("utf-8", "replace").split("\n")
        head: dict[str, Any] = {}
        if lines and lines[0].startswith("# {"):
            with contextlib.suppress(ValueError):
                head = json.loads(lines.pop(0)[2:])
        rows = [_row(line) for line in lines if line != _HEADER]
        whole = [row for row in rows if row is not None]
        time, voltage, displacement = np.array(whole, dtype=np.float64).reshape(-1, 3).T.copy()
        return Told(
            str(head.get("name", "")), dict(head.get("meta", {})), head.get("started"), (time, voltage, displacement),
            cut_off, len(rows) - len(whole),
        )  # fmt: skip

    def close(self) -> None:
        """Let the file go; it stays. May be called twice."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    def remove(self) -> None:
        """Take the file away."""
        if self.there:
            with contextlib.suppress(OSError):
                self.path.unlink()
        self.close()

    def keep(self) -> None:
        """Give the file a name under which it is not found again."""
        self.path.rename(numbered(self.path.with_name(self.path.name.removesuffix(SUFFIX) + _DAMAGED)))
        self.close()

    @property
    def _identity(self) -> tuple[int, int]:
        # A name is all that is left of a file that was closed.
        found = self.path.stat() if self._descriptor is None else os.fstat(self._descriptor)
        return found.st_dev, found.st_ino

    def _write(self, data: bytes) -> None:
        if self._descriptor is None:
            raise FileFormatError(f"{self.path}: this journal is closed; begin another")
        done = 0
        try:
            while done < len(data):
                done += os.write(self._descriptor, data[done:])
            os.fsync(self._descriptor)
        except OSError as error:
            done = data.rfind(b"\n", 0, done) + 1
            with contextlib.suppress(OSError):
                os.ftruncate(self._descriptor, self._size + done)
            self._fault = unwritten(self.path, error)
            raise self._fault from error
        finally:
            self._size += done
            self.samples += data.count(b"\n", 0, done)
        if not self.there:
            self.samples = 0
            self._fault = FileFormatError(f"{self.path}: was removed while recording; are folder and disk still there?")
            raise self._fault


def room(folder: PathLike, samples: int) -> None:
    """Refuse a record before it begins if the disk has no room for its journal and its file.

    Raises
    ------
    FileFormatError
        Naming the bytes that are needed and those that are free.
    """
    need = samples * _A_SAMPLE + _MARGIN
    try:
        free = shutil.disk_usage(folder).free
    except OSError as error:
        raise unwritten(folder, error) from error
    if free < need:
        raise FileFormatError(
            f"{folder}: {samples} samples need up to {need / 1e6:.1f} MB, but {free / 1e6:.1f} MB are free; make room "
            "there, or name a place that has some"
        )


def numbered(path: Path) -> Path:
    """The path, or where it is taken the first free of path-2, path-3, ..."""
    if not path.exists():
        return path
    names = (path.with_name(f"{path.stem}-{number}{path.suffix}") for number in itertools.count(2))
    return next(other for other in names if not other.exists())


def settle(path: Path) -> None:
    """Wait until a file and its name are on the disk."""
    descriptor = os.open(path, os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
    _settle_folder(path.parent)


def _settle_folder(folder: Path) -> None:
    # Windows opens no folders, and some file systems settle none.
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _lock(descriptor: int) -> None:
    """Hold a file until this process ends; raises BlockingIOError if another one does."""
    try:
        import fcntl
    except ImportError:
        return
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError:
        # A file system without locks.
        return


def _row(line: str) -> tuple[float, float, float] | None:
    try:
        time, voltage, displacement = map(float, line.split(","))
    except ValueError:
        return None
    return time, voltage, displacement
