"""`insight`, `check` and `update`: how far to trust a model, what to record next, and whether it is still true."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from dehyst._errors import ModelError
from dehyst.control import PathPlan, plan_path
from dehyst.model import needs_time
from dehyst.operations.axes import AxesModel, AxisText, is_stage
from dehyst.operations.check_log import append_checks, read_log
from dehyst.operations.command import (
    CONTINUED,
    INPUT,
    NUMBER,
    Only,
    Parsed,
    Values,
    command,
    number,
    option,
    output,
    page,
)
from dehyst.operations.files import RECORD, Columns, clock_of, columns_option
from dehyst.operations.paths import Zero, reach_remarks, temperature_of, zero_of_path
from dehyst.operations.run import Result, Run, files
from dehyst.operations.start import Start, starts_of
from dehyst.records import read_table
from dehyst.report import write_insight
from dehyst.trust import Insight, Recheck, StageInsight, Update
from dehyst.trust import check as check_one
from dehyst.trust import insight as insight_one
from dehyst.trust import update as update_one
from dehyst.trust.changes import NOUNS


def _single(given: Values) -> bool:
    return not is_stage(given["model"])


_of_one = Only(_single, "with a model of several axes")
_of_path = Only(lambda given: _single(given) and "trajectory" in given, "without --trajectory, on a model of one axis")


@command("insight", details=True)
@click.argument("model", type=INPUT)
@click.argument("records", type=INPUT, nargs=-1, required=True)
@option(
    "--trajectory", type=INPUT, only=_of_one, help="Show the promise of the path in this file, as compensate plans it."
)
@option("--zero", type=Parsed(Zero), only=_of_path, help="Zero of the trajectory, as in compensate.")
@option("--start", type=Parsed(Start), only=_of_path, help="State before the trajectory, as in compensate.")
@option(
    "--limits", type=(NUMBER, NUMBER), metavar="LOW HIGH", help="Voltages allowed [V]; default: those of the model."
)
@option("--slew-rate", type=AxisText("V/S|none", none=True), only=_of_path, help="Of the trajectory, as in compensate.")
@page()
@columns_option
def insight(
    run: Run,
    model: Path,
    records: tuple[Path, ...],
    trajectory: Path | None,
    zero: Zero | None,
    start: Start | None,
    limits: tuple[float, float] | None,
    slew_rate: str | None,
    report: Path | None,
    columns: Columns,
) -> Result:
    """Assess a MODEL by the RECORDS that it was identified from: its promise, and what to record next.

    The status is 1 if there is a warning.
    """
    known = AxesModel.read(run, model)
    keys = RECORD if trajectory is None else (*RECORD, "wanted", "temperature")
    known.demand(columns, keys, "on records")
    training = [known.record(run, path, columns) for path in records]
    asked: dict[str, Any] = {"limits": limits, "progress": run.progress}
    if known.stage is not None:
        whole = insight_one(known.stage, training, **asked)
        assessed: Insight | StageInsight = whole
        found, fields, head = whole.insights, whole.as_dict(), list(whole.lines())
    else:
        plan = None if trajectory is None else _planned(run, known, trajectory, columns, limits, slew_rate, zero, start)
        alone = insight_one(known.actuators[0], training, plan=plan, **asked)
        assessed, found, fields, head = alone, (alone,), alone.as_dict(), []
    if report is not None:
        run.progress("drawing the page")
        write_insight(report, assessed, command=run.command)

    def lines(*, full: bool) -> list[str]:
        parts = zip(known.axes, found, strict=True)
        each = [[*(["", f"Axis {axis}"] if axis else []), *part.summary(full).split("\n")] for axis, part in parts]
        return [*head, *(line for own in each for line in own), *files(Report=report)]

    good = not any(part.warnings() for part in found)
    return Result(fields, lines(full=False), lines(full=True), good=good)


def _planned(
    run: Run,
    known: AxesModel,
    trajectory: Path,
    columns: Columns,
    limits: tuple[float, float] | None,
    slew_rate: str | None,
    zero: Zero | None,
    start: Start | None,
) -> PathPlan:
    """Return the plan of a trajectory, as compensate makes it."""
    (actuator,) = known.actuators
    table = read_table(trajectory, columns)
    # Columns are those of the records, and of the path where it has them.
    own, clock = (name if name in table.names else None for name in (columns.displacement, columns.time))
    path = table.column("displacement", columns.wanted or own)
    time = clock_of(table, Columns(time=clock)).get("time_s")
    if needs_time(actuator) and time is None:
        raise ModelError(
            argument=str(trajectory), got="no time column", need="one: this model depends on time", hint="add time_s"
        )
    begins, remarks = starts_of(known, start, [limits], columns)
    path = path + zero_of_path(actuator, limits, zero, begins[0])
    warmth = temperature_of(known, None, columns, table, path.size, remark=run.note)
    rows = path[:, None]
    for remark in [*remarks, *reach_remarks(actuator, known.targets(rows).T[0], limits, zero, warmth)]:
        run.note(remark)
    (slew,) = known.slews([] if slew_rate is None else [slew_rate])
    return known.planned(plan_path, rows, [limits], [slew.bound], time=time, temperature=warmth, start=begins)[0]


@command("check")
@click.argument("model", type=INPUT)
@click.argument("record", type=INPUT)
@number("--goal", help="Largest error [% of the stroke] of a model that is still true; default: the model's, or 1.")
@option("--log", type=CONTINUED, help="Append the check to this table (CSV), one row an axis; --force begins it anew.")
@columns_option
def check(run: Run, model: Path, record: Path, goal: float | None, log: Path | None, columns: Columns) -> Result:
    """Check whether a MODEL is still true by a new RECORD of its actuator: its present error, and what has changed.

    The status is 0 if the model is still true, 1 if not.
    """
    before = None if log is None else read_log(log, again=run.force)
    known = AxesModel.read(run, model)
    known.demand(columns, RECORD, "on a record")
    measured = known.record(run, record, columns)
    if known.stage is None:
        found = [check_one(known.actuators[0], measured, goal=goal)]
        coupling, good = None, found[0].good
    else:
        stage = check_one(known.stage, measured, goal=goal)
        found, coupling, good = [*stage.rechecks], stage.as_dict(), stage.good
    if log is not None and before is not None:
        append_checks(log, before, dict(zip(known.axes, found, strict=True)))
    lines: list[str] = []
    warnings: list[str] = []
    for axis, recheck in zip(known.axes, found, strict=True):
        warnings += [f"{axis}: {recheck.mismatch}" if axis else recheck.mismatch] if recheck.mismatch else []
        lines += [f"Axis {axis}", *_check_lines(recheck), ""] if axis else _check_lines(recheck)
    if coupling is None:
        return Result(found[0].as_dict(), [*lines, *files(Log=log)], warnings=warnings, good=good)
    lines.append("Coupling: changed" if coupling["changes"] else "Coupling: as in the model")
    lines += [*(f"  - {sentence}" for sentence in coupling["changes"]), *files(Log=log)]
    fields = {**coupling, "axes": known.by_axis([recheck.as_dict() for recheck in found])}
    return Result(fields, lines, warnings=warnings, good=good)


def _check_lines(recheck: Recheck) -> Iterator[str]:
    """Yield the judgement, possible changes, and the remarks."""
    yield recheck.sentence
    if recheck.mismatch:
        return
    yield from recheck.change_sentences()
    yield ""
    yield f"{'change':<8}{'now less then':>38}{'effect, % of the stroke':>26}"
    for change in recheck.changes:
        sign = "-" if change.value < 0 else "+"
        effect = f"{100 * change.effect / recheck.stroke:+.3f}"
        counts = "  counts" if change.counts else ""
        name = " and ".join(NOUNS[part] for part in change.parts)
        yield f"{name:<8}{sign + change.amount(recheck.stroke):>38}{effect:>26}{counts}"
    yield "  (A change counts if it exceeds three standard errors, and its effect a quarter of the goal.)"
    if recheck.remarks:
        yield ""
        yield from (f"  - {remark}" for remark in recheck.remarks)


@command("update")
@click.argument("model", type=INPUT)
@click.argument("record", type=INPUT)
@output("Write the new model here (JSON).")
@number("--goal", help="Largest error allowed [% of the stroke]; default: the model's, or 1.")
@columns_option
def update(run: Run, model: Path, record: Path, output: Path, goal: float | None, columns: Columns) -> Result:
    """Update a MODEL from a new RECORD of its actuator, even of a single loop, and report what has changed.

    If no updated model predicts the record better, the output is the old model; a record on which it does not keep its
    promise widens it. A record that clearly belongs to another actuator is refused. The coupling of several axes is
    checked, not changed. The status is 0 if the error on held-out parts and the promise are within the goal, else 1.
    """
    known = AxesModel.read(run, model)
    known.demand(columns, RECORD, "on a record")
    measured = known.record(run, record, columns)
    coupling: tuple[str, ...] = ()
    if known.stage is None:
        found = update_one(known.actuators[0], measured, goal=goal)
        found.actuator.save(output)
        fields, updates, good = found.as_dict(), [found], found.good
    else:
        stage = update_one(known.stage, measured, goal=goal)
        stage.stage.save(output)
        fields, updates, good = stage.as_dict(), [*stage.updates], stage.good
        coupling = stage.coupling_changes
    lines = known.prefixed(_update_lines(update) for update in updates)
    lines += files(Model=output)
    return Result({**fields, "output": str(output)}, lines, warnings=coupling, good=good)


def _update_lines(update: Update) -> Iterator[str]:
    """Yield the result, the promise, and the changes."""
    yield update.sentence
    if update.promise is not None:
        yield from update.promise.lines
    yield from update.sentences()
    yield from (f"  - {remark}" for remark in update.recheck.remarks)
