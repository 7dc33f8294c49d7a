"""`dehyst insight`: how far to trust a model, and what to record next."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from dehyst.cli.axes.assess import insight_axes
from dehyst.cli.axes.inputs import axes_option, is_stage
from dehyst.cli.common import (
    PATH,
    command_line,
    force_option,
    json_option,
    limits_option,
    read_model,
    refuse_overwriting,
    refuse_replacing,
    report_option,
    write_output,
)
from dehyst.cli.output.printing import print_insight
from dehyst.cli.output.terminal import echo_json, note, progress_line
from dehyst.cli.record_files import columns_options, path_of, read_records
from dehyst.cli.start import Request
from dehyst.cli.zero import outside_reach, zero_of_path, zero_option


@click.command()
@click.argument("model", type=PATH)
@click.argument("records", nargs=-1, required=True, metavar="RECORD...", type=PATH)
@click.option("--trajectory", type=PATH, help="Predict the error along this path: a file with a displacement.")
@click.option("--wanted", metavar="NAME", help="Column of the trajectory's displacement.  [default: found by its name]")
@zero_option("From where the trajectory is counted, as in compensate.")
@limits_option("the model's")
@click.option("--seconds", type=float, help="Longest excitation to suggest.")
@click.option("--level", type=float, default=0.9, show_default=True, help="Confidence level of the intervals.")
@click.option(
    "--precision",
    type=float,
    default=0.2,
    show_default=True,
    help="A number is known if half its interval is at most this part of it.",
)
@click.option("--repeats", type=int, default=100, show_default=True, help="Resampled records; 0: no intervals.")
@click.option("-o", "--output", type=PATH, help="Write the trajectory with its band here (CSV).")
@report_option
@axes_option("those of the records")
@force_option
@columns_options
@json_option
def insight(
    model: Path,
    records: tuple[Path, ...],
    trajectory: Path | None,
    wanted: str | None,
    zero: str | float | None,
    output: Path | None,
    report: Path | None,
    axes: str | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Assess a MODEL: what the RECORDs that it was identified from determine, and what they leave open.

    The status is 1 if there is a warning, also if a number of the model is not known to the precision.
    """
    from dehyst._errors import ModelError
    from dehyst.uncertainty import insight as run

    if is_stage(model):
        if any(value is not None for value in (trajectory, wanted, zero, output, report)):
            raise ModelError("--trajectory, -o, --report: got one with a stage, which does not take it; leave it out")
        insight_axes(model, records, axes, {**options, "as_json": as_json})
        return

    if output is not None and trajectory is None:
        raise ModelError("-o: got no trajectory, need one to write its prediction band; give --trajectory")
    if zero is not None and trajectory is None:
        raise ModelError(f"--zero: got {zero} and no trajectory; give --trajectory, the path that it is for")
    if wanted is not None and trajectory is None:
        raise ModelError(f"--wanted: got '{wanted}' and no trajectory; give --trajectory, the file with this column")
    refuse_overwriting([model, *records, *([trajectory] if trajectory else [])], output, report)
    actuator = read_model(model)
    progress = progress_line()
    path, time = (None, {}) if trajectory is None else path_of(trajectory, wanted, options["max_bytes"])
    if trajectory is not None and actuator.needs_time and not time:
        raise ModelError(f"{trajectory}: got no time column, need one: this model depends on time; add time_s")
    if path is not None:
        request = Request(actuator, options["limits"], None, None, None, None, as_json)
        path = path + zero_of_path(request, zero)
        for warning in outside_reach(actuator, path, options["limits"], zero):
            note(warning)
    training = read_records(records, options)
    asked = {name: options[name] for name in ("limits", "seconds", "level", "precision", "repeats")}
    assessment = run(actuator, training, trajectory=path, time=time.get("time_s"), progress=progress, **asked)
    refuse_replacing(output, report)
    if output is not None and assessment.band is not None:
        write_output(output, {**time, **assessment.band.columns()})
    if report is not None:
        from dehyst.report import write_insight

        progress("drawing the page")
        write_insight(report, assessment, command=command_line())
    progress("")
    if as_json:
        echo_json(assessment.as_dict())
    else:
        print_insight(assessment, output, report)
    sys.exit(1 if assessment.warnings() else 0)
