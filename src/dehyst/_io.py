"""Files and folders: strict reading, and writing that is complete or absent, by a draft that is then renamed."""

from __future__ import annotations

import errno
import io
import json
import os
import re
import secrets
import stat
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from math import isfinite
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import DehystError, FileFormatError
from dehyst._version import __version__

PathLike: TypeAlias = str | os.PathLike[str]
# Names of drafts are short, so that a draft of any valid file name has a valid name.
_DRAFT = re.compile(r"\.dehyst-[0-9a-f]{8}\.tmp")
# Errors of file systems without sync.
_NO_SYNC = (errno.EINVAL, errno.ENOTSUP, errno.ENOSYS)

GENERATOR = f"dehyst {__version__}"
# Column of the displacement of a model; measured tables do not have it.
COMPUTED = "expected_um"
# Every format of dehyst has this version.
VERSION = 1
OTHER_VERSION = "write it again with this version of dehyst, or read it with the version that wrote it"
_HEAD = 4096
_FORMAT = re.compile(rb'(?:\xef\xbb\xbf)?\s*\{\s*"format"\s*:\s*"([a-z-]+)"|# (dehyst-scan): ')
# Types of data that are not names of files.
_ARRAYS = ("DataFrame", "ndarray")
# Most bytes of a JSON file. A model has hundreds of numbers, a calibration tens of thousands.
_MOST_JSON = 100_000_000


def draft_of(target: Path) -> Path:
    """Return a new hidden name for a draft beside the target; the draft of a killed process does no harm."""
    return target.with_name(f".dehyst-{secrets.token_hex(4)}.tmp")


def is_draft(name: str) -> bool:
    """Return whether a file or folder of this name is a draft."""
    return _DRAFT.fullmatch(name) is not None


def unwritten(path: PathLike, error: OSError) -> FileFormatError:
    """Return the error for a file or a folder that cannot be written, with advice for its cause."""
    advice = {
        **dict.fromkeys((errno.ENOSPC, errno.EDQUOT, errno.EFBIG), "make room there, or name a place that has some"),
        **dict.fromkeys((errno.EACCES, errno.EPERM, errno.EROFS), "check the permissions of the folder"),
        errno.ENAMETOOLONG: "give a shorter name",
    }.get(error.errno or 0, "check the name, and the room and the permissions of the folder")
    return FileFormatError(f"{path}: cannot be written ({error.strerror}); {advice}")


def write_atomically(path: PathLike, data: str | bytes | Iterable[str]) -> None:
    """Write a file completely or not at all: a draft in its folder is renamed when it is on the disk.

    Text, as a whole or in blocks, is written as UTF-8, and a lone surrogate as an escape. An existing file is replaced
    and keeps its mode. Raise `FileFormatError` if the folder is missing or not writable, or the path is no file.
    """
    blocks = [data] if isinstance(data, str | bytes) else data
    content = (block.encode(errors="backslashreplace") if isinstance(block, str) else block for block in blocks)
    try:
        mode = _mode_of(path)
        if mode is not None and stat.S_ISDIR(mode):
            raise FileFormatError(f"{path}: this is a folder; add a file name")
        if mode is not None and stat.S_ISBLK(mode):
            raise FileFormatError(f"{path}: is a disk; give the name of a file")
        # A device such as /dev/null, or a pipe, is never replaced.
        if mode is not None and not stat.S_ISREG(mode):
            with Path(path).open("wb") as stream:
                stream.writelines(content)
            return
        # Replace the file behind a link, not the link.
        target = Path(os.path.realpath(path))
        if not target.parent.is_dir():
            raise FileFormatError(f"{path}: the folder {Path(path).parent} does not exist; create it first")
        draft = draft_of(target)
        try:
            with draft.open("xb") as stream:
                if mode is not None:
                    # Some file systems have no modes.
                    with suppress(OSError):
                        draft.chmod(stat.S_IMODE(mode))
                stream.writelines(content)
                stream.flush()
                settle(stream.fileno())
            draft.replace(target)
        finally:
            draft.unlink(missing_ok=True)
        settle_folder(target.parent)
    except OSError as error:
        raise unwritten(path, error) from error


