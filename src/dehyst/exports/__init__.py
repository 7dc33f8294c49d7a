"""Exports: a compensator as C source, an actuator or a compensator as an FMU."""

from dehyst.exports.firmware import Exported, export
from dehyst.exports.fmu import SourceOnlyWarning, export_fmu
from dehyst.exports.footprint import Footprint, sizes
from dehyst.exports.operation_count import worst_case

__all__ = ["Exported", "Footprint", "SourceOnlyWarning", "export", "export_fmu", "sizes", "worst_case"]
