"""`dehyst insight`: how far to trust a model, and what to record next."""

from __future__ import annotations

import sys
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
    refuse_overwriting,
    refuse_unused,
    report_option,
    verbose_option,
    write_output,
)
from dehyst.cli.models import AxesModel, axes_option, is_stage
from dehyst.cli.output.printing import print_insight
from dehyst.cli.output.terminal import echo, echo_json, note, progress_line
from dehyst.cli.record_files import AXES_COLUMNS, COLUMNS, columns_options, path_of, read_records
from dehyst.cli.slew import Slew
from dehyst.cli.start import Request, StartFile, path_start_option, start_reader
from dehyst.cli.zero import outside_reach, zero_of_path, zero_option

if TYPE_CHECKING:
    from dehyst.model import Actuator
    from dehyst.trust import StageInsight

_ASKED = ("limits", "seconds", "level", "precision", "repeats")


@click.command()
@click.argument("model", type=PATH)
@click.argument("records", nargs=-1, required=True, metavar="RECORD...", type=PATH)
@click.option("--trajectory", type=PATH, help="Predict the error along this path: a file with a displacement.")
@click.option("--wanted", metavar="NAME", help="Column of the trajectory's displacement.  [default: found by its name]")
@zero_option("From where the trajectory is counted, as in compensate.")
@path_start_option
@limits_option("the model's")
@click.option("--seconds", type=float, help="Longest excitation to suggest.")
@click.option("--level", type=float, default=0.9, show_default=True, help="Confidence level of the intervals.")
@click.option(
    "--precision",
    type=float,
    help="Warn of numbers whose half interval exceeds this part of them.  [default: 0.2, without a warning]",
)
@click.option("--repeats", type=int, default=100, show_default=True, help="Resampled records; 0: no intervals.")
@click.option("-o", "--output", type=PATH, help="Write the trajectory with its band here (CSV).")
@report_option
@axes_option("those of the records")
@force_option
@columns_options
@verbose_option
@json_option
def insight(
    model: Path,
    records: tuple[Path, ...],
    trajectory: Path | None,
    wanted: str | None,
    zero: str | float | None,
    start: str | StartFile | None,
    output: Path | None,
    report: Path | None,
    axes: str | None,
    verbose: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Assess a MODEL: what the RECORDs that it was identified from determine, and what they leave open.

    The status is 1 if there is a warning, also if a number of the model is not known to a --precision that was given.
    """
    from dehyst.trust import insight as run

    if not options["repeats"]:
        refuse_given("with --repeats 0, which leaves out the intervals", "level", "precision")
    of_path = ("trajectory", "wanted", "zero", "start", "output") if trajectory is not None else ()
    several = is_stage(model)
    if several:
        refuse_unused("with a stage", "axes", *_ASKED, *AXES_COLUMNS)
    else:
        beside = "with the model of one axis" if of_path else "without --trajectory"
        refuse_unused(beside, "report", "force", *of_path, *_ASKED, *COLUMNS)
    before = [trajectory] if trajectory else []
    before += [start.path] if isinstance(start, StartFile) else []
    refuse_overwriting([model, *records, *before], output, report)
    known, progress = AxesModel.read(model), progress_line()
    path, time = (None, {}) if trajectory is None else _path(known.actuators[0], trajectory, wanted, zero, options)
    training = read_records(records, options, trajectory is not None, known.stored_columns(axes))
    asked = {"progress": progress, **{name: options[name] for name in _ASKED}}
    whole = None
    if known.stage is not None:
        from dehyst.trust import stage_insight

        whole = stage_insight(known.stage, training, **asked)
        assessments = whole.insights
    else:
        of_start = None if start is None else start_reader(start, options, options["limits"])
        given: dict[str, Any] = {"trajectory": path, "time": time.get("time_s"), "start": of_start}
        assessments = (run(known.actuators[0], training, **given, **asked),)
    assessment = assessments[0]
    if output is not None and assessment.band is not None:
        write_output(output, {**time, **assessment.band.columns()})
    if report is not None:
        from dehyst.report import write_insight

        progress("drawing the page")
        write_insight(report, assessment, command=command_line())
    progress("")
    if as_json:
        echo_json((whole or assessment).as_dict())
    else:
        if whole is not None:
            _print_coupling(whole)
        for axis, one in zip(known.axes, assessments, strict=True):
            if axis:
                echo()
                echo(f"Axis {axis}")
            print_insight(one, output, report, verbose=verbose)
    sys.exit(1 if any(one.warnings() for one in assessments) else 0)


def _print_coupling(found: StageInsight) -> None:
    for line in found.lines():
        echo(line)


def _path(
    actuator: Actuator, trajectory: Path, wanted: str | None, zero: str | float | None, options: dict[str, Any]
) -> tuple[Any, dict[str, Any]]:
    """Return the displacement (n,) [m] of a trajectory in the model's coordinates, and its time column."""
    from dehyst._errors import ModelError

    path, time = path_of(trajectory, wanted, options)
    if actuator.needs_time and not time:
        raise ModelError(
            argument=str(trajectory), got="no time column", need="one: this model depends on time", hint="add time_s"
        )
    request = Request(actuator, options["limits"], Slew(None, "none"), None, None, None, False)
    path = path + zero_of_path(request, zero)
    for warning in outside_reach(actuator, path, options["limits"], zero):
        note(warning)
    return path, time
