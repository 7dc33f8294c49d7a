"""A record being made: every lot of samples is on disk before the next comes, and nothing is lost by a killed process.

While it is made the samples stand in a journal, CSV that `dehyst.read` reads, beside the HDF5 file to be. At the end,
also an early one, that file is written wholly and the journal goes. Where a process was killed, or the disk full, the
journal stays, and `salvage` makes a file of it.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
import time
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import FileFormatError, RecordError
from dehyst._io.drafts import PathLike, path_of, settle_file, write_atomically
from dehyst.records import hdf5
from dehyst.records.journal import SUFFIX, Journal, numbered, room
from dehyst.records.record import Record

__all__ = ["Lot", "Recording", "numbered", "room", "salvage"]


class Lot(Protocol):
    """Some samples, in order: time (n,) [s], voltage (n,) [V], displacement (n,) [m]."""

    @property
    def time(self) -> ArrayLike: ...  # noqa: D102

    @property
    def voltage(self) -> ArrayLike: ...  # noqa: D102

    @property
    def displacement(self) -> ArrayLike: ...  # noqa: D102


class Recording:
    """A record being made, on disk at once.

    ::

        with Recording("tops.h5", meta={"rig": rig.name}) as recording:
            recording.finish(rig.play(excitation, recording.add))

    A with-block that an exception leaves, Ctrl-C too, writes what came until then, marked incomplete.

    Parameters
    ----------
    path : path
        The file to be, .h5 or .hdf5; it must not exist yet, nor its journal, ``path.part.csv``.
    name : str, optional
        The record's name; by default the file's, without suffix.
    meta : mapping, optional
        What is written with the record, told in JSON. Added to it: complete (bool), ended_because (None or a sentence),
        samples, started and ended (UTC, ISO 8601), sha256 (of the samples, see `write_hdf5`), source (the file's name).

    Attributes
    ----------
    path, journal : Path
    samples : int
        How many came.

    Raises
    ------
    FileFormatError
        The path exists or cannot be written, or the meta cannot be told in JSON.
    MissingExtraError
        If h5py is not installed.
    """

    def __init__(self, path: PathLike, *, name: str | None = None, meta: Mapping[str, Any] | None = None) -> None:
        self.path = path_of(path)
        if self.path.suffix.lower() not in hdf5.SUFFIXES:
            raise FileFormatError(f"{path}: a recording needs the suffix .h5 or .hdf5; rename it")
        # What would fail at the end fails now.
        hdf5.library()
        if os.path.lexists(self.path):
            raise FileFormatError(f"{path}: is there already, and no record is overwritten; name another")
        self.name = self.path.stem if name is None else name
        self._meta = dict(meta or {})
        self._started = _utc(time.time())
        self._lots: list[hdf5.Columns] = []
        self._ended = False
        self.samples = 0
        head = {"name": self.name, "meta": self._meta, "started": self._started}
        self._journal = Journal.begin(self.path, hdf5.in_json(head, self.path))
        self.journal = self._journal.path

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._end(None if error is None else f"{type(error).__name__}: {error}".removesuffix(": "))
        except FileFormatError as second:
            if error is None:
                raise
            error.add_note(str(second))

    def add(self, samples: Lot) -> None:
        """Append samples that follow the ones before; they are on the disk when this returns.

        Raises
        ------
        RecordError
            If the columns are not of one length, or the recording has ended.
        FileFormatError
            If they cannot be written: the disk is full, the folder went. They are kept in memory to be written at the
            end, if they then can be.
        """
        self._refuse_ended()
        lot = _columns(samples)
        if len({column.size for column in lot}) > 1:
            raise RecordError(f"{self.path}: got {', '.join(str(c.size) for c in lot)} values, need one length")
        self._lots.append(lot)
        self.samples += lot[0].size
        self._journal.append(lot)

    def finish(self, record: Record | None = None) -> Path:
        """End a complete record: write the file and take the journal away.

        Parameters
        ----------
        record : Record, optional
            The whole record, if its samples are known better than as they came; its meta is added.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        FileFormatError
            If it cannot be written; the journal stays.
        RecordError
            If the recording has ended.
        """
        self._refuse_ended()
        return self._end(None, record)

    def close(self) -> None:
        """End a record that was not finished: what came is written, marked incomplete. May be called twice."""
        if not self._ended:
            self._end("closed before it was finished")

    def _refuse_ended(self) -> None:
        if self._ended:
            raise RecordError(f"{self.path}: this recording has ended; begin another")

    def _end(self, why: str | None, record: Record | None = None) -> Path:
        """Write the file; `why` it is not complete, or None."""
        if self._ended:
            return self.path
        # A second Ctrl-C while it writes leaves the journal.
        self._ended = True
        columns = _columns(record) if record is not None else _joined(self._lots)
        about = {**self._meta, **(record.meta if record is not None else {})}
        try:
            _write(self.path, columns, self.name, about, why, self._started)
        except (FileFormatError, OSError) as error:
            self._journal.close()
            raise FileFormatError(f"{error}. {self._left(columns, about, why)}") from error
        self._journal.remove()
        return self.path

    def _left(self, columns: hdf5.Columns, about: dict[str, Any], why: str | None) -> str:
        """Where the samples are when the file could not be written, as a sentence."""
        whole = self._journal.samples
        if whole >= self.samples and self._journal.there:
            return f"All {whole} samples are in {self.journal}; salvage() makes a file of them"
        elsewhere = Path(tempfile.gettempdir()) / self.path.name
        with contextlib.suppress(FileFormatError, OSError):
            elsewhere = numbered(elsewhere)
            _write(elsewhere, columns, self.name, about, why or "not complete on its own disk", self._started)
            return f"All {self.samples} samples are in {elsewhere}"
        if self._journal.there:
            return f"The first {whole} of {self.samples} samples are in {self.journal}; salvage() makes a file of them"
        return f"The {self.samples} samples are lost: {self.journal} was removed while recording"


def salvage(folder: PathLike) -> list[Path]:
    """Make files, marked incomplete, of the journals that killed processes left in a folder.

    Nothing is overwritten: where the file is there already, the new one has a number in its name. A journal that a
    living process still writes is left alone, and so is a file whose name is not ``*.h5.part.csv``. One that has
    unusable lines (but for a last one cut off) is kept as ``*.part.damaged.csv`` beside the file: not three finite
    numbers, or a time that does not rise. If it has no sample at all, only that is done.

    Parameters
    ----------
    folder : path

    Returns
    -------
    list of Path
        The files, in the order of their names. Those of fewer than 2 samples hold their meta for the curious; `read`
        refuses them.

    Raises
    ------
    FileFormatError
        If there is no such folder, or a file cannot be written: its journal stays.
    MissingExtraError
        If h5py is not installed.
    """
    hdf5.library()
    folder = path_of(folder)
    if not folder.is_dir():
        raise FileFormatError(f"{folder}: no such folder; give the one that was recorded to")
    kinds = tuple(f"{kind}{SUFFIX}" for kind in hdf5.SUFFIXES)
    left = (path for path in sorted(folder.glob(f"?*{SUFFIX}")) if path.name.lower().endswith(kinds))
    found = [_salvaged(path) for path in left]
    return [path for path in found if path is not None]


def _salvaged(path: Path) -> Path | None:
    journal = Journal.found(path)
    if journal is None:
        return None
    with contextlib.closing(journal):
        told = journal.read()
        if told.damaged and not told.samples:
            journal.keep()
            return None
        target = path.with_name(path.name.removesuffix(SUFFIX))
        if told.samples and _holds(target, hdf5.digest(told.columns)):
            # Its process may have been killed before the file was on the disk.
            settle_file(target)
            journal.remove()
            return target
        meta, target = dict(told.meta), numbered(target)
        if told.cut_off:
            meta["cut_off"] = told.cut_off
        if told.damaged:
            meta["unreadable_lines"] = told.damaged
        why = "the process that recorded it ended before it could write it"
        _write(target, told.columns, told.name or target.stem, meta, why, told.started, _utc(path.stat().st_mtime))
        if told.damaged:
            journal.keep()
        else:
            journal.remove()
    return target


def _holds(path: Path, sha256: str) -> bool:
    """Whether a file is there that holds these samples: its process was killed before it took the journal away."""
    with contextlib.suppress(FileFormatError, OSError):
        stored = hdf5.decode(path)
        return stored is not None and stored.sha256 == sha256
    return False


def _write(
    path: Path,
    columns: hdf5.Columns,
    name: str,
    meta: Mapping[str, Any],
    why: str | None,
    started: str | None,
    ended: str | None = None,
) -> None:
    about = {
        **meta,
        "complete": why is None,
        "ended_because": why,
        "samples": int(columns[0].size),
        "started": started,
        "ended": ended or _utc(time.time()),
        "sha256": hdf5.digest(columns),
        "source": path.name,
    }
    write_atomically(path, hdf5.pack(columns, name, about, path))


def _columns(samples: Lot) -> hdf5.Columns:
    columns = samples.time, samples.voltage, samples.displacement
    t, v, y = (np.array(column, dtype=np.float64).ravel() for column in columns)
    return t, v, y


def _joined(lots: list[hdf5.Columns]) -> hdf5.Columns:
    if not lots:
        return np.zeros(0), np.zeros(0), np.zeros(0)
    t, v, y = (np.concatenate(columns) for columns in zip(*lots, strict=True))
    return t, v, y


def _utc(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="milliseconds")
