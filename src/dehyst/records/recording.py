"""A journal: samples appended to a CSV file, each block on the disk before the next; a journal left behind is read."""

from __future__ import annotations

import contextlib
import itertools
import json
import math
import os
import shutil
import tempfile
import time
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dehyst._errors import FileFormatError, RecordError
from dehyst._io import PathLike, lock, path_of, settle_file, settle_folder, to_json, unwritten, write_atomically
from dehyst._types import Array
from dehyst.records import hdf5
from dehyst.records.formats.columns import Column
from dehyst.records.record import Channel, Record

__all__ = ["Recording", "SampleBlock", "demand_disk_space", "salvage", "unused_path"]

# Appended to the name of the final file.
SUFFIX = ".part.csv"
_DAMAGED = ".part.damaged.csv"
# Bytes of a number: 24 characters at most, with a comma or a line end, and a double.
_NUMBER_BYTES, _MARGIN = 25 + 8, 1_000_000
# A last line longer than this [characters] was not merely cut off.
_LONGEST_LINE = 10_000

_Row = tuple[float, ...]
_Columns = dict[str, NDArray[np.float64]]


class JournalContents(NamedTuple):
    """Contents of a journal: name, meta and start, samples, a last line cut off, number of unusable lines."""

    name: str
    meta: dict[str, Any]
    started: str | None
    columns: _Columns
    cut_off: str
    damaged: int


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
    def create(cls, target: Path, head: str, columns: Sequence[str]) -> Self:
        """Create the journal of a file of columns, a line of JSON at its head; raise FileFormatError on failure."""
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
            lock(descriptor)
            journal._write(f"# {head}\n{','.join(columns)}\n".encode())
            settle_folder(path.parent)
        except FileFormatError:
            journal.remove()
            raise
        except OSError as error:
            journal.remove()
            raise unwritten(path, error) from error
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
            lock(descriptor)
        except BlockingIOError:
            journal.close()
            return None
        return journal

    @property
    def exists(self) -> bool:
        """Whether the file still exists under its name."""
        try:
            found = self.path.stat()
            # Of a closed file only the name is left.
            return self._descriptor is None or os.path.samestat(found, os.fstat(self._descriptor))
        except OSError:
            return False

    def append(self, columns: _Columns) -> None:
        """Append samples; they are on the disk when this returns.

        Raise `FileFormatError` if not all of them are written: whole lines stay. Nothing more can be appended, because
        of the gap.
        """
        if self._failure is not None:
            raise self._failure
        rows = zip(*(map(repr, column.tolist()) for column in columns.values()), strict=True)
        self._write("".join(f"{','.join(row)}\n" for row in rows).encode())

    def read(self) -> JournalContents:
        """Read the file, line by line.

        Lines without a finite number for each column, and the fewest lines that keep the time from rising, are left out
        and counted. Raise `FileFormatError` if it cannot be read.
        """
        try:
            data = self.path.read_bytes()
        except OSError as error:
            raise unwritten(self.path, error) from error
        # After a power cut a file system may have added zeros to a file whose end was not written.
        *lines, cut_off = data.rstrip(b"\0").decode("utf-8", "replace").split("\n")
        head = _head(lines[0][2:]) if lines and lines[0].startswith("# {") else None
        known = ",".join(hdf5.DATASETS)
        header = next((line for line in lines if line == known or line.startswith(f"{known},")), known)
        columns = header.split(",")
        rows = []
        for line in lines[head is not None :]:
            if line != header:
                try:
                    rows.append(tuple(map(float, line.split(","))))
                except ValueError:
                    rows.append(())
        whole = _rising([row for row in rows if len(row) == len(columns) and all(map(math.isfinite, row))])
        arrays = np.array(whole, dtype=np.float64).reshape(-1, len(columns)).T.copy()
        damaged = len(rows) - len(whole) + (len(cut_off) > _LONGEST_LINE)
        found = dict(zip(columns, arrays, strict=True))
        return JournalContents(*(head or ("", {}, None)), found, cut_off[:_LONGEST_LINE], damaged)

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


def demand_disk_space(folder: PathLike, samples: int, columns: int = 3) -> None:
    """Raise `FileFormatError` before a recording if the disk has no space for its journal and its file."""
    needed = samples * columns * _NUMBER_BYTES + _MARGIN
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
    """Return the path or, if it exists, the first unused path of path-2, path-3, ..."""
    # A dangling link counts as existing: data written to it would go to another place.
    if not os.path.lexists(path):
        return path
    names = (path.with_name(f"{path.stem}-{number}{path.suffix}") for number in itertools.count(2))
    return next(name for name in names if not os.path.lexists(name))


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


def _rising(rows: list[_Row]) -> list[_Row]:
    """Return the most rows with strictly rising times, so that a wrong time does not remove later rows."""
    ends: list[float] = []
    length = []
    for row in rows:
        place = bisect_left(ends, row[0])
        ends[place : place + 1] = [row[0]]
        length.append(place)
    kept: list[_Row] = []
    wanted = len(ends) - 1
    for row, place in zip(reversed(rows), reversed(length), strict=True):
        if place == wanted and (not kept or row[0] < kept[-1][0]):
            kept.append(row)
            wanted -= 1
    return kept[::-1]


