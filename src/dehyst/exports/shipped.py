"""Files that come with the package."""

from __future__ import annotations

import sys
from pathlib import Path

from dehyst._errors import FileFormatError


def shipped(name: str) -> str:
    """Return a text file that comes with the package."""
    return shipped_bytes(name).decode("utf-8")


def shipped_bytes(name: str) -> bytes:
    """Return a file that comes with the package; in a checkout the core's headers are where the core has them."""
    roots = [Path(root) for root in sys.modules["dehyst"].__path__]
    folders = [root / "exports" / "templates" for root in roots]
    for folder in [*(root.parents[1] / "core" / "include" for root in roots), *folders]:
        if (folder / name).is_file():
            return (folder / name).read_bytes()
    raise FileFormatError(f"exports/templates/{name}: not found beside the package; install dehyst again")
