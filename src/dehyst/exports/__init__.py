"""Exports: a compensator or a model as C source, as WebAssembly, or as an FMU."""

from dehyst.exports.fmu import SourceOnlyWarning
from dehyst.exports.naming import shipped
from dehyst.exports.targets import export
from dehyst.exports.wasm import wasm_module

__all__ = ["export"]
