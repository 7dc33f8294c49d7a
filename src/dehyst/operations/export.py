"""`export`: a model as C for a microcontroller, as WebAssembly, or as an FMU."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import click

from dehyst._errors import ModelError
from dehyst._views.fields import json_values
from dehyst._views.lines import ends
from dehyst.control import Axis, Compensator
from dehyst.exports.fmu import ANY_VOLTAGE
from dehyst.exports.model_header import ExportedStart
from dehyst.exports.targets import target_of, written
from dehyst.operations.axes import AxesModel, OfAxes, is_stage, limits_option, slew_option
from dehyst.operations.command import FOLDER, NUMBER, Values, argument, command, flag, option
from dehyst.operations.run import Result, Run, demand_outputs

# Entries of a start as JSON values.
_BEGINS = "displacement_m=displacement voltage_V=voltage way"


def _of_fmu(given: Values) -> str:
    fmu = given["directory"].suffix == ".fmu" and not is_stage(given["model"])
    return "" if fmu else "on anything but an FMU of one axis"


def _of_loop(given: Values) -> str:
    return "on an FMU of the actuator" if given.get("kind") == "actuator" else ""


@command("export")
def export(
    run: Run,
    model: Path = argument(),
    directory: Path = argument(FOLDER),
    number: Literal["double", "float"] = option(
        "double: the same bits as Python. float: for a processor without doubles.",
        click.Choice(["double", "float"]),
        default="double",
    ),
    limits: OfAxes = limits_option("Allowed voltages [V]; default: those of the records.", _of_loop),
    slew_rate: OfAxes = slew_option("Largest slew rate [V/s]; default: the model's, or none.", _of_loop),
    period: float | None = option("Time between steps [s]; a model that depends on time needs it.", NUMBER),
    preview: bool = flag("Compensate delay and inertia; displacements are needed in advance.", _of_loop),
    name: str | None = option("Prefix of files and functions; default: piezo, or stage."),
    kind: str = option(
        "Kind of FMU: compensator (displacement to voltage), or virtual actuator.",
        click.Choice(["compensator", "actuator"]),
        _of_fmu,
        default="compensator",
    ),
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
    bounds, slews = known.of("limits", limits) if loop else ANY_VOLTAGE, known.slews(slew_rate)
    compensator = Compensator(known.model, bounds, slews, period=period, preview=preview)
    if preview and not compensator.samples_ahead:
        raise ModelError("has no effect without a delay or inertia", argument="preview", hint="leave it out")
    known.remark(map(_remarks, compensator._axes))
    files = written(compensator if loop else known.model, directory, number, name, None if loop else period)
    begins = [ExportedStart.of(axis) for axis in compensator._axes]
    lines = [f"{directory}: the {kind} as {target.words}: {', '.join(file.name for file in files)}"]
    lines += known.prefixed(
        [f"memory begins at {at.words}{f'; to bring the actuator there, {at.way}' if loop else ''}"] for at in begins
    )
    fields = {"kind": kind, "files": list(map(str, files))}
    if loop:
        fields["slew_V_per_s"] = known.by_axis(slews)
        lines += known.prefixed([] if slew else ["slew rate: no bound; --slew-rate gives one"] for slew in slews)
    memory = [{"begins": json_values(at, _BEGINS)} for at in begins]
    return Result(fields | known.merged(memory), lines)


def _remarks(axis: Axis) -> Iterator[str]:
    """Yield a warning of limits beyond the records."""
    low, high = axis.limits
    least, most = axis.actuator.limits or (low, high)
    if (low, high) != ANY_VOLTAGE and not least <= low <= high <= most:
        yield (
            f"limits: {ends(low, high, 'V')} is used, but the records of the model have {ends(least, most, 'V')}: "
            "outside, the model is extrapolated"
        )
