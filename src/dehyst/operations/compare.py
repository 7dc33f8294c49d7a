"""`compare`: the models of dehyst and every baseline on the same records."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Literal

from dehyst._errors import IdentifyError
from dehyst._io import finite, write_json
from dehyst.baselines import ModelComparison
from dehyst.baselines import compare as run_comparison
from dehyst.baselines.comparison import OURS, ModelScore, contenders
from dehyst.operations.declaration import Input, Only, Output, beside, operation
from dehyst.operations.files import AS_FOUND, RECORD, Columns
from dehyst.operations.run import Result, Run, files
from dehyst.report import write_comparison

_TRUTHS = ("play", "creep", "preisach", "boucwen")


@operation(run_comparison)
def compare(
    run: Run,
    records: tuple[Input, ...] = (),
    *,
    validate: tuple[Input, ...] = (),
    lead: Annotated[float, beside("validate")] = 0.0,
    truths: tuple[Literal["play", "creep", "preisach", "boucwen", "all"], ...] = (),
    only: tuple[str, ...] = (),
    output: Output | None = None,
    report: Output | None = None,
    columns: Annotated[
        Columns, Only(lambda given: given.get("records") or given.get("validate"), "without a RECORD")
    ] = AS_FOUND,
) -> Result:
    """Compare dehyst's model with every baseline, fitted to RECORDS, on held-out records and virtual actuators.

    Without RECORDS, records of the first of --truths are used. The status is 1 if dehyst's own model fails.

    Parameters
    ----------
    truths
        Score tracking on this virtual actuator, with models fitted to its own records; may be repeated.
    only
        Compare only this model; may be repeated; default: all.
    output
        Write every figure here (JSON).
    report
        Write a self-contained HTML page here.
    """
    columns.demand(RECORD, "here")
    named = _TRUTHS if "all" in truths else tuple(dict.fromkeys(truths))
    run.progress("reading")
    training, held_out = columns.records(records), columns.records(validate)
    found = run_comparison(
        training, validate=held_out, truths=named, lead=lead, models=_chosen(only), progress=run.progress
    )
    if output is not None:
        write_json(output, {"format": "dehyst-comparison", "version": 1, **finite(found.as_dict())})
    if report is not None:
        write_comparison(report, found, command=run.command)
    good = not any(row.failure for row in found.rows if row.name == OURS)
    return Result(found.as_dict(), [*_lines(found), *files(Figures=output, Report=report)], good=good)


def _chosen(only: tuple[str, ...]) -> dict[str, Any]:
    """Return the models with these names, regardless of case."""
    known = contenders()
    names = {name.casefold(): name for name in known}
    for name in only:
        if name.casefold() not in names:
            raise IdentifyError(f"no model '{name}'", argument="only", hint=f"try {', '.join(map(repr, known))}")
    return {names[name.casefold()]: known[names[name.casefold()]] for name in only} or known


def _lines(found: ModelComparison) -> Iterator[str]:
    """Yield a row for each model, then the failures."""
    width = max(len("model"), *(len(row.name) for row in found.rows))
    groups = ["training", "held out", "promised", "no constant", *(f"track {name}" for name in found.truths)]
    yield f"{'':<{width}}" + "".join(f"  {group:^15}" for group in groups) + f"{'':>9}{'ns a sample':>18}"
    heads = len(groups) * f"  {'largest':>8}{'RMS':>7}"
    yield f"{'model':<{width}}{heads}{'fit, s':>9}{'simulate':>10}{'invert':>8}{'numbers':>9}"
    yield from (_line(row, found.truths, width) for row in found.rows)
    yield ""
    yield (
        f"Errors in % of the stroke, {found.stroke * 1e6:.4g} um, of the record with the largest error. Training and "
        "held out: with one free constant for each record. Promised: the expected error on the held-out records; for "
        "dehyst from its identification, for others by the same rule from their training errors."
    )
    if found.note:
        yield found.note
    yield from (f"{row.name}: {row.failure}" for row in found.rows if row.failure)


def _line(row: ModelScore, truths: tuple[str, ...], width: int) -> str:
    training, held_out = row.worst("training"), row.worst("validation")
    pairs: list[tuple[float, float] | None] = [
        None if training is None else (training.largest, training.rms),
        None if held_out is None else (held_out.largest, held_out.rms),
        row.promised,
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