class SampleBlock(Protocol):
    """Successive samples: time (n,) [s], voltage (n,) [V], displacement (n,) [m].

    If a recording has `others`, a block also has an attribute `others`: arrays (n,) by column name.
    """

    @property
    def time(self) -> ArrayLike: ...  # noqa: D102

    @property
    def voltage(self) -> ArrayLike: ...  # noqa: D102

    @property
    def displacement(self) -> ArrayLike: ...  # noqa: D102


class Recording:
    """A recording in progress, written to disk at once.

    ::

        with Recording("tops.h5", meta={"rig": rig.name}) as recording:
            recording.finish(rig.play(excitation, recording.add))

    If an exception (or Ctrl-C) ends the with-block, the samples so far are written and marked incomplete.

    Parameters
    ----------
    path : path
        The final file, .h5 or .hdf5; neither it nor its journal, ``path.part.csv``, may exist yet.
    name : str, optional
        The record's name; by default the file's, without suffix.
    meta : mapping, optional
        Written with the record, as JSON. Added to it: complete (bool), ended_because (None or a sentence),
        samples, started and ended (UTC, ISO 8601), sha256 (of the samples, see `write_hdf5`), source (the file's name).
    others : sequence of str
        Names of further channels, as "temperature_C" and "load_N"; each block of samples holds them in a mapping
        ``samples.others``.

    Attributes
    ----------
    path, journal : Path
    samples : int
        Number of samples so far.

    Raises
    ------
    FileFormatError
        The path exists or cannot be written, the meta cannot be written as JSON, or one of `others` has no unit.
    MissingExtraError
        If h5py is not installed.
    """

    def __init__(
        self,
        path: PathLike,
        *,
        name: str | None = None,
        meta: Mapping[str, Any] | None = None,
        others: Sequence[str] = (),
    ) -> None:
        self.path, self.others = path_of(path), tuple(others)
        for column in self.others:
            if fault := Channel.of(Column(column, np.zeros(1))).fault:
                raise FileFormatError(argument="others", message=fault)
        if self.path.suffix.lower() not in hdf5.SUFFIXES:
            raise FileFormatError(f"{path}: a recording needs the suffix .h5 or .hdf5; rename it")
        # A missing package is reported now, not at the end.
        hdf5.writer()
        if os.path.lexists(self.path):
            raise FileFormatError(f"{path}: is there already, and no record is overwritten; name another")
        self.name = self.path.stem if name is None else name
        self._meta = dict(meta or {})
        self._started = _utc(time.time())
        self._blocks: list[_Columns] = [{column: np.zeros(0) for column in (*hdf5.DATASETS, *self.others)}]
        self._ended = False
        self.samples = 0
        head = {"name": self.name, "meta": self._meta, "started": self._started}
        self._journal = Journal.create(self.path, to_json(head, f"{self.path}: meta"), list(self._blocks[0]))
        self.journal = self._journal.path

    @property
    def columns(self) -> dict[str, Array]:
        """The samples so far: arrays (n,) by column name, time, voltage and displacement [m] first."""
        return {name: np.concatenate([block[name] for block in self._blocks]) for name in self._blocks[0]}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._end(None if error is None else f"{type(error).__name__}: {error}".removesuffix(": "))
        except FileFormatError as failure:
            if error is None:
                raise
            error.add_note(str(failure))

    def add(self, samples: SampleBlock) -> None:
        """Append `samples` after the earlier ones; they are on the disk when this returns.

        Raises
        ------
        RecordError
            If the columns are not of one length, one of `others` is missing, or the recording has ended.
        FileFormatError
            If the samples cannot be written, because the disk is full or the folder was removed. They stay in memory,
            and are written at the end if possible.
        """
        self._refuse_ended()
        block = self._columns(samples)
        sizes = [column.size for column in block.values()]
        if len(set(sizes)) > 1:
            raise RecordError(f"{self.path}: got {', '.join(map(str, sizes))} values, need one length")
        self._blocks.append(block)
        self.samples += sizes[0]
        self._journal.append(block)

    def finish(self, record: Record | None = None) -> Path:
        """End a complete recording: write the file, delete the journal, and return the file's path.

        `record`: the whole record, which replaces the added samples; its meta is added.

        Raises
        ------
        FileFormatError
            If it cannot be written; the journal stays.
        RecordError
            If the recording has ended.
        """
        self._refuse_ended()
        return self._end(None, record)

    def discard(self) -> None:
        """End a recording whose samples are in another file, or needed no more: delete the journal, write no file."""
        if not self._ended:
            self._ended = True
            self._journal.remove()

    def close(self) -> None:
        """End a recording that was not finished: write its samples, marked incomplete; may be called twice."""
        if not self._ended:
            self._end("closed before it was finished")

    def _refuse_ended(self) -> None:
        if self._ended:
            raise RecordError(f"{self.path}: this recording has ended; begin another")

    def _end(self, why: str | None, record: Record | None = None) -> Path:
        """Write the file; `why` is the reason if it is not complete, else None."""
        if self._ended:
            return self.path
        # A second Ctrl-C during writing leaves the journal.
        self._ended = True
        columns = self.columns if record is None else record.one_axis().columns("m")
        meta = {**self._meta, **(record.meta if record is not None else {})}
        try:
            _write(self.path, columns, self.name, meta, why, self._started)
        except (FileFormatError, OSError) as error:
            self._journal.close()
            raise FileFormatError(f"{error}. {self._remains(columns, meta, why)}") from error
        self._journal.remove()
        return self.path

    def _columns(self, samples: SampleBlock) -> _Columns:
        further = getattr(samples, "others", {})
        if missing := [column for column in self.others if column not in further]:
            raise RecordError(
                f"{self.path}: got samples without {', '.join(missing)}, need all columns of the recording"
            )
        arrays = samples.time, samples.voltage, samples.displacement, *(further[column] for column in self.others)
        flat = (np.array(values, dtype=np.float64).ravel() for values in arrays)
        return dict(zip((*hdf5.DATASETS, *self.others), flat, strict=True))

    def _remains(self, columns: _Columns, meta: dict[str, Any], why: str | None) -> str:
        """Return a sentence with the place of the samples when the file could not be written."""
        whole = self._journal.samples
        if whole >= self.samples and self._journal.exists:
            return f"All {whole} samples are in {self.journal}; salvage() makes a file of them"
        elsewhere = Path(tempfile.gettempdir()) / self.path.name
        with contextlib.suppress(FileFormatError, OSError):
            elsewhere = unused_path(elsewhere)
            _write(elsewhere, columns, self.name, meta, why or "not complete on its own disk", self._started)
            return f"All {self.samples} samples are in {elsewhere}"
        if self._journal.exists:
            return f"The first {whole} of {self.samples} samples are in {self.journal}; salvage() makes a file of them"
        return f"The {self.samples} samples are lost: {self.journal} was removed while recording"


