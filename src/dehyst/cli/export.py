"""`dehyst export`: a model as C for a microcontroller, as WebAssembly, or as an FMU."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dehyst.cli.axes.export import export_axes, footprint_rows
from dehyst.cli.axes.inputs import axis_bounds_options, is_stage, refuse_axis_bounds
from dehyst.cli.common import PATH, conclude, json_option, limits_option, read_model, refuse_overwriting
from dehyst.cli.start import given_start, start_or_top_option, start_words
from dehyst.records.formats.file_content import MOST

if TYPE_CHECKING:
    from dehyst.control import Compensator, PossibleStart
    from dehyst.exports import Exported
    from dehyst.model import Actuator, State


# Limits that no voltage reaches.
_NONE = -1e300, 1e300
# Share of the limits' range by which a start may lie outside without a warning.
_NEAR = 0.01


@click.command()
@click.argument("model", type=PATH)
@click.argument("directory", metavar="DIR|FMU|WASM", type=PATH)
@click.option(
    "--number",
    type=click.Choice(["double", "float"]),
    default="double",
    show_default=True,
    help="double: the same bits as Python. float: for a processor without doubles.",
)
@limits_option()
@click.option("--slew", type=float, metavar="V/S", help="Largest slew rate; needs --period.")
@axis_bounds_options
@click.option("--period", type=float, metavar="S", help="Seconds between steps; a model that depends on time needs it.")
@click.option("--preview", is_flag=True, help="Compensate delay and inertia too; displacements are then given ahead.")
@click.option(
    "--name",
    metavar="NAME",
    help="Name of files, type and calls, so that several models fit into one firmware.  [default: piezo]",
)
@click.option(
    "--measure/--no-measure",
    default=True,
    help="Compile it and report its size and the error of floats; takes seconds.  [default: measure]",
)
@click.option("--force", is_flag=True, help="Replace an earlier export or, for a file, one that dehyst did not write.")
@click.option(
    "--fmu",
    type=click.Choice(["2.0", "3.0"]),
    is_flag=False,
    flag_value="3.0",
    help="Write an FMU of this version of FMI instead.  [without a version: 3.0]",
)
@click.option(
    "--kind",
    type=click.Choice(["compensator", "actuator"]),
    help="With --fmu: displacement to voltage, or the virtual actuator.  [default: compensator]",
)
@start_or_top_option
@json_option
def export(
    model: Path,
    directory: Path,
    number: Any,
    limits: tuple[float, float] | None,
    slew: float | None,
    period: float | None,
    preview: bool,
    name: str | None,
    measure: bool,
    force: bool,
    fmu: Any,
    kind: Any,
    start: str | Path,
    as_json: bool,
    **axis_bounds: Any,
) -> None:
    """Write a MODEL's compensator as C into DIR: files, numbers, a README, and a trace that `make check` replays.

    A stage is written as C only, with all its axes and their coupling.

    With --fmu, write it or its actuator as an FMU for co-simulation. To a name that ends in .wasm, write it as
    WebAssembly, and beside it the JavaScript module that calls it.
    """
    from dehyst.control import Compensator
    from dehyst.exports import export as run

    if is_stage(model):
        if fmu is not None or kind is not None or directory.suffix in (".fmu", ".wasm"):
            raise click.UsageError("a stage is exported as C; give a folder, and leave out --fmu and --kind")
        if number != "double" or preview:
            raise click.UsageError("--number float and --preview are for single actuators; leave them out")
        bounds = {"limits": limits, "slew": slew, "period": period, **axis_bounds}
        export_axes(model, directory, start, bounds, name=name, measure=measure, force=force, as_json=as_json)
        return
    refuse_axis_bounds(axis_bounds)
    if fmu is None and directory.suffix == ".fmu":
        raise click.UsageError(f"{directory}: got a name that ends in .fmu without --fmu; give --fmu or another folder")
    as_wasm = directory.suffix == ".wasm"
    if as_wasm:
        _demand_of_wasm(model, directory, fmu, number, name, measure)
    _demand_of_fmu(fmu, kind, number, name, measure, limited=limits is not None or slew is not None or preview)
    actuator = read_model(model)
    begin, remarks = given_start(actuator, start, limits, MOST)
    remarks += _open_start(actuator, begin)
    state = begin.state
    compensator = Compensator(
        actuator, _NONE if kind == "actuator" else limits, slew, period=period, state=state, preview=preview
    )
    if fmu is not None:
        refuse_overwriting([model], directory)
        result, line, more = _write_fmu(compensator, state, directory, fmu, kind or "compensator", force)
        result["warnings"] = remarks = [*remarks, *more]
        conclude(as_json, result, [line, _begin_words(compensator, actuator, begin, kind)], remarks)
        return
    if as_wasm:
        result, line = _write_wasm(compensator, directory, force)
        remarks += _limit_warnings(compensator, state)
        lines = [line, _begin_words(compensator, actuator, begin)]
        conclude(as_json, {**result, "warnings": remarks}, lines, remarks)
        return
    named = {} if name is None else {"name": name}
    exported = run(compensator, directory, number, force=force, measure=measure, **named)
    remarks += _limit_warnings(compensator, state)
    if measure and exported.unmeasured is not None:
        remarks.append(f"bytes and errors were not measured on this computer: {exported.unmeasured}")
    result = {
        "directory": str(directory),
        "number": number,
        "warnings": remarks,
        **_begins(compensator),
        **_numbers(exported),
    }
    words = _begin_words(compensator, actuator, begin)
    conclude(as_json, result, [f"{directory}: a compensator of {number}s", words, *_table(exported)], remarks)


def _demand_of_fmu(
    fmu: str | None, kind: str | None, number: str, name: str | None, measure: bool, *, limited: bool
) -> None:
    """Refuse options that do not go together."""
    if fmu is None and kind is not None:
        raise click.UsageError("--kind applies to an FMU: give --fmu too")
    if fmu is not None and (name is not None or not measure):
        raise click.UsageError("--name and --no-measure apply to C: an FMU has its model's name; leave them out")
    if fmu is not None and number != "double":
        raise click.UsageError("--number float: an FMU has doubles; leave it out")
    if kind == "actuator" and limited:
        raise click.UsageError(
            "--kind actuator has neither limits nor a preview: leave out --limits, --slew, --preview"
        )


def _demand_of_wasm(model: Path, path: Path, fmu: str | None, number: str, name: str | None, measure: bool) -> None:
    """Refuse options that are not of WebAssembly, and files that an export would replace."""
    from dehyst.exports.wasm import wasm_files

    if fmu is not None:
        raise click.UsageError(f"{path}: got a name that ends in .wasm with --fmu; give one of them")
    if name is not None or not measure or number != "double":
        raise click.UsageError("--name, --no-measure and --number apply to C: leave them out")
    refuse_overwriting([model], *wasm_files(path))


def _write_wasm(compensator: Compensator, path: Path, force: bool) -> tuple[dict[str, Any], str]:
    """Write WebAssembly; return its result as JSON values, and as a line."""
    from dehyst.exports import export_wasm
    from dehyst.exports.wasm import wasm_files

    export_wasm(compensator, path, force=force)
    _, script, types = wasm_files(path)
    size = path.stat().st_size
    result = {"wasm": str(path), "script": str(script), "types": str(types), "bytes": size, **_begins(compensator)}
    return result, f"{path}: a compensator in WebAssembly, {size} bytes; {script} calls it, {types} has its types"


def _write_fmu(
    compensator: Compensator, state: State, path: Path, version: Any, kind: Any, force: bool
) -> tuple[dict[str, Any], str, list[str]]:
    """Write an FMU; return its result as JSON values, as a line, and warnings."""
    from dehyst.exports import SourceOnlyWarning, export_fmu

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", SourceOnlyWarning)
        export_fmu(compensator, path, version, kind, force=force)
    remarks = [str(warning.message) for warning in caught if issubclass(warning.category, SourceOnlyWarning)]
    result = {"fmu": str(path), "version": version, "kind": kind, "binary": not remarks, **_begins(compensator)}
    remarks += _limit_warnings(compensator, state) if kind == "compensator" else []
    content = "sources and a binary for Linux x86-64" if result["binary"] else "sources"
    return {**result, "warnings": remarks}, f"{path}: an FMU {version} of the {kind}, {content}", remarks


def _open_start(actuator: Actuator, start: PossibleStart) -> list[str]:
    """Warn of a start that the voltages before it leave open by more than the model's error."""
    from dehyst.control.start_error import model_error

    places = [state.displacement for state in start.states]
    width = max(places) - min(places)
    if width <= model_error(actuator):
        return []
    return [
        f"{start.name}: these voltages leave the displacement at the start open by {1e6 * width:.3g} um: memory begins "
        "in the middle; home the actuator first"
    ]


