"""The name of an export's own files, symbols and macros, so that several models go into one firmware."""

from __future__ import annotations

import re
from pathlib import Path

from dehyst._errors import ModelError
from dehyst.exports.shipped import shipped

DEFAULT = "piezo"
# Files whose words an export renames; the core is the same for all.
_OWN = ("piezo.c", "piezo.h", "check.c")
_CODE_WORD = re.compile(r"(?<![\w.])(?<!->)[A-Za-z_]\w*")
_NOT_CODE = re.compile(r'/\*.*?\*/|"(?:\\.|[^"\\])*"', re.DOTALL)
_TITLE = re.compile(r"/\* The actuator '.*', made by dehyst ")
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
# Names of files that a compiler would take for another.
_HEADERS = (
    "assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal stdarg stdbool stddef "
    "stdint stdio stdlib string tgmath time wchar wctype check trace license makefile readme"
)


def demand_name(name: object) -> None:
    """Refuse what cannot be the name of a type in C beside the core.

    Raises
    ------
    ModelError
    """
    if not isinstance(name, str) or len(name) > _MOST or not _NAME.fullmatch(name):
        raise ModelError(
            f"name: got {name!r}, need a name in C: a letter, then letters, digits and underscores, {_MOST} at most"
        )
    lower = name.lower()
    if lower.startswith(("dehyst", "trace_", "model_")):
        raise ModelError(f"name: got {name!r}, but such names are of the core and its numbers; give another")
    if lower in f"{_KEYWORDS} {_HEADERS}".split() or (name != DEFAULT and name in _words()):
        raise ModelError(f"name: got {name!r}, which means something else in C or in the exported files; give another")


def file_of(file: str, name: str) -> str:
    """The name of a file of an export: by default piezo.c and piezo.h."""
    return re.sub(r"^piezo\.", f"{name}.", file)


def text_of(text: str, name: str) -> str:
    """A text with its symbols, macros and files of that name."""
    if name == DEFAULT:
        return text
    text = re.sub(r"\bpiezo(?=\b(?! actuator)|_)", name, text)
    return re.sub(r"\bMODEL_", f"{name.upper()}_MODEL_", text.replace("PIEZO_H", f"{name.upper()}_H"))


def printable(name: str) -> str:
    """The name of a model in a line of text, without what no XML and no terminal should see."""
    return "".join(one if one.isprintable() else " " for one in name).strip() or "actuator"


def in_comment(name: str) -> str:
    """The same in a comment of C, where only the marks of comments mean something."""
    return printable(name).replace("*/", "* /").replace("/*", "/ *")


def name_in(folder: Path) -> str | None:
    """The name of the export that a folder holds; None if it holds none."""
    names = [path.stem for path in sorted(folder.glob("*.h")) if _TITLE.match(_first_line(path))]
    return names[0] if len(names) == 1 else None


def _first_line(path: Path) -> str:
    with path.open(encoding="utf-8", errors="replace") as stream:
        return stream.readline()


def _words() -> frozenset[str]:
    """Identifiers of the files that are renamed, members of structures left out."""
    return frozenset(word for file in _OWN for word in _CODE_WORD.findall(_NOT_CODE.sub(" ", shipped(file))))
