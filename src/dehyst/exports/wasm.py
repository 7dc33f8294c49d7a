"""A compensator for browsers and node: the core in WebAssembly with the numbers of the model inside."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from dehyst._errors import FileFormatError
from dehyst._io import write_atomically
from dehyst._version import __version__
from dehyst.control import Compensator, only_axis
from dehyst.exports.model_header import ExportedStart
from dehyst.exports.naming import shipped, shipped_bytes
from dehyst.model import evaluator_of

_MAGIC = b"\0asm\1\0\0\0"
_WRAPPER = {".js": "compensator.js", ".d.ts": "compensator.d.ts"}


def write_wasm(compensator: Compensator, path: Path) -> None:
    """Write a compensator as WebAssembly, see `dehyst.export`; NAME.js and NAME.d.ts are the same for all models."""
    module, files = wasm_module(compensator), wasm_files(path)
    # The module is written last: if it exists, all files exist.
    for file, template in zip(files[1:], _WRAPPER.values(), strict=True):
        write_atomically(file, shipped(template))
    write_atomically(files[0], module)


def wasm_files(path: Path) -> list[Path]:
    """Return the files that an export to `path` writes, `path` first."""
    return [path, *(path.with_suffix(suffix) for suffix in _WRAPPER)]


def wasm_module(compensator: Compensator) -> bytes:
    """Return an export as WebAssembly; raise `ModelError` if `compensator` is not a Compensator."""
    axis = only_axis(compensator)
    core = shipped_bytes("core.wasm")
    if not core.startswith(_MAGIC):
        raise FileFormatError("exports/templates/core.wasm: not the file of this version; install dehyst again")
    actuator, start = axis.actuator, ExportedStart.of(axis)
    about = {
        "format": "dehyst-wasm",
        "version": __version__,
        "name": actuator.name,
        "limits": list(axis.limits),
        "slewRate": axis.slew_rate,
        "period": axis.period,
        "needsPeriod": evaluator_of(actuator).needs_time or axis.previews,
        "samplesAhead": axis.preview[1],
        "reach": list(replace(axis).reach),
        "start": {"displacement": start.displacement, "voltage": start.voltage, "way": start.way},
    }
    if (thermal := actuator.thermal) is not None:
        about["thermal"] = {"gain": thermal.gain, "offset": thermal.offset, "reference": thermal.reference}
    text = json.dumps(about, ensure_ascii=False, allow_nan=False).encode(errors="backslashreplace")
    # The sections of dehyst come first: they identify the file by its beginning.
    return _MAGIC + _section("dehyst.about", text) + _section("dehyst.model", axis.block()) + core[8:]


def _section(name: str, content: bytes) -> bytes:
    """Return a custom section of a module."""
    body = _length(len(name)) + name.encode() + content
    return b"\0" + _length(len(body)) + body


def _length(value: int) -> bytes:
    """Return a length as WebAssembly writes it, seven bits a byte (LEB128)."""
    low, rest = value & 0x7F, value >> 7
    return bytes([low]) if not rest else bytes([low | 0x80]) + _length(rest)
