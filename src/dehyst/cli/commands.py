"""The command line: a skin. Exit status 0 done, 1 done but not good enough, 2 wrong input."""

from __future__ import annotations

import shlex
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dehyst._version import __version__
from dehyst.cli.calibrate import calibrate
from dehyst.cli.common import (
    PATH,
    Commands,
    ManyToValidate,
    came_from,
    columns_options,
    conclude,
    force_option,
    json_option,
    lagging,
    leave_cleanly,
    outside_words,
    path_of,
    read_model,
    read_records,
    refuse_overwriting,
    refuse_replacing,
    start_option,
    start_state,
    state_dict,
    time_of_table,
)
from dehyst.cli.compare import compare
from dehyst.cli.compensate import compensate
from dehyst.cli.excite import excite
from dehyst.cli.export import export
from dehyst.cli.printing import print_fit, print_insight, print_paper
from dehyst.cli.rig import rig
from dehyst.cli.terminal import echo, echo_json, progress_line, worded

if TYPE_CHECKING:
    from dehyst.model import Check


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(__version__, prog_name="dehyst")
@click.pass_context
def main(context: click.Context) -> None:
    """Take the hysteresis out of piezoelectric actuators."""
    leave_cleanly(context)


main.add_command(calibrate)
main.add_command(compare)
main.add_command(compensate)
main.add_command(excite)
main.add_command(export)
main.add_command(rig)


@main.command(cls=ManyToValidate)
@click.argument("records", nargs=-1, required=True, metavar="RECORD...", type=PATH)
@click.option("-o", "--output", type=PATH, help="Write the model here (JSON).")
@click.option(
    "--validate",
    multiple=True,
    type=PATH,
    metavar="RECORD...",
    help="Simulate these records only, all named up to the next option.",
)
@click.option("--report", type=PATH, help="Write a self-contained HTML report here.")
@click.option(
    "--method", type=click.Choice(["record", "breakpoints", "antisymmetric"]), default="record", show_default=True
)
@click.option(
    "--elements", type=int, metavar="N", help="Number of slip elements.  [default: 20; 10 for the paper's methods]"
)
@click.option(
    "--structure",
    type=click.Choice(["auto", "paper"]),
    default="auto",
    show_default=True,
    help="What held-out cycles ask for (transformer, graded elements, creep, ...), or the paper's class, for which "
    "--elements, --knots and another --method ask, too.",
)
@click.option("--refine", is_flag=True, help="Try to make the error of simulation smaller; slow.")
@click.option("--norm", type=click.Choice(["l1", "l2", "linf"]), default="l1", show_default=True)
@click.option("--knots", type=int, metavar="M", help="Knots of the spring.  [default: N + 1, at most 41]")
@click.option(
    "--slope-floor", type=float, default=0.2, show_default=True, help="Least slope of the spring / mean slope."
)
@click.option("--delay", type=float, metavar="SECONDS", help="Lag of the displacement.  [default: estimated]")
@click.option("--shared-datum", is_flag=True, help="No record zeroed its sensor anew.")
@click.option("--no-drift", is_flag=True, help="Do not set the drift of a record aside.")
@force_option
@columns_options
@json_option
def identify(
    records: tuple[Path, ...],
    output: Path | None,
    validate: tuple[Path, ...],
    report: Path | None,
    method: Any,
    elements: int | None,
    structure: Any,
    refine: bool,
    norm: Any,
    knots: int | None,
    slope_floor: float,
    delay: float | None,
    shared_datum: bool,
    no_drift: bool,
    as_json: bool,
    **columns: Any,
) -> None:
    """Identify an actuator from RECORDs of voltage and displacement."""
    from dehyst.identification import identify as run
    from dehyst.uncertainty import insight as trust

    refuse_overwriting([*records, *validate], output, report)
    tell = progress_line()
    tell("reading")
    training = read_records(records, columns)
    fit = run(
        training,
        validate=read_records(validate, columns),
        method=method,
        elements=elements,
        structure=structure,
        refine=refine,
        norm=norm,
        knots=knots,
        slope_floor=slope_floor,
        delay=delay,
        shared_datum=shared_datum,
        drift=not no_drift,
        throw=False,
        progress=tell,
    )
    refuse_replacing(output, report)
    fit = replace(fit, repairs=worded(fit.repairs), remarks=worded(fit.remarks), checks=_worded_checks(fit.checks))
    if output is not None and fit.actuator is not None:
        fit.actuator.save(output)
    if report is not None:
        from dehyst.report import write_report

        tell("drawing the report")
        told = None if fit.actuator is None else trust(fit.actuator, training, repeats=0)
        write_report(report, fit, command=shlex.join(["dehyst", *sys.argv[1:]]), insight=told)
    tell("")
    if as_json:
        echo_json(fit.as_dict())
    else:
        print_fit(fit, output, report)
    sys.exit(0 if fit.outcome.good else 1)


