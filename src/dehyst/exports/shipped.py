"""Files that come with the package."""

from __future__ import annotations

import sys
from pathlib import Path

from dehyst._errors import FileFormatError


def shipped(name: str) -> str:
    """Return a text file that comes with the package."""
    return shipped_bytes(name).decode("utf-8")


def shipped_bytes(name: str) -> bytes:
    """Return a file that comes with the package; an editable install has the core's in another folder."""
    for root in sys.modules["dehyst"].__path__:
        path = Path(root) / "exports" / "templates" / name
        if path.is_file():
            return path.read_bytes()
    raise FileFormatError(f"exports/templates/{name}: not found beside the package; install dehyst again")
