"""`dehyst export`: a model as C for a microcontroller, as WebAssembly, or as an FMU."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dehyst.cli.common import (
    PATH,
    conclude,
    force_option,
    given,
    json_option,
    limits_option,
    refuse_overwriting,
    refuse_unused,
)
from dehyst.cli.models import AXIS_BOUNDS, AxesModel, axis_bounds_options, bounds_of, is_stage
from dehyst.cli.start import StartFile, given_starts, start_or_top_option, start_words
from dehyst.records.formats.file_content import MOST

if TYPE_CHECKING:
    from dehyst.control import Compensator, PossibleStart, StageCompensator
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
@force_option
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
    fmu: Any,
    kind: Any,
    start: str | StartFile,
    as_json: bool,
    **axis_bounds: Any,
) -> None:
    """Write a MODEL's compensator as C into DIR: files, numbers, a README, and a trace that `make check` replays.

    A stage is written as C only, with all its axes and their coupling.

    With --fmu, write it or its actuator as an FMU for co-simulation. To a name that ends in .wasm, write it as
    WebAssembly, and beside it the JavaScript module that calls it.
    """
    from dehyst.exports.targets import TARGETS

    several = is_stage(model)
    target = TARGETS[_target(directory, fmu, kind, several)]
    if target.files is not None:
        refuse_overwriting([model], *target.files(directory))
    known = AxesModel.read(model)
    bounds, slews = bounds_of(known.axes, {"limits": limits, "slew": slew, **axis_bounds})
    begins, remarks = given_starts(known, start, bounds, {"max_bytes": MOST, "decimal": None})
    starts = [one for one in begins if one is not None]
    pairs = list(zip(known.actuators, starts, strict=True))
    remarks += known.prefixed(_open_start(*pair) for pair in pairs)
    if kind == "actuator":
        bounds = [_NONE]
    compensator, loops = _compensators(known, starts, bounds, slews, period=period, preview=preview)
    options = {"number": number, "name": name, "measure": measure, "force": bool(given("force"))}
    written = target.write(compensator, directory, {**options, "fmu": fmu, "kind": kind})
    remarks += written.remarks
    if not several and kind != "actuator":
        remarks += _limit_warnings(loops[0], starts[0].state)
    begin_words = known.prefixed([_begin_words(loop, *pair, kind)] for loop, pair in zip(loops, pairs, strict=True))
    result = {**written.values, "warnings": remarks, **known.merged([_begins(loop) for loop in loops])}
    conclude(as_json, result, [written.line, *begin_words, *written.table], remarks)


def _target(directory: Path, fmu: str | None, kind: str | None, several: bool) -> str:
    """Return the kind of export; refuse options that have no effect on it."""
    from dehyst.exports.targets import TARGETS

    always = ("limits", "slew", "period", "start", "force")
    suffixes = {target.suffix: name for name, target in TARGETS.items() if target.suffix}
    if several:
        refuse_unused("with a stage, which is exported as C", *always, *AXIS_BOUNDS, "name", "measure")
        if directory.suffix in suffixes:
            raise click.UsageError("a stage is exported as C; give a folder")
        return "c"
    name = "fmu" if fmu is not None and directory.suffix != ".wasm" else suffixes.get(directory.suffix, "c")
    if name == "fmu" and fmu is None:
        raise click.UsageError(f"{directory}: got a name that ends in .fmu without --fmu; give --fmu or another folder")
    if kind == "actuator" and name == "fmu":
        refuse_unused("on an FMU of the actuator", "period", "start", "force", "fmu", "kind")
    refuse_unused(f"on {TARGETS[name].words}", *always, *TARGETS[name].options)
    return name


def _compensators(
    known: AxesModel, starts: list[PossibleStart], limits: list[Any], slews: list[Any], *, period: Any, preview: bool
) -> tuple[Compensator | StageCompensator, tuple[Compensator, ...]]:
    """Return the compensator to export, and that of each axis."""
    from dehyst.control import Compensator, StageCompensator

    states = [start.state for start in starts]
    if known.stage is not None:
        several = StageCompensator(known.stage, period=period, limits=limits, slew_rate=slews, states=states)
        return several, several.compensators
    one = Compensator(known.actuators[0], limits[0], slews[0], period=period, state=states[0], preview=preview)
    return one, (one,)


def _open_start(actuator: Actuator, start: PossibleStart) -> list[str]:
    """Warn of a start that the voltages before it leave open by more than the model's error."""
    from dehyst.control.planning.start import model_error

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
    from dehyst.exports.model_header import ExportedStart

    begin = ExportedStart.of(compensator)
    return {"begins": {"displacement_m": begin.displacement, "voltage_V": begin.voltage, "way": begin.way}}


def _begin_words(compensator: Compensator, actuator: Actuator, start: PossibleStart, kind: str | None = None) -> str:
    from dehyst.exports.model_header import ExportedStart

    begin = ExportedStart.of(compensator)
    sentence = f"memory begins at {begin.words} {start_words(actuator, start, compensator.state)}"
    return sentence if kind == "actuator" else f"{sentence}; to bring the actuator there, {begin.way}"