def _worded_checks(checks: tuple[Check, ...]) -> tuple[Check, ...]:
    sentences = worded(check.sentence for check in checks)
    return tuple(replace(check, sentence=said) for check, said in zip(checks, sentences, strict=True))


@main.command()
@click.argument("model", type=PATH)
@click.argument("voltage_file", metavar="VOLTAGE", type=PATH)
@click.option("-o", "--output", type=PATH, required=True, help="Write time, voltage and displacement here (CSV).")
@click.option("--lag", is_flag=True, help="Let the displacement lag the voltage as it was measured to do.")
@force_option
@start_option
@columns_options
@json_option
def simulate(
    model: Path, voltage_file: Path, output: Path, lag: bool, start: str, as_json: bool, **columns: Any
) -> None:
    """Displacement that a VOLTAGE file causes; adds displacement_um.

    The status is 1 if a voltage lies outside the model's limits by more than a tenth of their range.
    """
    from dehyst.records import read_table, write_columns

    refuse_overwriting([model, voltage_file], output)
    actuator = read_model(model)
    table = read_table(voltage_file, max_bytes=columns["max_bytes"])
    voltage = table.column("voltage", columns["voltage"])
    time = time_of_table(table, voltage.size, columns)
    motion = actuator.simulate(
        voltage,
        time=time.get("time_s") if actuator.needs_time else None,
        state=start_state(actuator, start),
        extrapolate=True,
    )
    displacement = lagging(motion.displacement, actuator, time) if lag else motion.displacement
    refuse_replacing(output)
    write_columns(output, {**time, "voltage_V": voltage, "displacement_um": displacement * 1e6})
    outside, far, said = outside_words(actuator, voltage)
    if actuator.delay and not lag:
        said.append(f"the displacement was measured to lag by {actuator.delay * 1e3:.4g} ms; --lag puts that in")
    result = {
        "samples": voltage.size,
        "outside": outside,
        "far_outside": far,
        "warnings": said,
        "state": state_dict(motion.state),
        "output": str(output),
    }
    conclude(as_json, result, f"{voltage.size} samples {came_from(actuator, start)}: {output}", said)
    sys.exit(1 if far else 0)


@main.command()
@click.option(
    "-o",
    "--output",
    type=PATH,
    default=Path("dehyst-demo"),
    show_default=True,
    help="Folder for the files: new, empty, or an earlier demo's.",
)
@click.option("--report/--no-report", default=True, help="Draw the report (needs matplotlib).")
@json_option
def demo(output: Path, report: bool, as_json: bool) -> None:
    """Record, identify, compensate and verify on an embedded virtual actuator."""
    from dehyst.studies import demo as journey

    journey.demand_folder(output)
    tell = progress_line()
    result = journey.run(tell)
    tell("writing")
    written = journey.write(result, output, report=report)
    tell("")
    numbers = result.as_dict()
    if as_json:
        echo_json({**numbers, "written": [str(path) for path in written]})
        return
    print_fit(result.fit, None, None)
    echo()
    echo("Tracking a path with nine reversals, largest error in % of the stroke")
    for name, key in (("linear feedforward (end-point ratio)", "linear"), ("dehyst", "compensated")):
        largest, rms = numbers[key]["largest_percent"], numbers[key]["rms_percent"]
        paper = numbers["paper"][f"{key}_largest_percent"]
        echo(f"  {name:<38}{largest:7.2f} %   RMS {rms:5.2f} %   (paper {paper:5.2f} %)")
    echo()
    echo(f"Written to {output}/: {', '.join(path.name for path in written)}")


