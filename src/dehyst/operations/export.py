"""`export`: a model as C for a microcontroller, as WebAssembly, or as an FMU."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Annotated, Any, Literal

from dehyst.control import Compensator, PossibleStart, StageCompensator
from dehyst.control.planning.start import model_error
from dehyst.exports import Exported, SourceOnlyWarning, export_fmu, export_wasm
from dehyst.exports import export as export_c
from dehyst.exports.model_header import ExportedStart
from dehyst.exports.wasm import wasm_files
from dehyst.model import Actuator
from dehyst.operations.axes import AxesModel, Limit, Slew, is_stage, limits_of, rates_of
from dehyst.operations.declaration import Folder, Input, Only, OperationError, Values, operation
from dehyst.operations.files import AS_FOUND
from dehyst.operations.run import Result, Run, demand_outputs
from dehyst.operations.start import Start, start_words, starts_of

# Limits that no voltage reaches.
_UNLIMITED = -1e300, 1e300
# Share of the limits' range by which a start may lie outside without a warning.
_NEAR = 0.01
_TOP = Start("top")


def _target(given: Values) -> str:
    """Return what is written: "C", "C of axes", "WebAssembly", "FMU" or "FMU of the actuator"."""
    if is_stage(given["model"]):
        return "C of axes"
    if given["directory"].suffix == ".fmu":
        return "FMU of the actuator" if given.get("kind") == "actuator" else "FMU"
    return "WebAssembly" if given["directory"].suffix == ".wasm" else "C"


def _on(*targets: str) -> Only:
    return Only(lambda given: _target(given) in targets, f"on another target than {', '.join(targets)}")


_LOOP = ("C", "C of axes", "WebAssembly", "FMU")
_of_loop, _of_c, _of_fmu = _on(*_LOOP), _on("C", "C of axes"), _on("FMU", "FMU of the actuator")


@operation(Compensator)
def export(
    run: Run,
    model: Input,
    directory: Folder,
    *,
    number: Annotated[Literal["double", "float"], _on("C")] = "double",
    limits: Annotated[tuple[Limit, ...], _of_loop] = (),
    slew_rate: Annotated[tuple[Slew, ...], _of_loop] = (),
    period: float | None = None,
    preview: Annotated[bool, _on("C", "WebAssembly", "FMU")] = False,
    name: Annotated[str | None, _of_c] = None,
    measure: Annotated[bool, _of_c] = True,
    fmu: Annotated[Literal["2.0", "3.0"], _of_fmu] = "3.0",
    kind: Annotated[Literal["compensator", "actuator"], _of_fmu] = "compensator",
    start: Start = _TOP,
) -> Result:
    """Write a MODEL's compensator as C into a DIRECTORY: files, numbers, a README, and a trace for `make check`.

    A model of several axes is written as C only, with all its axes and their coupling.

    To a name that ends in .fmu, write it or its actuator as an FMU for co-simulation. To one that ends in .wasm, write
    it as WebAssembly, and the JavaScript module that calls it.

    Parameters
    ----------
    number
        double: the same bits as Python. float: for a processor without doubles.
    limits
        Voltages allowed [V], of all axes or of one; default: those of the records.
    slew_rate
        Largest slew rate [V/s]; needs --period.
    period
        Seconds between steps; a model that depends on time needs it.
    preview
        Compensate delay and inertia too; displacements are then given ahead.
    name
        Name of files, type and calls, so that several models fit into one firmware; default: piezo.
    measure
        Compile it and report its size and the error of floats; takes seconds.
    fmu
        Version of FMI.
    kind
        Of an FMU: displacement to voltage, or the virtual actuator.
    start
        State in which memory begins, as in compensate.
    """
    target = _target({"model": model, "directory": directory, "kind": kind})
    if target == "C of axes" and directory.suffix in (".fmu", ".wasm"):
        raise OperationError(argument="directory", got=str(directory), need="a folder for several axes")
    if "FMU" in target or target == "WebAssembly":
        demand_outputs([model], wasm_files(directory) if target == "WebAssembly" else [directory])
    known = AxesModel.read(run, model)
    bounds: list[Any] = limits_of(known.axes, limits)
    begins, remarks = starts_of(known, start, bounds, AS_FOUND)
    states = [one for one in begins if one is not None]
    remarks += known.prefixed(map(_open_start, known.actuators, states))
    if target == "FMU of the actuator":
        bounds = [_UNLIMITED]
    slews = rates_of(known.axes, slew_rate)
    options: dict[str, Any] = {"period": period}
    compensator: Compensator | StageCompensator
    if known.stage is not None:
        options |= {"limits": bounds, "slew_rate": slews, "states": [one.state for one in states]}
        compensator = StageCompensator(known.stage, **options)
        loops = compensator.compensators
    else:
        options |= {"state": states[0].state, "preview": preview}
        compensator = Compensator(known.actuators[0], bounds[0], slews[0], **options)
        loops = (compensator,)
    if target in ("C", "WebAssembly", "FMU"):
        remarks += _limit_warnings(loops[0], states[0])
    if isinstance(compensator, StageCompensator) or target == "C":
        fields, lines = _write_c(compensator, directory, number, name, measure, remarks, force=run.force)
    elif target == "WebAssembly":
        fields, lines = _write_wasm(compensator, directory)
    else:
        fields, lines = _write_fmu(compensator, directory, fmu, kind, remarks)
    begin = [ExportedStart.of(loop) for loop in loops]
    begun = [
        {"begins": {"displacement_m": one.displacement, "voltage_V": one.voltage, "way": one.way}} for one in begin
    ]
    words = []
    for one, loop, actuator, state in zip(begin, loops, known.actuators, states, strict=True):
        way = "" if kind == "actuator" else f"; to bring the actuator there, {one.way}"
        words.append([f"memory begins at {one.words} {start_words(actuator, state, loop.state)}{way}"])
    lines = [lines[0], *known.prefixed(words), *lines[1:]]
    return Result({**fields, **known.merged(begun), "warnings": remarks}, lines, warnings=remarks)


def _write_c(
    compensator: Compensator | StageCompensator,
    directory: Path,
    number: Any,
    name: str | None,
    measure: bool,
    remarks: list[str],
    *,
    force: bool,
) -> tuple[dict[str, Any], list[str]]:
    """Write C; return its result as JSON values, and as lines."""
    exported: Exported = export_c(compensator, directory, number, force=force, measure=measure, name=name)
    if measure and exported.unmeasured is not None:
        remarks.append(f"bytes and errors were not measured on this computer: {exported.unmeasured}")
    several = isinstance(compensator, StageCompensator)
    of_axes = f" of the axes {', '.join(compensator.stage.axes)}," if several else ""  # type: ignore[union-attr]
    lines = [f"{directory}: a compensator{of_axes} of {number}s"]
    lines += [f"{'bytes':<40}{'flash':>8}{'RAM':>8}{'stack':>8}"] if exported.footprints else []
    for what, size in exported.footprints.items():
        stack = "-" if size.stack is None else size.stack
        lines.append(f"{what:<40}{size.flash:>8}{size.ram:>8}{stack:>8}")
    if exported.error is not None:
        lines.append(f"floats: errors up to {exported.error:.1e} of the range")
    fields = {
        "directory": str(directory),
        "number": number,
        "bytes": {what: size._asdict() for what, size in exported.footprints.items()},
        "error_of_range": exported.error,
        "unmeasured": exported.unmeasured,
    }
    return fields, lines


def _write_wasm(compensator: Compensator, path: Path) -> tuple[dict[str, Any], list[str]]:
    """Write WebAssembly; return its result as JSON values, and as lines."""
    export_wasm(compensator, path)
    _, script, types = wasm_files(path)
    size = path.stat().st_size
    line = f"{path}: a compensator in WebAssembly, {size} bytes; {script} calls it, {types} has its types"
    return {"wasm": str(path), "script": str(script), "types": str(types), "bytes": size}, [line]


def _write_fmu(
    compensator: Compensator, path: Path, version: Any, kind: Any, remarks: list[str]
) -> tuple[dict[str, Any], list[str]]:
    """Write an FMU; return its result as JSON values, and as lines."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", SourceOnlyWarning)
        export_fmu(compensator, path, version, kind)
    sources = [str(warning.message) for warning in caught if issubclass(warning.category, SourceOnlyWarning)]
    remarks += sources
    content = "sources" if sources else "sources and a binary for Linux x86-64"
    fields = {"fmu": str(path), "version": version, "kind": kind, "binary": not sources}
    return fields, [f"{path}: an FMU {version} of the {kind}, {content}"]


def _open_start(actuator: Actuator, start: PossibleStart) -> list[str]:
    """Warn of a start that the voltages before it leave open by more than the model's error."""
    places = [state.displacement for state in start.states]
    width = max(places) - min(places)
    if width <= model_error(actuator):
        return []
    return [
        f"{start.name}: these voltages leave the displacement at the start open by {1e6 * width:.3g} um: memory begins "
        "in the middle; home the actuator first"
    ]


def _limit_warnings(compensator: Compensator, start: PossibleStart) -> list[str]:
    """Warn of a start state clearly outside the limits."""
    (low, high), present = compensator.limits, compensator.actuator.voltage(start.state)
    if low - _NEAR * (high - low) <= present <= high + _NEAR * (high - low):
        return []
    return [
        f"the start state needs {present:.6g} V, outside the limits {low:.6g} to {high:.6g} V: memory begins at the "
        "nearest limit; choose another state with --start"
    ]
