"""The kinds of export: a table with one row for each suffix, from which `dehyst export` chooses."""

from __future__ import annotations

import errno
import json
import os
import shutil
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from dehyst._errors import DehystError, PluginError
from dehyst._io import draft_of, finite, protecting, unwritten, write_atomically
from dehyst._plugins import Registry, plugin_errors
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
    None, for a folder whose export checks its files itself, is dehyst's own: a plug-in must list them. `about`: a
    sentence for the page.
    """

    words: str
    write: Callable[[Any, Path, Mapping[str, Any]], Written]
    options: tuple[str, ...] = ()
    files: Callable[[Path], list[Path]] | None = lambda path: [path]
    about: str = ""


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
    version, kind = options["fmu"], options["kind"] or "compensator"
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", SourceOnlyWarning)
        export_fmu(loop, path, version, kind)  # type: ignore[arg-type]
    remarks = [str(warning.message) for warning in caught if issubclass(warning.category, SourceOnlyWarning)]
    content = "sources" if remarks else "sources and a binary for Linux x86-64"
    values = {"fmu": str(path), "version": version, "kind": kind, "binary": not remarks}
    return Written(values, f"{path}: an FMU {version} of the {kind}, {content}", (), remarks)


def _of_plugin(suffix: str, target: Target) -> Target:
    if not isinstance(target, Target) or target.files is None:
        raise TypeError(f"got {target!r}, need a dehyst.exports.Target with files")
    if not suffix.startswith(".") or "." in suffix[1:] or suffix != suffix.lower():
        raise ValueError(f"got the name {suffix!r}, need a suffix in lower case, such as '.st'")

    listed = target.files

    def files(path: Path) -> list[Path]:
        with plugin_errors(f"{path}"):
            if found := [Path(one) for one in listed(path)]:
                return found
            raise ValueError("files returned no file")

    def write(loop: Loop, path: Path, options: Mapping[str, Any]) -> Written:
        return _write_of_plugin(target._replace(files=files), loop, path, options)

    return target._replace(write=write, files=files)


def _write_of_plugin(target: Target, loop: Loop, path: Path, options: Mapping[str, Any]) -> Written:
    """Let a plug-in write its files into a draft folder, and put them in their places if all are there."""
    folder = draft_of(path)
    try:
        folder.mkdir()
        with plugin_errors(f"{path}"):
            written = _of_draft(target.write(loop, folder / path.name, options), folder)
            pairs = list(zip(target.files(folder / path.name), target.files(path), strict=True))  # type: ignore[misc]
        missing = [str(place) for draft, place in pairs if not draft.is_file()]
        drafts = {draft for draft, _ in pairs}
        more = [one.name for one in folder.rglob("*") if one.is_file() and one not in drafts]
        if missing or more:
            fault = f"did not write {', '.join(missing)}" if missing else f"wrote {', '.join(more)} too"
            raise PluginError(f"{path}: a plug-in {fault}, need the files that it declares; report it to its author")
        # The command has compared them with the files that are there.
        with protecting(force=True):
            for draft, place in pairs:
                write_atomically(place, draft.read_bytes())
    except DehystError as error:
        cause = error.__cause__ if isinstance(error, PluginError) else None
        # An OSError of another file is the plug-in's own.
        if isinstance(cause, OSError) and (cause.errno in _FULL or folder.name in str(cause.filename)):
            raise unwritten(path, cause) from cause
        error.message, error.got, error.hint = (_placed(one, folder) for one in (error.message, error.got, error.hint))
        error.args = (error.text(),)
        raise
    except OSError as error:
        raise unwritten(path, error) from error
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return written


def _placed(text: str, folder: Path, separator: str = os.sep) -> str:
    """Return a text with the names that files in a draft folder will have."""
    return text.replace(f"{folder.name}{separator}", "").replace(f"{separator}{folder.name}", "")


def _of_draft(written: Written, folder: Path) -> Written:
    """Return what a plug-in's `write` returned, with the final names of files; raise TypeError for other types."""
    if not isinstance(written, Written):
        raise TypeError(f"write returned a {type(written).__name__}, need a dehyst.exports.Written")
    texts = (written.line, *written.table, *written.remarks)
    if not isinstance(written.values, Mapping) or not all(isinstance(one, str) for one in texts):
        raise TypeError(f"write returned {str(written)[:100]}, need a dictionary, and text")
    values = _placed(json.dumps(finite(dict(written.values))), folder, json.dumps(os.sep)[1:-1])
    table, remarks = ([_placed(one, folder) for one in lines] for lines in (written.table, written.remarks))
    return Written(json.loads(values), _placed(written.line, folder), table, remarks)


# By suffix; a path without one is a folder of C, as is any with a suffix that is not here.
_OWN = {
    "": Target("C for one axis", _write_c, ("preview", "number", "name", "measure"), None),
    ".wasm": Target("WebAssembly", _write_wasm, ("preview",), wasm_files),
    ".fmu": Target("an FMU", _write_fmu, ("preview", "fmu", "kind")),
}
TARGETS: Registry[Target] = Registry("targets", _OWN, _of_plugin)
