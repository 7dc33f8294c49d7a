"""The kinds of export: a table with one row for each suffix, from which `dehyst export` chooses."""

from __future__ import annotations

import errno
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from dehyst.control import Compensator
from dehyst.exports.firmware import export
from dehyst.exports.fmu import SourceOnlyWarning, export_fmu
from dehyst.exports.golden_trace import Loop
from dehyst.exports.wasm import export_wasm, wasm_files

# The disk is full or broken.
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)


class Written(NamedTuple):
    """Result of an export: `values` for JSON, a `line` about it, a `table` of lines below it, and `remarks`."""

    values: dict[str, Any]
    line: str
    table: Sequence[str] = ()
    remarks: Sequence[str] = ()


class Target(NamedTuple):
    """A kind of export.

    `words`: its name in messages. `write`: function that writes a compensator to a path with a dictionary of options.
    `options`: those options of the command that not all kinds have. `files`: function that returns all files of a path;
    None for a folder whose export checks its files itself.
    """

    words: str
    write: Callable[[Any, Path, Mapping[str, Any]], Written]
    options: tuple[str, ...] = ()
    files: Callable[[Path], list[Path]] | None = lambda path: [path]


def _write_c(loop: Loop, path: Path, options: Mapping[str, Any]) -> Written:
    number, measured = options["number"], options["measure"]
    made = export(loop, path, number, force=options["force"], measure=measured, name=options["name"])
    remarks = []
    if measured and made.unmeasured is not None:
        remarks.append(f"bytes and errors were not measured on this computer: {made.unmeasured}")
    table = [f"{'bytes':<40}{'flash':>8}{'RAM':>8}{'stack':>8}"] if made.footprints else []
    for name, size in made.footprints.items():
        table.append(f"{name:<40}{size.flash:>8}{size.ram:>8}{'-' if size.stack is None else size.stack:>8}")
    if made.error is not None:
        table.append(f"floats: errors up to {made.error:.1e} of the range")
    values = {
        "directory": str(path),
        "number": number,
        "bytes": {name: size._asdict() for name, size in made.footprints.items()},
        "error_of_range": made.error,
        "unmeasured": made.unmeasured,
    }
    of_axes = "" if isinstance(loop, Compensator) else f" of the axes {', '.join(loop.stage.axes)},"
    return Written(values, f"{path}: a compensator{of_axes} of {number}s", table, remarks)


def _write_wasm(loop: Loop, path: Path, options: Mapping[str, Any]) -> Written:
    export_wasm(loop, path)  # type: ignore[arg-type]
    _, script, types = wasm_files(path)
    size = path.stat().st_size
    values = {"wasm": str(path), "script": str(script), "types": str(types), "bytes": size}
    line = f"{path}: a compensator in WebAssembly, {size} bytes; {script} calls it, {types} has its types"
    return Written(values, line)


def _write_fmu(loop: Loop, path: Path, options: Mapping[str, Any]) -> Written:
    kind = options["kind"] or "compensator"
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", SourceOnlyWarning)
        export_fmu(loop, path, kind)  # type: ignore[arg-type]
    remarks = [str(warning.message) for warning in caught if issubclass(warning.category, SourceOnlyWarning)]
    content = "sources" if remarks else "sources and a binary for Linux x86-64"
    values = {"fmu": str(path), "kind": kind, "binary": not remarks}
    return Written(values, f"{path}: an FMU of the {kind}, {content}", (), remarks)


# By suffix; a path without one is a folder of C, as is any with a suffix that is not here.
TARGETS = {
    "": Target("C for one axis", _write_c, ("preview", "number", "name", "measure"), None),
    ".wasm": Target("WebAssembly", _write_wasm, ("preview",), wasm_files),
    ".fmu": Target("an FMU", _write_fmu, ("preview", "kind")),
}
