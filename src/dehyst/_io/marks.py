"""Marks of files written by dehyst: a marked file may be replaced, any other file only by force.

JSON begins with a format that begins with dehyst, HTML names its generator, SVG its creator, an FMU its generating
tool, a NumPy archive begins with an array of dehyst, WebAssembly with a section of it, its JavaScript with a comment,
the metadata at the end of Parquet have a key of dehyst.
CSV has no place for a word that every reader skips: the first number is written with the exponent e0, which does not
change it, and no other program writes one such number before numbers without.
"""

from __future__ import annotations

import re
import stat
import zlib
from decimal import Decimal
from math import isfinite
from pathlib import Path

from dehyst._errors import FileFormatError
from dehyst._io.drafts import PathLike, is_draft, mode_of, unwritten
from dehyst._version import __version__

GENERATOR = f"dehyst {__version__}"

_HEAD = 16384
_JSON = re.compile(rb'(?:\xef\xbb\xbf)?\s*\{\s*"format"\s*:\s*"(dehyst-[a-z-]+)"')
_HTML = re.compile(rb'<!DOCTYPE html>.{0,2000}?<meta name="generator" content="dehyst [^"]*">', re.DOTALL)
_SVG = re.compile(
    rb"<\?xml[^>]*>\s*<!DOCTYPE svg[^>]*>\s*<svg [^>]*>\s*<metadata>.{0,1000}?<dc:title>dehyst [^<]*</dc:title>",
    re.DOTALL,
)
_WASM = re.compile(rb"\x00asm\x01\x00\x00\x00\x00[\x80-\xff]*[\x00-\x7f]\x0cdehyst\.about")
_SCRIPT = re.compile(rb"// dehyst: ")
_FIRST = re.compile(rb"[^\r\n]*\r?\n-?\d+\.\d+e0(?:[,\t][^\r\n]*)?(?:\r?\n|$)")
_OTHERS = re.compile(rb"[\d.]e0(?![\d])")
# Name of the first array of a NumPy archive of dehyst, and where a ZIP archive has the name of its first file.
ARCHIVE, _ZIP_NAME = "dehyst-output", 30
# A Parquet file begins and ends so; its metadata, with the keys last, are before that end.
_PARQUET, _PARQUET_KEY = b"PAR1", b"dehyst-fleet"
_TOOL = re.compile(rb'generationTool="dehyst [^"]*"')


def marked(cell: str) -> str:
    """Return the first number of a table as only dehyst writes it: all digits, and the exponent e0."""
    number = float(cell)
    if not isfinite(number):
        return cell
    digits = format(Decimal(cell), "f") if "e" in cell else cell
    return f"{digits}e0" if "." in digits else f"{digits}.0e0"


def format_of(path: PathLike) -> str | None:
    """Return the format at the beginning of a JSON file of dehyst; None for any other file."""
    match = _JSON.match(_head(path))
    return match[1].decode() if match else None


def written_by_dehyst(path: PathLike) -> bool:
    """Return whether a command of dehyst wrote this file."""
    head = _head(path)
    if head.startswith(b"PK\3\4"):
        return head[_ZIP_NAME:].startswith(f"{ARCHIVE}.npy".encode()) or _is_own_fmu(path)
    if head.startswith(_PARQUET):
        return _PARQUET_KEY in _tail(path)
    patterns = (_JSON, _HTML, _SVG, _WASM, _SCRIPT)
    return any(pattern.match(head) for pattern in patterns) or _is_own_table(head)


def demand_replaceable(path: PathLike, *, force: bool = False) -> None:
    """Refuse to replace a file that dehyst did not write, unless forced; an empty file may be replaced.

    Raises
    ------
    FileFormatError
    """
    try:
        mode = mode_of(path)
        if mode is None or not stat.S_ISREG(mode) or force:
            if mode is not None and stat.S_ISBLK(mode):
                raise FileFormatError(f"{path}: is a disk; give the name of a file")
            return
        if not Path(path).stat().st_size or written_by_dehyst(path):
            return
    except OSError as error:
        raise unwritten(path, error) from error
    raise FileFormatError(
        f"{path}: is there already, and dehyst did not write it; give another name, or --force to replace it"
    )


def demand_own_folder(folder: PathLike, marker: str, kind: str, *, option: str = "-o") -> None:
    """Refuse a folder that is neither new, nor empty, nor one whose `marker` is JSON of the format `kind`.

    `option` is that of the command by which the folder is given.

    Raises
    ------
    FileFormatError
    """
    try:
        names = sorted(path.name for path in Path(folder).iterdir() if not is_draft(path.name))
    except FileNotFoundError:
        return
    except NotADirectoryError as error:
        raise FileFormatError(
            f"{folder}: cannot be made a folder (it is a file); give another one with {option}"
        ) from error
    except OSError as error:
        raise unwritten(folder, error) from error
    if names and format_of(Path(folder) / marker) != kind:
        more = f" and {len(names) - 3} more" if len(names) > 3 else ""
        raise FileFormatError(
            f"{folder}: holds other files ({', '.join(names[:3])}{more}); give the name of a new or an empty folder "
            f"with {option}"
        )


def make_own_folder(folder: PathLike, marker: str, kind: str, *, option: str = "-o") -> Path:
    """Return a folder that may be written to, created if necessary; raise as `demand_own_folder` does."""
    demand_own_folder(folder, marker, kind, option=option)
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileFormatError(
            f"{folder}: cannot be made a folder ({error.strerror}); give another one with {option}"
        ) from error
    return Path(folder)


def _head(path: PathLike) -> bytes:
    """Return the first bytes of a regular file; none if it cannot be read."""
    try:
        if not Path(path).is_file():
            return b""
        with Path(path).open("rb") as stream:
            return stream.read(_HEAD)
    except OSError:
        return b""


def _tail(path: PathLike) -> bytes:
    """Return the last bytes of a file; none if it cannot be read."""
    try:
        with Path(path).open("rb") as stream:
            stream.seek(max(0, stream.seek(0, 2) - _HEAD))
            return stream.read(_HEAD)
    except OSError:
        return b""


def _is_own_table(head: bytes) -> bool:
    first = _FIRST.match(head)
    return first is not None and len(_OTHERS.findall(head, head.index(b"\n"))) == 1


def _is_own_fmu(path: PathLike) -> bool:
    import zipfile

    try:
        with zipfile.ZipFile(path) as archive, archive.open("modelDescription.xml") as stream:
            return _TOOL.search(stream.read(_HEAD)) is not None
    except (zipfile.BadZipFile, KeyError, OSError, RuntimeError, ValueError, EOFError, zlib.error):
        return False
