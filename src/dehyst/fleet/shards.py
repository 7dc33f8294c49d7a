"""The shards of a run: one file a record, written atomically, in a folder beside the table."""

from __future__ import annotations

import json
import os
import platform
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

from dehyst._errors import FileFormatError
from dehyst._io import finite, is_draft, lock, make_own_folder, read_json, unwritten, write_atomically, write_json
from dehyst._text import counted
from dehyst.fleet.dataset import Task

# What a row holds beside its keys, in the order of the table's columns.
NUMBERS = (
    *("largest_percent", "rms_percent", "expected_percent", "noise_nm", "noise_percent", "stroke_um"),
    *("width25_um", "width50_um", "width75_um", "drift_percent", "cycle_s"),
)
TEXTS = ("outcome", "detail", "reason")
PRIORS = ("prior", "held_out_own_percent", "held_out_prior_percent")
# Where the record lies in the dataset, and where its refusal was raised.
PLACE, CAUSE = "place", "cause"
COLUMNS = (
    *(*TEXTS, *NUMBERS, *PRIORS, "samples", "coefficients", "version", "sha256", "cpu_s", "wall_s", "memory_MB"),
    *(PLACE, CAUSE),
)
MODEL = "model"


MARKER = ("fleet.json", "dehyst-fleet-parts")
_ROW, _LOCK = "dehyst-fleet-row", "fleet.lock"
# Suffix of the file that has a byte for each trial of a record.
_TRIED = ".tried"


class Shards:
    """The folder of the shards of one run.

    `folder`: its path. `digest`: of dataset and options; shards of another one are none of this run. A shard has the
    name of its record's place in the dataset: records may come and go.
    """

    def __init__(self, folder: Path, digest: str) -> None:
        self.folder, self.digest = folder, digest

    @classmethod
    def beside(cls, output: Path, digest: str) -> Shards:
        """Return the shards of a table: in a folder of its name with ".parts"."""
        return cls(output.with_name(f"{output.name}.parts"), digest)

    @contextmanager
    def held(self) -> Iterator[None]:
        """Hold the folder, which is made if necessary, for one run; at its end remove drafts, or all without rows.

        Raise `FileFormatError` if another run holds it, or if it holds other files.
        """
        with self._locked():
            try:
                yield
            finally:
                for path in self.folder.rglob(".*"):
                    if is_draft(path.name):
                        path.unlink(missing_ok=True)
                if not any(self.files()):
                    self.remove()

    def _locked(self) -> IO[bytes]:
        """Return the open lock of the folder."""
        path = self.folder / _LOCK
        while True:
            try:
                make_own_folder(self.folder, *MARKER)
            except FileFormatError:
                # A run that has just begun, or was killed then, has no marker yet.
                if not path.exists():
                    raise
            try:
                stream = path.open("a+b")
            except FileNotFoundError:
                # The run that had the folder has just removed it.
                continue
            except OSError as error:
                raise unwritten(path, error) from error
            if self._is_mine(stream):
                return stream
            stream.close()

    def _is_mine(self, stream: IO[bytes]) -> bool:
        """Lock an open file; return whether it is still that of the folder."""
        try:
            lock(stream.fileno())
        except BlockingIOError as error:
            stream.seek(0)
            who = stream.read(200).decode(errors="replace")
            stream.close()
            raise FileFormatError(
                f"{self.folder}: another run uses it ({who}); wait for its end, or name another table"
            ) from error
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(stream.fileno()), (self.folder / _LOCK).stat()):
                stream.truncate(0)
                stream.write(f"process {os.getpid()} on {platform.node()}".encode())
                stream.flush()
                return True
        return False

    @property
    def begun(self) -> bool:
        """Whether the folder is that of a run that has begun."""
        return (self.folder / MARKER[0]).exists()

    def prepare(self, count: int, options: Mapping[str, Any], *, resume: bool) -> None:
        """Begin, or raise `FileFormatError` if there are shards that are not to be resumed, or others."""
        marker = self.folder / MARKER[0]
        if self.begun:
            self._check(read_json(marker), resume)
            for path in self.folder.glob(f"*/*{_TRIED}"):
                path.unlink(missing_ok=True)
            return
        head = {"format": MARKER[1], "version": 1, "digest": self.digest, "records": count, "options": dict(options)}
        write_json(marker, finite(head))

    def _check(self, head: Mapping[str, Any], resume: bool) -> None:
        if not resume:
            done = sum(1 for _ in self.files())
            raise FileFormatError(
                f"{self.folder}: holds {counted(done, 'record')} of a run that did not end; go on with --resume, or "
                "remove the folder"
            )
        if head.get("format") != MARKER[1] or head.get("digest") != self.digest:
            raise FileFormatError(
                f"{self.folder}: is of another dataset, other options or another version; repeat the command of that "
                "run, or remove the folder"
            )

    def path(self, task: Task) -> Path:
        """Return the file of a record; a folder with very many files is slow in many file systems."""
        return self.folder / task.code[:2] / f"{task.code}.json"

    def files(self) -> Iterator[Path]:
        """Yield the files of records, named by the `Task.code` of each."""
        return self.folder.glob("*/*.json")

    def write(self, task: Task, row: Mapping[str, Any]) -> None:
        """Write the row of a record, whole or not at all."""
        path = self._made(task)
        head = {"format": _ROW, "digest": self.digest, PLACE: task.within}
        write_atomically(path, json.dumps(finite({**head, **row}), allow_nan=False))
        path.with_suffix(_TRIED).unlink(missing_ok=True)

    def trial(self, task: Task) -> int:
        """Count a trial of a record in this run, and return its number: that before it ended with its process."""
        path = self._made(task).with_suffix(_TRIED)
        try:
            with path.open("ab") as stream:
                stream.write(b".")
                return stream.tell()
        except OSError as error:
            raise unwritten(path, error) from error

    def _made(self, task: Task) -> Path:
        """Return the file of a record, its folder made if necessary."""
        path = self.path(task)
        try:
            path.parent.mkdir(exist_ok=True)
        except OSError as error:
            raise unwritten(path.parent, error) from error
        return path

    def read(self, task: Task) -> dict[str, Any] | None:
        """Return the row of a record; None if there is none, or its file is not whole or of another run."""
        path = self.path(task)
        if not path.is_file():
            return None
        with suppress(FileFormatError):
            row = read_json(path)
            if [row.get(name) for name in ("format", "digest", PLACE)] == [_ROW, self.digest, task.within]:
                return row
        return None

    def discard(self, task: Task) -> None:
        """Remove the row of a record."""
        self.path(task).unlink(missing_ok=True)

    def remove(self) -> None:
        """Remove the folder, once the table holds its rows."""
        for path in self.folder.glob("*/"):
            shutil.rmtree(path, ignore_errors=True)
        # Marker and lock last: a run that is killed before has left a folder to resume.
        shutil.rmtree(self.folder, ignore_errors=True)
