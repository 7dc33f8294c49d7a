"""`dehyst fleet`: thousands of records identified at once, and what their table shows."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dehyst.cli.common import (
    PATH,
    command_line,
    conclude,
    force_option,
    given,
    json_option,
    refuse_overwriting,
)
from dehyst.cli.output.terminal import note, progress_line
from dehyst.cli.record_files import decimal_option, sample_rate_option

if TYPE_CHECKING:
    from dehyst.fleet import Drifts, Fleet


@click.group()
def fleet() -> None:
    """Identify thousands of records at once, and look at all of them."""


@fleet.command()
@click.argument("dataset", type=PATH)
@click.option("-o", "--output", type=PATH, required=True, metavar="TABLE.parquet", help="Write the table here.")
@click.option("--by", metavar="NAMES", help="Keys of a record, as serial,session.  [default: its number or name]")
@click.option(
    "--structure",
    type=click.Choice(["maxwell_slip", "auto"]),
    default="maxwell_slip",
    show_default=True,
    help="maxwell_slip: slip elements and a spring. auto: parts selected by cross-validation, much slower.",
)
@click.option("--elements", type=int, metavar="N", help="Number of slip elements, maxwell_slip.  [default: 20]")
@click.option("--norm", type=click.Choice(["l1", "l2", "linf"]), default="l1", show_default=True)
@click.option("--delay", type=float, metavar="SECONDS", help="Lag of the displacements.  [default: estimated]")
@click.option("--no-drift", is_flag=True, help="Do not estimate and remove the drift of a record.")
@click.option("--prior", type=PATH, metavar="TABLE.parquet", help="An identified fleet, for few or noisy data.")
@click.option("--jobs", type=click.IntRange(1), metavar="N", help="Processes.  [default: one a processor]")
@click.option("--dask", metavar="ADDRESS", help="Workers of a Dask scheduler, tcp://HOST:PORT.")
@click.option("--time-limit", type=float, metavar="SECONDS", help="Most time for a record; then it is lost.")
@click.option("--resume", is_flag=True, help="Go on with a run that did not end; compute changed records again.")
@click.option("--time", metavar="NAME", help="Column of the time.  [default: found by its name]")
@click.option("--voltage", metavar="NAME", help="Column of the voltage.  [default: found by its name]")
@click.option("--displacement", metavar="NAME", help="Column of the displacement.  [default: found by its name]")
@click.option("--voltage-scale", metavar="SCALE", help="Of an amplifier's monitor, e.g. '100 V/V'.")
@click.option("--displacement-scale", metavar="SCALE", help="Of a sensor's voltage, e.g. '10 um/V'.")
@sample_rate_option
@decimal_option
@force_option
@json_option
def identify(
    dataset: Path,
    output: Path,
    by: str | None,
    no_drift: bool,
    prior: Path | None,
    jobs: int | None,
    dask: str | None,
    time_limit: float | None,
    resume: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Identify every record of DATASET: a Parquet file (a row group a record), a Zarr store or a folder of files.

    The table has one row a record. Until it is written, each record has a file of its own in TABLE.parquet.parts: a run
    that was stopped goes on with --resume. The exit status is 1 if a record was lost.
    """
    from dehyst.fleet import FleetOptions, identify_fleet
    from dehyst.fleet.run import refuse_inside

    refuse_overwriting([path for path in (dataset, prior) if path is not None], output)
    refuse_inside(dataset, output)
    remarks: list[str] = []

    def remark(sentence: str) -> None:
        # At once: a run may take hours.
        remarks.append(sentence)
        note(sentence)

    try:
        done = identify_fleet(
            dataset,
            output,
            by=_names(by),
            options=FleetOptions(drift=not no_drift, **options),
            prior=prior,
            jobs=jobs,
            dask=dask,
            time_limit=time_limit,
            resume=resume,
            progress=progress_line(),
            remark=remark,
        )
    except (KeyboardInterrupt, SystemExit):
        note(f"stopped; what is done is in {output}.parts: give the same command with --resume to go on")
        raise
    tally = Counter(row["outcome"] for row in done.rows)
    result = {"records": len(done), **tally, "output": str(output), "cpu_s": _sum(done, "cpu_s"), "remarks": remarks}
    conclude(as_json, result, _summary(done, tally, output), [])
    sys.exit(1 if tally["lost"] else 0)


