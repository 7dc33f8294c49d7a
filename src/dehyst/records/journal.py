"""A journal: samples appended to a CSV file, each lot on the disk before the next; what is left of one is read back."""

from __future__ import annotations

import contextlib
import itertools
import json
import math
import os
import shutil
from bisect import bisect_left
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from dehyst._errors import FileFormatError
from dehyst._io.drafts import PathLike, settle_folder, unwritten
from dehyst.records.hdf5 import DATASETS, Columns, in_json

# Behind the name of the file that is to be.
SUFFIX = ".part.csv"
_DAMAGED = ".part.damaged.csv"
_HEADER = ",".join(DATASETS)
# Bytes a sample: three numbers of 24 characters at most, each with a comma or a line's end, and three doubles.
_A_SAMPLE = 3 * 25 + 3 * 8
_MARGIN = 1_000_000
# A last line longer than this [characters] is none that was cut off.
_LONGEST_LINE = 10_000

_Row = tuple[float, float, float]


class JournalContents(NamedTuple):
    """What a journal holds: name, meta and start as it was begun, samples, a last line cut off, unusable lines."""

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
            settle_folder(path.parent)
        except (FileFormatError, OSError) as error:
            journal.remove()
            raise (error if isinstance(error, FileFormatError) else unwritten(path, error)) from error
        journal.samples = 0
        return journal

    @classmethod
    def found(cls, path: Path) -> Self | None:
        """A journal that was left behind; None if another process still holds it. Raises FileFormatError."""
        if not path.is_file():
            raise FileFormatError(f"{path}: is no file, but the name is one of a journal; move it to another folder")
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

    def read(self) -> JournalContents:
        """Read what the file holds, line by line.

        Lines that are no three finite numbers, and the fewest that keep the time from rising, are left out and counted.

        Raises
        ------
        FileFormatError
            If it cannot be read.
        """
        try:
            data = self.path.read_bytes()
        except OSError as error:
            raise unwritten(self.path, error) from error
        # After a power cut a file system may have added zeros to a file whose end it had not written.
        *lines, cut_off = data.rstrip(b"\0").decode("utf-8", "replace").split("\n")
        name, meta, started = "", dict[str, Any](), None
        if lines and lines[0].startswith("# {") and (head := _head(lines[0][2:])) is not None:
            name, meta, started = head
            del lines[0]
        rows = [_row(line) for line in lines if line != _HEADER]
        whole = _rising([row for row in rows if row is not None])
        time, voltage, displacement = np.array(whole, dtype=np.float64).reshape(-1, 3).T.copy()
        damaged = len(rows) - len(whole) + (len(cut_off) > _LONGEST_LINE)
        return JournalContents(name, meta, started, (time, voltage, displacement), cut_off[:_LONGEST_LINE], damaged)

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
        """Give the file a name under which it is not found again; raises FileFormatError."""
        other = numbered(self.path.with_name(self.path.name.removesuffix(SUFFIX) + _DAMAGED))
        try:
            self.path.rename(other)
        except OSError as error:
            raise unwritten(other, error) from error
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
    # A link that leads nowhere is a name that is taken, too: what is written to it would land elsewhere.
    if not os.path.lexists(path):
        return path
    names = (path.with_name(f"{path.stem}-{number}{path.suffix}") for number in itertools.count(2))
    return next(other for other in names if not os.path.lexists(other))


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


def _head(text: str) -> tuple[str, dict[str, Any], str | None] | None:
    """Name, meta and start in the first line of a journal; None if they are of other types or cannot be written."""
    try:
        head = json.loads(text)
        in_json(head, "head")
    except (ValueError, RecursionError):
        return None
    name, meta, started = head.get("name", ""), head.get("meta", {}), head.get("started")
    if isinstance(name, str) and isinstance(meta, dict) and isinstance(started, str | None):
        return name, meta, started
    return None


def _row(line: str) -> _Row | None:
    try:
        time, voltage, displacement = map(float, line.split(","))
    except ValueError:
        return None
    row = time, voltage, displacement
    return row if all(map(math.isfinite, row)) else None


def _rising(rows: list[_Row]) -> list[_Row]:
    """The most rows whose times rise strictly, in their order: one wrong time does not cost those after it."""
    ends: list[float] = []
    length = []
    for time, _, _ in rows:
        place = bisect_left(ends, time)
        ends[place : place + 1] = [time]
        length.append(place)
    kept: list[_Row] = []
    wanted = len(ends) - 1
    for row, place in zip(reversed(rows), reversed(length), strict=True):
        if place == wanted and (not kept or row[0] < kept[-1][0]):
            kept.append(row)
            wanted -= 1
    return kept[::-1]