def _mode_of(path: PathLike) -> int | None:
    """Return the type and mode of the file at a path; None if there is no file."""
    try:
        return Path(path).stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return None


def settle(descriptor: int) -> None:
    """Wait until an open file is on the disk, if the file system can sync; raise OSError on failure."""
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in _NO_SYNC:
            raise


def settle_folder(folder: Path) -> None:
    """Wait until the names in a folder are on the disk, if the system can sync folders."""
    # Windows cannot open folders, and some file systems cannot sync them.
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def path_of(value: object, what: str = "path") -> Path:
    """Return the name of a file or a folder as a path; raise FileFormatError for anything else."""
    name = os.fspath(value) if isinstance(value, str | os.PathLike) else None
    if isinstance(name, str) and "\0" not in name:
        return Path(name)
    kind, need = type(value).__name__, "the name of a file or a folder"
    if kind in _ARRAYS:
        hint = "make a record of its columns with dehyst.Record.from_arrays"
        raise FileFormatError(argument=what, got=kind, need=need, hint=hint)
    raise FileFormatError(argument=what, got=repr(value), need=f"{need}, as 'loops.csv' or a pathlib.Path")


def format_of(path: PathLike) -> str | None:
    """Return the "format" at the beginning of a JSON file or of the path of a scan; None for any other file."""
    try:
        if not Path(path).is_file():
            return None
        with Path(path).open("rb") as stream:
            match = _FORMAT.match(stream.read(_HEAD))
    except OSError:
        return None
    return (match[1] or match[2]).decode() if match else None


def demand_own_folder(folder: PathLike, marker: str, kind: str, *, force: bool | None = None) -> None:
    """Raise `FileFormatError` unless a folder is new, empty, or of an earlier run.

    Such a folder has the file `marker`, JSON of the format `kind`. `force`: any files are allowed; None: no --force.
    """
    try:
        held = sorted(path.name for path in Path(folder).iterdir() if not is_draft(path.name))
    except FileNotFoundError:
        return
    except NotADirectoryError as error:
        raise FileFormatError(f"{folder}: cannot be made a folder (it is a file); give another name") from error
    except OSError as error:
        raise unwritten(folder, error) from error
    if held and not force and format_of(Path(folder) / marker) != kind:
        named = f"{', '.join(held[:3])}{' ...' if len(held) > 3 else ''}"
        more = "" if force is None else ", or --force to write into it, and to replace files of the same name"
        raise FileFormatError(f"{folder}: holds other files ({named}); give the name of a new or an empty folder{more}")


def made_folder(folder: PathLike) -> Path:
    """Return a folder, made if necessary; raise FileFormatError if it cannot be made."""
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
    except FileExistsError as error:
        raise FileFormatError(f"{folder}: is a file where a folder is needed; give another name, or move it") from error
    except OSError as error:
        raise unwritten(folder, error) from error
    return Path(folder)


@contextmanager
def reading(path: Path, kind: str, most: float) -> Iterator[BinaryIO]:
    """Open a file of at most `most` bytes; raise FileFormatError for any error while it is read."""
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            raise FileFormatError(f"{path}: this is a folder; give one of the files in it")
        if not stat.S_ISREG(status.st_mode):
            raise FileFormatError(f"{path}: is a device, a pipe or a socket; give the name of a file")
        if not status.st_size:
            raise FileFormatError(f"{path}: the file is empty; write or export it again")
        if status.st_size > most:
            size, need = f"{status.st_size / 1e6:.4g} MB", f"{most / 1e6:g} MB at most"
            raise FileFormatError(f"{path}: has {size}, need {need}; check the name, or save fewer rows")
        with path.open("rb") as stream:
            yield stream
    except DehystError:
        raise
    except FileNotFoundError as error:
        raise FileFormatError(f"{path}: no such file; check the name and the folder") from error
    except PermissionError as error:
        raise FileFormatError(f"{path}: no permission to read it; check the file's mode") from error
    except Exception as error:  # Each library has its own errors for broken content.
        got, need = f"{str(error)[:300] or 'other content'!r} from its reader", f"a complete {kind} file"
        hint = "correct the suffix, or save the file again"
        raise FileFormatError(f"{path}: cannot be read", got=got, need=need, hint=hint) from error


