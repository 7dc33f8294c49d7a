"""Files of the package for exports; names in an export, which let several models fit into one firmware."""

from __future__ import annotations

import re
import sys
from pathlib import Path

from dehyst._errors import FileFormatError, ModelError

DEFAULT = "piezo"
# Files with symbols of the model; the core is the same for all models.
_RENAMED = ("piezo.c", "piezo.h", "check.c")
_CODE_WORD = re.compile(r"(?<![\w.])(?<!->)[A-Za-z_]\w*")
_NOT_CODE = re.compile(r'/\*.*?\*/|"(?:\\.|[^"\\])*"', re.DOTALL)
_NAME, _MOST = re.compile(r"[A-Za-z]\w*", re.ASCII), 40
_KEYWORDS = (
    "alignas alignof and and_eq asm auto bitand bitor bool break case catch char class compl concept const consteval "
    "constexpr constinit const_cast continue co_await co_return co_yield decltype default delete do double "
    "dynamic_cast else enum explicit export extern false float for friend goto if inline int long mutable namespace "
    "new noexcept not not_eq nullptr operator or or_eq private protected public register reinterpret_cast requires "
    "restrict return short signed sizeof static static_assert static_cast struct switch template this thread_local "
    "throw true try typedef typeid typename union unsigned using virtual void volatile wchar_t while xor xor_eq "
    "fortran typeof"
)
# Names of headers, and of other files of an export.
_HEADERS = (
    "assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal stdarg stdbool stddef "
    "stdint stdio stdlib string tgmath time wchar wctype check trace license makefile readme misra worst"
)


def demand_name(name: object) -> None:
    """Raise an error for a name that cannot be the name of a C type in an export.

    Raises
    ------
    ModelError
    """
    if not isinstance(name, str) or len(name) > _MOST or not _NAME.fullmatch(name):
        raise ModelError(
            argument="name",
            got=repr(name),
            need=f"a name in C: a letter, then letters, digits and underscores, {_MOST} at most",
        )
    lower = name.lower()
    # Identifiers of the files with symbols of the model, without members of structures.
    words = {word for file in _RENAMED for word in _CODE_WORD.findall(_NOT_CODE.sub(" ", shipped(file)))}
    taken = lower in f"{_KEYWORDS} {_HEADERS}".split() or (name != DEFAULT and name in words)
    if taken or lower.startswith(("dehyst", "trace_")):
        raise ModelError(
            f"got {name!r}, which already has a meaning in C or in the exported files",
            argument="name",
            hint="give another",
        )


def text_of(text: str, name: str) -> str:
    """Rename symbols, macros and files in a template, where `piezo` and PIEZO occur in such names only."""
    return text.replace("PIEZO", name.upper()).replace("piezo", name)


def printable(name: str) -> str:
    """Return the name of a model for a line of text, without characters that XML or a terminal cannot show."""
    return "".join(letter if letter.isprintable() else " " for letter in name).strip() or "actuator"


def shipped(name: str) -> str:
    """Return a text file that comes with the package."""
    return shipped_bytes(name).decode("utf-8")


def shipped_bytes(name: str) -> bytes:
    """Return a file of the package; in a checkout, headers of the core are in the folder of the core."""
    roots = [Path(root) for root in sys.modules["dehyst"].__path__]
    folders = [root / "exports" / "templates" for root in roots]
    for folder in [*(root.parents[1] / "core" / "include" for root in roots), *folders]:
        if (folder / name).is_file():
            return (folder / name).read_bytes()
    raise FileFormatError(f"exports/templates/{name}: not found in the package; install dehyst again")