def salvage(folder: PathLike) -> list[Path]:
    """Convert the journals of killed processes in a folder to record files, marked incomplete; return their paths.

    Nothing is overwritten: if the file exists, the new one gets a number in its name. Journals of running processes,
    and files that are not named ``*.h5.part.csv``, are not touched. Lines are unusable if they lack a finite number for
    a column or their time does not rise; an incomplete last line is allowed. A journal with unusable lines is kept as
    ``*.part.damaged.csv`` next to the file; a journal without any sample is only renamed. `read` refuses files of fewer
    than 2 samples, which only keep the meta. Raise `FileFormatError` if there is no such folder, or a file cannot be
    written: its journal stays. Raise `MissingExtraError` if h5py is not installed.
    """
    hdf5.writer()
    folder = path_of(folder)
    if not folder.is_dir():
        raise FileFormatError(f"{folder}: no such folder; give the folder of the recordings")
    kinds = tuple(f"{kind}{SUFFIX}" for kind in hdf5.SUFFIXES)
    journals = (path for path in sorted(folder.glob(f"?*{SUFFIX}")) if path.name.lower().endswith(kinds))
    return [path for path in map(_salvage, journals) if path is not None]


def _salvage(path: Path) -> Path | None:
    journal = Journal.reopen(path)
    if journal is None:
        return None
    with contextlib.closing(journal):
        contents = journal.read()
        size, sha256 = contents.columns[hdf5.DATASETS[0]].size, hdf5.sha256_of(contents.columns.values())
        if contents.damaged and not size:
            journal.set_aside()
            return None
        target = path.with_name(path.name.removesuffix(SUFFIX))
        stored = None
        with contextlib.suppress(FileFormatError, OSError):
            stored = hdf5.decode(target.read_bytes())
        if size and stored is not None and stored.sha256 == sha256:
            # The process was killed before it deleted the journal, perhaps before the file was on the disk.
            settle_file(target)
            journal.remove()
            return target
        meta, target = dict(contents.meta), unused_path(target)
        if contents.cut_off:
            meta["cut_off"] = contents.cut_off
        if contents.damaged:
            meta["unreadable_lines"] = contents.damaged
        why, ended = "the process that recorded it ended before it could write it", _utc(path.stat().st_mtime)
        _write(target, contents.columns, contents.name or target.stem, meta, why, contents.started, ended)
        (journal.set_aside if contents.damaged else journal.remove)()
    return target


def _write(
    path: Path,
    columns: _Columns,
    name: str,
    meta: Mapping[str, Any],
    why: str | None,
    started: str | None,
    ended: str | None = None,
) -> None:
    meta = {
        **meta,
        "complete": why is None,
        "ended_because": why,
        "samples": int(columns[hdf5.DATASETS[0]].size),
        "started": started,
        "ended": ended or _utc(time.time()),
        "sha256": hdf5.sha256_of(columns.values()),
        "source": path.name,
    }
    write_atomically(path, hdf5.pack(columns, name, meta, path))


def _utc(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="milliseconds")
