"""`identify`: an actuator, or several coupled ones, from records of voltage and displacement."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

import dehyst._validation as check
from dehyst._errors import IdentifyError
from dehyst._text import escaped
from dehyst.identification import Deadline, Fit, StageFit
from dehyst.identification import identify as identify_one
from dehyst.model import Actuator, Stage, with_identification
from dehyst.operations.command import INPUT, REPORT, Values, argument, beside, command, flag, number, option, output
from dehyst.operations.files import AS_FOUND, COLUMNS, RECORD, Columns
from dehyst.operations.paths import reason_of
from dehyst.operations.run import Result, Run, files
from dehyst.records import read
from dehyst.report import write_report
from dehyst.trust import insight

# Number of remarks beside the promise; the others need --verbose.
_REMARKS = 2


def _of_several(given: Values) -> str:
    return "" if len(given.get("records", ())) + len(given.get("validate", ())) > 1 else "on one record"


# Arguments of `dehyst.identify`.
_SETTINGS = {
    "structure": option(
        "auto: by the error on held-out time. maxwell_slip: as in Yeh's paper.",
        click.Choice(["auto", "maxwell_slip"]),
        default="auto",
    ),
    "goal": number("Largest allowed error [% of the stroke].", default=1.0),
    "sensor_lag": number("Time constant of the sensor's filter [s]."),
    "lag_of": option("What lags in the records, if it is known.", click.Choice(["actuator", "sensor"])),
    "delay": number("Lag of the displacement [s]; default: estimated."),
    "drift": option("Remove a drift of each record.", words="--drift/--no-drift", default=True),
    "shared_zero": flag("The sensor kept its zero in all records.", _of_several, words="--shared-zero"),
}


@command("identify", _SETTINGS, details=True)
def identify(
    run: Run,
    records: tuple[Path, ...] = argument(nargs=-1),
    output: Path | None = output("Write the model here (JSON).", required=False),
    validate: tuple[Path, ...] = option("Held-out records, which are only simulated.", INPUT, multiple=True),
    report: Path | None = REPORT,
    time_limit: float | None = number("Time after which the search ends [s]."),
    slew_rate: float | None = number("Largest slew rate [V/s] of later paths; the model keeps it.", beside("output")),
    columns: Columns = COLUMNS,
    **settings: Any,
) -> Result:
    """Identify an actuator from RECORDS of voltage and displacement; with axes in --columns, several coupled actuators.

    Ctrl-C ends the search: the best model so far is completed and written, and the status is 1. A second Ctrl-C stops
    at once. With several axes Ctrl-C writes nothing.
    """
    columns.demand(RECORD, "on records", axes=bool(columns.axes))
    check.Numbers(positive=True, optional=True, error=IdentifyError)(slew_rate, "slew_rate")
    deadline = Deadline(time_limit)
    run.progress("reading")
    training, held_out = ([read(path, columns) for path in paths] for paths in (records, validate))
    settings |= {"validate": held_out, "progress": run.progress}
    with nullcontext() if columns.axes else run.ended_by(lambda: deadline.end("Ctrl-C", leave_step=True)):
        fit = identify_one(training, time_limit=deadline, **settings)
    if output is not None:
        _with_defaults(fit.model, columns, slew_rate).save(output)
    if report is not None:
        run.progress("drawing the report")
        quick = deadline.ended or not isinstance(fit, Fit)
        found = None if quick else insight(fit.actuator, training)
        write_report(report, fit, command=run.command, insight=found)
    where = "was printed" if output is None else f"is in {output}"
    run.remarks += [f"stopped by Ctrl-C; the best model so far {where}"] * deadline.ended
    # A wrong unit shows in the ranges.
    written = [*(repr(record)[1:-1] for record in training), *files(Model=output, Report=report)]
    lines, more = [*_answer(fit), *written], [*fit.summary(full=True).split("\n"), *written]
    return Result(fit.as_dict(), lines, more, good=fit.good and not deadline.ended)


def _with_defaults(model: Actuator | Stage, columns: Columns, slew_rate: float | None) -> Actuator | Stage:
    """Return a model that keeps the columns of its records, unless they are in several files, and a slew rate."""
    if isinstance(model, Stage):
        kept = (with_identification(axis, allowed_slew_rate=slew_rate) for axis in model.actuators)
        return replace(model, actuators=tuple(kept))
    text = "" if columns.join is not None or columns == AS_FOUND else str(columns)
    return with_identification(model, columns=text, allowed_slew_rate=slew_rate)


def _answer(fit: Fit | StageFit) -> list[str]:
    """Return the promise of a good fit and its first reservations and remarks; for any other fit, all reasons."""
    brief = fit.summary().split("\n")
    if not isinstance(fit, Fit) or not fit.good:
        return brief
    cut = len(fit.options["cut"]) > 0
    first = fit.remarks[:1] if cut else reason_of(fit.promise.promise, fit.actuator.identification.validity)
    remarks = (*first, *fit.promise.reservations, *fit.remarks[cut:])
    return [brief[0], *(f"  - {escaped(remark)}" for remark in remarks[:_REMARKS])]
