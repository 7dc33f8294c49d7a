"""JSON files, read strictly and written atomically."""

from __future__ import annotations

import json
import stat
import sys
from collections.abc import Mapping
from math import isfinite
from pathlib import Path
from typing import Any

from dehyst._errors import FileFormatError
from dehyst._io.drafts import PathLike, write_atomically
from dehyst._io.reading import named, reading_errors

# A model has some hundred numbers, a calibration's results some ten thousand.
_MOST_JSON = 100_000_000


def read_json(path: PathLike) -> dict[str, Any]:
    """Read a JSON object strictly: exactly what `write_json` wrote, without guesses.

    Raises
    ------
    FileFormatError
        No name of a file, no such file, a device or a pipe, more than 100 MB, not UTF-8, no valid JSON, no object, a
        key that is there twice in one object, NaN, Infinity, or a number too large for a float.
    """
    path = named(path)

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        keys = [key for key, _ in pairs]
        if len(set(keys)) < len(keys):
            twice = next(key for i, key in enumerate(keys) if key in keys[:i])
            raise FileFormatError(f"{path}: the key '{twice}' is there twice in one object; remove one of the two")
        return dict(pairs)

    def number(digits: str) -> float | int:
        if not isfinite(float(digits)):
            short = digits if len(digits) <= 30 else f"{digits[:30]}..."
            raise FileFormatError(f"{path}: the number {short} is too large for a float; correct it")
        return float(digits) if set(digits) & set(".eE") else int(digits)

    def constant(word: str) -> float:
        raise FileFormatError(f"{path}: holds {word}, but every number must be finite; correct it")

    with reading_errors(path, "JSON"):
        _demand_regular(path, _MOST_JSON)
        try:
            text = path.read_bytes().decode("utf-8-sig")
            data = json.loads(
                text, object_pairs_hook=unique, parse_float=number, parse_int=number, parse_constant=constant
            )
        except UnicodeDecodeError as error:
            raise FileFormatError(f"{path}: byte {error.start} is not UTF-8; save the file as UTF-8 text") from error
        except json.JSONDecodeError as error:
            raise FileFormatError(
                f"{path}: line {error.lineno}, column {error.colno}: no valid JSON ({error.msg}); correct it there, or "
                "write the file again if it was cut off"
            ) from error
    if not isinstance(data, dict):
        raise FileFormatError(f"{path}: holds a JSON {type(data).__name__}, but an object {{...}} is needed")
    return data


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
    """Replace numbers that JSON does not have by None, in lists and dicts too."""
    if isinstance(value, dict):
        return {key: finite(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [finite(entry) for entry in value]
    return None if isinstance(value, float) and not abs(value) <= sys.float_info.max else value


def _demand_regular(path: Path, most: int) -> None:
    """Refuse a device or a pipe before it is opened, and a file of more bytes than `most`."""
    status = path.stat()
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError
    if not stat.S_ISREG(status.st_mode):
        raise FileFormatError(f"{path}: is a device, a pipe or a socket; give the name of a file")
    if status.st_size > most:
        raise FileFormatError(
            f"{path}: has {status.st_size / 1e6:.0f} MB, need {most / 1e6:g} MB at most; check the name"
        )
