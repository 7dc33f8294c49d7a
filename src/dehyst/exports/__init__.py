"""Exports: a compensator as C source or WebAssembly, an actuator or a compensator as an FMU."""

from dehyst.exports.firmware import export
from dehyst.exports.fmu import SourceOnlyWarning, export_fmu
from dehyst.exports.naming import shipped
from dehyst.exports.wasm import export_wasm, wasm_module

__all__ = [
    "SourceOnlyWarning",
    "export",
    "export_fmu",
    "export_wasm",
    "wasm_module",
]
