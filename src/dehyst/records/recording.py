"""A recording in progress: every block of samples is on disk before the next, so that a killed process loses nothing.

During the recording the samples are in a journal, CSV that `dehyst.read` reads, beside the future HDF5 file. At the
end, also an early one, that file is written as a whole and the journal is deleted. After a killed process or with a
full disk the journal stays, and `salvage` makes a file of it.
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
from dehyst._io.json_files import to_json
from dehyst.records import hdf5
from dehyst.records.journal import SUFFIX, Journal, demand_disk_space, unused_path
from dehyst.records.record import Record

__all__ = ["Recording", "SampleBlock", "demand_disk_space", "salvage", "unused_path"]


class SampleBlock(Protocol):
    """Successive samples: time (n,) [s], voltage (n,) [V], displacement (n,) [m]."""

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

    If an exception, Ctrl-C too, ends the with-block, the samples so far are written and marked incomplete.

    Parameters
    ----------
    path : path
        The final file, .h5 or .hdf5; neither it nor its journal, ``path.part.csv``, may exist yet.
    name : str, optional
        The record's name; by default the file's, without suffix.
    meta : mapping, optional
        Written with the record, as JSON. Added to it: complete (bool), ended_because (None or a sentence),
        samples, started and ended (UTC, ISO 8601), sha256 (of the samples, see `write_hdf5`), source (the file's name).

    Attributes
    ----------
    path, journal : Path
    samples : int
        Number of samples so far.

    Raises
    ------
    FileFormatError
        The path exists or cannot be written, or the meta cannot be written as JSON.
    MissingExtraError
        If h5py is not installed.
    """

    def __init__(self, path: PathLike, *, name: str | None = None, meta: Mapping[str, Any] | None = None) -> None:
        self.path = path_of(path)
        if self.path.suffix.lower() not in hdf5.SUFFIXES:
            raise FileFormatError(f"{path}: a recording needs the suffix .h5 or .hdf5; rename it")
        # A missing package is reported now, not at the end.
        hdf5.demand_writer()
        if os.path.lexists(self.path):
            raise FileFormatError(f"{path}: is there already, and no record is overwritten; name another")
        self.name = self.path.stem if name is None else name
        self._meta = dict(meta or {})
        self._started = _utc(time.time())
        self._blocks: list[hdf5.Columns] = []
        self._ended = False
        self.samples = 0
        head = {"name": self.name, "meta": self._meta, "started": self._started}
        self._journal = Journal.create(self.path, to_json(head, f"{self.path}: meta"))
        self.journal = self._journal.path

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
            If the columns are not of one length, or the recording has ended.
        FileFormatError
            If they cannot be written: the disk is full, or the folder was removed. They stay in memory, and are written
            at the end if that is possible then.
        """
        self._refuse_ended()
        block = _columns(samples)
        if len({column.size for column in block}) > 1:
            raise RecordError(f"{self.path}: got {', '.join(str(c.size) for c in block)} values, need one length")
        self._blocks.append(block)
        self.samples += block[0].size
        self._journal.append(block)

    def finish(self, record: Record | None = None) -> Path:
        """End a complete recording: write the file and delete the journal.

        `record`: the whole record, to replace the samples that were added; its meta is added.

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
        columns = _columns(record) if record is not None else _join(self._blocks)
        meta = {**self._meta, **(record.meta if record is not None else {})}
        try:
            _write(self.path, columns, self.name, meta, why, self._started)
        except (FileFormatError, OSError) as error:
            self._journal.close()
            raise FileFormatError(f"{error}. {self._remains(columns, meta, why)}") from error
        self._journal.remove()
        return self.path

    def _remains(self, columns: hdf5.Columns, meta: dict[str, Any], why: str | None) -> str:
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
    """Make files, marked incomplete, of the journals that killed processes left in a folder.

    Nothing is overwritten: if the file exists, the new one has a number in its name. A journal that a running process
    still writes is not touched, nor is a file whose name is not ``*.h5.part.csv``. A journal with unusable lines (not
    three finite numbers, or a time that does not rise, except a last line cut off) is kept as ``*.part.damaged.csv``
    beside the file. If it has no sample at all, it is only renamed so. Raise `FileFormatError` if there is no such
    folder, or a file cannot be written: its journal stays. Raise `MissingExtraError` if h5py is not installed.

    Returns
    -------
    list of Path
        The files, in the order of their names. `read` refuses those of fewer than 2 samples, which only keep the meta.
    """
    hdf5.demand_writer()
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
        if contents.damaged and not contents.samples:
            journal.set_aside()
            return None
        target = path.with_name(path.name.removesuffix(SUFFIX))
        if contents.samples and _has_samples(target, hdf5.sha256_of(contents.columns)):
            # The process may have been killed before the file was on the disk.
            settle_file(target)
            journal.remove()
            return target
        meta, target = dict(contents.meta), unused_path(target)
        if contents.cut_off:
            meta["cut_off"] = contents.cut_off
        if contents.damaged:
            meta["unreadable_lines"] = contents.damaged
        why = "the process that recorded it ended before it could write it"
        _write(
            target,
            contents.columns,
            contents.name or target.stem,
            meta,
            why,
            contents.started,
            _utc(path.stat().st_mtime),
        )
        if contents.damaged:
            journal.set_aside()
        else:
            journal.remove()
    return target


def _has_samples(path: Path, sha256: str) -> bool:
    """Return whether a file with these samples exists: the process was killed before it deleted the journal."""
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
    meta = {
        **meta,
        "complete": why is None,
        "ended_because": why,
        "samples": int(columns[0].size),
        "started": started,
        "ended": ended or _utc(time.time()),
        "sha256": hdf5.sha256_of(columns),
        "source": path.name,
    }
    write_atomically(path, hdf5.pack(columns, name, meta, path))


def _columns(samples: SampleBlock) -> hdf5.Columns:
    columns = samples.time, samples.voltage, samples.displacement
    t, v, y = (np.array(column, dtype=np.float64).ravel() for column in columns)
    return t, v, y


def _join(blocks: list[hdf5.Columns]) -> hdf5.Columns:
    if not blocks:
        return np.zeros(0), np.zeros(0), np.zeros(0)
    t, v, y = (np.concatenate(columns) for columns in zip(*blocks, strict=True))
    return t, v, y


def _utc(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="milliseconds")