def _names(text: str | None) -> tuple[str, ...]:
    return () if text is None else tuple(part.strip() for part in text.split(","))


def _sum(done: Fleet, column: str) -> float:
    return float(sum(row[column] or 0.0 for row in done.rows))


def _summary(done: Fleet, tally: Counter[str], output: Path) -> list[str]:
    lines = [f"{len(done)} records: {', '.join(f'{count} {outcome}' for outcome, count in tally.most_common())}"]
    lines.append(f"table: {output}")
    if tally["lost"]:
        lines.append("lost records are tried again by the same command with --resume")
    return [*lines, f"next: dehyst fleet report {output} -o fleet.html"]


def _drift_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add what is one actuator, what orders its sessions, and the cost that is allowed."""
    for option in (
        click.option(
            "--goal",
            type=click.FloatRange(min=0, min_open=True),
            default=1.0,
            show_default=True,
            metavar="PERCENT",
            help="Cost, in % of the stroke, above which an actuator is to be recalibrated in any case.",
        ),
        click.option(
            "--over",
            default="session",
            show_default=True,
            metavar="NAME",
            help="Key of its sessions, oldest first: 2 is before 10.",
        ),
        click.option("--by", default="serial", show_default=True, metavar="NAME", help="Key of one actuator."),
    ):
        command = option(command)
    return command


@fleet.command()
@click.argument("table", type=PATH, metavar="TABLE.parquet")
@click.option("-o", "--output", type=PATH, metavar="PAGE.html", help="Write a self-contained page here.")
@click.option(
    "--threshold",
    type=click.FloatRange(min=0, min_open=True),
    default=5.0,
    show_default=True,
    metavar="Z",
    help="Robust standard deviations from the fleet's median beyond which a record is listed.",
)
@_drift_options
@force_option
@json_option
def report(table: Path, output: Path | None, threshold: float, as_json: bool, **sessions: Any) -> None:
    """Show outliers, refused records with reasons, duplicates, distributions and what has aged of an identified fleet.

    What has aged, as dehyst fleet drift shows it, is left out if the table has no sessions.
    """
    from dehyst.fleet import findings_of, load
    from dehyst.fleet.page import write_fleet_page

    refuse_overwriting([table], output)
    loaded = load(table)
    found, drifts = findings_of(loaded, threshold=threshold), _drifts(loaded, sessions)
    if output is not None:
        write_fleet_page(output, found, drifts=drifts, command=command_line())
    written = [] if output is None else [f"page: {output}"]
    result = {**found.as_dict(), "drift": None if drifts is None else drifts.as_dict()}
    lines = found.lines() if drifts is None else [*drifts.lines(), "", *found.lines()]
    conclude(as_json, result, [*lines, *written], [] if drifts is None else drifts.remarks)


def _drifts(table: Fleet, sessions: dict[str, Any]) -> Drifts | None:
    """Return what ageing costs; None if the table has no sessions and none were asked for."""
    from dehyst._errors import FileFormatError
    from dehyst.fleet import drifts_of

    try:
        return drifts_of(table, **sessions)
    except FileFormatError:
        if given(*sessions):
            raise
    return None


@fleet.command()
@click.argument("table", type=PATH, metavar="TABLE.parquet")
@_drift_options
@json_option
def drift(table: Path, by: str, over: str, goal: float, as_json: bool) -> None:
    """Show what keeping the oldest model of each actuator costs at its later sessions.

    The exit status is 1 if an actuator is to be recalibrated: its last cost is above --goal, or its costs are out of
    their limits.
    """
    from dehyst.fleet import drifts_of, load

    found = drifts_of(load(table), by=by, over=over, goal=goal)
    conclude(as_json, found.as_dict(), found.lines(), found.remarks)
    sys.exit(1 if found.recalibrate else 0)
