"""The shards of a run: one file a record, written atomically, in a folder beside the table."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from dehyst._errors import FileFormatError
from dehyst._io.drafts import write_atomically
from dehyst._io.json_files import finite, read_json, write_json
from dehyst._io.marks import make_own_folder
from dehyst._text import counted
from dehyst.fleet.dataset import Task

MARKER = ("fleet.json", "dehyst-fleet-parts")
_ROW = "dehyst-fleet-row"
# A folder with very many files is slow in many file systems.
_IN_A_FOLDER = 1000


class Shards:
    """The folder of the shards of one run.

    `folder`: its path. `digest`: of dataset and options; shards of another one are none of this run.
    """

    def __init__(self, folder: Path, digest: str) -> None:
        self.folder, self.digest = folder, digest

    @classmethod
    def beside(cls, output: Path, digest: str) -> Shards:
        """Return the shards of a table: in a folder of its name with ".parts"."""
        return cls(output.with_name(f"{output.name}.parts"), digest)

    def prepare(self, count: int, options: Mapping[str, Any], *, resume: bool) -> None:
        """Make the folder; raise `FileFormatError` if it holds shards and they are not to be resumed, or others."""
        marker = self.folder / MARKER[0]
        if marker.exists():
            self._check(read_json(marker), resume)
            return
        make_own_folder(self.folder, *MARKER)
        head = {"format": MARKER[1], "version": 1, "digest": self.digest, "records": count, "options": dict(options)}
        write_json(marker, finite(head))

    def _check(self, head: Mapping[str, Any], resume: bool) -> None:
        if not resume:
            done = sum(1 for _ in self.folder.glob("*/*.json"))
            raise FileFormatError(
                f"{self.folder}: holds {counted(done, 'record')} of a run that did not end; go on with --resume, or "
                "remove the folder"
            )
        if head.get("format") != MARKER[1] or head.get("digest") != self.digest:
            raise FileFormatError(
                f"{self.folder}: is of another dataset, other options or another version; repeat the command of that "
                "run, or remove the folder"
            )

    def path(self, position: int) -> Path:
        """Return the file of a record."""
        return self.folder / f"{position // _IN_A_FOLDER:06d}" / f"{position:09d}.json"

    def write(self, task: Task, row: Mapping[str, Any]) -> None:
        """Write the row of a record, whole or not at all."""
        path = self.path(task.position)
        path.parent.mkdir(exist_ok=True)
        head = {"format": _ROW, "digest": self.digest, "position": task.position}
        write_atomically(path, json.dumps(finite({**head, **row}), allow_nan=False))

    def read(self, task: Task) -> dict[str, Any] | None:
        """Return the row of a record; None if there is none, or its file is not whole or of another run."""
        path = self.path(task.position)
        if not path.is_file():
            return None
        with suppress(FileFormatError):
            row = read_json(path)
            if [row.get(name) for name in ("format", "digest", "position")] == [_ROW, self.digest, task.position]:
                return row
        return None

    def discard(self, task: Task) -> None:
        """Remove the row of a record."""
        self.path(task.position).unlink(missing_ok=True)

    def remove_empty(self) -> None:
        """Remove the folder if it holds no row: it would only stand in the way of the next run."""
        if not any(self.folder.glob("*/*.json")):
            self.remove()

    def remove(self) -> None:
        """Remove the folder, once the table holds its rows."""
        shutil.rmtree(self.folder, ignore_errors=True)
