"""`export`: a model as C for a microcontroller, as WebAssembly, or as an FMU."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import click

from dehyst._views.fields import json_values
from dehyst.control import Axis, Compensator, PossibleStart
from dehyst.control.planning.start import model_error
from dehyst.exports.fmu import ANY_VOLTAGE, SourceOnlyWarning
from dehyst.exports.model_header import ExportedStart
from dehyst.exports.targets import TARGETS, target_of, written
from dehyst.operations.axes import (
    AxesModel,
    AxisLimits,
    AxisNumbers,
    is_stage,
    limits_of,
    limits_option,
    of_one_axis,
    slew_option,
)
from dehyst.operations.command import FOLDER, Condition, Values, argument, command, flag, option
from dehyst.operations.command import number as number_option
from dehyst.operations.files import AS_FOUND
from dehyst.operations.run import Result, Run, demand_outputs
from dehyst.operations.start import START, Start, start_words, starts_of

# Entries of a start as JSON values.
_BEGINS = "displacement_m=displacement voltage_V=voltage way"
# Share of the limits' range by which a start may lie outside without a warning.
_NEAR = 0.01


def _of(option: str) -> Condition:
    """Return the condition that the target supports an option."""
    takers = " or ".join(target.words for target in TARGETS.values() if option in target.options)

    def supports(given: Values) -> str:
        suffix = "" if is_stage(given["model"]) else given["directory"].suffix
        return "" if option in TARGETS.get(suffix, TARGETS[""]).options else f"on anything but {takers}"

    return supports


def _of_loop(given: Values) -> str:
    return "on an FMU of the actuator" if given.get("kind") == "actuator" else ""


_PREVIEW = (of_one_axis, _of("preview"), _of_loop)


@command("export")
def export(
    run: Run,
    model: Path = argument(),
    directory: Path = argument(FOLDER),
    number: Literal["double", "float"] = option(
        "double: the same bits as Python. float: for a processor without doubles.",
        click.Choice(["double", "float"]),
        of_one_axis,
        _of("number"),
        default="double",
    ),
    limits: AxisLimits = limits_option("Voltages allowed [V]; default: those of the records.", _of_loop),
    slew_rate: AxisNumbers = slew_option("Largest slew rate [V/s]; default: the model's, or none.", _of_loop),
    period: float | None = number_option("Time between steps [s]; a model that depends on time needs it."),
    preview: bool = flag("Compensate delay and inertia, of displacements in advance.", *_PREVIEW),
    name: str | None = option("Prefix of files and functions; default: piezo, or stage.", None, _of("name")),
    kind: str = option(
        "Kind of FMU: compensator (displacement to voltage), or virtual actuator.",
        click.Choice(["compensator", "actuator"]),
        _of("kind"),
        default="compensator",
    ),
    start: Start = option("Initial state of the memory, as in compensate.", START, default="top"),
) -> Result:
    """Write the compensator of a MODEL as C into a DIRECTORY: sources, numbers, a README, and a trace for `make check`.

    A model of several axes is written as C only, with all its axes and their coupling.

    If the name ends in .fmu, write the compensator or its actuator as an FMU for co-simulation (FMI 2.0). If the name
    ends in .wasm, write the compensator as WebAssembly, with the JavaScript module that calls it.
    """
    target, loop = target_of(directory, coupled=is_stage(model)), kind != "actuator"
    if target.files is not None:
        demand_outputs([model], target.files(directory), force=run.force)
    known = AxesModel.read(run, model)
    bounds: list[Any] = limits_of(known.axes, limits)
    begins, remarks = starts_of(known, start, bounds, AS_FOUND)
    states, slews = [state for state in begins if state is not None], known.slews(slew_rate)
    given: dict[str, Any] = {"slew_rate": [slew.bound for slew in slews], "state": [at.state for at in states]}
    allowed = bounds if loop else ANY_VOLTAGE
    compensator = Compensator(known.stage or known.actuators[0], allowed, period=period, preview=preview, **given)
    loops = compensator._axes
    remarks += known.prefixed(map(_remarks, loops, states))
    source = compensator if loop else replace(known.actuators[0], state=states[0].state)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", SourceOnlyWarning)
        files = written(source, directory, number, name, None if loop else period)
    remarks += [str(warning.message) for warning in caught if issubclass(warning.category, SourceOnlyWarning)]
    fields = {"path": str(directory), "kind": kind, "files": list(map(str, files)), "warnings": remarks}
    lines = [f"{directory}: the {kind} as {target.words}: {', '.join(file.name for file in files)}"]
    lines += known.prefixed(_memory_words(*each, led=loop) for each in zip(loops, states, strict=True))
    if loop:
        fields |= known.merged([slew.fields() for slew in slews])
        unbound = ["slew rate: no bound; --slew-rate gives one"]
        lines += known.prefixed(slew.words if slew.bound else unbound for slew in slews)
    memory = [{"begins": json_values(ExportedStart.of(part), _BEGINS)} for part in loops]
    return Result(fields | known.merged(memory), lines, warnings=remarks)


def _memory_words(axis: Axis, start: PossibleStart, *, led: bool) -> Iterator[str]:
    """Yield where the memory begins, and how an actuator that is `led` by it is brought there."""
    at = ExportedStart.of(axis)
    way = f"; to bring the actuator there, {at.way}" if led else ""
    yield f"memory begins at {at.words} {start_words(axis.actuator, start, axis.state)}{way}"


def _remarks(axis: Axis, start: PossibleStart) -> Iterator[str]:
    """Yield warnings of limits beyond the records, and of a start outside of them or open by more than the error."""
    actuator, (low, high) = axis.actuator, axis.limits
    least, most = actuator.limits or (low, high)
    if (low, high) != ANY_VOLTAGE and not least <= low <= high <= most:
        yield (
            f"limits: {low:.6g} to {high:.6g} V is used, but the model's records cover {least:.6g} to {most:.6g} V: "
            "outside, the model is extrapolated"
        )
    places, present = [actuator.displacement(state) for state in start.states], actuator.voltage(start.state)
    if not low - _NEAR * (high - low) <= present <= high + _NEAR * (high - low):
        yield (
            f"the start state needs {present:.6g} V, outside the limits {low:.6g} to {high:.6g} V: memory begins at "
            "the nearest limit; choose another state with --start"
        )
    if (width := max(places) - min(places)) > model_error(actuator):
        yield (
            f"{start.name}: these voltages leave the displacement at the start open by {1e6 * width:.3g} um: memory "
            "begins in the middle; home the actuator first"
        )
