"""`dehyst calibrate`: the whole experiment on an instrument."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dehyst.cli.axes.calibrate import calibrate_axes
from dehyst.cli.axes.inputs import axis_bounds_options, refuse_axis_bounds
from dehyst.cli.common import (
    PATH,
    command_line,
    force_option,
    json_option,
    limits_option,
    refuse_replacing,
)
from dehyst.cli.output.instrument_errors import note_narrower, reported_errors
from dehyst.cli.output.terminal import echo, echo_json, note
from dehyst.cli.record_files import size_option

if TYPE_CHECKING:
    from dehyst.instruments import AbstractRig
    from dehyst.instruments.calibration import Calibration, Plan


REPORT = "report.html"


@click.command()
@click.argument("rig", metavar="RIG")
@click.option(
    "-o",
    "--output",
    type=PATH,
    default=Path("dehyst-calibration"),
    show_default=True,
    help="Folder for records, model and report. Complete records of one axis in it are not played again, "
    "except one loop that must agree with them.",
)
@click.option(
    "--axes",
    metavar="1,2,3",
    help="Calibrate these axes of one body together: coupling, model and path of all axes.  [default: one axis]",
)
@limits_option("the device's", "Range of the voltage.")
@click.option("--slew", type=float, metavar="V/S", help="Largest slew rate.  [default: the whole range in 0.1 s]")
@axis_bounds_options
@click.option("--frequency", type=float, default=1.0, show_default=True, metavar="HZ", help="Loops a second.")
@click.option("--hold", type=float, metavar="S", help="Hold at each step, for creep.  [default: three cycles]")
@click.option(
    "--protocol",
    type=PATH,
    multiple=True,
    metavar="FILE",
    help="Record this voltage (from dehyst excite) instead of suggested ones; may be repeated.",
)
@click.option(
    "--rounds", type=int, default=2, show_default=True, metavar="N", help="Rounds of further, suggested recordings."
)
@click.option(
    "--goal", type=float, default=1.0, show_default=True, metavar="PERCENT", help="Largest error allowed on the path."
)
@force_option
@click.option("--dry-run", is_flag=True, help="Print what would be sent, and send nothing.")
@size_option
@json_option
def calibrate(
    rig: str,
    output: Path,
    axes: str | None,
    dry_run: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Home, excite, record, identify, compensate and measure the actuator on RIG.

    RIG: pi://HOST:PORT, epics://PREFIX, sim://play, or FILE.py:FUNCTION, which returns a rig of your own. Several axes
    of one controller: pi://HOST:PORT/1,2,3, or --axes 1,2,3.

    Ctrl-C brings the voltage to a safe value; the same command continues from the records on disk, or with --axes
    begins again.
    """
    if axes is not None or _several(rig):
        calibrate_axes(rig, output, axes, options, dry_run=dry_run, as_json=as_json)
        return
    refuse_axis_bounds(options)
    limits, slew = options.pop("limits"), options.pop("slew")
    from dehyst.instruments import open_rig
    from dehyst.instruments.calibration import Plan
    from dehyst.instruments.voltage_file import read_voltage

    max_bytes = options.pop("max_bytes")
    given = tuple(read_voltage(path, max_bytes=max_bytes).excitation for path in options.pop("protocol"))
    plan = Plan(protocol=given, **options)
    if not dry_run:
        _refuse_replacing(output)
    with reported_errors(output), open_rig(rig, limits=limits, slew_rate=slew) as instrument:
        note_narrower(instrument, limits, slew)
        if dry_run:
            _print_plan(instrument, plan, as_json)
            return
        calibration = _run(instrument, output, plan)
    _print(calibration, output, as_json)
    sys.exit(0 if calibration.good else 1)


def _refuse_replacing(folder: Path) -> None:
    """Refuse a folder in which results would replace foreign files."""
    from dehyst._io.marks import format_of
    from dehyst.instruments.calibration.experiment import RESULTS
    from dehyst.instruments.calibration.session import FORMAT

    if format_of(folder / "campaign.json") != FORMAT:
        refuse_replacing(*(folder / name for name in (*RESULTS, REPORT)))


def _several(rig: str) -> bool:
    """Return whether an address names several axes."""
    return rig.lower().startswith("pi://") and "," in rig.rpartition("/")[2]


def _print_plan(rig: AbstractRig, plan: Plan, as_json: bool) -> None:
    """Print what would be sent."""
    from dehyst.instruments.calibration.plan import entries

    planned = entries(rig, plan)
    allowed = {
        "rig": rig.name,
        "axis": rig.axis,
        "limits_V": [rig.limits.low, rig.limits.high],
        "slew_rate_V_per_s": rig.slew_rate,
        "safe_V": rig.safe,
    }
    if as_json:
        echo_json({**allowed, "steps": planned})
        return
    echo(f"{rig.name}, axis {rig.axis}: {rig.limits.words}, at most {rig.slew_rate:.6g} V/s; nothing was sent")
    for entry in planned:
        numbers = ""
        if "samples" in entry:
            numbers = (
                f"{entry['seconds']:8.1f} s {entry['samples']:7d} samples, {entry['lowest_V']:.6g} to "
                f"{entry['highest_V']:.6g} V, up to {entry['steepest_V_per_s']:.4g} V/s; "
            )
        echo(f"  {entry['step']:12s}{numbers}{entry['what']}")
    seconds = sum(entry.get("seconds", 0.0) for entry in planned)
    echo(f"up to {seconds:.0f} s of playing in all, and further recordings that are suggested on the way")


def _run(rig: AbstractRig, output: Path, plan: Plan) -> Calibration:
    from dehyst.cli.output.live import display
    from dehyst.instruments.calibration import calibrate as run
    from dehyst.instruments.calibration.plan import STEPS
    from dehyst.report import write_calibration

    with display(STEPS) as live:
        calibration = run(rig, output, plan=plan, watcher=live)
        live.step("report")
        write_calibration(output / REPORT, calibration, command=command_line())
        return calibration


def _kept(calibration: Calibration) -> Iterator[str]:
    """Yield what was not measured now, as sentences."""
    if calibration.agreement is not None:
        yield calibration.agreement.words
    if calibration.kept and not calibration.played:
        yield (
            f"nothing else was played: all else is from records on disk, {calibration.since}; give another -o to "
            "measure anew"
        )
    elif calibration.kept:
        yield (
            f"from records on disk, {calibration.since}, not played again: {', '.join(calibration.kept)}; give "
            "another -o to measure anew"
        )


def _print(calibration: Calibration, output: Path, as_json: bool) -> None:
    if as_json:
        echo_json({**calibration.as_dict(), "output": str(output)})
        return
    for warning in (*_kept(calibration), *calibration.warnings()):
        note(warning)
    fit = calibration.fit
    echo(f"{fit.outcome.value}")
    for error in fit.errors:
        echo(
            f"  {error.record:12s} {error.role:12s} largest {error.largest_percent:6.3f} %  RMS "
            f"{error.rms_percent:6.3f} % of the stroke"
        )
    echo("Measured along a path of nine reversals, in % of the stroke:")
    for name, path in (("nominal", calibration.nominal), ("compensated", calibration.compensated)):
        echo(f"  {name:12s} largest {path.largest_percent:6.3f} %  RMS {path.rms_percent:6.3f} %")
    echo(f"model.json, report.html, calibration.json and records: {output}")
