"""`dehyst calibrate`: the whole experiment on an instrument."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dehyst.cli.common import (
    PATH,
    command_line,
    force_option,
    json_option,
    limits_option,
    refuse_given,
    refuse_unused,
)
from dehyst.cli.models import AXIS_BOUNDS, axis_bounds_options, bounds_of
from dehyst.cli.output.instrument_errors import note_narrower, reported_errors
from dehyst.cli.output.terminal import echo, echo_json, note
from dehyst.cli.record_files import size_option

if TYPE_CHECKING:
    from dehyst.calibration import Calibration, Plan
    from dehyst.identification import Fit, StageFit
    from dehyst.instruments import AbstractRig


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
    several = axes is not None or _several(rig)
    if several:
        bounds = ("limits", "slew", *AXIS_BOUNDS)
        refuse_unused("with several axes", "output", "force", "axes", "dry_run", "frequency", "goal", *bounds)
    else:
        refuse_given("with one axis", *AXIS_BOUNDS)
        if not options["protocol"]:
            refuse_given("without --protocol", "max_bytes")
    from dehyst.calibration import Plan
    from dehyst.calibration.plan import read_voltage
    from dehyst.instruments import open_rig

    names = [name.strip() for name in (axes or rig.rpartition("/")[2]).split(",")] if several else None
    limits, slew = bounds_of(names or ["1"], options)
    max_bytes = options.pop("max_bytes")
    given = tuple(read_voltage(path, max_bytes=max_bytes).excitation for path in options.pop("protocol"))
    plan = Plan(protocol=given, **{name: options[name] for name in ("frequency", "hold", "rounds", "goal")})
    if not dry_run:
        _refuse_replacing(output, several)
    bounds_given = {"limits": limits, "slew_rate": slew} if several else {"limits": limits[0], "slew_rate": slew[0]}
    with reported_errors(output, again=not several), open_rig(rig, names, **bounds_given) as instrument:
        for one, allowed, steepest in zip(instrument.rigs, limits, slew, strict=True):
            note_narrower(one, allowed, steepest, one.axis if several else "")
        if dry_run:
            _print_plan(instrument, plan, as_json)
            return
        calibration = _run(instrument, output, plan)
    _print(calibration, output, as_json)
    sys.exit(0 if calibration.good else 1)


def _refuse_replacing(folder: Path, several: bool) -> None:
    """Refuse a folder in which results would replace foreign files."""
    from dehyst._io import demand_alike, format_of
    from dehyst.calibration.experiment import RESULTS, STAGE_RESULTS
    from dehyst.calibration.session import FORMAT

    if format_of(folder / "campaign.json") != FORMAT:
        for name in (*(STAGE_RESULTS if several else RESULTS), REPORT):
            demand_alike(folder / name)


def _several(rig: str) -> bool:
    """Return whether an address names several axes."""
    return rig.lower().startswith("pi://") and "," in rig.rpartition("/")[2]


def _print_plan(rig: AbstractRig, plan: Plan, as_json: bool) -> None:
    """Print what would be sent."""
    from dehyst.calibration.plan import entries

    planned = entries(rig, plan)
    if as_json:
        several = len(rig.axes) > 1
        columns: dict[str, Any] = {
            "axis": list(rig.axes),
            "limits_V": [[one.limits.low, one.limits.high] for one in rig.rigs],
            "slew_rate_V_per_s": [one.slew_rate for one in rig.rigs],
            "safe_V": [one.safe for one in rig.rigs],
        }
        named = {"axes" if several and name == "axis" else name: values for name, values in columns.items()}
        allowed = named if several else {name: values[0] for name, values in named.items()}
        echo_json({"rig": rig.name, **allowed, "steps": planned})
        return
    bounds = "; ".join(f"axis {one.axis}: {one.limits.words}, at most {one.slew_rate:.6g} V/s" for one in rig.rigs)
    echo(f"{rig.name}, {bounds}; nothing was sent")
    for line in _plan_lines(planned):
        echo(line)
    more = ", and further recordings that are suggested on the way" if len(rig.axes) == 1 else ""
    echo(f"up to {sum(entry.get('seconds', 0.0) for entry in planned):.0f} s of playing in all{more}")


def _plan_lines(planned: list[dict[str, Any]]) -> Iterator[str]:
    for entry in planned:
        numbers = ""
        if "samples" in entry:
            numbers = (
                f"{entry['seconds']:8.1f} s {entry['samples']:7d} samples, {_joined(entry['lowest_V'])} to "
                f"{_joined(entry['highest_V'])} V, up to {_joined(entry['steepest_V_per_s'], 4)} V/s; "
            )
        yield f"  {entry['step']:12s}{numbers}{entry['what']}"


def _joined(values: float | list[float], digits: int = 6) -> str:
    """Return the number of one axis, or those of several."""
    return ", ".join(f"{value:.{digits}g}" for value in (values if isinstance(values, list) else [values]))


def _run(rig: AbstractRig, output: Path, plan: Plan) -> Calibration:
    from dehyst.calibration import calibrate as run
    from dehyst.calibration.plan import entries
    from dehyst.cli.output.live import display
    from dehyst.identification import StageFit
    from dehyst.report import write_calibration, write_stage_report

    if len(rig.axes) > 1:
        for line in _plan_lines(entries(rig, plan)):
            note(line)
    with display(plan.step_names(rig)) as live:
        calibration = run(rig, output, plan=plan, watcher=live)
        live.step("report")
        if isinstance(calibration.fit, StageFit):
            records = [*calibration.training, *calibration.held_out]
            write_stage_report(output / REPORT, calibration.fit, records, command=command_line())
        else:
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
    fit, several = calibration.fit, bool(calibration.compensated.axes)
    for line in _fit_lines(fit):
        echo(line)
    what = "of all axes together, in % of the stroke of each" if several else "of nine reversals, in % of the stroke"
    echo(f"Measured along a path {what}:")
    for name, path in (("nominal", calibration.nominal), ("compensated", calibration.compensated)):
        for axis, one in zip(path.axes or ("",), path.each, strict=True):
            word = f"axis {axis:6s} " if axis else ""
            echo(f"  {name:12s} {word}largest {one.largest_percent:6.3f} %  RMS {one.rms_percent:6.3f} %")
    echo(f"{'stage' if several else 'model'}.json, report.html, calibration.json and records: {output}")


def _fit_lines(fit: Fit | StageFit) -> list[str]:
    from dehyst.identification import Fit

    if not isinstance(fit, Fit):
        return fit.summary().split("\n")
    return [
        fit.outcome.value,
        *(
            f"  {error.record:12s} {error.role:12s} largest {error.largest_percent:6.3f} %  RMS "
            f"{error.rms_percent:6.3f} % of the stroke"
            for error in fit.errors
        ),
    ]
