"""`insight`, `check` and `update`: how far to trust a model, what to record next, and whether it is still true."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from dehyst._errors import FileFormatError
from dehyst._io import unwritten, write_atomically
from dehyst.control import plan_path
from dehyst.operations.axes import AxesModel, OfAxes, limits_option, slew_option
from dehyst.operations.command import CONTINUED, INPUT, REPORT, Values, argument, command, number, option, output
from dehyst.operations.files import AS_FOUND, COLUMNS, Columns, columns_in
from dehyst.operations.paths import read_path
from dehyst.operations.run import Result, Run, files
from dehyst.records import percent, read_table
from dehyst.report import write_report
from dehyst.trust import Recheck, Update
from dehyst.trust import check as check_one
from dehyst.trust import insight as insight_one
from dehyst.trust import update as update_one


def _of_path(given: Values) -> str:
    return "" if "trajectory" in given else "without --trajectory"


@command("insight", details=True)
def insight(
    run: Run,
    model: Path = argument(),
    records: tuple[Path, ...] = argument(nargs=-1),
    trajectory: Path | None = option("Show the promise of the path in this file.", INPUT),
    zero: float | None = number("Zero of the trajectory, as in dehyst compensate.", _of_path),
    limits: OfAxes = limits_option("Voltages of the trajectory [V]; default: those of the model.", _of_path),
    slew_rate: OfAxes = slew_option("Largest slew rate of the trajectory [V/s].", _of_path),
    report: Path | None = REPORT,
    columns: Columns = COLUMNS,
) -> Result:
    """Assess a MODEL by the RECORDS that it was identified from: its promise, and what to record next.

    A trajectory is read as by dehyst compensate; a name in --columns counts for the file that has it. The status is 1
    if there is a warning, for instance if a path cannot be followed.
    """
    known, plan = AxesModel.read(run, model), None
    if trajectory is not None:
        of_path = columns
        if columns != AS_FOUND and not known.several:
            tables = [read_table(path, columns) for path in (records[0], trajectory)]
            columns, of_path = columns_in(columns, *tables), columns_in(columns, *reversed(tables))
        of_path = replace(of_path, voltage=None, hold=None, join=None)
        path, warmth, clock = read_path(known, trajectory, of_path, zero)
        when = {"time": clock.get("time_s"), "temperature": warmth}
        plan = known.planned(plan_path, path, known.of("limits", limits), known.slews(slew_rate), **when)
    training = [known.record(path, columns) for path in records]
    assessed: Any = insight_one(known.model, training, plan=plan, progress=run.progress)
    if report is not None:
        run.progress("drawing the page")
        write_report(report, assessed, command=run.command)
    found = getattr(assessed, "insights", (assessed,))
    head = assessed.lines() if known.several else []
    lines, more = (
        [*head, *known.headed(part.summary(full).split("\n") for part in found), *files(Report=report)]
        for full in (False, True)
    )
    return Result(assessed.as_dict(), lines, more, good=not any(part.warnings() for part in found))


@command("check")
def check(
    run: Run,
    model: Path = argument(),
    record: Path = argument(),
    goal: float | None = number("Largest allowed error [% of the stroke]; default: the model's, or 1."),
    log: Path | None = option("Append a row for each axis to this table (CSV); --force begins a new one.", CONTINUED),
    columns: Columns = COLUMNS,
) -> Result:
    """Check whether a MODEL is still true by a new RECORD of its actuator: its present error, and what has changed.

    The status is 0 if the model is still true, 1 if not.
    """
    before = b"" if log is None else _read_log(log, again=run.force)
    known = AxesModel.read(run, model)
    whole: Any = check_one(known.model, known.record(record, columns), goal=goal)
    found: Sequence[Recheck] = getattr(whole, "rechecks", (whole,))
    if log is not None:
        _append_checks(log, before, dict(zip(known.axes, found, strict=True)))
    known.remark([recheck.mismatch] if recheck.mismatch else [] for recheck in found)
    lines = known.headed(map(_check_lines, found))
    if known.several:
        lines.append("Coupling: changed" if whole.changes else "Coupling: as in the model")
        lines += [f"  - {sentence}" for sentence in whole.changes]
    return Result(whole.as_dict(), [*lines, *files(Log=log)], good=whole.good)


def _check_lines(recheck: Recheck) -> Iterator[str]:
    """Yield the judgement, the changes that count, and the remarks."""
    yield recheck.sentence
    if not recheck.mismatch:
        yield from recheck.change_sentences()
        yield from (f"  - {remark}" for remark in recheck.remarks)


_LOGGED = "date,record,model,axis,standing,error_percent,rms_percent,goal_percent,promised_percent,promised_rms_percent"
_LOGGED += ",promise_kept,changes"


def _read_log(path: Path, *, again: bool) -> bytes:
    """Return the table of checks, or the header of a new one; raise `FileFormatError` for any other file."""
    try:
        before = (path.read_bytes() if path.exists() else b"") or _LOGGED.encode()
    except OSError as error:
        raise unwritten(path, error) from error
    if before.split(b"\n")[0].rstrip() != _LOGGED.encode():
        raise FileFormatError(f"{path}: is not a table that --log has written; give another name with --log")
    return _LOGGED.encode() if again else before


def _append_checks(path: Path, before: bytes, checks: Mapping[str, Recheck]) -> None:
    """Write a table of checks with another row for the check of each axis."""
    stream, now = io.StringIO(), f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}"
    csv.writer(stream, lineterminator="\n").writerows(_row(now, axis, check) for axis, check in checks.items())
    write_atomically(path, before.rstrip(b"\n") + b"\n" + stream.getvalue().encode())


def _row(now: str, axis: str, check: Recheck) -> list[str]:
    """Return the cells of a check; the cell of an unknown number is empty."""
    found, promise = (check.without_noise, check.rms_without_noise), check.promise
    bounds = () if promise is None else (promise.largest, promise.rms)
    errors, promised = ([f"{percent(part, check.stroke):.4g}" for part in parts] for parts in (found, bounds))
    promised = [*promised, "yes" if check.kept else "no"] if promised else [""] * 3
    changes = (f"{new.name} {'-' if new.value < 0 else '+'}{new.amount(check.stroke)}" for new in check.changed)
    known = [now, check.record, check.model, axis, check.standing.value]
    return [*known, *errors, f"{check.goal:.4g}", *promised, "; ".join(changes)]


@command("update")
def update(
    run: Run,
    model: Path = argument(),
    record: Path = argument(),
    output: Path = output("Write the new model here (JSON)."),
    goal: float | None = number("Largest allowed error [% of the stroke]; default: the model's, or 1."),
    columns: Columns = COLUMNS,
) -> Result:
    """Update a MODEL from a new RECORD of its actuator, even of a single loop, and report what has changed.

    If no updated model predicts the record better, the output is the old model, with a wider promise if it did not keep
    its own. A record that clearly belongs to another actuator is refused. The coupling of several axes is checked, not
    changed. The status is 0 if the error on held-out parts and the promise are within the goal, else 1.
    """
    known = AxesModel.read(run, model)
    found: Any = update_one(known.model, known.record(record, columns), goal=goal)
    (found.stage if known.several else found.actuator).save(output)
    lines = known.headed(map(_update_lines, getattr(found, "updates", (found,))))
    run.remarks += getattr(found, "coupling_changes", ())
    return Result(found.as_dict(), [*lines, *files(Model=output)], good=found.good)


def _update_lines(update: Update) -> Iterator[str]:
    """Yield the result, the promise, and the changes."""
    yield update.sentence
    if update.promise is not None:
        yield from update.promise.lines(update.recheck.goal)
    yield from update.sentences()
    yield from (f"  - {remark}" for remark in update.recheck.remarks)
