"""`dehyst compare`: the models of dehyst and every baseline on the same records."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dehyst._io import finite
from dehyst.cli.common import (
    PATH,
    ManyToValidate,
    command_line,
    echo_files,
    force_option,
    json_option,
    refuse_overwriting,
    refuse_unused,
    report_option,
)
from dehyst.cli.output.terminal import echo, echo_json, progress_line
from dehyst.cli.record_files import COLUMNS, columns_options, read_records

if TYPE_CHECKING:
    from dehyst.baselines import ModelComparison
    from dehyst.baselines.comparison import ModelScore

_TRUTHS = ["play", "creep", "preisach", "boucwen"]


@click.command(cls=ManyToValidate)
@click.argument("records", nargs=-1, metavar="[RECORD]...", type=PATH)
@click.option(
    "--validate", multiple=True, type=PATH, metavar="RECORD...", help="Held-out records, all up to the next option."
)
@click.option(
    "--lead",
    type=float,
    default=0.0,
    metavar="SECONDS",
    show_default=True,
    help="Lead-in of each held-out record: it does not count, but a model may take its constant from it.",
)
@click.option(
    "--truth",
    "truths",
    multiple=True,
    type=click.Choice([*_TRUTHS, "all"]),
    help="Track on this virtual actuator with models fitted to its own records; may be repeated.",
)
@click.option("--only", multiple=True, metavar="MODEL", help="This model only; may be repeated.  [default: all]")
@click.option("-o", "--output", type=PATH, help="Write every figure here (JSON).")
@report_option
@force_option
@columns_options
@json_option
def compare(
    records: tuple[Path, ...],
    validate: tuple[Path, ...],
    lead: float,
    truths: tuple[str, ...],
    only: tuple[str, ...],
    output: Path | None,
    report: Path | None,
    as_json: bool,
    **columns: Any,
) -> None:
    """Compare dehyst's model with every baseline: fitted to RECORDs, scored on held-out ones and virtual actuators.

    Without a RECORD, those of the first --truth are used. Status 1 if dehyst's own model fails.
    """
    from dehyst._io import write_json
    from dehyst.baselines import compare as run
    from dehyst.baselines.comparison import OURS

    files = ("validate", *COLUMNS) if records or validate else ()
    beside = "without --validate" if files else "without a RECORD"
    refuse_unused(beside, "truths", "only", "output", "report", "force", *files, *(("lead",) if validate else ()))
    refuse_overwriting([*records, *validate], output, report)
    chosen = _chosen(only)
    named = _TRUTHS if "all" in truths else list(dict.fromkeys(truths))
    progress = progress_line()
    progress("reading")
    training, held_out = read_records(records, columns), read_records(validate, columns)
    comparison = run(training, validate=held_out, truths=named, lead=lead, models=chosen, progress=progress)
    if output is not None:
        write_json(output, {"format": "dehyst-comparison", "version": 1, **finite(comparison.as_dict())})
    if report is not None:
        from dehyst.report import write_comparison

        write_comparison(report, comparison, command=command_line())
    progress("")
    if as_json:
        echo_json(comparison.as_dict())
    else:
        print_comparison(comparison, output, report)
    sys.exit(1 if any(row.failure for row in comparison.rows if row.name == OURS) else 0)


def _chosen(only: tuple[str, ...]) -> dict[str, Any]:
    """Return the models of those names, in capitals or not."""
    from dehyst._errors import IdentifyError
    from dehyst.baselines.comparison import contenders

    known = contenders()
    if not only:
        return known
    names = {name.casefold(): name for name in known}
    for name in only:
        if name.casefold() not in names:
            raise IdentifyError(f"no model '{name}'", argument="only", hint=f"try {', '.join(known)}")
    return {names[name.casefold()]: known[names[name.casefold()]] for name in only}


def print_comparison(comparison: ModelComparison, output: Path | None, report: Path | None) -> None:
    """Print a row for each model, then what failed."""
    width = max(len("model"), *(len(row.name) for row in comparison.rows))
    groups = ["training", "held out", "no constant", *(f"track {name}" for name in comparison.truths)]
    echo(f"{'':<{width}}" + "".join(f"  {group:^15}" for group in groups) + f"{'':>9}{'ns a sample':>18}")
    echo(
        f"{'model':<{width}}" + len(groups) * f"  {'largest':>8}{'RMS':>7}" + f"{'fit, s':>9}"
        f"{'simulate':>10}{'invert':>8}{'numbers':>9}"
    )
    for row in comparison.rows:
        echo(_line(row, comparison.truths, width))
    stroke = f"{comparison.stroke * 1e6:.4g} um"
    echo()
    echo(
        f"Errors in % of the stroke, {stroke}, of the record with the largest error. Training and held out: with one "
        "free constant for each record."
    )
    if comparison.note:
        echo(comparison.note)
    for row in comparison.rows:
        if row.failure:
            echo(f"{row.name}: {row.failure}")
    echo_files(Figures=output, Report=report)


def _line(row: ModelScore, truths: tuple[str, ...], width: int) -> str:
    training, held_out = row.worst("training"), row.worst("validation")
    pairs: list[tuple[float, float] | None] = [
        None if training is None else (training.largest, training.rms),
        None if held_out is None else (held_out.largest, held_out.rms),
        None if held_out is None else (held_out.largest_without, held_out.rms_without),
        *(None if (track := row.tracking.get(name)) is None else (track.largest, track.rms) for name in truths),
    ]
    cells = "".join(f"  {'-':>8}{'-':>7}" if p is None else f"  {p[0]:>8.3f}{p[1]:>7.3f}" for p in pairs)
    last = (
        (row.seconds, ">9.2f", 9),
        (row.simulate, ">10.1f", 10),
        (row.compensate, ">8.1f", 8),
        (row.parameters, ">9", 9),
    )
    return f"{row.name:<{width}}{cells}" + "".join(f"{'-':>{w}}" if x is None else f"{x:{form}}" for x, form, w in last)