@main.command()
@click.argument("model", type=PATH)
@click.argument("records", nargs=-1, required=True, metavar="RECORD...", type=PATH)
@click.option("--trajectory", type=PATH, help="How wrong may this path come out? A file with a displacement.")
@click.option("--wanted", metavar="NAME", help="Column of the trajectory's displacement.  [default: found by its name]")
@click.option("--limits", type=(float, float), metavar="LOW HIGH", help="Voltages allowed.  [default: the model's]")
@click.option("--seconds", type=float, help="Longest excitation to be advised.")
@click.option("--level", type=float, default=0.9, show_default=True, help="Of the intervals.")
@click.option("--repeats", type=int, default=100, show_default=True, help="Resampled records; 0: no intervals.")
@click.option("-o", "--output", type=PATH, help="Write the trajectory with its band here (CSV).")
@click.option("--report", type=PATH, help="Write a self-contained HTML page here.")
@force_option
@columns_options
@json_option
def insight(
    model: Path,
    records: tuple[Path, ...],
    trajectory: Path | None,
    wanted: str | None,
    limits: tuple[float, float] | None,
    seconds: float | None,
    level: float,
    repeats: int,
    output: Path | None,
    report: Path | None,
    as_json: bool,
    **columns: Any,
) -> None:
    """What RECORDs can and cannot tell of a MODEL identified from them; status 1 if there is something to beware of."""
    from dehyst._errors import ModelError
    from dehyst.records import write_columns
    from dehyst.uncertainty import insight as run

    if output is not None and trajectory is None:
        raise ModelError("-o: got no trajectory, need one to write its band; give --trajectory")
    if wanted is not None and trajectory is None:
        raise ModelError(f"--wanted: got '{wanted}' and no trajectory; give --trajectory, the file with this column")
    refuse_overwriting([model, *records, *([trajectory] if trajectory else [])], output, report)
    actuator = read_model(model)
    tell = progress_line()
    path, time = (None, {}) if trajectory is None else path_of(trajectory, wanted, columns["max_bytes"])
    if trajectory is not None and actuator.needs_time and not time:
        raise ModelError(f"{trajectory}: got no time column, need one, for this model depends on time; add time_s")
    found = run(
        actuator,
        read_records(records, columns),
        trajectory=path,
        time=time.get("time_s"),
        limits=limits,
        seconds=seconds,
        level=level,
        repeats=repeats,
        progress=tell,
    )
    refuse_replacing(output, report)
    if output is not None and found.band is not None:
        write_columns(output, {**time, **found.band.columns()})
    if report is not None:
        from dehyst.report import write_insight

        tell("drawing the page")
        write_insight(report, found, command=shlex.join(["dehyst", *sys.argv[1:]]))
    tell("")
    if as_json:
        echo_json(found.as_dict())
    else:
        print_insight(found, output, report)
    sys.exit(1 if found.warnings() else 0)


@main.command()
@click.option(
    "-o",
    "--output",
    type=PATH,
    default=Path("dehyst-paper"),
    show_default=True,
    help="Folder for the files: new, empty, or one of an earlier run.",
)
@json_option
def paper(output: Path, as_json: bool) -> None:
    """Redo the paper's experiment on a virtual actuator: every table and figure, beside the paper's numbers."""
    from dehyst.studies.paper import run as experiment

    experiment.demand_folder(output)
    tell = progress_line()
    result = experiment.run(tell)
    tell("drawing")
    written = experiment.write(result, output)
    tell("")
    if as_json:
        echo_json({**result.as_dict(), "written": [str(path) for path in written]})
        return
    print_paper(result, output)
