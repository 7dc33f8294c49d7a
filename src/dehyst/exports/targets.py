"""The kinds of export: a table with one row for each suffix, from which `dehyst export` chooses."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from dehyst.control import Compensator
from dehyst.exports.firmware import export
from dehyst.exports.fmu import SourceOnlyWarning, export_fmu
from dehyst.exports.golden_trace import Loop
from dehyst.exports.wasm import export_wasm, wasm_files


class Written(NamedTuple):
    """Result of an export: `values` for JSON, a `line` about it, and `remarks`."""

    values: dict[str, Any]
    line: str
    remarks: Sequence[str] = ()


class Target(NamedTuple):
    """A kind of export.

    `words`: its name in messages. `write`: function that writes a compensator to a path with a dictionary of options.
    `options`: those options of the command that not all kinds have. `files`: function that returns all files of a path;
    None for a folder.
    """

    words: str
    write: Callable[[Any, Path, Mapping[str, Any]], Written]
    options: tuple[str, ...] = ()
    files: Callable[[Path], list[Path]] | None = lambda path: [path]


def _write_c(loop: Loop, path: Path, options: Mapping[str, Any]) -> Written:
    number = options["number"]
    export(loop, path, number, name=options["name"])
    values = {"directory": str(path), "number": number}
    of_axes = "" if isinstance(loop, Compensator) else f" of the axes {', '.join(loop.stage.axes)},"
    return Written(values, f"{path}: a compensator{of_axes} of {number}s")


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
    return Written(values, f"{path}: an FMU of the {kind}, {content}", remarks)


# By suffix; a path without one is a folder of C, as is any with a suffix that is not here.
TARGETS = {
    "": Target("C for one axis", _write_c, ("preview", "number", "name"), None),
    ".wasm": Target("WebAssembly", _write_wasm, ("preview",), wasm_files),
    ".fmu": Target("an FMU", _write_fmu, ("preview", "kind")),
}
