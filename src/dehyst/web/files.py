"""Modules and styles of pages: single files for a server, or one script for a page without a server."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

from dehyst.exports import shipped

# The compensator in WebAssembly is a file of the exports.
COMPENSATOR = "dehyst.js"
_FOLDER = Path(__file__).parent
_IMPORT = re.compile(r'^import .*? from "\./([\w.]+)";\n', re.MULTILINE)
_EXPORT = re.compile(r"^export ", re.MULTILINE)
_BLANK = re.compile(r"^\s*//.*\n|^\s+", re.MULTILINE)


def names() -> list[str]:
    """Return the names of all modules and styles."""
    return sorted([path.name for path in _FOLDER.iterdir() if path.suffix in {".js", ".css"}] + [COMPENSATOR])


@cache
def text(name: str) -> str:
    """Return a module or a style."""
    return shipped("compensator.js") if name == COMPENSATOR else (_FOLDER / name).read_text(encoding="utf-8")


def script(source: str) -> str:
    """Return a module and all its imports as one script, without statements of import and export.

    Comments and indents are left out. A source is the name of a module in this folder, or the text of another module.
    Top-level names of modules must differ.
    """
    found: dict[str, str] = {}

    def add(source: str) -> None:
        if source in found:
            return
        module = text(source) if source.endswith(".js") else source
        for name in _IMPORT.findall(module):
            add(name)
        found[source] = _BLANK.sub("", _EXPORT.sub("", _IMPORT.sub("", module)))

    add(source)
    return "\n".join(found.values())
