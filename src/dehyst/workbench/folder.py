"""The folder of a workbench: records, models, voltages, and the script of the commands that made them."""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

from dehyst._errors import FileFormatError
from dehyst._io import (
    demand_own_folder,
    demand_version,
    draft_of,
    is_draft,
    lock,
    made_folder,
    read_json,
    unwritten,
    write_atomically,
    write_json,
)

FORMAT = "dehyst-workbench"
STATE, SCRIPT, LOCK = "workbench.json", "commands.sh", ".lock"
UPLOADS, RECORDS, MODELS, REPORTS = "uploads", "records", "models", "reports"
EXCITATIONS, PATHS, VOLTAGES, EXPORTS = "excitations", "paths", "voltages", "exports"
_PLACES = (EXCITATIONS, UPLOADS, RECORDS, MODELS, REPORTS, PATHS, VOLTAGES, EXPORTS)
_HEADER = """#!/bin/sh
# The commands of this workbench. In a new folder with its uploads/ and paths/ they give the same files.
cd "$(dirname "$0")" || exit
mkdir -p {places}
"""
# Characters that are not allowed in a name of a file, and its largest length.
_OTHERS, _LONGEST = re.compile(r"[^\w.+-]+"), 80
_SUFFIX = re.compile(r"(\.\w{1,9})?")


class Folder:
    """The folder of one workbench, which no other user may read.

    Parameters
    ----------
    path : Path
        New, empty, or of a workbench before.

    Attributes
    ----------
    privacy : str
        A remark on the folder's permissions, or empty.

    Raises
    ------
    FileFormatError
        If it holds other files, cannot be written, or another workbench uses it.
    """

    def __init__(self, path: Path) -> None:
        demand_own_folder(path, STATE, FORMAT)
        self.path = made_folder(path).resolve()
        self.privacy = _made_private(self.path)
        if not (self.path / STATE).exists():
            self.save({})
        self._lock = _locked(self.path)
        for name in _PLACES:
            (self.path / name).mkdir(exist_ok=True)
        self._promised: set[str] = set()
        self._script = self.path / SCRIPT
        if not self._script.exists():
            write_atomically(self._script, _HEADER.format(places=" ".join(_PLACES)))

    def close(self) -> None:
        """Let another workbench use the folder."""
        self._lock.close()

    def save(self, state: Mapping[str, Any]) -> None:
        """Write the state, completely or not at all."""
        write_json(self.path / STATE, {"format": FORMAT, "version": 1, **state})

    def saved(self) -> dict[str, Any]:
        """Return the state of an earlier workbench in the folder."""
        state = read_json(self.path / STATE)
        demand_version(state, f"{self.path / STATE}")
        return state

    def new(self, place: str, name: str, suffix: str = "") -> str:
        """Return a relative path that does not exist yet, from a name without the characters that files may not have.

        Each path is returned only once, even if its file is written much later.
        """
        stem = _OTHERS.sub("-", name).strip("-.")[:_LONGEST] or "unnamed"
        suffix = suffix if _SUFFIX.fullmatch(suffix) else ""
        names = (f"{place}/{stem}{'' if k == 1 else f'-{k}'}{suffix}" for k in range(1, 1_000_000))
        found = next(path for path in names if path not in self._promised and not (self.path / path).exists())
        self._promised.add(found)
        return found

    def inside(self, relative: str) -> Path:
        """Return a file that the page may read; raises FileFormatError for anything else."""
        parts = relative.split("/")
        known = relative == SCRIPT or parts[0] in _PLACES
        if not known or "\\" in relative or "\0" in relative or any(part.startswith(".") or not part for part in parts):
            raise FileFormatError(f"{relative}: is not a file of this workbench; choose a file of its list")
        path = self.path / relative
        # A link may lead elsewhere.
        if not path.resolve().is_relative_to(self.path) or not path.is_file():
            raise FileFormatError(f"{relative}: is not a file of this workbench; choose a file of its list")
        return path

    def files(self) -> Iterator[dict[str, Any]]:
        """Yield each file of the list: path, bytes and kind."""
        # The file may have been deleted in the meantime.
        there = [place for place in _PLACES if (self.path / place).is_dir()]
        for place in (*there, None):
            for path in sorted((self.path / place).iterdir()) if place else [self._script]:
                if not path.name.startswith(".") and not is_draft(path.name) and path.exists():
                    size = path.stat().st_size if path.is_file() else None
                    kind = place.removesuffix("s") if place else "script"
                    yield {"path": path.relative_to(self.path).as_posix(), "bytes": size, "kind": kind}

    def commands(self) -> list[str]:
        """Return the lines of the script after its header."""
        if not self._script.exists():
            return []
        lines = self._script.read_text(encoding="utf-8").split("\n")
        return [line for line in lines[_HEADER.count("\n") :] if line]

    def note(self, words: Sequence[str]) -> None:
        """Append a command to the script."""
        line = shlex.join(words).replace("\n", " ")
        with self._script.open("a", encoding="utf-8") as script:
            script.write(f"{line}\n")

    @contextmanager
    def receive(self, relative: str) -> Iterator[BinaryIO]:
        """Open a file that arrives in parts; if it stays incomplete, it is removed, and its name is free again."""
        path = self.path / relative
        draft = draft_of(path)
        try:
            with draft.open("xb") as stream:
                yield stream
                stream.flush()
                os.fsync(stream.fileno())
            draft.replace(path)
        except OSError as error:
            raise unwritten(path, error) from error
        finally:
            draft.unlink(missing_ok=True)
            self._promised.discard(relative)


def _made_private(folder: Path) -> str:
    """Make a folder private; return a remark if other users can still read it."""
    if os.name == "posix":
        with suppress(OSError):
            folder.chmod(0o700)
        if folder.stat().st_mode & 0o077:
            return f"{folder}: other users of this machine may read it, and this cannot be changed; give another folder"
    return ""


def _locked(folder: Path) -> BinaryIO:
    """Return the open lock of a folder; raises FileFormatError if another process has it."""
    stream = (folder / LOCK).open("ab")
    try:
        lock(stream.fileno())
    except BlockingIOError as error:
        stream.close()
        raise FileFormatError(
            f"{folder}: another workbench uses this folder; open the link that it printed, or give another folder"
        ) from error
    return stream
