"""Errors of reading a file, as one sentence each."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from dehyst._errors import DehystError, FileFormatError


def named(path: object, what: str = "path") -> Path:
    """Return the name of a file as a path; raise FileFormatError if it is none."""
    if isinstance(path, str) or (isinstance(path, os.PathLike) and isinstance(os.fspath(path), str)):
        return Path(path)
    raise FileFormatError(f"{what}: got {path!r}, need the name of a file, as 'loops.csv' or a pathlib.Path")


@contextmanager
def reading_errors(path: Path, kind: str) -> Iterator[None]:
    """Raise FileFormatError for any error while a file of this kind is read."""
    try:
        yield
    except DehystError:
        raise
    except FileNotFoundError as error:
        raise FileFormatError(f"{path}: no such file; check the name and the folder") from error
    except IsADirectoryError as error:
        raise FileFormatError(f"{path}: this is a folder; give one of the files in it") from error
    except PermissionError as error:
        raise FileFormatError(f"{path}: no permission to read it; check the file's mode") from error
    except Exception as error:  # every library has its own errors for broken content
        raise FileFormatError(
            f"{path}: not a readable {kind} file ({type(error).__name__}: {error}); check that the suffix fits"
        ) from error
