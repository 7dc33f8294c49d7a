"""Writing a file completely or not at all: first a draft in its folder, then, once on the disk, renamed."""

from __future__ import annotations

import errno
import os
import re
import secrets
import stat
from contextlib import suppress
from pathlib import Path
from typing import TypeAlias

from dehyst._errors import FileFormatError

PathLike: TypeAlias = str | os.PathLike[str]

# Short and of one length, so that the draft of every valid file name has a valid name.
_DRAFT = re.compile(r"\.dehyst-[0-9a-f]{8}\.tmp")
# Errors of file systems that cannot sync.
_NO_SYNC = (errno.EINVAL, errno.ENOTSUP, errno.ENOSYS)


def draft_of(target: Path) -> Path:
    """Return a new hidden name beside the target for an incomplete file; one left by a killed process does no harm."""
    return target.with_name(f".dehyst-{secrets.token_hex(4)}.tmp")


def is_draft(name: str) -> bool:
    """Return whether a file or folder of this name is a draft."""
    return _DRAFT.fullmatch(name) is not None


def unwritten(path: PathLike, error: OSError) -> FileFormatError:
    """Return the error for a file or a folder that cannot be written, with advice that fits."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        advice = "make room there, or name a place that has some"
    elif error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
        advice = "check the folder's rights"
    elif error.errno == errno.ENAMETOOLONG:
        advice = "give a shorter name"
    else:
        advice = "check the name, and the folder's room and rights"
    return FileFormatError(f"{path}: cannot be written ({error.strerror}); {advice}")


def write_atomically(path: PathLike, data: str | bytes) -> None:
    """Write a file completely or not at all: first a draft in its folder, then, once on the disk, renamed.

    Text is written as UTF-8, a lone surrogate as an escape. An existing file is replaced, whoever wrote it, and keeps
    its mode; commands check it before (`dehyst._io.marks`).

    Raises
    ------
    FileFormatError
        The folder is missing or not writable, or the path is a folder.
    """
    content = data.encode(errors="backslashreplace") if isinstance(data, str) else data
    try:
        mode = mode_of(path)
        if mode is not None and stat.S_ISDIR(mode):
            raise FileFormatError(f"{path}: this is a folder; add a file name")
        # A device such as /dev/null, or a pipe, is written to, never replaced.
        if mode is not None and not stat.S_ISREG(mode):
            Path(path).write_bytes(content)
            return
        # A link keeps pointing at its file.
        target = Path(os.path.realpath(path))
        if not target.parent.is_dir():
            raise FileFormatError(f"{path}: the folder {Path(path).parent} does not exist; create it first")
        _replace(target, content, mode)
    except OSError as error:
        raise unwritten(path, error) from error


def mode_of(path: PathLike) -> int | None:
    """Return type and mode of what lies at a path; None if there is nothing."""
    try:
        return Path(path).stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return None


def _replace(target: Path, content: bytes, mode: int | None) -> None:
    draft = draft_of(target)
    try:
        _write_through(draft, content, mode)
        draft.replace(target)
    finally:
        draft.unlink(missing_ok=True)
    settle_folder(target.parent)


def _write_through(draft: Path, content: bytes, mode: int | None) -> None:
    with draft.open("xb") as stream:
        if mode is not None:
            # Not every file system has modes.
            with suppress(OSError):
                draft.chmod(stat.S_IMODE(mode))
        stream.write(content)
        stream.flush()
        settle(stream.fileno())


def settle(descriptor: int) -> None:
    """Wait until an open file is on the disk, if the file system can sync; raise OSError on failure."""
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in _NO_SYNC:
            raise


def settle_file(path: Path) -> None:
    """Wait until a file that another process may have written, and its name, are on the disk.

    Raises
    ------
    FileFormatError
    """
    try:
        descriptor = os.open(path, os.O_RDWR)
        try:
            settle(descriptor)
        finally:
            os.close(descriptor)
    except OSError as error:
        raise unwritten(path, error) from error
    settle_folder(path.parent)


def settle_folder(folder: Path) -> None:
    """Wait until the names in a folder are on the disk, if the system can sync folders."""
    # Windows opens no folders, and some file systems cannot sync them.
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def path_of(value: object) -> Path:
    """Return a path; raise FileFormatError for anything else."""
    if not isinstance(value, str | os.PathLike) or not isinstance(name := os.fspath(value), str) or "\0" in name:
        raise FileFormatError(f"got {value!r}, need the name of a file or a folder; give a path")
    return Path(name)
