"""Marks of files written by dehyst: a marked file may be replaced, any other file only by force.

JSON begins with a format that begins with dehyst, HTML names its generator, SVG its creator, an FMU its generating
tool. CSV has no place for a word that every reader skips: the first number is written with the exponent e0, which does
not change it, and no other program writes one such number before numbers without.
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
_FIRST = re.compile(rb"[^\r\n]*\r?\n-?\d+\.\d+e0(?:[,\t][^\r\n]*)?(?:\r?\n|$)")
_OTHERS = re.compile(rb"[\d.]e0(?![\d])")
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
        return _is_own_fmu(path)
    return bool(_JSON.match(head) or _HTML.match(head) or _SVG.match(head) or _is_own_table(head))


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
