"""`export`: a model as C for a microcontroller, as WebAssembly, or as an FMU."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import click

from dehyst.control import Compensator, PossibleStart, StageCompensator
from dehyst.control.planning.start import model_error
from dehyst.exports.fmu import ANY_VOLTAGE, SourceOnlyWarning
from dehyst.exports.model_header import ExportedStart
from dehyst.exports.targets import TARGETS, target_of
from dehyst.exports.targets import export as write
from dehyst.model import Actuator
from dehyst.operations.axes import AxesModel, is_stage, limits_of, limits_option, slew_option
from dehyst.operations.command import FOLDER, INPUT, Only, Parsed, Values, command, number, option
from dehyst.operations.files import AS_FOUND
from dehyst.operations.paths import coverage_remarks
from dehyst.operations.run import Result, Run, demand_outputs
from dehyst.operations.start import Start, start_words, starts_of

# Share of the limits' range by which a start may lie outside without a warning.
_NEAR = 0.01


def _of(option: str) -> Only:
    """Return the condition that the target supports an option."""
    takers = " or ".join(target.words for target in TARGETS.values() if option in target.options)

    def supports(given: Values) -> bool:
        suffix = "" if is_stage(given["model"]) else given["directory"].suffix
        return option in TARGETS.get(suffix, TARGETS[""]).options

    return Only(supports, f"on anything but {takers}")


_of_loop = Only(lambda given: given.get("kind") != "actuator", "on an FMU of the actuator")
_of_one = Only(lambda given: not is_stage(given["model"]), "with a model of several axes")


_of_preview = (_of_one, _of("preview"), _of_loop)


@command("export")
@click.argument("model", type=INPUT)
@click.argument("directory", type=FOLDER)
@option(
    "--number",
    type=click.Choice(["double", "float"]),
    default="double",
    only=(_of_one, _of("number")),
    help="double: the same bits as Python. float: for a processor without doubles.",
)
@limits_option("Voltages allowed [V], of all axes or of one; default: those of the records.", only=_of_loop)
@slew_option("Largest slew rate [V/s], with --period; default: what the model keeps, or not limited.", only=_of_loop)
@number("--period", help="Time between steps [s]; a model that depends on time needs it.")
@option("--preview", is_flag=True, only=_of_preview, help="Compensate delay and inertia, of displacements in advance.")
@option("--name", only=_of("name"), help="Prefix of files and functions; default: piezo, or stage for several axes.")
@option(
    "--kind",
    type=click.Choice(["compensator", "actuator"]),
    default="compensator",
    only=_of("kind"),
    help="Kind of FMU: compensator (displacement to voltage), or virtual actuator.",
)
@option("--start", type=Parsed(Start), default="top", help="Initial state of the memory, as in compensate.")
def export(
    run: Run,
    model: Path,
    directory: Path,
    number: Literal["double", "float"],
    limits: Sequence[tuple[str, float]],
    slew_rate: Sequence[str],
    period: float | None,
    preview: bool,
    name: str | None,
    kind: str,
    start: Start,
) -> Result:
    """Write the compensator of a MODEL as C into a DIRECTORY: sources, numbers, a README, and a trace for `make check`.

    A model of several axes is written as C only, with all its axes and their coupling.

    If the name ends in .fmu, write the compensator or its actuator as an FMU for co-simulation (FMI 2.0). If the name
    ends in .wasm, write the compensator as WebAssembly, with the JavaScript module that calls it.
    """
    target = target_of(directory, coupled=is_stage(model))
    if target.files is not None:
        demand_outputs([model], target.files(directory), force=run.force)
    known = AxesModel.read(run, model)
    bounds: list[Any] = limits_of(known.axes, limits)
    begins, remarks = starts_of(known, start, bounds, AS_FOUND)
    states = [state for state in begins if state is not None]
    remarks += known.prefixed(map(_open_start, known.actuators, states))
    if kind == "actuator":
        bounds = [ANY_VOLTAGE]
    slews = known.slews(slew_rate)
    rates = [slew.bound for slew in slews]
    options: dict[str, Any] = {"period": period}
    compensator: Compensator | StageCompensator
    if known.stage is not None:
        options |= {"limits": bounds, "slew_rate": rates, "states": [state.state for state in states]}
        compensator = StageCompensator(known.stage, **options)
        loops = compensator.compensators
    else:
        options |= {"state": states[0].state, "preview": preview}
        compensator = Compensator(known.actuators[0], bounds[0], rates[0], **options)
        loops = (compensator,)
        remarks += [] if kind == "actuator" else _limit_warnings(compensator, states[0])
    if kind != "actuator":
        remarks += known.prefixed(map(coverage_remarks, known.actuators, bounds))
    source = replace(known.actuators[0], state=states[0].state) if kind == "actuator" else compensator
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", SourceOnlyWarning)
        write(source, directory, number, name=name, period=period if kind == "actuator" else None)
    remarks += [str(warning.message) for warning in caught if issubclass(warning.category, SourceOnlyWarning)]
    begin = [ExportedStart.of(loop) for loop in loops]
    begun = [{"begins": {"displacement_m": at.displacement, "voltage_V": at.voltage, "way": at.way}} for at in begin]
    words = []
    for at, loop, actuator, state in zip(begin, loops, known.actuators, states, strict=True):
        way = "" if kind == "actuator" else f"; to bring the actuator there, {at.way}"
        words.append([f"memory begins at {at.words} {start_words(actuator, state, loop.state)}{way}"])
    files = target.files(directory) if target.files is not None else sorted(directory.iterdir())
    fields = {"path": str(directory), "kind": kind, "files": list(map(str, files)), **known.merged(begun)}
    if kind != "actuator":
        fields |= known.merged([slew.fields() for slew in slews])
        words = [[*own, slew.words] for own, slew in zip(words, slews, strict=True)]
    line = f"{directory}: the {kind} as {target.words}: {', '.join(file.name for file in files)}"
    lines = [line, *known.prefixed(words)]
    return Result({**fields, "warnings": remarks}, lines, warnings=remarks)


def _open_start(actuator: Actuator, start: PossibleStart) -> list[str]:
    """Warn if the voltages before leave the start uncertain by more than the model's error."""
    places = [actuator.displacement(state) for state in start.states]
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
