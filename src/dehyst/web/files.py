"""The modules and styles that pages share: for a server one by one, for a page without a server as one script."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

from dehyst.exports import shipped

# The compensator in WebAssembly comes with each export.
COMPENSATOR = "dehyst.js"
_FOLDER = Path(__file__).parent
_IMPORT = re.compile(r'^import .*? from "\./([\w.]+)";\n', re.MULTILINE)
_EXPORT = re.compile(r"^export ", re.MULTILINE)


def names() -> list[str]:
    """Return the names of all modules and styles."""
    return sorted([one.name for one in _FOLDER.iterdir() if one.suffix in {".js", ".css"}] + [COMPENSATOR])


@cache
def text(name: str) -> str:
    """Return a module or a style."""
    return shipped("compensator.js") if name == COMPENSATOR else (_FOLDER / name).read_text(encoding="utf-8")


def script(*sources: str) -> str:
    """Return the text of modules and of all that they import as one script, without imports and exports.

    A source is the name of a module of this folder, or the text of another one. Names at the top of modules differ.
    """
    found: dict[str, str] = {}

    def add(source: str) -> None:
        if source in found:
            return
        module = text(source) if source.endswith(".js") else source
        for name in _IMPORT.findall(module):
            add(name)
        found[source] = _EXPORT.sub("", _IMPORT.sub("", module))

    for one in sources:
        add(one)
    return "\n".join(found.values())
