"""Builds the core for WebAssembly by Debian's clang and wasm-ld: ``python bindings/wasm/build.py [FILE]``.

The module records the digest of the sources and options of which it was built, in a section of its own.
"""

from __future__ import annotations

import hashlib
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
MODULE = ROOT / "src/dehyst/exports/templates/core.wasm"
SECTION = "dehyst.sources"
# The core's sources in the order of its amalgamation, then the functions that JavaScript calls.
SOURCES = (
    *(f"core/src/{name}.c" for name in ("slip", "graded", "smooth", "step", "compensator", "block")),
    "bindings/wasm/module.c",
)
HEADERS = (
    *(f"core/include/{name}.h" for name in ("dehyst_config", "dehyst", "dehyst_model")),
    "core/src/internal.h",
)
# No fused multiply-add and no library: the bits are Python's. A stack that overflows meets the end of the memory.
OPTIONS = (
    *("--target=wasm32", "-std=c99", "-Os", "-flto", "-ffp-contract=off"),
    *("-ffreestanding", "-fno-builtin", "-nostdlib", "-fvisibility=hidden"),
    *("-Wall", "-Wextra", "-Werror", "-Icore/include", "-Icore/src", "-I."),
    "-Wl,--no-entry,--strip-all,--stack-first,--lto-O3,-z,stack-size=16384",
)


def digest() -> str:
    """Return the digest of all sources and options."""
    found = hashlib.sha256(" ".join(OPTIONS).encode())
    for name in (*HEADERS, *SOURCES):
        found.update(f"\n{name}\n".encode() + (ROOT / name).read_bytes())
    return found.hexdigest()


def recorded(module: bytes) -> str:
    """Return the digest that a module records."""
    return module[-64:].decode("ascii", errors="replace")


def build(path: Path) -> None:
    """Compile and link the module as one unit, and write it with its digest."""
    unit = "".join(f'#include "{name}"\n' for name in SOURCES)
    with tempfile.TemporaryDirectory() as folder:
        linked = Path(folder) / "core.wasm"
        command = ["clang", *OPTIONS, "-x", "c", "-", "-o", str(linked)]
        subprocess.run(command, cwd=ROOT, input=unit, text=True, check=True)
        module = linked.read_bytes()
    name, text = SECTION.encode(), digest().encode()
    body = bytes([len(name)]) + name + text
    path.write_bytes(module + bytes([0, len(body)]) + body)


if __name__ == "__main__":
    build(Path(sys.argv[1]) if len(sys.argv) > 1 else MODULE)