def read_json(path: PathLike) -> dict[str, Any]:
    """Read a JSON object strictly: exactly what `write_json` wrote, without guesses.

    Raise `FileFormatError` if it cannot be read, has more than 100 MB, is not UTF-8 or not valid JSON, is no object, or
    has a repeated key, NaN, Infinity, or a number too large for a float.
    """
    path = path_of(path)

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        keys = [key for key, _ in pairs]
        if len(set(keys)) < len(keys):
            twice = next(key for i, key in enumerate(keys) if key in keys[:i])
            raise FileFormatError(f"{path}: an object has the key '{twice}' twice; remove one of the two")
        return dict(pairs)

    def number(digits: str) -> float | int:
        if not isfinite(float(digits)):
            short = digits if len(digits) <= 30 else f"{digits[:30]}..."
            raise FileFormatError(f"{path}: the number {short} is too large for a float; correct it")
        return float(digits) if set(digits) & set(".eE") else int(digits)

    def constant(word: str) -> float:
        raise FileFormatError(f"{path}: holds {word}, but every number must be finite; correct it")

    with reading(path, "JSON", _MOST_JSON) as stream:
        try:
            text = stream.read().decode("utf-8-sig")
            data = json.loads(
                text, object_pairs_hook=unique, parse_float=number, parse_int=number, parse_constant=constant
            )
        except UnicodeDecodeError as error:
            raise FileFormatError(f"{path}: byte {error.start} is not UTF-8; save the file as UTF-8 text") from error
        except json.JSONDecodeError as error:
            if error.pos == 0 and any(mark in text.partition("\n")[0] for mark in ",;\t"):
                raise FileFormatError(
                    f"{path}: is a table of a record or a path; need a JSON file, such as a model"
                ) from error
            raise FileFormatError(
                f"{path}: line {error.lineno}, column {error.colno}: no valid JSON ({error.msg}); correct it there, or "
                "write the file again if it was cut off"
            ) from error
    if not isinstance(data, dict):
        raise FileFormatError(f"{path}: holds a JSON {type(data).__name__}, but an object {{...}} is needed")
    return data


def demand_version(data: Mapping[str, Any], what: str) -> None:
    """Raise FileFormatError if a file of dehyst states another version than `VERSION`; `what`: the file."""
    found = data.get("version", VERSION)
    if type(found) is not int or found != VERSION:
        raise FileFormatError(what, got=f"version {found!r}", need=f"version {VERSION}", hint=OTHER_VERSION)


def write_json(path: PathLike, data: Mapping[str, Any]) -> None:
    """Write an object as JSON with its keys in the order given; raise FileFormatError for NaN, inf and other types."""
    write_atomically(path, to_json(data, f"{path}:", indent=1) + "\n")


def to_json(data: Mapping[str, Any], what: str, indent: int | None = None) -> str:
    """Return an object as JSON in ASCII, by default on one line; raise FileFormatError for NaN, inf and other types."""
    try:
        return json.dumps(dict(data), indent=indent, allow_nan=False)
    except (TypeError, ValueError, RecursionError) as error:
        raise FileFormatError(
            f"{what} cannot be written as JSON ({error}); use text, finite numbers, booleans, None, lists and dicts"
        ) from error


def finite(value: Any) -> Any:
    """Replace numbers that JSON does not have by None, also in lists and dicts."""
    if isinstance(value, dict):
        return {key: finite(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [finite(entry) for entry in value]
    return None if isinstance(value, float) and not abs(value) <= sys.float_info.max else value


def packed(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Return arrays as the content of an .npz file, in this order and without compression."""
    content, named = io.BytesIO(), dict[str, Any](arrays)
    np.savez(content, **named)
    return content.getvalue()


def lock(descriptor: int) -> None:
    """Lock an open file until it is closed; raise BlockingIOError if another process has locked it.

    On Windows and on file systems without locks, the file is not locked, and no error is raised.
    """
    try:
        import fcntl
    except ImportError:
        return
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError:
        return
