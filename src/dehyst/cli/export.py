"""`dehyst export`: a model as C for a microcontroller, or as an FMU."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dehyst.cli.common import (
    PATH,
    conclude,
    json_option,
    read_model,
    refuse_overwriting,
)
from dehyst.cli.start import start_option, start_state, start_words

if TYPE_CHECKING:
    from dehyst.control import Compensator
    from dehyst.exports import Exported
    from dehyst.model import Actuator, State


# Limits that no voltage meets.
_NONE = -1e300, 1e300
# Share of the limits' range by which a start may lie outside without a word.
_NEAR = 0.01


@click.command()
@click.argument("model", type=PATH)
@click.argument("directory", metavar="DIR|FMU", type=PATH)
@click.option(
    "--number",
    type=click.Choice(["double", "float"]),
    default="double",
    show_default=True,
    help="double: the same bits as Python. float: for a processor that has no more.",
)
@click.option(
    "--limits", type=(float, float), metavar="LOW HIGH", help="Voltages allowed.  [default: those of the records]"
)
@click.option("--slew", type=float, metavar="V/S", help="Largest slew rate; needs --period.")
@click.option("--period", type=float, metavar="S", help="Seconds between steps; a model with time in it needs them.")
@click.option("--preview", is_flag=True, help="Make up for delay and inertia; displacements are then given ahead.")
@click.option(
    "--name",
    metavar="NAME",
    help="Of files, type and calls, so that several models go into one firmware.  [default: piezo]",
)
@click.option(
    "--measure/--no-measure",
    default=True,
    help="Compile it to tell its bytes and the error of floats, which takes seconds.  [default: measure]",
)
@click.option(
    "--force", is_flag=True, help="Replace an earlier export, or a file where an FMU goes that dehyst did not write."
)
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
@start_option
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
    start: str,
    as_json: bool,
) -> None:
    """Write a MODEL's compensator as C into DIR: files, numbers, a README, and a trace that `make check` replays.

    With --fmu, write it or its actuator as an FMU for co-simulation.
    """
    from dehyst.control import Compensator
    from dehyst.exports import export as run

    if fmu is None and directory.suffix == ".fmu":
        raise click.UsageError(f"{directory}: an FMU? give --fmu; a folder's name cannot end in .fmu")
    _demand_of_fmu(fmu, kind, number, name, measure, limited=limits is not None or slew is not None or preview)
    actuator = read_model(model)
    state = start_state(actuator, start)
    compensator = Compensator(
        actuator, _NONE if kind == "actuator" else limits, slew, period=period, state=state, preview=preview
    )
    if fmu is not None:
        refuse_overwriting([model], directory)
        result, line, said = _write_fmu(compensator, state, directory, fmu, kind or "compensator", force)
        conclude(as_json, result, [line, _begin_words(compensator, actuator, start, kind)], said)
        return
    named = {} if name is None else {"name": name}
    made = run(compensator, directory, number, force=force, measure=measure, **named)
    said = _start_words(compensator, state)
    if measure and made.unmeasured is not None:
        said.append(f"bytes and errors were not measured on this computer: {made.unmeasured}")
    result = {"directory": str(directory), "number": number, "warnings": said, **_begins(compensator), **_numbers(made)}
    begin = _begin_words(compensator, actuator, start)
    conclude(as_json, result, [f"{directory}: a compensator of {number}s", begin, *_table(made)], said)


def _demand_of_fmu(
    fmu: str | None, kind: str | None, number: str, name: str | None, measure: bool, *, limited: bool
) -> None:
    """Refuse options that do not go together."""
    if fmu is None and kind is not None:
        raise click.UsageError("--kind is of an FMU: give --fmu too")
    if fmu is not None and (name is not None or not measure):
        raise click.UsageError("--name and --no-measure are of C: an FMU has its model's name; leave them out")
    if fmu is not None and number != "double":
        raise click.UsageError("--number float: an FMU has doubles; leave it out")
    if kind == "actuator" and limited:
        raise click.UsageError(
            "--kind actuator has no limits and looks not ahead: leave out --limits, --slew, --preview"
        )


def _write_fmu(
    compensator: Compensator, state: State, path: Path, version: Any, kind: Any, force: bool
) -> tuple[dict[str, Any], str, list[str]]:
    """What is to be told of it: as JSON, in a line, and in words of warning."""
    from dehyst.exports import SourceOnlyWarning, export_fmu

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", SourceOnlyWarning)
        export_fmu(compensator, path, version, kind, force=force)
    said = [str(one.message) for one in caught if issubclass(one.category, SourceOnlyWarning)]
    result = {"fmu": str(path), "version": version, "kind": kind, "binary": not said, **_begins(compensator)}
    said += _start_words(compensator, state) if kind == "compensator" else []
    holds = "sources and a binary for Linux x86-64" if result["binary"] else "sources"
    return {**result, "warnings": said}, f"{path}: an FMU {version} of the {kind}, {holds}", said


def _start_words(compensator: Compensator, state: State) -> list[str]:
    """A state that is clearly not within the limits."""
    (low, high), present = compensator.limits, compensator.actuator.voltage(state)
    if low - _NEAR * (high - low) <= present <= high + _NEAR * (high - low):
        return []
    return [
        f"the state that it starts in is held by {present:.6g} V, outside the limits {low:.6g} to {high:.6g} V: memory "
        "begins at the nearest limit; choose another state with --start"
    ]


def _begins(compensator: Compensator) -> dict[str, Any]:
    from dehyst.exports.start import ExportedStart

    outset = ExportedStart.of(compensator)
    return {"begins": {"displacement_m": outset.displacement, "voltage_V": outset.voltage, "way": outset.way}}


def _begin_words(compensator: Compensator, actuator: Actuator, start: str, kind: str | None = None) -> str:
    from dehyst.exports.start import ExportedStart

    outset = ExportedStart.of(compensator)
    said = f"memory begins at {outset.words} {start_words(actuator, start, compensator.state)}"
    return said if kind == "actuator" else f"{said}; to bring the actuator there, {outset.way}"


def _numbers(made: Exported) -> dict[str, Any]:
    operations = made.operations
    return {
        "bytes": {name: one._asdict() for name, one in made.footprints.items()},
        "operations": {
            "arithmetic": operations.arithmetic,
            "divisions": operations.divisions,
            "comparisons": operations.comparisons,
        },
        "error_of_range": made.error,
        "unmeasured": made.unmeasured,
    }


def _table(made: Exported) -> list[str]:
    worst = made.operations
    rows = [f"{'bytes':<40}{'flash':>8}{'RAM':>8}{'stack':>8}"] if made.footprints else []
    rows += [
        f"{name:<40}{one.flash:>8}{one.ram:>8}{'-' if one.stack is None else one.stack:>8}"
        for name, one in made.footprints.items()
    ]
    rows.append(
        f"a step: at most {worst.arithmetic} additions, subtractions and multiplications, {worst.divisions} divisions, "
        f"{worst.comparisons} comparisons"
    )
    if made.error is not None:
        rows.append(f"floats: errors up to {made.error:.1e} of the range")
    return rows