def _limit_warnings(compensator: Compensator, state: State) -> list[str]:
    """Warn of a start state clearly outside the limits."""
    (low, high), present = compensator.limits, compensator.actuator.voltage(state)
    if low - _NEAR * (high - low) <= present <= high + _NEAR * (high - low):
        return []
    return [
        f"the start state needs {present:.6g} V, outside the limits {low:.6g} to {high:.6g} V: memory begins at the "
        "nearest limit; choose another state with --start"
    ]


def _begins(compensator: Compensator) -> dict[str, Any]:
    from dehyst.exports.start import ExportedStart

    begin = ExportedStart.of(compensator)
    return {"begins": {"displacement_m": begin.displacement, "voltage_V": begin.voltage, "way": begin.way}}


def _begin_words(compensator: Compensator, actuator: Actuator, start: PossibleStart, kind: str | None = None) -> str:
    from dehyst.exports.start import ExportedStart

    begin = ExportedStart.of(compensator)
    sentence = f"memory begins at {begin.words} {start_words(actuator, start, compensator.state)}"
    return sentence if kind == "actuator" else f"{sentence}; to bring the actuator there, {begin.way}"


def _numbers(exported: Exported) -> dict[str, Any]:
    operations = exported.operations
    return {
        "bytes": {name: footprint._asdict() for name, footprint in exported.footprints.items()},
        "operations": {
            "arithmetic": operations.arithmetic,
            "divisions": operations.divisions,
            "comparisons": operations.comparisons,
        },
        "error_of_range": exported.error,
        "unmeasured": exported.unmeasured,
    }


def _table(exported: Exported) -> list[str]:
    worst = exported.operations
    rows = footprint_rows(exported.footprints)
    rows.append(
        f"a step: at most {worst.arithmetic} additions, subtractions and multiplications, {worst.divisions} divisions, "
        f"{worst.comparisons} comparisons"
    )
    if exported.error is not None:
        rows.append(f"floats: errors up to {exported.error:.1e} of the range")
    return rows
