"""`dehyst export` of a stage: the compensator of all axes as C."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dehyst.cli.axes.compensate import starts_of
from dehyst.cli.axes.inputs import bounds_of
from dehyst.cli.common import conclude

if TYPE_CHECKING:
    from dehyst.exports import Footprint


def export_axes(
    model: Path,
    directory: Path,
    start: str | Path,
    bounds: dict[str, Any],
    *,
    name: str | None,
    measure: bool,
    force: bool,
    as_json: bool,
) -> None:
    """Write the compensator of a stage as C, print what it takes, and exit."""
    from dehyst.stages import Stage, StageCompensator, export_stage

    stage = Stage.load(model)
    limits, slew = bounds_of(stage.axes, bounds)
    states, remarks = starts_of(stage, start, limits)
    compensator = StageCompensator(stage, period=bounds["period"], limits=limits, slew_rate=slew, states=states)
    named = {} if name is None else {"name": name}
    exported = export_stage(compensator, directory, force=force, measure=measure, **named)
    if measure and exported.unmeasured is not None:
        remarks.append(f"bytes were not measured on this computer: {exported.unmeasured}")
    result = {
        "directory": str(directory),
        "axes": list(stage.axes),
        "begins_V": compensator.voltage.tolist(),
        "bytes": {processor: size._asdict() for processor, size in exported.footprints.items()},
        "unmeasured": exported.unmeasured,
        "warnings": remarks,
    }
    begins = ", ".join(f"{axis} {v:.6g} V" for axis, v in zip(stage.axes, compensator.voltage.tolist(), strict=True))
    lines = [
        f"{directory}: a compensator of the axes {', '.join(stage.axes)}, of doubles",
        f"memory begins at {begins}; the README says how to bring each actuator there",
        *footprint_rows(exported.footprints),
    ]
    conclude(as_json, result, lines, remarks)


def footprint_rows(footprints: Mapping[str, Footprint]) -> list[str]:
    """Return a table of bytes by processor."""
    rows = [f"{'bytes':<40}{'flash':>8}{'RAM':>8}{'stack':>8}"] if footprints else []
    return rows + [
        f"{name:<40}{size.flash:>8}{size.ram:>8}{'-' if size.stack is None else size.stack:>8}"
        for name, size in footprints.items()
    ]
