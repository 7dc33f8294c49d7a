"""Whether the samples of a record are still those of its row, so that a resumed run keeps no row of other samples."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from dehyst._errors import DehystError
from dehyst.fleet.dataset import Place, Task
from dehyst.fleet.options import FleetOptions
from dehyst.fleet.reader import Reader, sha256_of

# Column of a shard: the stamp of the place when its record was read.
STAMP = "stamp"


def stamp_of(place: Place) -> str | None:
    """Return sizes and times of change of the files of a place; None if they cannot be seen."""
    path = Path(place.path)
    try:
        if place.kind != "zarr":
            return _stamp(path)
        root = path / place.part
        files = sorted(file for file in root.rglob("*") if file.is_file())
        return digest_of(f"{file.relative_to(root)} {_stamp(file)}" for file in files)
    except OSError:
        return None


def _stamp(path: Path) -> str:
    state = path.stat()
    return f"{state.st_size} {state.st_mtime_ns}"


def digest_of(texts: Iterable[str | None]) -> str:
    """Return the hash of texts."""
    state = hashlib.sha256()
    for text in texts:
        state.update(f"{text}\n".encode(errors="surrogateescape"))
    return state.hexdigest()


def is_current(row: Mapping[str, Any], task: Task, options: FleetOptions, reader: Reader) -> bool:
    """Return whether a row is that of the record as it is now; the record is read only if its files have changed."""
    stamp = stamp_of(task.place)
    if stamp is not None and stamp == row.get(STAMP):
        return True
    if not row.get("sha256"):
        return False
    try:
        return sha256_of(reader.record(task, options)) == str(row["sha256"])
    except DehystError:
        return False
