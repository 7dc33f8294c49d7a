"""A journal: samples appended to a CSV file, each block on the disk before the next; a journal left behind is read."""

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
from dehyst._io.json_files import to_json
from dehyst.records.hdf5 import DATASETS, Columns

# Appended to the name of the final file.
SUFFIX = ".part.csv"
_DAMAGED = ".part.damaged.csv"
_HEADER = ",".join(DATASETS)
# Bytes a sample: three numbers of 24 characters at most, each with a comma or a line end, and three doubles.
_SAMPLE_BYTES = 3 * 25 + 3 * 8
_MARGIN = 1_000_000
# A last line longer than this [characters] was not merely cut off.
_LONGEST_LINE = 10_000

_Row = tuple[float, float, float]


class JournalContents(NamedTuple):
    """Contents of a journal: name, meta and start, samples, a last line cut off, number of unusable lines."""

    name: str
    meta: dict[str, Any]
    started: str | None
    columns: Columns
    cut_off: str
    damaged: int

    @property
    def samples(self) -> int:
        """Number of samples."""
        return int(self.columns[0].size)


class Journal:
    """A journal that this process has locked; the lock ends with the process.

    `samples`: appended samples that are whole lines on the disk.
    """

    def __init__(self, path: Path, descriptor: int) -> None:
        self.path, self.samples = path, 0
        self._descriptor: int | None = descriptor
        self._size = os.fstat(descriptor).st_size
        self._failure: FileFormatError | None = None

    @classmethod
    def create(cls, target: Path, head: str) -> Self:
        """Create the journal of a future file, with one line of JSON at its head; raise FileFormatError on failure."""
        path = target.with_name(target.name + SUFFIX)
        flags = os.O_CREAT | os.O_EXCL | os.O_RDWR | os.O_APPEND | getattr(os, "O_BINARY", 0)
        try:
            descriptor = os.open(path, flags, 0o666)
        except FileExistsError as error:
            raise FileFormatError(
                f"{path}: is there already: another process records to it, or was killed; salvage() makes a file of "
                "its samples"
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
    def reopen(cls, path: Path) -> Self | None:
        """Open a journal left behind; return None if another process locked it, raise FileFormatError on failure."""
        if not path.is_file():
            raise FileFormatError(f"{path}: is not a file, but has the name of a journal; move it to another folder")
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
    def exists(self) -> bool:
        """Whether the file still exists under its name."""
        try:
            status, identity = self.path.stat(), self._identity
        except OSError:
            return False
        return (status.st_dev, status.st_ino) == identity

    def append(self, columns: Columns) -> None:
        """Append samples; they are on the disk when this returns.

        Raise `FileFormatError` if not all of them are written: whole lines stay. Nothing more can be appended, because
        of the gap.
        """
        if self._failure is not None:
            raise self._failure
        rows = zip(*(map(repr, column.tolist()) for column in columns), strict=True)
        self._write("".join(f"{','.join(row)}\n" for row in rows).encode())

    def read(self) -> JournalContents:
        """Read the file, line by line.

        Lines without three finite numbers, and the fewest lines that keep the time from rising, are left out and
        counted. Raise `FileFormatError` if it cannot be read.
        """
        try:
            data = self.path.read_bytes()
        except OSError as error:
            raise unwritten(self.path, error) from error
        # After a power cut a file system may have added zeros to a file whose end was not written.
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
        """Close the file, which stays; may be called twice."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    def remove(self) -> None:
        """Delete the file."""
        if self.exists:
            with contextlib.suppress(OSError):
                self.path.unlink()
        self.close()

    def set_aside(self) -> None:
        """Rename the file so that it is not salvaged again; raise FileFormatError if it cannot be renamed."""
        target = unused_path(self.path.with_name(self.path.name.removesuffix(SUFFIX) + _DAMAGED))
        try:
            self.path.rename(target)
        except OSError as error:
            raise unwritten(target, error) from error
        self.close()

    @property
    def _identity(self) -> tuple[int, int]:
        # Of a closed file only the name is left.
        status = self.path.stat() if self._descriptor is None else os.fstat(self._descriptor)
        return status.st_dev, status.st_ino

    def _write(self, data: bytes) -> None:
        if self._descriptor is None:
            raise FileFormatError(f"{self.path}: this journal is closed; create another")
        done = 0
        try:
            while done < len(data):
                done += os.write(self._descriptor, data[done:])
            os.fsync(self._descriptor)
        except OSError as error:
            done = data.rfind(b"\n", 0, done) + 1
            with contextlib.suppress(OSError):
                os.ftruncate(self._descriptor, self._size + done)
            self._failure = unwritten(self.path, error)
            raise self._failure from error
        finally:
            self._size += done
            self.samples += data.count(b"\n", 0, done)
        if not self.exists:
            self.samples = 0
            self._failure = FileFormatError(
                f"{self.path}: was removed while recording; check that the folder and the disk still exist"
            )
            raise self._failure


def demand_disk_space(folder: PathLike, samples: int) -> None:
    """Refuse a record, before it begins, if the disk has no space for its journal and its file.

    Raises
    ------
    FileFormatError
        With the bytes needed and those free.
    """
    needed = samples * _SAMPLE_BYTES + _MARGIN
    try:
        free = shutil.disk_usage(folder).free
    except OSError as error:
        raise unwritten(folder, error) from error
    if free < needed:
        raise FileFormatError(
            f"{folder}: {samples} samples need up to {needed / 1e6:.1f} MB, but {free / 1e6:.1f} MB are free; make "
            "room there, or name a place that has some"
        )


def unused_path(path: Path) -> Path:
    """Return the path or, if it exists, the first unused one of path-2, path-3, ..."""
    # A dangling link counts as existing: data written to it would go to another place.
    if not os.path.lexists(path):
        return path
    names = (path.with_name(f"{path.stem}-{number}{path.suffix}") for number in itertools.count(2))
    return next(name for name in names if not os.path.lexists(name))


def _lock(descriptor: int) -> None:
    """Lock a file until this process ends; raise BlockingIOError if another process has locked it."""
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
    """Return name, meta and start from the first line of a journal; None for other types or if not writable as JSON."""
    try:
        head = json.loads(text)
        to_json(head, "head")
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
    """Return the most rows whose times rise strictly: one wrong time does not remove those after it."""
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
