"""`compare`: dehyst's model, a table, a straight line and the models of plug-ins on the same records."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from dehyst.operations.command import INPUT, REPORT, argument, command, option
from dehyst.operations.files import COLUMNS, RECORD, Columns
from dehyst.operations.run import Result, Run, files
from dehyst.records import read
from dehyst.report import write_report
from dehyst.trust import ModelComparison
from dehyst.trust import compare as run_comparison
from dehyst.trust.comparison import OURS, ModelScore


@command("compare", details=True)
def compare(
    run: Run,
    records: tuple[Path, ...] = argument(nargs=-1),
    validate: tuple[Path, ...] = option("Held-out records; default: the last quarter of each.", INPUT, multiple=True),
    report: Path | None = REPORT,
    columns: Columns = COLUMNS,
) -> Result:
    """Compare dehyst's model with a table of two branches, a straight line and models of plug-ins, fitted to RECORDS.

    Without --validate, the last quarter of each record is held out. The status is 1 if dehyst's own model fails.
    """
    columns.demand(RECORD, "here")
    run.progress("reading")
    training, held_out = ([read(path, columns) for path in paths] for paths in (records, validate))
    found = run_comparison(training, validate=held_out, progress=run.progress)
    if report is not None:
        write_report(report, found, command=run.command)
    good = not any(row.failure for row in found.rows if row.name == OURS)
    lines, more = ([*_lines(found, full=full), *files(Report=report)] for full in (False, True))
    return Result(found.as_dict(), lines, more, good=good)


def _lines(found: ModelComparison, *, full: bool) -> Iterator[str]:
    """Yield the best model and its lead, a row for each model if `full` or if none is best, then the failures."""
    if found.best is not None:
        yield str(found.best)
    if full or found.best is None:
        width = max(len("model"), *(len(row.name) for row in found.rows))
        groups = ["held out", "no constant", "training"]
        yield f"{'':<{width}}" + "".join(f"  {group:^15}" for group in groups)
        heads = len(groups) * f"  {'largest':>8}{'RMS':>7}"
        yield f"{'model':<{width}}{heads}{'fit, s':>9}"
        yield from (_line(row, width) for row in found.rows)
        yield f"Errors in % of the stroke, {found.stroke * 1e6:.4g} um, of the record with the largest error; held out"
        yield "and training: with one free constant for each record."
        yield found.note
    yield from (f"{row.name}: {row.failure}" for row in found.rows if row.failure)
    if found.hint:
        yield found.hint


def _line(row: ModelScore, width: int) -> str:
    training, held_out = row.worst("training"), row.worst("validation")
    pairs = [
        None if held_out is None else (held_out.largest, held_out.rms),
        None if held_out is None else (held_out.largest_without, held_out.rms_without),
        None if training is None else (training.largest, training.rms),
    ]
    cells = "".join(f"  {'-':>8}{'-':>7}" if p is None else f"  {p[0]:>8.3f}{p[1]:>7.3f}" for p in pairs)
    return f"{row.name:<{width}}{cells}" + (f"{'-':>9}" if row.seconds is None else f"{row.seconds:>9.2f}")
