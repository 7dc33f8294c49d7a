"""`dehyst calibrate --axes`: the whole experiment on several axes of an instrument."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dehyst.cli.axes.inputs import bounds_of
from dehyst.cli.common import command_line, refuse_replacing
from dehyst.cli.output.instrument_errors import note_narrower, reported_errors
from dehyst.cli.output.terminal import echo, echo_json, note

if TYPE_CHECKING:
    from dehyst.instruments import AbstractStageRig
    from dehyst.stages import StageCalibration, StagePlan

REPORT = "report.html"


def calibrate_axes(
    rig: str,
    output: Path,
    axes: str | None,
    options: dict[str, Any],
    *,
    dry_run: bool,
    as_json: bool,
) -> None:
    """Calibrate several axes together, write and print the result, and exit."""
    from dehyst.instruments import open_stage_rig
    from dehyst.stages import StagePlan

    _refuse_single(options)
    plan = StagePlan(frequency=options["frequency"], goal=options["goal"])
    names = [name.strip() for name in (axes or rig.rpartition("/")[2]).split(",")]
    limits, slew = bounds_of(names, options)
    if not dry_run:
        _refuse_replacing(output)
    with (
        reported_errors(output, again=False),
        open_stage_rig(rig, names, limits=limits, slew_rate=slew) as instrument,
    ):
        for one, allowed, steepest in zip(instrument.rigs, limits, slew, strict=True):
            note_narrower(one, allowed, steepest, one.axis)
        if dry_run:
            _print_plan(instrument, plan, as_json)
            return
        calibration = _run(instrument, output, plan)
    _print(calibration, output, as_json)
    sys.exit(0 if calibration.good else 1)


def _refuse_single(options: dict[str, Any]) -> None:
    """Refuse options that concern one axis only."""
    if options["protocol"] or options["hold"] is not None:
        name = "--protocol" if options["protocol"] else "--hold"
        raise click.UsageError(f"{name}: is for one axis; leave it out, or leave out --axes")


def _refuse_replacing(folder: Path) -> None:
    """Refuse a folder in which results would replace foreign files."""
    from dehyst._io.marks import format_of
    from dehyst.instruments.calibration.session import FORMAT
    from dehyst.stages.calibration.experiment import STAGE_RESULTS

    if format_of(folder / "campaign.json") != FORMAT:
        refuse_replacing(*(folder / name for name in (*STAGE_RESULTS, REPORT)))


def _run(rig: AbstractStageRig, output: Path, plan: StagePlan) -> StageCalibration:
    from dehyst.cli.output.live import display
    from dehyst.stages import calibrate_stage, write_stage_report
    from dehyst.stages.calibration.experiment import STAGE_STEPS

    for line in _plan_lines(rig, plan):
        note(line)
    with display(STAGE_STEPS) as live:
        calibration = calibrate_stage(rig, output, plan=plan, watcher=live)
        live.step("report")
        records = [calibration.training, calibration.held_out]
        write_stage_report(output / REPORT, calibration.fit, records, command=command_line())
        return calibration


def _print_plan(rig: AbstractStageRig, plan: StagePlan, as_json: bool) -> None:
    """Print what would be sent."""
    from dehyst.stages.calibration.experiment import stage_entries

    if as_json:
        echo_json(
            {
                "rig": rig.name,
                "axes": list(rig.axes),
                "limits_V": [[one.low, one.high] for one in rig.limits],
                "slew_rate_V_per_s": rig.slew_rate.tolist(),
                "safe_V": rig.safe.tolist(),
                "steps": stage_entries(rig, plan),
            }
        )
        return
    bounds = "; ".join(
        f"axis {axis}: {one.words}, at most {one.slew_rate:.6g} V/s"
        for axis, one in zip(rig.axes, rig.limits, strict=True)
    )
    echo(f"{rig.name}, {bounds}; nothing was sent")
    for line in _plan_lines(rig, plan):
        echo(line)


def _plan_lines(rig: AbstractStageRig, plan: StagePlan) -> list[str]:
    from dehyst.stages.calibration.experiment import stage_entries

    entries = stage_entries(rig, plan)
    lines = [
        f"  {entry['step']:12s}{entry['seconds']:8.1f} s {entry['samples']:7d} samples, up to "
        f"{_joined(entry['highest_V'])} V and {_joined(entry['steepest_V_per_s'])} V/s; {entry['what']}"
        for entry in entries
    ]
    return [*lines, f"{sum(entry['seconds'] for entry in entries):.0f} s of playing in all"]


def _joined(values: Sequence[float]) -> str:
    return ", ".join(f"{value:.4g}" for value in values)


def _print(calibration: StageCalibration, output: Path, as_json: bool) -> None:
    if as_json:
        echo_json({**calibration.as_dict(), "output": str(output)})
        return
    for warning in calibration.warnings():
        note(warning)
    for line in calibration.fit.summary().split("\n"):
        echo(line)
    echo("Measured along a path of all axes together, in % of the stroke of each:")
    for name, path in (("nominal", calibration.nominal), ("compensated", calibration.compensated)):
        for axis, largest, rms in zip(path.axes, path.largest_percent, path.rms_percent, strict=True):
            echo(f"  {name:12s} axis {axis:6s} largest {largest:6.3f} %  RMS {rms:6.3f} %")
    echo(f"stage.json, report.html, calibration.json and records: {output}")
